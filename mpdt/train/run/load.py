"""`mpdt.load_policy`: a bundle, the folder of a run, or an address. Light until data is needed.

policy = mpdt.load_policy("runs/cheetah_dir-base", task="forward")
observation, reward, over = env.reset(seed=0)[0], None, False
while not over:
    observation, reward, terminated, truncated, _ = env.step(policy.act(observation, reward))
    over = terminated or truncated
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from mpdt.errors import MissingFileError, UsageError, quoted
from mpdt.reading import refuse_closed
from mpdt.train.bundle.acting import ActingPolicy
from mpdt.train.bundle.read import is_bundle, read_bundle, read_config
from mpdt.train.bundle.select import policy_of_bundle, refuse_left_out

if TYPE_CHECKING:
    from mpdt.train.run.stored import Adaptation


def load_policy(
    run: Path | str, task: str | int | None = None, *, data: Path | str | None = None,
    start: str | Adaptation | None = None,
) -> ActingPolicy:  # fmt: skip
    """A trained policy, ready to act as one task of its data.

    A bundle, which every run leaves in its folder as policy/, needs no data, no trainer and no
    network. An address is fetched once and then found in the cache.

    Args:
        run: a bundle's folder, a run's, such as runs/cheetah_dir-base, or an address of a bundle:
            hf://OWNER/NAME, s3://..., sftp://..., and what else `mpdt-train pull` takes.
        task: name or row; None = the first. One that was trained on acts behind its own prompt.
        data: FILE or FILE:slice a run was trained on, to adapt anew; None = the policy the run
            has left, or else the file of that name in the working folder or beside that of runs.
        start: act as `task`, a test task, adapted from there; "none" = P_c and the mean of all
            P_k. None = the own prompt, or "none" for a task that was not trained on. A function
            is an adaptation of your own, see `Adaptation`.
    Raises: MissingFileError; UsageError for a task without prompt and an unknown family;
        TrainingError or FormatError for weights of other data or settings, and for a bundle that
        is not as it was written; StorageError; as `open_dataset`; RemoteError.
    """
    folder = local_folder(run)
    found = _bundle_in(folder)
    if found is not None and data is None and not callable(start):
        config = read_config(found)
        refuse_left_out(config, start)
        starts = [one.name for one in config.prompts]
        # A start that the run did not try: the run itself may still know its data.
        if found == folder or start is None or start in starts:
            return policy_of_bundle(read_bundle(found), task, start)
    if found == folder:
        raise UsageError("a bundle adapts no more", where=str(folder),
                         expected="start=, as the bundle names it",
                         hint="load the folder of the run it is from")  # fmt: skip
    if not folder.exists():
        raise MissingFileError("no such folder", where=str(folder),
                               expected="a bundle or the folder of a run")  # fmt: skip
    from mpdt.train.run.folder import RunFolder
    from mpdt.train.run.stored import policy_of_run

    return policy_of_run(RunFolder(folder), task, data, start)


def bundle_folder(where: str) -> Path:
    """The bundle's folder at an address, in a folder or in that of a run.

    Raises: MissingFileError; StorageError; RemoteError.
    """
    folder = local_folder(where)
    found = _bundle_in(folder)
    if found is not None:
        return found
    hint = f"mpdt-train bundle {quoted(folder)} -o {quoted(f'{folder.name}-policy')}"
    raise MissingFileError("no bundle here", where=str(folder), expected="a bundle, or the folder "
                           "of a run with one", hint=hint if folder.is_dir() else "")  # fmt: skip


def _bundle_in(folder: Path) -> Path | None:
    """Of one that the system will not list nothing says that no bundle is in it."""
    for place in (folder, folder / "policy"):
        if place.is_dir():
            refuse_closed(place)
        if is_bundle(place):
            return place
    return None


def local_folder(run: Path | str) -> Path:
    """Where a bundle or run lies here; an address is fetched. Raises: RemoteError."""
    if "://" not in str(run):
        return Path(run)
    from mpdt.train.bundle.travel import fetched

    return fetched(str(run))
