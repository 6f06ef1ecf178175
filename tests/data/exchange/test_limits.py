"""Small foreign files that announce much: refused before anything is read, and what is not ours
to read is not opened."""

from __future__ import annotations

import json
import os
import resource
import socket
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from mpdt.data.exchange.folder import files_below
from mpdt.data.exchange.hdf5 import array
from mpdt.errors import FormatError, MissingFileError

Make = Callable[..., Any]


@pytest.fixture
def exported(run: Make, collected: Path) -> Make:
    def export(to: str) -> Path:
        assert run("export", collected, "--to", to, "-o", "out") == 0
        return Path("out")

    return export


def one_more_member(path: Path, name: str, megabytes: int) -> None:
    """A deflated array of zeros, a thousandth of its size in the archive."""
    header = {"descr": "<f4", "fortran_order": False, "shape": (megabytes << 18,)}
    with (
        zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED) as archive,
        archive.open(f"{name}.npy", "w", force_zip64=True) as file,
    ):
        np.lib.format.write_array_header_1_0(file, header)
        for _ in range(megabytes):
            file.write(bytes(1 << 20))


def peak_kb() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def test_only_wanted_members_are_read(exported: Make, run: Make) -> None:
    path = exported("npz") / "tiny.npz"
    one_more_member(path, "notes", 300)
    before = peak_kb()
    assert run("import", path, "--from", "npz", "-o", "x.h5") == 0
    assert peak_kb() - before < 100_000


