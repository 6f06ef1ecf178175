"""SSH hosts: only those that ~/.ssh/known_hosts knows by the key they show.

fsspec's own way is to accept whoever answers, and then to send a password.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any


def known_hosts_only() -> Any:
    """A host key policy for fsspec's SFTP. Raises: ImportError without paramiko."""
    import paramiko

    from mpdt.errors import RemoteError

    class KnownHostsOnly(paramiko.MissingHostKeyPolicy):  # type: ignore[misc]
        def missing_host_key(self, client: Any, hostname: str, key: Any) -> None:
            """Called for every host, as fsspec loads no list of known ones."""
            path = Path("~/.ssh/known_hosts").expanduser()
            known = paramiko.HostKeys(str(path)) if path.exists() else paramiko.HostKeys()
            if known.check(hostname, key):
                return
            what = "another host key than the known one" if known.lookup(hostname) else (
                "an unknown host")  # fmt: skip
            raise RemoteError(what, where=hostname, found=f"{key.get_name()} {key.fingerprint}",
                              hint="connect once with ssh, which shows the key and asks; "
                                   f"it is kept in {path}")  # fmt: skip

    return KnownHostsOnly()
