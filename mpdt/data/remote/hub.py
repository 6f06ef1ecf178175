"""Hub: many files as one commit to the Hugging Face hub, through its own library."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from mpdt.errors import UsageError, quoted

if TYPE_CHECKING:
    from mpdt.data.remote.place import Place


Kind = Literal["dataset", "model"]
"""What a repository holds: data, or a policy."""
_ADDRESSES: dict[Kind, str] = {
    "dataset": "hf://datasets/OWNER/NAME[/PATH]", "model": "hf://OWNER/NAME[/PATH]",
}  # fmt: skip


def commit(
    place: Place, files: Mapping[str, Path], list_path: str, listed: bytes, kind: Kind
) -> int:
    """Send files and their list of sums, all at once or not at all; returns the bytes sent.

    The library sends large files in pieces and does not send again what the hub has, so that a
    broken commit is repeated cheaply. Its token comes from `hf auth login` or HF_TOKEN.

    Raises: UsageError if the repository does not exist: who may read it is for its owner to
        say. RemoteError.
    """
    from huggingface_hub import CommitOperationAdd, HfApi
    from huggingface_hub.errors import RepositoryNotFoundError

    if _kind_of(place.address) != kind:
        raise UsageError(f"not a {kind} repository", where=place.address,
                         expected=_ADDRESSES[kind])  # fmt: skip
    contents: dict[str, Path | bytes] = {**files, list_path: listed}
    with place.told():
        try:
            target = place.fs.resolve_path(list_path)
            operations = [
                CommitOperationAdd(place.fs.resolve_path(path).path_in_repo, content)
                for path, content in contents.items()
            ]
            HfApi(place.fs.endpoint, place.fs.token).create_commit(
                target.repo_id, operations, repo_type=target.repo_type, revision=target.revision,
                commit_message=f"{len(files)} file{'s' * (len(files) != 1)} from mpdt",
            )  # fmt: skip
        except (RepositoryNotFoundError, FileNotFoundError):
            raise UsageError("no such repository, or none that you may write to",
                             where=place.address,
                             hint=f"hf repo create OWNER/NAME --repo-type {quoted(kind)}; "
                                  "--private if it is not for all") from None  # fmt: skip
    return sum(path.stat().st_size for path in files.values())


def _kind_of(address: str) -> str:
    first = address.removeprefix("hf://").partition("/")[0]
    return {"datasets": "dataset", "spaces": "space"}.get(first, "model")
