"""The log that can forget."""

import re

import pytest

from mpdt.errors import FormatError
from mpdt.train.fit import log as module
from mpdt.train.fit.log import MetricsLog


def test_metrics_log_forgets_what_came_after_a_checkpoint(tmp_path):
    log = MetricsLog(tmp_path / "metrics.jsonl")
    log.append({"phase": "x", "step": 1})
    size_bytes = log.size_bytes
    log.append({"phase": "x", "step": 2})
    log.cut(size_bytes)
    log.append({"phase": "x", "step": 3})
    assert log.records() == [{"phase": "x", "step": step} for step in (1, 3)]


def test_what_was_written_with_a_log_finds_it_or_says_so(tmp_path):
    log = MetricsLog(tmp_path / "metrics.jsonl")
    log.check(0)
    with pytest.raises(FormatError, match="line that ends at byte 1, found 0 bytes"):
        log.check(1)
    log.append({"phase": "x", "step": 1})
    whole = log.size_bytes
    log.check(whole)
    for wrong, said in ((whole + 1, f"found {whole} bytes"), (whole - 1, "none ends there")):
        with pytest.raises(FormatError, match=said):
            log.cut(wrong)
    assert log.size_bytes == whole
    log.put(whole, [{"phase": "x", "step": 2}])
    log.put(whole, [{"phase": "x", "step": 3}])
    assert [record["step"] for record in log.records()] == [1, 3]


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("[]", "Expected `object`"),
        ("{", "truncated"),
        ('{"phase": ' + "[" * 3000 + "]" * 3000 + "}", "nested deeper"),
        ('{"step": 1, "action_loss": 1.0}', "field `phase`"),
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


def test_lines_of_older_runs_without_prompt_tokens(tmp_path):
    path = tmp_path / "metrics.jsonl"
    path.write_text('{"phase": "student", "step": 1, "action_loss": 1.0, "rms_cross": NaN}\n')
    (record,) = MetricsLog(path).records()
    assert record["rms_cross"] is None
    path.write_text('{"phase": "student", "step": 1, "action_loss": NaN}\n')
    with pytest.raises(FormatError, match="got `null`"):
        MetricsLog(path).records()


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


def test_lines_of_one_start_tell_of_the_same_tasks(tmp_path):
    log = MetricsLog(tmp_path / "metrics.jsonl")
    for start, losses in (("a", [1.0, 2.0]), ("b", [1.0]), ("a", [1.0])):
        log.append({"phase": "adapt", "start": start, "step": 1, "losses": losses})
    with pytest.raises(FormatError, match="line 3: another number of tasks than before"):
        log.records()
