"""Tree: every object of one open HDF5 file, looked at once, and whether a file of ours has it.

HDF5 can point elsewhere and say anything of its size: links to other files and paths, arrays kept
in any file of the disk or put together from several, two names for one object, a shape of
terabytes without a byte behind it. A file of ours has groups and plain arrays, each linked once,
one array behind the other inside the file; whatever is not so is named and refused before a
number is read.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from math import prod
from typing import Any, BinaryIO

import h5py
import numpy as np
from h5py import h5a, h5d, h5g, h5l, h5o, h5s, h5t
from numpy.typing import NDArray

from mpdt.data.store import layout
from mpdt.errors import FormatError

_LINKS = {h5l.TYPE_SOFT: "SoftLink", h5l.TYPE_EXTERNAL: "ExternalLink"}
_TEXT_BYTES = 16
"""A text in an array is its length, and where in the file it is."""
MAPPED_BYTES = 1 << 20
"""Numbers of a table of that size or larger are a map of the file; smaller ones are read faster."""
_NUMBERS = (h5t.INTEGER, h5t.FLOAT, h5t.ENUM)  # a bool is an enum of two numbers


@dataclass(eq=False)
class Array:
    """One dataset of the file. `offset` is None where nothing is stored, or not in one piece.

    Args:
        stream: the bytes of the file, once it is known that the array lies in them.
    """

    path: str
    id: h5d.DatasetID = field(repr=False)
    stream: BinaryIO | None = field(default=None, repr=False)

    @cached_property
    def dtype(self) -> np.dtype[Any]:
        return self.id.dtype  # type: ignore[no-any-return]

    @cached_property
    def shape(self) -> tuple[int, ...]:
        return self.id.shape  # type: ignore[no-any-return]

    @property
    def nbytes(self) -> int:
        """Of the numbers, or of the references to the texts; a Python number, so without limit."""
        return prod(self.shape) * (_TEXT_BYTES if self.is_text else self.dtype.itemsize)

    @property
    def is_text(self) -> bool:
        return h5py.check_string_dtype(self.dtype) is not None

    @property
    def offset(self) -> int | None:
        return self.id.get_offset()  # type: ignore[no-any-return]

    @cached_property
    def values(self) -> Any:
        """All of it, read once or mapped; text as bytes objects.

        A map is private: whoever writes to it changes a copy of that page.
        """
        if self.is_text or self.dtype.kind not in "iufb":
            return h5py.Dataset(self.id)[()]
        if self.stream is not None and self.nbytes >= MAPPED_BYTES:
            at = self.offset
            if at is not None and at % self.dtype.itemsize == 0:
                return np.asarray(np.memmap(self.stream, self.dtype, "c", at, self.shape))
        values = np.empty(self.shape, self.dtype)
        self.id.read(h5s.ALL, h5s.ALL, values)
        return values

    def texts(self) -> tuple[str, ...]:
        """A column of text. Raises: UnicodeError."""
        return tuple(value.decode("utf-8") for value in self.values)


class Tree:
    """What is in `file`, by path without the leading slash; the root is "".

    groups, arrays: each under the first name that was met.
    odd: path -> what it is, for everything that is no group or array linked once: a soft link and
        its target, a second name for something, a named type.
    """

    def __init__(self, file: h5py.File, where: str) -> None:
        self.where, self.name = where, file.filename
        self.groups: dict[str, h5g.GroupID] = {"": h5g.open(file.id, b"/")}
        self.arrays: dict[str, Array] = {}
        self.odd: dict[str, list[str]] = {}
        self._attributes: dict[str, dict[str, Any]] = {}
        self._seen = {int(h5o.get_info(self.groups[""]).addr): "/"}
        self._walk("", self.groups[""])

    def _walk(self, above: str, group: h5g.GroupID) -> None:
        found: list[tuple[bytes, int, Any]] = []
        group.links.iterate(lambda name, info: found.append((name, info.type, info.u)), info=True)
        for name, kind, at in found:
            path = f"{above}/{_plain(name)}".lstrip("/")
            if kind != h5l.TYPE_HARD:
                self.odd[path] = [_LINKS.get(kind, "UserLink"), _target(group, name, kind)]
                continue
            if (other := self._seen.setdefault(int(at), path)) != path:
                self.odd[path] = ["HardLink", other]
                continue
            item = h5o.open(group, name)
            if isinstance(item, h5g.GroupID):
                self.groups[path] = item
                self._walk(path, item)
            elif isinstance(item, h5d.DatasetID):
                self.arrays[path] = Array(path, item)
            else:
                self.odd[path] = ["Datatype", ""]

    def below(self, group: str) -> dict[str, Array]:
        """The arrays right below a group, by their own name."""
        start = f"{group}/"
        return {
            path.removeprefix(start): array
            for path, array in self.arrays.items()
            if path.startswith(start) and "/" not in path.removeprefix(start)
        }

    def names(self, group: str) -> list[str]:
        """Of the groups right below a group."""
        start = f"{group}/"
        return [path.removeprefix(start) for path in self.groups
                if path.startswith(start) and "/" not in path.removeprefix(start)]  # fmt: skip

    def attributes(self, path: str) -> dict[str, Any]:
        """Of a group or an array, by name in alphabetical order; read once.

        Raises: FormatError for one that is no number, short list of numbers or text.
        """
        if path not in self._attributes:
            item = self.groups[path] if path in self.groups else self.arrays[path].id
            found = {}
            for index in range(h5a.get_num_attrs(item)):
                attribute = h5a.open(item, index=index)
                name = _plain(attribute.name)
                found[name] = _attribute(attribute, f"attribute '{name}' of /{path}", self.where)
            self._attributes[path] = dict(sorted(found.items()))
        return self._attributes[path]

    def text(self, group: str, key: str) -> str:
        """What `layout.write_text` stored.

        Raises: FormatError where there is neither attribute nor array, or no text in it;
            UnicodeError.
        """
        path = f"{group}/{key}".lstrip("/")
        value = self.attributes(group).get(key)
        if value is None and path in self.arrays and self.arrays[path].shape == ():
            value = self.arrays[path].values
        if value is None:
            raise FormatError(f"attribute '{key}' of /{group} is missing", where=self.where,
                              hint="the file is damaged or foreign; take another copy")  # fmt: skip
        if not isinstance(value, bytes | str):
            raise self._mistyped(group, key, "text", value)
        return value.decode("utf-8") if isinstance(value, bytes) else value

    def integers(self, group: str, key: str) -> list[int]:
        """A short list of whole numbers. Raises: FormatError for anything else."""
        value = self.attributes(group).get(key)
        if not (isinstance(value, np.ndarray) and value.dtype.kind in "iu"):
            raise self._mistyped(group, key, "whole numbers", value)
        return [int(number) for number in value]

    def _mistyped(self, group: str, key: str, wanted: str, value: Any) -> FormatError:
        return FormatError(f"attribute '{key}' of /{group} is not {wanted}", where=self.where,
                           found=ascii(value)[:60], hint=layout.FOREIGN_HINT)  # fmt: skip

    def json(self, group: str, key: str) -> dict[str, Any]:
        """What `layout.write_json` stored. Raises: FormatError for anything but a JSON object."""
        return layout.parse_json(self.text(group, key), f"{self.where}: /{group} {key}")

    def columns(
        self, group: str, columns: tuple[layout.Column, ...], sizes: dict[str, int] | None
    ) -> dict[str, Array]:
        """Compare one group with its columns; letters met first bind a size in `sizes`.

        `sizes` None: each array may have sizes of its own, only the number of axes counts.

        Returns: the columns that are there.
        Raises: FormatError naming the first missing array, wrong dtype or wrong shape.
        """
        present: dict[str, Array] = {}
        for column in columns:
            found = self.arrays.get(f"{group}/{column.path}")
            if found is None:
                if column.optional:
                    continue
                raise FormatError(f"dataset /{group}/{column.path} is missing", where=self.where,
                                  hint="the file is damaged or foreign; take another copy",
                                  )  # fmt: skip
            dtype, shape = found.dtype, found.shape
            if not (found.is_text if column.dtype == "str" else dtype == np.dtype(column.dtype)):
                raise FormatError(f"dataset /{found.path} has the wrong type", where=self.where,
                                  expected=column.dtype, found=str(dtype))  # fmt: skip
            bound = {} if sizes is None else sizes
            wanted = [bound.setdefault(letter, size) if isinstance(letter, str) else letter
                      for letter, size in zip(column.shape, shape, strict=False)]  # fmt: skip
            if len(shape) != len(column.shape) or list(shape) != wanted:
                letters = ", ".join(map(str, column.shape))
                raise FormatError(f"dataset /{found.path} has the wrong shape", where=self.where,
                                  expected=f"({letters}) = {wanted}",
                                  found=str(list(shape)))  # fmt: skip
            present[column.path] = found
        return present

    def check(self, stream: BinaryIO, size_bytes: int) -> None:
        """Is everything what the format knows, where it has to be, and no larger than the file?

        Args:
            stream: the bytes of the file, `size_bytes` many.
        Raises: FormatError naming the first object that is not.
        """
        if self.odd:
            path, (kind, target) = next(iter(self.odd.items()))
            what = {"SoftLink": "a link", "ExternalLink": "a link to another file",
                    "UserLink": "a link of a kind of its own",
                    "HardLink": "a second name", "Datatype": "a named type"}[kind]  # fmt: skip
            raise self._refused(path, f"is {what}", target)
        for path in self.groups:
            if path and not layout.GROUP_PATHS.fullmatch(path):
                raise self._refused(path, "is no group of the format")
        used = 0
        for path, array in self.arrays.items():
            if not layout.ARRAY_PATHS.fullmatch(path):
                raise self._refused(path, "is no array of the format")
            used += self._check_array(array, stream, size_bytes)
        if used > size_bytes:
            raise FormatError("its arrays are larger than the file", where=self.where,
                              expected=f"at most {size_bytes:,} bytes", found=f"{used:,}",
                              hint=layout.FOREIGN_HINT)  # fmt: skip

    def map_large(self, stream: BinaryIO) -> None:
        """From now on values of large tables are maps of `stream`; only after `check`."""
        for array in self.arrays.values():
            array.stream = stream

    def _check_array(self, array: Array, stream: BinaryIO, size_bytes: int) -> int:
        """Bytes that it takes. Raises: FormatError."""
        plan, kind = array.id.get_create_plist(), array.id.get_type()
        if (layout_class := plan.get_layout()) == h5d.VIRTUAL:
            raise self._refused(array.path, "is put together from other arrays (virtual)")
        if plan.get_external_count():
            raise self._refused(array.path, "is in another file", _plain(plan.get_external(0)[0]))
        if layout_class != h5d.CONTIGUOUS:  # only chunks can have filters
            raise self._refused(array.path, "is not contiguous")
        is_text = (type_class := kind.get_class()) == h5t.STRING and kind.is_variable_str()
        if not is_text and type_class not in _NUMBERS:
            raise self._refused(array.path, "is neither numbers nor text", str(array.dtype))
        if not (nbytes := array.nbytes):
            return 0
        at = array.offset
        if at is None or at + nbytes > size_bytes:
            raise FormatError(f"/{array.path} is larger than what the file holds of it",
                              where=self.where, expected=f"{nbytes:,} bytes",
                              found="none" if at is None else f"{max(0, size_bytes - at):,}",
                              hint=layout.FOREIGN_HINT)  # fmt: skip
        if not is_text:
            return nbytes
        stream.seek(at)
        entries: NDArray[Any] = np.frombuffer(stream.read(nbytes), "<u4").reshape(-1, 4)
        return nbytes + int(entries[:, 0].sum(dtype=np.int64))

    def _refused(self, path: str, what: str, found: str = "") -> FormatError:
        return FormatError(f"/{path} {what}", where=self.where, found=found,
                           expected="groups and plain arrays of the format, inside the file",
                           hint=layout.FOREIGN_HINT)  # fmt: skip


def _plain(name: bytes) -> str:
    """As h5py does: bytes that are no text stay visible and distinct."""
    return name.decode("utf-8", "surrogateescape")


def _target(group: h5g.GroupID, name: bytes, kind: int) -> str:
    if kind not in _LINKS:
        return ""
    value = group.links.get_val(name)
    parts = value if isinstance(value, tuple) else (value,)
    return " ".join(_plain(bytes(part)) for part in parts)


def _attribute(attribute: h5a.AttrID, name: str, where: str) -> Any:
    """A text as bytes, a number or numbers (n,)."""
    kind, shape, limit = attribute.get_type(), attribute.shape, layout.ATTRIBUTE_LIMIT_BYTES
    good = (kind.get_class() == h5t.STRING and shape == ()) or (
        kind.get_class() in _NUMBERS and shape is not None and len(shape) <= 1
    )
    if not good or prod(shape) * attribute.dtype.itemsize > limit:
        raise FormatError(f"{name} is neither text nor a few numbers", where=where,
                          found=f"shape {shape}", hint=layout.FOREIGN_HINT)  # fmt: skip
    holder = np.empty(shape, attribute.dtype)
    attribute.read(holder)
    value = holder[()]
    if isinstance(value, bytes) and len(value) > limit:
        raise FormatError(f"{name} is longer than the format writes", where=where,
                          expected=f"at most {limit:,} bytes", found=f"{len(value):,}",
                          hint=layout.FOREIGN_HINT)  # fmt: skip
    return value
