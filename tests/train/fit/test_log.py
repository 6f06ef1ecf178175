"""The log that can forget."""

from mpdt.train.fit.log import MetricsLog


def test_metrics_log_forgets_what_came_after_a_checkpoint(tmp_path):
    log = MetricsLog(tmp_path / "metrics.jsonl")
    log.append({"step": 1})
    size_bytes = log.size_bytes
    log.append({"step": 2})
    log.cut(size_bytes)
    log.append({"step": 3})
    assert log.records() == [{"step": 1}, {"step": 3}]
