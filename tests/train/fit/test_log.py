"""The log that can forget."""

import re

import pytest

from mpdt.errors import FormatError
from mpdt.train.fit import log as module
from mpdt.train.fit.log import MetricsLog


def test_metrics_log_forgets_what_came_after_a_checkpoint(tmp_path):
    log = MetricsLog(tmp_path / "metrics.jsonl")
    log.append({"step": 1})
    size_bytes = log.size_bytes
    log.append({"step": 2})
    log.cut(size_bytes)
    log.append({"step": 3})
    assert log.records() == [{"step": 1}, {"step": 3}]


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("[]", "Expected `object`"),
        ("{", "truncated"),
        ('{"phase": ' + "[" * 3000 + "]" * 3000 + "}", "recursion"),
        ('{"step": 1, "action_loss": 1.0}', "no `phase`"),
        ('{"phase": [], "step": 1}', "Expected `str`"),
        ('{"phase": "student", "action_loss": 1.0}', "no `step`"),
        ('{"phase": "student", "step": 1, "action_loss": [1.0]}', "Expected `float`"),
        ('{"phase": "adapt", "step": 1, "losses": [1.0]}', "no `start`"),
        ('{"phase": "adapt", "start": "x", "step": 1, "losses": [[1.0]]}', "Expected `float`"),
        ('{"phase": "infer", "task": "x"}', "no `weights`"),
        ('{"phase": "student", "step": 1, "action_loss": 1e400}', "out of range"),
        ("\x00", "invalid character"),
    ],
)
def test_a_line_that_is_none_of_ours_is_one_error_with_its_number(tmp_path, line, said):
    path = tmp_path / "metrics.jsonl"
    path.write_text('{"phase": "student", "step": 1, "action_loss": 1.0}\n' + line + "\n")
    with pytest.raises(FormatError, match=re.escape(said)) as raised:
        MetricsLog(path).records()
    assert f"{path}, line 2" in str(raised.value)


def test_a_last_line_that_a_kill_cut_off_is_left_out(tmp_path):
    path = tmp_path / "metrics.jsonl"
    path.write_text('{"phase": "x", "step": 1, "action_loss": 1.0}\n{"phase": "st')
    assert len(MetricsLog(path).records()) == 1


def test_a_log_is_on_the_disk_before_a_checkpoint_counts_on_it(tmp_path, monkeypatch):
    synced = []
    monkeypatch.setattr(module, "sync", synced.append)
    own = MetricsLog(tmp_path / "m.jsonl")
    own.sync()
    assert synced == [], "no log yet"
    own.append({"step": 1})
    assert synced == [], "not with every line"
    own.sync()
    own.cut(0)
    assert synced == [own.path, own.path]
