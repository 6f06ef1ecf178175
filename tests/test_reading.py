"""What a file is, is looked at before its format is tried."""

from __future__ import annotations

import bz2
import gzip
import io
import lzma
import tarfile
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mpdt.data.cli import main
from mpdt.errors import FormatError
from mpdt.reading import decode_json, read_json, told_by

LFS = b"version https://git-lfs.github.com/spec/v1\noid sha256:4d7a2146\nsize 12345\n"


def tar() -> bytes:
    stream = io.BytesIO()
    with tarfile.open(fileobj=stream, mode="w") as archive:
        archive.addfile(tarfile.TarInfo("x.pkl"))
    return stream.getvalue()


def zipped() -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        archive.writestr("x", "x")
    return stream.getvalue()


def array() -> bytes:
    stream = io.BytesIO()
    np.save(stream, np.zeros(3))
    return stream.getvalue()


KINDS: dict[str, tuple[Callable[[], bytes] | bytes, str]] = {
    "a git-lfs pointer": (LFS, "git lfs pull"),
    "a git-annex pointer": (b"/annex/objects/SHA256E-s3--12.pkl\n", "git annex get"),
    "a gzip file": (lambda: gzip.compress(b"x"), "gunzip"),
    "a bzip2 file": (lambda: bz2.compress(b"x"), "unpack"),
    "an xz file": (lambda: lzma.compress(b"x"), "unpack"),
    "a zip archive": (zipped, "unpack"),
    "a tar archive": (tar, "unpack"),
    "an HTML page": (b"\n<!DOCTYPE html><html><body>404", "download it again"),
    "XML": (b'<?xml version="1.0"?><Error/>', "download it again"),
    "a Parquet file": (b"PAR1\x15\x04", ""),
    "an array of numpy (.npy)": (array, ""),
    "a pickle": (b"\x80\x04K\x01.", ""),
    "text": (b"not it\n", ""),
    "an empty file": (b"", "copy it again"),
}
READ = {
    ".pkl": ("promptdt", ("a pickle", "text")),
    ".npy": ("mtdiff", ("an array of numpy (.npy)",)),
    ".hdf5": ("d4rl", ()),
    ".npz": ("npz", ("a zip archive",)),
    ".parquet": ("parquet", ("a Parquet file",)),
    ".json": ("minari", ("text",)),
    ".h5": ("", ()),
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("suffix", READ)
def test_a_file_of_another_kind_is_called_by_its_name(
    kind: str, suffix: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    content, todo = KINDS[kind]
    form, own = READ[suffix]
    names = {".pkl": "ant_dir-0-expert", ".npy": "reach-v2_prompt", ".parquet": "episodes",
             ".json": "metadata"}  # fmt: skip
    path = tmp_path / (names.get(suffix, "x") + suffix)
    path.write_bytes(content if isinstance(content, bytes) else content())
    words = ["show", str(path)]
    if form:
        words = ["import", str(path), "--from", form, "-o", str(tmp_path / "out.h5")]
        family = {"promptdt": "ant_dir", "mtdiff": "ml10", "d4rl": "ant_dir"}.get(form)
        words += ["--family", family] if family else []
        words += ["--task", "dir-07"] if form == "d4rl" else []
    assert main(words) == 1
    error = capsys.readouterr().err
    assert error.startswith("error: ") and str(path.parent) in error
    if kind not in own:
        assert f"found {kind}\n" in error, error
        assert todo in error
    assert not (tmp_path / "out.h5").exists()


def test_what_bytes_do_not_tell() -> None:
    assert told_by(b"\x00\x01\x02\xff") == ("", "")
    assert told_by(b'{"a": 1}')[0] == "text"


@pytest.mark.parametrize(
    "text",
    ["NaN", "[Infinity]", "1e400", '"\\ud800"', "[" * 60 + "]" * 60, "[" * 5000 + "]" * 5000,
     '{"a": ' + "9" * 400 + "}", "{", "", "\ufeff{}", '{"a": 1,}'],
)  # fmt: skip
def test_json_of_the_standard_only(text: str) -> None:
    with pytest.raises(ValueError):
        decode_json(text)
    assert decode_json('{"a": [1e-400, -9223372036854775807, "ä"]}')["a"][2] == "ä"


def test_a_file_of_json_holds_an_object(tmp_path: Path) -> None:
    path = tmp_path / "x.json"
    for text, told in (("[]", "not a JSON object; found list"), ("\0", "not JSON")):
        path.write_text(text)
        with pytest.raises(FormatError, match=told):
            read_json(path)
