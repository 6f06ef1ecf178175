"""Place: the files behind one URL, through fsspec; every failure is one clear error.

A connection that broke is made again by `reconnect`. Credentials are the business of the
libraries: keys and known hosts in ~/.ssh, ~/.aws, the hub's own login, fsspec's configuration.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib import import_module
from itertools import count
from pathlib import Path
from typing import Any
from urllib.parse import quote, urlsplit

import fsspec
from fsspec.registry import known_implementations

from mpdt.data.remote import objects
from mpdt.data.remote.address import hidden, without_parameters, without_secrets
from mpdt.data.remote.failure import (
    NoRangesError,
    RefusedError,
    is_absence,
    missing_package,
    refusal,
    status_of,
)
from mpdt.disk import put_file, write_bytes
from mpdt.errors import MissingFileError, MpdtError, RemoteError, UsageError, unknown_name

CHUNK_BYTES = 1 << 18
MOST_TEXT_BYTES = 1 << 24  # of a list of sums; 100,000 files have one of 10 MB
_SECURE_SHELL = {"sftp", "ssh"}
_APPEND = {"file", "local", "memory", *_SECURE_SHELL}
_READ_ONLY, _WEBDAV = {"http", "https"}, ("webdav", "webdavs")
_WITH_HOST = {*_READ_ONLY, *_WEBDAV, *_SECURE_SHELL, "ftp"}
_HOST = re.compile(r"[\w.-]+|[\da-fA-F:.]+")
# What file systems call the state of a file. An access time is none.
_VERSIONS = ("ETag", "etag", "Content-MD5", "md5", "sha256", "blob_id", "oid", "mtime",
             "modified", "last_modified", "LastModified", "Last-Modified")  # fmt: skip


class Place:
    """Where a URL points.

    Args:
        url: with whatever secrets it has; `address` is without.
    Raises: UsageError for what is no URL, for an unknown protocol or one whose package is missing;
        RemoteError.
    """

    def __init__(self, url: str) -> None:
        self._url, self.address = url, hidden(url)
        _check(url, self.address)
        self.protocol = url.partition("://")[0] if "://" in url else "file"
        self.can_append = self.protocol in _APPEND
        self.is_read_only = self.protocol in _READ_ONLY
        self.is_store = self.protocol in objects.PROTOCOLS
        self.is_folder = self.protocol in ("file", "local")  # of this machine, or mounted
        self.fs: Any = None
        self.reconnect()

    def __enter__(self) -> Place:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def close(self) -> None:
        """Close what its library leaves open."""
        if self.fs is None:
            return
        if self.protocol in _SECURE_SHELL:
            self.fs.close()
        elif self.protocol in _WEBDAV:
            self.fs.client.http.close()

    def reconnect(self) -> None:
        """Connect, with nothing left of an earlier connection."""
        self.close()
        with self.told(connecting=True):
            options: dict[str, Any] = {"skip_instance_cache": True}
            if self.protocol in _WEBDAV:  # webdav4 does not read URLs
                host, _, self.path = self._url.partition("://")[2].partition("/")
                scheme = self.protocol.replace("webdav", "http")
                self.fs = fsspec.filesystem("webdav", base_url=f"{scheme}://{host}", **options)
                return
            if self.is_store:
                self.fs, self.path = objects.connect(self._url, self.address)
                return
            if self.protocol in _SECURE_SHELL:
                secure_shell = import_module("mpdt.data.remote.secure_shell")  # needs sshfs
                self.fs, self.path = secure_shell.connect(self._url)
                return
            self.fs, self.path = fsspec.url_to_fs(self._url, **options)

    def info(self, path: str) -> dict[str, Any] | None:
        """What is known of a file or folder: `type`, `size`, ...; None if it is not there."""
        with self.told():
            try:
                self.fs.invalidate_cache()
                found: dict[str, Any] = self.fs.info(path)
            except FileNotFoundError as error:
                if self.is_read_only and not is_absence(error):  # fsspec's word for any failure
                    raise
                return None
            return found

    def state(self, path: str) -> dict[str, Any] | None:
        """Size in bytes (None if the server does not say) and version of a file, as JSON values."""
        found = self.info(path)
        if found is None or found.get("type") == "directory":
            return None
        known = next((key for key in _VERSIONS if found.get(key)), None)
        version = f"{known} {found[known]}" if known else ""
        return {"size": found.get("size"), "version": version}

    def stream(self, path: str, offset: int = 0) -> Iterator[bytes]:
        """The bytes of a file from `offset` on. Raises: RemoteError, MissingFileError."""
        if not (offset and self.is_read_only):
            yield from self._stream(path, offset)
            return
        try:
            yield from self._stream(path, offset)
        except NoRangesError:  # it sends all of it again, and what is here already is passed over
            for chunk in self._stream(path, 0):
                yield chunk[offset:] if offset < len(chunk) else b""
                offset = max(0, offset - len(chunk))

    def _stream(self, path: str, offset: int) -> Iterator[bytes]:
        # One plain GET reads a whole file even from a server that knows no ranges.
        whole = {"block_size": 0} if self.is_read_only and not offset else {}
        with self.told(), self.fs.open(path, "rb", **whole) as file:
            if offset:
                file.seek(offset)
            for size in self._sizes():
                if not (chunk := file.read(size)):
                    return
                yield chunk

    def _sizes(self) -> Iterator[int]:
        """Bytes to ask for in one go.

        Over SFTP one go takes one round trip whatever its size, and is lost if the connection
        breaks: each is about half of what came before it.
        """
        grows = self.protocol in _SECURE_SHELL
        for number in count():
            yield CHUNK_BYTES << min(number, 5) if grows else CHUNK_BYTES

    def read(self, path: str) -> bytes | None:
        """A small file; None if it is not there. Some servers call that forbidden.

        Raises: RemoteError for one of over MOST_TEXT_BYTES, whatever its server announced.
        """
        content = b""
        try:
            for chunk in self.stream(path):
                content += chunk
                if len(content) > MOST_TEXT_BYTES:
                    raise RemoteError("too large for a list of sums", where=self.address,
                                      expected=f"at most {MOST_TEXT_BYTES:,} bytes",
                                      found="more")  # fmt: skip
        except (MissingFileError, RefusedError):
            return None
        return content

    def sha256(self, path: str) -> str:
        """Of what is there: read back, unless the hub computed it when it took the file."""
        known = ((self.info(path) or {}).get("lfs") or {}).get("sha256")
        if known:
            return str(known)
        found = hashlib.sha256()
        for chunk in self.stream(path):
            found.update(chunk)
        return found.hexdigest()

    def append(self, path: str, source: Path, offset: int) -> None:
        """Write `source` from `offset` on to the end of `path`, or from 0 to a new file."""
        with self.told(), source.open("rb") as local:
            local.seek(offset)
            self.make_folder(path)
            with self.fs.open(path, "ab" if offset else "wb") as file:
                for size in self._sizes():
                    if not (chunk := local.read(size)):
                        break
                    file.write(chunk)

    def put(self, path: str, source: Path) -> None:
        """Write a whole file in the way its protocol does best."""
        with self.told():
            if self.is_store:
                objects.write(self.fs, path, source)
                return
            self.make_folder(path)
            self.fs.put_file(str(source), path)

    def enter(self, name: str) -> None:
        """Point at `name` in the folder that this is."""
        self.path = f"{self.path.rstrip('/')}/{name}"
        self.address = f"{self.address.rstrip('/')}/{name}"

    def shown(self, path: str) -> str:
        """A path of this place to print or store; a web server's is a URL with its secrets."""
        return without_parameters(path) if self.protocol in _WEBDAV else hidden(path)

    def make_folder(self, path: str) -> None:
        """The folder of `path`; a refusal is left to the write. Object stores have none."""
        if self.is_store:
            return
        with suppress(OSError, NotImplementedError):
            self.fs.makedirs(path.rpartition("/")[0] or "/", exist_ok=True)

    def write(self, path: str, content: bytes) -> None:
        """Write a small file."""
        with self.told():
            self.make_folder(path)
            if self.is_folder:
                write_bytes(Path(path), content, amends=True)
                return
            if self.protocol in _SECURE_SHELL:  # its pipe_file cannot write to the root
                with self.fs.open(path, "wb") as file:
                    file.write(content)
                return
            self.fs.pipe_file(path, content)

    def rename(self, old: str, new: str) -> None:
        """In one step where the protocol has one; what was at `new` is gone."""
        with self.told():
            if self.protocol in _WEBDAV:
                self.fs.client.move(old, new, overwrite=True)  # its mv refuses to
            elif self.is_folder:
                put_file(Path(old), Path(new))
            elif self.is_store:
                objects.rename(self.fs, old, new)
            else:
                self.fs.mv(old, new)

    def remove(self, path: str) -> None:
        with self.told(), suppress(FileNotFoundError):
            if self.is_store:
                objects.remove(self.fs, path)
            else:
                self.fs.rm_file(path)

    @contextmanager
    def told(self, connecting: bool = False) -> Iterator[None]:
        """Turn what dozens of libraries raise into our errors, without secrets.

        `from None`: a traceback would quote the library's words, URL and all.
        """
        try:
            yield
        except MpdtError:
            raise
        except ImportError as error:
            raise missing_package(self.address, self.protocol, error) from None
        except Exception as error:  # noqa: BLE001  the libraries share no base class
            if connecting and isinstance(error, ValueError) and "not known" in str(error):
                raise unknown_name("protocol", self.protocol, known_implementations,
                                   where=self.address) from None  # fmt: skip
            if is_absence(error):
                raise MissingFileError("no such file", where=self.address) from None
            raise refusal(self.address, self._words(error.__cause__ or error), error) from None

    def _words(self, error: BaseException) -> str:
        text = without_secrets(str(error), self._url).strip()
        status = status_of(error)
        text = text or (f"status {status}" if status else "")
        return f"{type(error).__name__}: {text}"[:300] if text else type(error).__name__


def _check(url: str, address: str) -> None:
    """Raises: UsageError for what is meant to be a URL and none. Any other text is a path."""
    protocol, colon, rest = url.partition(":/")
    if not colon or not re.fullmatch(r"[A-Za-z][\w+.-]+", protocol) or Path(url).exists():
        return
    try:
        parts = urlsplit(url)
        host, _ = parts.hostname or "", parts.port
        mark = next((mark for mark in "?#" if mark in url), "")
    except ValueError:  # brackets, or a port that is no number
        host = mark = ""
    needs_host = protocol.lower() in _WITH_HOST
    if not rest.startswith("/") or (needs_host and not _HOST.fullmatch(host)):
        raise UsageError("not a URL", where=address,
                         expected="PROTOCOL://HOST/PATH, such as sftp://host/data/x.h5",
                         hint="marks in a user or password are escaped: %40 for @, %23 for "
                              "#" if "@" in url else "")  # fmt: skip
    if mark and protocol.lower() in _SECURE_SHELL:
        raise UsageError(f"a path of SFTP with a {mark}, which ends a path in a URL", where=address,
                         hint="choose a name without it; in a password it is "
                              f"{quote(mark)}")  # fmt: skip
