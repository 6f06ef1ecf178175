"""mpdt-train as typed, in this process: words of a run of seconds, its exit code, its folder."""

import pytest

from mpdt.train.cli import main

QUICK = ["--preset", "smoke", "--threads", "1", "--statistics.batches", "1", "--evaluation.horizon",
         "3", "--evaluation.no-constants", "--multitask.log-every", "6"]  # fmt: skip


def call(*arguments):
    """Exit code of one call."""
    with pytest.raises(SystemExit) as stopped:
        main([str(argument) for argument in arguments])
    return stopped.value.code


def names_in(folder):
    return sorted(path.name for path in folder.iterdir())
