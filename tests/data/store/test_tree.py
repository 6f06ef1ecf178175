"""Opening: nothing but groups and plain arrays of the format, each linked once, inside the file."""

from __future__ import annotations

import os
import socket
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

from mpdt.data.store.reader import open_dataset
from mpdt.data.store.seal import seal
from mpdt.data.verify.finding import Outcome
from mpdt.data.verify.verify import verify
from mpdt.errors import FormatError

SECRET = b"my private key " * 100


def again(file: h5py.File, name: str, **how: object) -> None:
    """The array of this name once more, kept in another way."""
    values = file[name][()]
    del file[name]
    file.create_dataset(name, data=values, **how)


def external(file: h5py.File) -> None:
    shape = file["steps/rewards"].shape
    del file["steps/rewards"]
    secret = str(Path(file.filename).parent / "secret.txt")
    file.create_dataset("steps/rewards", shape, "<f4", external=[(secret, 0, 4 * shape[0])])


def virtual(file: h5py.File) -> None:
    array = file["steps/rewards"]
    layout = h5py.VirtualLayout(array.shape, array.dtype)
    layout[:] = h5py.VirtualSource(Path(file.filename).parent / "other.h5", "steps/rewards",
                                   array.shape)  # fmt: skip
    del file["steps/rewards"]
    file.create_virtual_dataset("steps/rewards", layout)


def replaced_by(name: str, link: object) -> Callable[[h5py.File], None]:
    def change(file: h5py.File) -> None:
        if name in file:
            del file[name]
        file[name] = link

    return change


def far_away(file: h5py.File) -> None:
    """A soft link through an external one, as a path that looks like our own."""
    file["far"] = h5py.ExternalLink("other.h5", "/")
    replaced_by("steps/rewards", h5py.SoftLink("/far/steps/rewards"))(file)


def second_name(file: h5py.File) -> None:
    del file["episodes/obs_start"]
    file["episodes/obs_start"] = file["episodes/start"]


def circle(file: h5py.File) -> None:
    file["slices/all"] = file["/"]


def declared(shape: tuple[int, ...], **how: object) -> Callable[[h5py.File], None]:
    """A huge shape, and nothing behind it."""

    def change(file: h5py.File) -> None:
        del file["steps/observations"]
        file.create_dataset("steps/observations", shape, "<f4", **how)

    return change


def texts(file: h5py.File) -> None:
    """Many references to one long text."""
    path = file.filename
    del file["policies/name"]
    file["policies/name"] = np.array([b"x" * 30_000, *[b"y"] * 2], object)
    place = file["policies/name"].id.get_offset()
    file.close()
    data = bytearray(Path(path).read_bytes())
    one = np.frombuffer(data[place : place + 16], "<u4").copy()
    one[0] = 4_000_000_000
    data[place : place + 16] = one.tobytes()
    Path(path).write_bytes(data)


def compound(file: h5py.File) -> None:
    replaced_by("episodes/task", np.zeros(4, [("a", "<i4"), ("b", "<i4")]))(file)


def references(file: h5py.File) -> None:
    value = file["steps"].ref
    del file["episodes/task"]
    file.create_dataset("episodes/task", (4,), h5py.ref_dtype)[...] = value


def lists(file: h5py.File) -> None:
    del file["episodes/task"]
    file.create_dataset("episodes/task", (4,), h5py.vlen_dtype(np.dtype("<i4")))


ODD = {
    "another file's bytes": (external, "/steps/rewards is in another file"),
    "put together": (virtual, "/steps/rewards is put together from other arrays"),
    "a soft link": (replaced_by("steps/rewards", h5py.SoftLink("/steps/observations")),
                    "/steps/rewards is a link"),
    "a dead link": (replaced_by("slices/gone", h5py.SoftLink("/nowhere")),
                    "/slices/gone is a link"),
    "an external link": (replaced_by("stats", h5py.ExternalLink("other.h5", "/stats")),
                         "/stats is a link to another file"),
    "through another file": (far_away, "is a link"),
    "two names for one array": (second_name, "/episodes/start is a second name"),
    "a circle": (circle, "/slices/all is a second name"),
    "a named type": (lambda f: f.__setitem__("slices/type", np.dtype("<f4")),
                     "/slices/type is a named type"),
    "chunks": (lambda f: again(f, "steps/rewards", chunks=(2,)),
               "/steps/rewards is not contiguous"),
    "a filter": (lambda f: again(f, "tta/default/sim_rewards", compression="gzip"),
                 "/tta/default/sim_rewards is not contiguous"),
    "room to grow": (lambda f: again(f, "episodes/task", maxshape=(None,)), "is not contiguous"),
    "another array": (lambda f: f.__setitem__("steps/notes", np.zeros(3)),
                      "/steps/notes is no array of the format"),
    "another group": (lambda f: f.create_group("a/b/c"), "/a is no group of the format"),
    "a reward beside a set": (lambda f: f.__setitem__("tta/default/steps/rewards", np.zeros(3)),
                              "/tta/default/steps/rewards is no array of the format"),
    "nothing behind a shape": (declared((20_000_000, 2)), "/steps/observations is larger than"),
    "more than any disk": (declared((1 << 40, 1 << 20)), "/steps/observations is larger than"),
    "chunks behind a shape": (declared((1 << 40, 2), chunks=(4, 2)), "is not contiguous"),
    "one long text": (texts, "its arrays are larger than the file"),
    "a compound": (compound, "/episodes/task is neither numbers nor text"),
    "references": (references, "/episodes/task is neither numbers nor text"),
    "lists": (lists, "/episodes/task is neither numbers nor text"),
    "a table as attribute": (lambda f: f.attrs.__setitem__("name", ["a", "b"]),
                             "attribute 'name' of / is neither text nor a few numbers"),
    "an attribute of megabytes": (lambda f: f.attrs.__setitem__("name", "x" * 1_000_000),
                                  "attribute 'name' of / is longer than the format writes"),
    "a nested name": (lambda f: f.__setitem__("slices/../../x", np.arange(2)), "/slices/.. is no"),
}  # fmt: skip


