from __future__ import annotations

from pathlib import Path

import msgspec
import pytest
import torch
from safetensors.torch import save_file

from mpdt.errors import FormatError, MissingFileError, ShapeError, StorageError
from mpdt.model.weights import WeightsHeader, load_weights, module_shapes, save_weights

TENSORS = {"cross": torch.arange(6.0).reshape(2, 3), "table": torch.ones(4)}
HEADER = WeightsHeader(kind="mpdt", hashes={"backbone": "aa"}, settings={"rank": 1})


@pytest.fixture
def path(tmp_path: Path) -> Path:
    target = tmp_path / "run" / "weights.safetensors"
    save_weights(target, TENSORS, HEADER)
    return target


def test_round_trip(path: Path) -> None:
    header, tensors = load_weights(
        path, kind="mpdt", hashes={"backbone": "aa"}, shapes={"cross": (2, 3), "table": (4,)}
    )
    assert header == HEADER
    assert tensors.keys() == TENSORS.keys()
    assert all(torch.equal(tensors[name], TENSORS[name]) for name in TENSORS)
    assert [file.name for file in path.parent.iterdir()] == ["weights.safetensors"]


def test_shared_and_transposed_memory_can_be_saved(tmp_path: Path) -> None:
    base = torch.arange(6.0).reshape(2, 3)
    save_weights(tmp_path / "w", {"a": base, "b": base, "c": base.T}, HEADER)
    assert torch.equal(load_weights(tmp_path / "w")[1]["c"], base.T)


def test_other_hash_kind_and_shape_are_refused(path: Path) -> None:
    with pytest.raises(FormatError, match="trained on another backbone; expected bb, found aa"):
        load_weights(path, hashes={"backbone": "bb"})
    with pytest.raises(FormatError, match="found nothing recorded"):
        load_weights(path, hashes={"data": "cc"})
    with pytest.raises(FormatError, match="expected teacher, found mpdt"):
        load_weights(path, kind="teacher")
    with pytest.raises(
        ShapeError, match=r"'cross' does not fit; expected \(2, 4\), found \(2, 3\)"
    ):
        load_weights(path, shapes={"cross": (2, 4), "table": (4,)})
    with pytest.raises(ShapeError, match="'table' does not fit; expected no such tensor"):
        load_weights(path, shapes={"cross": (2, 3)})
    with pytest.raises(ShapeError, match=r"'u' does not fit.*found no such tensor"):
        load_weights(path, shapes={"cross": (2, 3), "table": (4,), "u": (1,)})


def test_files_that_are_not_ours(path: Path, tmp_path: Path) -> None:
    with pytest.raises(MissingFileError, match="no such file of weights") as caught:
        load_weights(tmp_path / "nothing")
    assert "`mpdt-train --data FILE`" in caught.value.hint
    cut = tmp_path / "cut"
    cut.write_bytes(path.read_bytes()[:-5])
    with pytest.raises(FormatError, match="not a whole safetensors file"):
        load_weights(cut)
    foreign = tmp_path / "foreign"
    save_file(TENSORS, foreign)
    with pytest.raises(FormatError, match="not written by mpdt"):
        load_weights(foreign)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"format": "mpdt-weights/2", "kind": "mpdt"}', "expected mpdt-weights/1, found mpdt-w"),
        ('{"format": "mpdt-weights/1", "kind": 3}', "unreadable header"),
        ("not json", "unreadable header"),
    ],
)
def test_headers_that_cannot_be_read(tmp_path: Path, text: str, message: str) -> None:
    save_file(TENSORS, tmp_path / "w", metadata={"mpdt": text})
    with pytest.raises(FormatError, match=message):
        load_weights(tmp_path / "w")


def test_header_text_is_plain_json() -> None:
    assert msgspec.json.decode(msgspec.json.encode(HEADER)) == {
        "kind": "mpdt",
        "hashes": {"backbone": "aa"},
        "settings": {"rank": 1},
        "format": "mpdt-weights/1",
    }


def test_disk_that_refuses(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way of a folder")
    with pytest.raises(StorageError, match="cannot be written"):
        save_weights(tmp_path / "file" / "w", TENSORS, HEADER)


def test_module_shapes() -> None:
    assert module_shapes(torch.nn.Linear(3, 2)) == {"weight": (2, 3), "bias": (2,)}


def test_a_flipped_bit_of_a_number_is_found(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[-1] ^= 1  # the numbers stand at the end
    path.write_bytes(content)
    with pytest.raises(FormatError, match="not those that were written"):
        load_weights(path)


def test_a_changed_word_of_the_header_is_found(path: Path) -> None:
    """Another kind of the same length would be believed otherwise."""
    content = path.read_bytes()
    assert content.count(b"mpdt-weights/1") == 1 and b'\\"mpdt\\"' in content
    path.write_bytes(content.replace(b'\\"mpdt\\"', b'\\"mpdu\\"'))
    with pytest.raises(FormatError, match="not those that were written"):
        load_weights(path)
