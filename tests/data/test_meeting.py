"""Writers that meet: one waits or is told, nothing is lost, what came meanwhile is not replaced."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace as replace_holder
from pathlib import Path
from typing import Any

import pytest

from mpdt.data.cli import main
from mpdt.data.collect.collect import collect
from mpdt.data.collect.job import make_job
from mpdt.data.collect.parts import PartsFolder
from mpdt.data.exchange import formats, incoming
from mpdt.data.exchange.selection import Selection
from mpdt.data.remote.pull import pull
from mpdt.data.slices import split as split_module
from mpdt.data.slices.cut import Cut, cut_file
from mpdt.data.slices.split import split
from mpdt.data.slices.standard import standard_additions as additions
from mpdt.data.spec.entry import DatasetSpec
from mpdt.data.store.amend import add_slice
from mpdt.data.store.reader import open_dataset
from mpdt.disk import replace
from mpdt.disk.holder import Holder
from mpdt.errors import BusyError, DataError


class Gate:
    """Holds the first call of a function until it is let go."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self.reached, self.open = threading.Event(), threading.Event()
        self._function = function

    def __call__(self, *args: Any) -> Any:
        if not self.reached.is_set():
            self.reached.set()
            assert self.open.wait(60)
        return self._function(*args)


@contextmanager
def meeting(
    monkeypatch: pytest.MonkeyPatch, first: Callable[[], Any], second: Callable[[], Any]
) -> Iterator[tuple[Future[Any], Future[Any]]]:
    """Both in threads of their own, which is like processes: the second begins while the first
    has everything but the last step behind it."""
    gate = Gate(replace.sync)
    monkeypatch.setattr(replace, "sync", gate)
    monkeypatch.setattr(replace, "sync_tree", lambda folder: gate(folder))
    with ThreadPoolExecutor(2) as pool:
        one = pool.submit(first)
        assert gate.reached.wait(60)
        two = pool.submit(second)
        threading.Timer(0.2, gate.open.set).start()
        yield one, two


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_two_slices_at_once_are_both_in_the_file(tiny_file, monkeypatch):
    def add(quality: str, name: str) -> Callable[[], Any]:
        return lambda: split(str(tiny_file), Cut(quality=quality), name=name)

    with meeting(monkeypatch, add("medium", "mine"), add("expert", "yours")) as (one, two):
        assert one.result()[0].slice == "mine" and two.result()[0].slice == "yours"
    assert {"mine", "yours"} <= set(open_dataset(tiny_file).slices)
    assert names(tiny_file.parent) == ["datasets.yaml", "tiny.h5"]


def test_two_cut_outs_at_once_are_one_file_and_one_refusal(tiny_file, monkeypatch):
    data, target = open_dataset(tiny_file), tiny_file.with_name("m.h5")

    def cut(quality: str) -> Callable[[], Any]:
        return lambda: cut_file(data, Cut(quality=quality), target)

    with meeting(monkeypatch, cut("medium"), cut("expert")) as (one, two):
        made = one.result()
        with pytest.raises(BusyError, match="meanwhile"):
            two.result()
    assert open_dataset(target).content_hash == made.content_hash
    assert names(target.parent) == ["datasets.yaml", "m.h5", "tiny.h5"]


def test_two_exports_at_once_are_one_whole_tree(tiny_file, monkeypatch):
    data, target = open_dataset(tiny_file), tiny_file.with_name("ex")

    def export(name: str) -> Callable[[], Any]:
        chosen = Selection(data, data.select(), "")
        return lambda: formats.write(name, chosen, target)

    with meeting(monkeypatch, export("npz"), export("parquet")) as (one, two):
        one.result()
        with pytest.raises(BusyError, match="meanwhile"):
            two.result()
    back = formats.read("npz", [target], None, "back")
    assert incoming.store(back, target.with_name("b.h5"), additions).content_hash == (
        data.content_hash
    )
    assert names(target.parent) == ["b.h5", "datasets.yaml", "ex", "tiny.h5"]


KILLED = """
import os, signal, shutil, sys
from mpdt.data.cli import main
from mpdt.data.store import amend
copy = shutil.copyfile
def half(source, target):
    content = open(source, "rb").read()
    open(target, "wb").write(content[: len(content) // 2])
    os.kill(os.getpid(), signal.SIGKILL)
amend.shutil.copyfile = half
main(sys.argv[1:])
"""


@pytest.mark.parametrize("locking", ["TRUE", "FALSE"])
def test_a_kill_in_the_middle_of_an_amendment_harms_nobody(tiny_file, locking):
    before = tiny_file.read_bytes()
    words = ["split", str(tiny_file), "--quality", "expert", "--name"]
    killed = subprocess.run(
        [sys.executable, "-c", KILLED, *words, "yours"], check=False, capture_output=True,
        env=os.environ | {"HDF5_USE_FILE_LOCKING": locking},
    )  # fmt: skip
    assert killed.returncode == -9 and tiny_file.read_bytes() == before
    assert len(names(tiny_file.parent)) == 4
    assert main([*words, "mine", "-q"]) == 0
    assert "mine" in open_dataset(tiny_file).slices
    assert names(tiny_file.parent) == ["datasets.yaml", "tiny.h5"]


