"""Verbs that move data to another place and back: push and pull. Bodies import lazily."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from mpdt.data.verbs.options import Options
from mpdt.pace import Pace

Url = Annotated[Positional[str], arg(metavar="URL")]


@dataclass(frozen=True, kw_only=True)
class Push(Options):
    """Send a dataset file, or a folder that export wrote, to a URL.

    sftp://, webdav(s)://, s3://, gs://, az://, hf://datasets/OWNER/NAME, a mounted folder: all
    that fsspec knows, each with its own package. A SHA-256 goes beside it, what was sent is read
    back and compared, and a broken transfer goes on where it stopped.

    Examples:
      mpdt-data push cheetah_dir.h5 sftp://host/data/
      mpdt-data push cheetah_dir-parquet hf://datasets/me/cheetah_dir
      mpdt-data push ml10.h5 s3://bucket/ml10.h5 --replace
    """

    source: Annotated[Positional[Path], arg(metavar="FILE|FOLDER")]
    """What to send."""
    url: Url
    """Where it shall be; one that ends with / gets the name of what is sent."""
    replace: bool = False
    """Also if something else is there."""
    check: bool = True
    """Read back what was sent; otherwise only its size counts."""

    def run(self) -> None:
        from mpdt.data.remote.address import revealed
        from mpdt.data.remote.push import push

        found = push(
            self.source, revealed(self.url), replace=self.replace, check=self.check,
            tell=line_writer("push", self.say),
        )  # fmt: skip
        result = {
            "url": found.address,
            "files": found.num_files,
            "bytes": found.num_bytes,
            "moved_bytes": found.num_new_bytes,
            "checked": found.checked,
        }
        self.print(result, summary("pushed ", found.address, *list(result.values())[1:4]))


@dataclass(frozen=True, kw_only=True)
class Pull(Options):
    """Bring a dataset file, or an export that push sent, from a URL.

    It appears under its name when every byte is proved: by the SHA-256 beside it, or else by the
    file's own digests. A broken transfer goes on where it stopped if the source is unchanged.

    Examples:
      mpdt-data pull https://host/cheetah_dir.h5
      mpdt-data pull sftp://host/data/ml10.h5 -o data/ml10.h5 --locked
      mpdt-data pull hf://datasets/me/cheetah_dir -o cheetah_dir-parquet
    """

    url: Url
    """What to bring."""
    output: Annotated[str | None, arg(aliases=["-o"], metavar="FILE|FOLDER")] = None
    """Where to put it; default: its own name, here. A file goes into a folder that is there.
    Nothing is replaced."""
    locked: bool = False
    """Only what datasets.lock holds will do."""
    spec: Annotated[Path | None, arg(metavar="YAML")] = None
    """The datasets.yaml whose lock counts; default as in collect."""

    def run(self) -> None:
        from mpdt.data.lock.file import lock_path
        from mpdt.data.remote.address import revealed
        from mpdt.data.remote.pull import pull
        from mpdt.data.spec.catalog import load_catalog

        lock = lock_path(load_catalog(self.spec).path) if self.locked else None
        found = pull(
            revealed(self.url), None if self.output is None else Path(self.output), lock=lock,
            tell=line_writer("pull", self.say),
            inside=(self.output or "").endswith(("/", "/.")),  # which `Path` forgets
        )  # fmt: skip
        result = {
            "path": str(found.path),
            "files": found.num_files,
            "bytes": found.num_bytes,
            "moved_bytes": found.num_new_bytes,
            "proof": found.proof,
            "content_hash": found.content_hash or None,
        }
        text = summary("pulled ", str(found.path), *list(result.values())[1:4])
        if found.content_hash:
            text += f"   content {found.content_hash[:8]}"
        self.print(result, text)


def summary(verb: str, what: str, files: object, size: object, moved: object) -> str:
    """`pulled  x.h5   54.2 MB`, and how many of them were there already."""
    assert isinstance(files, int) and isinstance(size, int) and isinstance(moved, int)
    if not moved:
        verb = "nothing to do: there already "
    text = f"{verb} {what}   {size / 1e6:.1f} MB"
    if files > 1:
        text += f" in {files} files"
    return text + (f"   {(size - moved) / 1e6:.1f} MB were there already" if size > moved else "")


def line_writer(verb: str, say: Callable[[str], None]) -> Callable[[str, int, int | None], None]:
    """`pull     12.0 / 54.2 MB  x.h5`, once in 10 s, and where an interrupted one goes on."""
    pace = Pace()
    names: set[str] = set()

    def tell(name: str, done: int, size: int | None) -> None:
        goes_on = name not in names and done > 0
        names.add(name)
        if pace.is_time(anyway=goes_on):
            total = "?" if size is None else f"{size / 1e6:.1f}"
            say(f"{verb}     {done / 1e6:.1f} / {total} MB  {name}" + "  goes on" * goes_on)

    return tell