@pytest.mark.parametrize("kind", ODD)
def test_what_no_file_of_ours_holds_is_refused(made, tmp_path, kind):
    change, text = ODD[kind]
    (tmp_path / "secret.txt").write_bytes(SECRET)
    (tmp_path / "other.h5").write_bytes(made.path.read_bytes())
    with h5py.File(made.path, "r+") as file:
        change(file)
    if kind not in ("an attribute of megabytes", "a table as attribute", "one long text"):
        with h5py.File(made.path, "r+") as file:  # as whoever means it would
            seal(file)
    with pytest.raises(FormatError) as caught:
        open_dataset(made.path)
    assert text in str(caught.value) and caught.value.hint
    assert [one.outcome for one in verify(made.path, only=["format"]).findings] == [Outcome.FAIL]


def test_the_seal_knows_links(made):
    """Their names and kinds; it stays what it was without any."""
    seals = set()
    for link in (None, h5py.SoftLink("/steps"), h5py.ExternalLink("steps", "/"),
                 h5py.SoftLink("/goals"), "hard"):  # fmt: skip
        with h5py.File(made.path, "r+") as file:
            if file.get("x", getlink=True):
                del file["x"]
            if link is not None:
                file["x"] = file["goals"] if link == "hard" else link
            seal(file)
            seals.add(file.attrs["seal"])
    assert len(seals) == 5


def test_pipes_sockets_and_devices_are_not_opened(tmp_path):
    os.mkfifo(tmp_path / "pipe.h5")
    end = socket.socket(socket.AF_UNIX)
    end.bind(str(tmp_path / "s.h5"))
    for path, kind in ((tmp_path / "pipe.h5", "named pipe"), (tmp_path / "s.h5", "socket"),
                       (Path("/dev/zero"), "device"), (tmp_path, "folder")):  # fmt: skip
        with pytest.raises(FormatError, match=f"a {kind}, not a file"):
            open_dataset(path)
    end.close()


NAMES = {
    "name": ["../OUT", "/etc/x", "a\\b", ".hidden", "", "x" * 200, "a\x1b[2Jb", "a\nb", "\u202eh5"],
    "version": ["1/0", "\x9b31m"],
    "family": ["cheetah_dir/../x"],
    "license": ["CC0\x07", "x" * 2000],
}


@pytest.mark.parametrize(("where", "name"), [(k, n) for k, names in NAMES.items() for n in names])
def test_names_that_lead_elsewhere(made, where, name):
    def change(file: h5py.File) -> None:
        file.attrs[where] = name

    refused(made.path, change, "licence" if where == "license" else where)


# A policy's name is shown, and leads nowhere.
@pytest.mark.parametrize(("kind", "name"), [
    ("task", "../x"), ("task", ""), ("task", "a\x1b]0;x\x07"), ("policy", "a\x1b]0;x\x07"),
])  # fmt: skip
def test_rows_that_lead_elsewhere(made, kind, name):
    def change(file: h5py.File) -> None:
        file[{"task": "tasks/name", "policy": "policies/name"}[kind]][0] = name

    refused(made.path, change, kind)


def test_slices_and_sets_that_lead_elsewhere(made):
    for group in ("slices", "tta"):
        content = made.path.read_bytes()
        for name in (".hidden", "a\x1bb", "x" * 130):

            def change(file: h5py.File, group: str = group, name: str = name) -> None:
                if group == "tta":
                    file.move("tta/default", f"tta/{name}")
                else:
                    file[f"slices/{name}"] = np.arange(2)
                    file[f"slices/{name}"].attrs["rule"] = "{}"

            refused(made.path, change, "slice" if group == "slices" else "TTA set")
            made.path.unlink()
            made.path.write_bytes(content)


def refused(path: Path, change: Callable[[h5py.File], None], kind: str) -> None:
    with h5py.File(path, "r+") as file:
        change(file)
        seal(file)
    with pytest.raises(FormatError, match=f"the {kind} (has characters|is longer|is no name)") as e:
        open_dataset(path)
    assert e.value.render().isprintable() or "\n" in e.value.render()
    assert not set("\x1b\x07\x9b\u202e") & set(e.value.render())