def test_amending_through_a_link_keeps_link_and_mode(tiny_file):
    tiny_file.chmod(0o440)
    link = tiny_file.with_name("link.h5")
    link.symlink_to(tiny_file.name)
    assert main(["split", str(link), "--quality", "medium", "--name", "m", "-q"]) == 0
    assert link.is_symlink() and tiny_file.stat().st_mode & 0o777 == 0o440
    assert "m" in open_dataset(tiny_file).slices


def test_what_comes_during_an_import_stays(tiny_file):
    data, target = open_dataset(tiny_file), tiny_file.with_name("i.h5")
    formats.write("npz", Selection(data, data.select(), ""), tiny_file.with_name("ex"))
    found = formats.read("npz", [tiny_file.with_name("ex")], None, "i")

    def late(dataset: Any) -> Any:
        target.write_text("precious")
        return additions(dataset)

    with pytest.raises(BusyError, match="meanwhile"):
        incoming.store(found, target, late)
    assert target.read_text() == "precious"
    with pytest.raises(DataError, match="would replace"):
        incoming.store(found, target, additions)
    assert names(target.parent) == ["datasets.yaml", "ex", "i.h5", "tiny.h5"]


def test_what_comes_during_a_collection_stays_and_so_do_the_parts(
    tiny_spec: DatasetSpec, fakes, workplace: Path
):
    target = workplace / "late.h5"

    def late(progress: Any) -> None:
        if progress.done_blocks == 3:
            target.write_text("precious")

    with pytest.raises(BusyError, match="meanwhile"):
        collect(make_job(tiny_spec), target, workers=0, on_progress=late)
    assert target.read_text() == "precious"
    target.unlink()
    assert len(list((PartsFolder(target).path / "blocks").glob("*.npz"))) == 22
    assert collect(make_job(tiny_spec), target, workers=0).resumed_blocks == 22
    assert names(workplace) == ["datasets.yaml", "late.h5"]


def test_what_comes_during_a_pull_stays(tiny_file):
    target = tiny_file.with_name("p.h5")

    def late(name: str, done: int, size: int | None) -> None:
        target.write_text("precious")

    with pytest.raises(BusyError, match="meanwhile"):
        pull(str(tiny_file), target, tell=late)
    assert target.read_text() == "precious"
    target.unlink()
    assert pull(str(tiny_file), target).num_new_bytes == 0, "it goes on from what came"
    assert names(target.parent) == ["datasets.yaml", "p.h5", "tiny.h5"]


def test_a_default_name_replaces_the_same_cut_out_only(tiny_file, capsys):
    assert main(["split", "tiny.h5", "--quality", "medium", "-q"]) == 0
    assert main(["split", "tiny.h5", "--quality", "medium", "-q"]) == 0, "made again"
    words = ["merge", "tiny-medium.h5", "tiny.h5", "-o", "tiny-expert.h5", "-q"]
    assert main(words) == 0
    before = Path("tiny-expert.h5").read_bytes()
    assert main(["split", "tiny.h5", "--quality", "expert"]) == 1
    assert "split would replace another file" in capsys.readouterr().err
    assert Path("tiny-expert.h5").read_bytes() == before


def test_two_calls_of_add_slice_at_once_are_both_in_the_file(tiny_file, monkeypatch):
    def add(name: str) -> Callable[[], Any]:
        return lambda: add_slice(tiny_file, name, [0], {})

    with meeting(monkeypatch, add("mine"), add("yours")) as (one, two):
        one.result(), two.result()
    assert {"mine", "yours"} <= set(open_dataset(tiny_file).slices)


def test_a_slice_is_chosen_in_the_file_it_goes_into(tiny_file, monkeypatch):
    """Another file took its place between the first look and the hold."""
    few = cut_file(open_dataset(tiny_file), Cut(quality="expert"), tiny_file.with_name("few.h5"))
    holding = split_module.holding

    def late(path: Path, **options: Any) -> Any:
        if few.path.exists():
            few.path.replace(tiny_file)
        return holding(path, **options)

    monkeypatch.setattr(split_module, "holding", late)
    split(str(tiny_file), Cut(quality="expert"), name="all")
    found = open_dataset(tiny_file)
    assert found.slices["all"].tolist() == list(range(found.num_episodes))


@pytest.mark.parametrize("refused", ["export", "collect"])
def test_who_has_nothing_to_do_sweeps_what_a_killed_one_left(tiny_file, refused, capsys):
    """A kill between the last rename and giving the hold back, or while it finds it is too late."""
    target = tiny_file if refused == "collect" else tiny_file.with_name("ex")
    if refused == "export":
        assert main(["export", str(tiny_file), "--to", "npz", "-o", "ex", "-q"]) == 0
    dead = subprocess.Popen(["true"])
    dead.wait()
    me = replace_holder(Holder.me(), pid=dead.pid)
    (target.parent / f".{target.name}.lock").write_bytes(me.encoded())
    (target.parent / f".{target.name}.{me.token}.tmp").write_text("half")
    words = {"export": ["export", str(tiny_file), "--to", "npz", "-o", "ex"],
             "collect": ["collect", "tiny", "--workers", "0", "-o", str(tiny_file)]}  # fmt: skip
    assert main(words[refused]) == (1 if refused == "export" else 0)
    assert not [name for name in names(target.parent) if name.startswith(".")]
