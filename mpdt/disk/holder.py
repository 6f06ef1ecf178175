"""Holder: which process writes a target, as its lock file says it, and whether it still lives."""

from __future__ import annotations

import json
import os
import re
import secrets
import socket
import sys
from dataclasses import asdict, dataclass
from datetime import datetime
from pathlib import Path

FORMAT = "mpdt-lock/1"
_LONGEST = 4096  # bytes that are read of a lock file


@dataclass(frozen=True)
class Holder:
    """What a lock file holds.

    Args:
        start: of the process, in the kernel's clock: ids are used again.
        since: local time at which it took the lock.
        command: program and verb; the other words may name what nobody else should read.
        token: part of the name of every temporary file it makes, unguessable.
    """

    pid: int
    host: str
    start: str
    since: str
    command: str
    token: str

    @classmethod
    def me(cls) -> Holder:
        program = Path(sys.argv[0] or "python").name
        verb = next((word for word in sys.argv[1:2] if re.fullmatch(r"[a-z]+", word)), "")
        return cls(
            os.getpid(), socket.gethostname(), _start_of(os.getpid()),
            datetime.now().astimezone().isoformat(timespec="seconds"),
            f"{program} {verb}".rstrip(), secrets.token_hex(8),
        )  # fmt: skip

    @classmethod
    def of(cls, content: bytes) -> Holder | None:
        """Undo `encoded`; None for anything else."""
        try:
            found = json.loads(content)
            ours = isinstance(found, dict) and found.pop("format", None) == FORMAT
            holder = cls(**found) if ours else None
        except (ValueError, TypeError, RecursionError):
            return None
        if holder is None or type(holder.pid) is not int or holder.pid < 1:
            return None
        words = (holder.host, holder.start, holder.since, holder.command, holder.token)
        if not all(isinstance(word, str) and word.isprintable() for word in words):
            return None
        return holder if re.fullmatch("[0-9a-f]{16}", holder.token) else None

    def encoded(self) -> bytes:
        return (json.dumps({"format": FORMAT, **asdict(self)}) + "\n").encode()

    def __str__(self) -> str:
        return f"process {self.pid} on {self.host}, since {self.since}: {self.command}"

    @property
    def is_here(self) -> bool:
        """Of this machine."""
        return self.host == socket.gethostname()

    @property
    def may_live(self) -> bool:
        """False only if that process is certainly gone; of another machine nobody knows."""
        if not self.is_here:
            return True
        try:
            os.kill(self.pid, 0)
        except ProcessLookupError:
            return False
        except PermissionError:
            pass  # another user's
        start = _start_of(self.pid)
        return start == self.start or "" in (start, self.start)


def read_holder(handle: int) -> Holder | None:
    """Who wrote an open lock file; None if nobody did yet.

    Raises: ValueError if it is no lock file.
    """
    content = os.pread(handle, _LONGEST, 0)
    holder = Holder.of(content)
    if content and holder is None:
        raise ValueError(f"{content[:40]!r}")
    return holder


def writer_of(target: Path) -> Holder | None:
    """Who writes that file or folder now; None if nobody does, or it cannot be told."""
    path = Path(os.path.realpath(target))
    try:
        handle = os.open(path.with_name(f".{path.name}.lock"), os.O_RDONLY | os.O_NONBLOCK)
    except OSError:
        return None
    try:
        holder = read_holder(handle)
    except (OSError, ValueError):
        return None
    finally:
        os.close(handle)
    return holder if holder is not None and holder.may_live else None


def _start_of(pid: int) -> str:
    """Ticks since boot at which a process began; "" where the kernel does not say."""
    try:
        text = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""
    words = text.rpartition(")")[2].split()  # none while the process goes
    return words[19] if len(words) > 19 else ""
