"""A run's folder in which one thing is closed is refused before hours of work, and kept."""

from __future__ import annotations

from rights import without_rights

from .command import QUICK, call

CLOSED = {
    "config.json": 0, "results.json": 0, "weights.safetensors": 0, "metrics.jsonl": 0o444,
    "policy": 0, "judged": 0o555,
}  # fmt: skip


def test_it_is_told_what_is_closed(tiny_file, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    run = tmp_path / "r"
    assert call("--data", tiny_file, *QUICK, "--runs-dir", tmp_path, "--name", "r", "-q") == 0
    (run / "judged").mkdir()
    before = sorted(path.name for path in run.rglob("*"))

    def told(*words):
        capsys.readouterr()
        with without_rights():
            code = call(*words)
        return code, capsys.readouterr().err

    for name, mode in CLOSED.items():
        (run / name).chmod(mode)
        words = ["evaluate", "r", "--data", tiny_file, "-q", "--evaluation.seed", "5"]
        code, err = told(*words)
        assert code == 1 and err.startswith(f"error: r/{name}: "), err
        if name == "policy":
            words = ["rollout", "r", "-q", "-o", "a.h5"]
            assert "cannot be opened" in told(*words)[1]
        assert err.splitlines()[1] == "hint:  ask whoever owns it (ls -ld shows who)"
        (run / name).chmod(0o755)
        assert sorted(path.name for path in run.rglob("*")) == before
