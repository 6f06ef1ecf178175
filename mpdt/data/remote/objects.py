"""Object stores: s3:// and gs:// through pyarrow, which is installed already.

s3fs stays out: botocore wants a python-dateutil that our pins exclude. Credentials come from the
environment alone, never from a file in the home, never from the URL:

    AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY, AWS_SESSION_TOKEN
    AWS_REGION or AWS_DEFAULT_REGION, AWS_ENDPOINT_URL_S3 or AWS_ENDPOINT_URL (MinIO, Ceph, R2, ...)
    GOOGLE_APPLICATION_CREDENTIALS, STORAGE_EMULATOR_HOST

Without them a public bucket can still be read.
"""

from __future__ import annotations

import os
from contextlib import suppress
from datetime import timedelta
from pathlib import Path
from typing import Any

from mpdt.data.remote.address import hidden
from mpdt.errors import UsageError

PROTOCOLS = ("s3", "gs")
CONNECT_S, REQUEST_S, ATTEMPTS = 10.0, 60.0, 3
WRITE_BYTES = 1 << 23
_DENIED = ("ACCESS_DENIED", "SIGNATURE_DOES_NOT_MATCH", "INVALID_ACCESS_KEY_ID",
           "INVALID_CLIENT_TOKEN_ID", "EXPIRED_TOKEN", "HTTP status 400", "HTTP status 401",
           "HTTP status 403", "PERMISSION_DENIED", "UNAUTHENTICATED")  # fmt: skip


def connect(url: str, address: str) -> tuple[Any, str]:
    """fsspec's view of the store, and the path BUCKET/KEY.

    Raises: UsageError for a URL that holds credentials, or none of a bucket.
    """
    from fsspec.implementations.arrow import ArrowFSWrapper

    protocol, _, path = url.partition("://")
    if hidden(url) != url:
        raise UsageError("credentials do not belong into this URL", where=address,
                         expected=f"{protocol}://BUCKET/KEY",
                         hint="they come from the environment, see docs/remote.md")  # fmt: skip
    if not path.partition("/")[0]:
        raise UsageError("no bucket", where=address, expected=f"{protocol}://BUCKET/KEY")
    return ArrowFSWrapper(_s3() if protocol == "s3" else _gs()), path


def is_denied(error: BaseException) -> bool:
    """Whether the store knows who asks, or does not, and will not. pyarrow has no class for it."""
    return isinstance(error, OSError) and any(word in str(error) for word in _DENIED)


def is_absent(error: BaseException) -> bool:
    return isinstance(error, OSError) and any(
        word in str(error) for word in ("NO_SUCH_BUCKET", "NO_SUCH_KEY")
    )


def write(fs: Any, path: str, source: Path) -> None:
    """A whole object. One that breaks off is removed: closing a stream would make it look whole."""
    stream = fs.fs.open_output_stream(path, buffer_size=0)
    try:
        with source.open("rb") as local:
            while chunk := local.read(WRITE_BYTES):
                stream.write(chunk)
    except BaseException:
        with suppress(OSError):
            stream.close()
        with suppress(OSError):
            remove(fs, path)
        raise
    stream.close()


def remove(fs: Any, path: str) -> None:
    """Raises: OSError if it is still there.

    pyarrow then makes a folder of the key's parent, which not every store lets it.
    """
    try:
        fs.fs.delete_file(path)
    except OSError:
        if fs.exists(path):
            raise


def rename(fs: Any, old: str, new: str) -> None:
    """Copied by the store itself, which AWS does up to 5 GB; a store has no renaming."""
    fs.fs.copy_file(old, new)
    with suppress(OSError):
        remove(fs, old)


def _s3() -> Any:
    from pyarrow.fs import AwsStandardS3RetryStrategy, S3FileSystem

    # Sums of our own are compared anyway, and what AWS sends by default no MinIO of 2024 takes.
    os.environ.setdefault("AWS_REQUEST_CHECKSUM_CALCULATION", "when_required")
    os.environ.setdefault("AWS_RESPONSE_CHECKSUM_VALIDATION", "when_required")
    key, secret = os.environ.get("AWS_ACCESS_KEY_ID"), os.environ.get("AWS_SECRET_ACCESS_KEY")
    known: dict[str, Any] = {"anonymous": True}
    if key and secret:
        known = {"access_key": key, "secret_key": secret,
                 "session_token": os.environ.get("AWS_SESSION_TOKEN") or None}  # fmt: skip
    endpoint = os.environ.get("AWS_ENDPOINT_URL_S3") or os.environ.get("AWS_ENDPOINT_URL")
    region = os.environ.get("AWS_REGION") or os.environ.get("AWS_DEFAULT_REGION") or "us-east-1"
    return S3FileSystem(
        **known, region=region, endpoint_override=endpoint or None, background_writes=False,
        connect_timeout=CONNECT_S, request_timeout=REQUEST_S,
        retry_strategy=AwsStandardS3RetryStrategy(max_attempts=ATTEMPTS),
    )  # fmt: skip


def _gs() -> Any:
    from pyarrow.fs import GcsFileSystem

    known = bool(os.environ.get("GOOGLE_APPLICATION_CREDENTIALS"))
    emulator = os.environ.get("STORAGE_EMULATOR_HOST", "")
    scheme, _, host = emulator.rpartition("://")
    return GcsFileSystem(
        anonymous=not known, endpoint_override=host or None, scheme=scheme or "https",
        retry_time_limit=timedelta(seconds=REQUEST_S),
    )  # fmt: skip