@pytest.mark.parametrize("name", ["rewards", "goals/values"])
def test_a_member_that_grows(
    exported: Make, run: Make, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    path = exported("npz") / "tiny.npz"
    with zipfile.ZipFile(path) as old, zipfile.ZipFile("new.npz", "w") as new:
        for info in old.infolist():
            if info.filename != f"{name}.npy":
                new.writestr(info, old.read(info))
    one_more_member(Path("new.npz"), name, 60)
    assert run("import", "new.npz", "--from", "npz", "-o", "x.h5") == 1
    assert f"array {name} is" in capsys.readouterr().err


def test_a_table_of_equal_rows(
    exported: Make, run: Make, capsys: pytest.CaptureFixture[str]
) -> None:
    """Ten million equal rows take some kilobytes."""
    folder = exported("parquet")
    table = pq.read_table(folder / "goals.parquet")
    many = {name: pa.chunked_array([pa.repeat(table[name][0], 10_000_000)])
            for name in ("dim", "task")}  # fmt: skip
    many["values"] = pa.chunked_array(
        [pa.FixedSizeListArray.from_arrays(pa.repeat(0.0, 10_000_000), 1)]
    )
    pq.write_table(pa.table(many), folder / "goals.parquet", compression="zstd")
    assert run("import", folder, "--from", "parquet", "-o", "x.h5") == 1
    assert "larger than a file of its size can hold" in capsys.readouterr().err


def test_a_flat_file_with_nothing_in_it(
    run: Make, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with h5py.File(tmp_path / "flat.hdf5", "w") as file:
        for name in ("observations", "next_observations", "actions", "rewards", "terminals"):
            file.create_dataset(name, (10**12,), "<f4", chunks=(1000,))
    words = ("--from", "d4rl", "--family", "cheetah_dir", "--task", "forward", "-o", "x.h5")
    assert run("import", tmp_path / "flat.hdf5", *words) == 1
    assert "terminals is larger than its file can hold" in capsys.readouterr().err


def test_pipes_sockets_and_dead_links_among_the_files(tmp_path: Path) -> None:
    folder = tmp_path / "in"
    (folder / "deep").mkdir(parents=True)
    (folder / "deep/a.pkl").touch()
    (tmp_path / "else").mkdir()
    (tmp_path / "else/b.pkl").touch()
    (folder / "linked").symlink_to(tmp_path / "else")
    (folder / "deep/circle").symlink_to(folder)
    found = files_below([folder], ".pkl")
    assert [path.relative_to(folder).as_posix() for path in found] == ["deep/a.pkl", "linked/b.pkl"]
    (folder / "gone.pkl").symlink_to("nowhere")
    with pytest.raises(MissingFileError, match="a link that leads nowhere; found nowhere"):
        files_below([folder], ".pkl")
    (folder / "gone.pkl").unlink()
    os.mkfifo(folder / "pipe.pkl")
    end = socket.socket(socket.AF_UNIX)
    end.bind(str(tmp_path / "s.pkl"))
    for path in (folder, folder / "pipe.pkl", tmp_path / "s.pkl", Path("/dev/zero")):
        with pytest.raises(FormatError, match=r"a (named pipe|socket|device), not a file"):
            files_below([path], ".pkl")
    end.close()


# Each name with every command that opens it.
@pytest.mark.parametrize(("name", "words"), [
    *((name, ("list",)) for name in ("x.h5", "datasets.yaml", "datasets.lock")),
    *(("x.h5", words) for words in (("show", "x.h5"), ("verify", "x.h5", "--locked"),
                                    ("split", "x.h5", "--quality", "expert"))),
    *((name, ("lock",)) for name in ("datasets.yaml", "datasets.lock")),
    ("datasets.yaml", ("plan", "cheetah_dir")), ("datasets.lock", ("verify", "x.h5", "--locked")),
])  # fmt: skip
def test_no_command_waits_for_a_pipe(run: Make, name: str, words: tuple[str, ...]) -> None:
    os.mkfifo(name)
    run(*words)  # that it comes back is the test


def test_a_few_stored_numbers_do_not_stand_for_millions(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "x.hdf5", "w") as file:
        rows = file.create_dataset("a", (10**7,), "<f4", chunks=(10**5,), compression="gzip")
        rows[: 10**5] = 0
        with pytest.raises(FormatError, match="a is larger than its file can hold"):
            array(file, "a", "x")
        dense = file.create_dataset("b", (10**5,), "<f4", compression="gzip")
        dense[:] = np.arange(10**5)
        assert array(file, "b", "x").sum() == dense[:].sum()


def test_metadata_without_end(run: Make, exported: Make) -> None:
    folder = exported("minari")
    path = next(folder.rglob("metadata.json"))
    path.write_text(json.dumps(json.loads(path.read_text()) | {"x": "[" * 50_000}))
    path.write_text("[" * 50_000)
    assert run("import", folder, "--from", "minari", "-o", "x.h5") == 1


def test_what_an_export_does_not_announce(
    exported: Make, run: Make, capsys: pytest.CaptureFixture[str]
) -> None:
    """Steps nobody asked about are an error, anything else is told."""
    folder = exported("parquet")
    shard = folder / "data/expert/train-00000-of-00001.parquet"
    (folder / "data/none").mkdir()
    names = ("train-00001-of-00002.parquet", "train-00001-of-00001.parquet", "z.parquet")
    others = [
        *map(shard.with_name, names),
        folder / "a.parquet",
        folder / f"data/none/{shard.name}",
    ]
    for path in others:
        path.symlink_to(shard.absolute())
        assert run("import", folder, "--from", "parquet", "-o", "x.h5") == 1
        assert f"{path}: not of the export that it lies in" in capsys.readouterr().err
        path.unlink()
    twice = pa.concat_tables([pq.read_table(shard, partitioning=None)] * 2)
    whole = shard.read_bytes()
    shard.unlink()
    assert run("import", folder, "--from", "parquet", "-o", "x.h5") == 2
    assert f"{shard}: steps of the export are missing" in capsys.readouterr().err
    pq.write_table(twice, shard, row_group_size=5)
    assert run("import", folder, "--from", "parquet", "-o", "x.h5") == 1
    assert f"{shard}: more row groups than the export has episodes" in capsys.readouterr().err
    shard.write_bytes(whole)
    (folder / "notes.txt").touch()
    assert run("import", folder, "--from", "parquet", "-o", "x.h5") == 0
    told = capsys.readouterr().err
    assert f"left out {folder / 'notes.txt'}: not of this format" in told and "README" not in told


@pytest.mark.parametrize("form", ["minari", "d4rl", "promptdt", "npz"])
def test_other_files_in_a_folder_are_told(
    exported: Make, run: Make, capsys: pytest.CaptureFixture[str], form: str
) -> None:
    folder = exported(form)
    capsys.readouterr()
    words = ("--family", "cheetah_dir", "--horizon", 5) if form in ("d4rl", "promptdt") else ()
    assert run("import", folder, "--from", form, *words, "-o", "x.h5") == 0
    assert "left out out" not in capsys.readouterr().err
    (folder / "more.tar.gz").touch()
    assert run("import", folder, "--from", form, *words, "-o", "y.h5") == 0
    assert f"left out {folder / 'more.tar.gz'}: not of this format" in capsys.readouterr().err


def test_members_of_one_name_and_of_other_names(
    exported: Make, run: Make, capsys: pytest.CaptureFixture[str]
) -> None:
    path = exported("npz") / "tiny.npz"
    one_more_member(path, "notes", 1)
    assert run("import", path, "--from", "npz", "-o", "x.h5") == 0
    assert f"left out of {path}: notes.npy" in capsys.readouterr().err
    with pytest.warns(UserWarning, match="Duplicate name"):
        one_more_member(path, "rewards", 1)
    assert run("import", path, "--from", "npz", "-o", "y.h5") == 1
    assert "two members are called rewards.npy" in capsys.readouterr().err


def test_names_that_no_disk_takes(run: Make, capsys: pytest.CaptureFixture[str]) -> None:
    long = "x" * 3000
    for words in (("show", long), ("show", f"a.h5:{long}"), ("list", "--dir", long),
                  ("list", "--spec", long), ("import", long, "--from", "npz", "-o", "x.h5"),
                  ("merge", long, long, "-o", long), ("push", long, "memory://x"),
                  ("pull", "memory://x", "-o", long), ("export", long, "--to", "npz")):  # fmt: skip
        assert run(*words) in (1, 2)
        told = capsys.readouterr().err
        assert told.startswith("error: ") and len(told) < 1500, words
