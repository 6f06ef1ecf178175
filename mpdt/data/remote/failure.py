"""What dozens of libraries raise about another place, as one of our errors.

They share no base class: fsspec's HTTP raises FileNotFoundError whatever went wrong, webdav4,
asyncssh, httpx and pyarrow have errors of their own.
"""

from __future__ import annotations

import errno

from fsspec.registry import known_implementations

from mpdt.data.remote import objects
from mpdt.errors import MpdtError, RemoteError, StorageError, UsageError
from mpdt.reading import OWNER

# Of webdav4 and asyncssh, which need not be installed.
_ABSENT = {"ResourceNotFound", "SFTPNoSuchFile", "SFTPNoSuchPath"}
_DISK = {
    errno.ENOSPC: "the disk there is full", errno.EDQUOT: "the disk there is full",
    errno.EROFS: "the disk there is read-only",
}  # fmt: skip
_LOCKED = "a key with a passphrase is used through ssh-agent alone, or FSSPEC_SFTP_PASSPHRASE"


class RefusedError(RemoteError):
    """The other side knows who asks, or does not, and will not."""


class NoRangesError(RemoteError):
    """A web server that sends whole files only."""


def missing_package(address: str, protocol: str, error: ImportError) -> MpdtError:
    """fsspec names the package of every protocol it knows; its own for SFTP is not ours."""
    known = known_implementations.get(protocol, {}).get("err") or str(error)
    if protocol in ("sftp", "ssh"):
        known = str(error)
    return UsageError(f"{protocol} needs a package that is not installed", where=address,
                      found=known,
                      hint="install it with pip; 'mpdt[remote]' brings those of sftp, webdav "
                           "and http")  # fmt: skip


def status_of(error: BaseException | None) -> int | None:
    """Of an HTTP answer, in the ways of aiohttp, requests and httpx."""
    answer = getattr(error, "response", error)
    found = getattr(answer, "status", None) or getattr(answer, "status_code", None)
    return found if isinstance(found, int) else None


def is_absence(error: Exception) -> bool:
    """Whether the other side said that there is no such file.

    fsspec's HTTP raises FileNotFoundError whatever went wrong; its cause tells.
    """
    cause = error.__cause__
    if status_of(error) in (404, 410) or status_of(cause) in (404, 410):
        return True
    if objects.is_absent(error):
        return True
    if _ABSENT & {type(error).__name__, type(cause).__name__}:
        return True
    missing = (FileNotFoundError, NotADirectoryError)
    return isinstance(error, missing) and (cause is None or isinstance(cause, missing))


def refusal(address: str, words: str, error: Exception) -> MpdtError:
    if isinstance(error, ValueError) and "range requests" in str(error):
        return NoRangesError("the server sends whole files only", where=address, found=words)
    name = type(error).__name__
    denied = isinstance(error, PermissionError) or "Authentication" in name or "Denied" in name
    if (
        denied
        or objects.is_denied(error)
        or {status_of(error), status_of(error.__cause__)} & {401, 403}
    ):
        hint = "credentials come from the library's own places, see docs/remote.md"
        if address.startswith(("sftp:", "ssh:")):
            hint += f"; {_LOCKED}"
        elif "://" not in address:
            hint = OWNER
        return RefusedError("no permission", where=address, found=words, hint=hint)
    if isinstance(error, OSError) and error.errno in _DISK:
        return StorageError(_DISK[error.errno], where=address, found=words,
                            hint="with room the same command goes on from here")  # fmt: skip
    if name == "SFTPFailure":
        return RemoteError("the server says that it failed", where=address, found=words,
                           hint="it may have no room; with room the same command goes on "
                                "from here")  # fmt: skip
    return RemoteError("cannot be reached, or the connection broke", where=address, found=words,
                       hint="the same command goes on from here")  # fmt: skip
