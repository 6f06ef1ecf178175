"""The commands of mpdt-train that take a trained policy: one dataclass each, as in options.py."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

Said = Literal["nothing", "task id", "X", "X+rewards", "labelled steps", "demonstration"]


@dataclass(frozen=True)
class Evaluate:
    """Judge a stored run again without training, with other settings of judging.

    Every setting of --adapt, --few-shot, --statistics and --evaluation can be given. Somebody
    else's policy is judged by --policy in place of the folder.

    Examples:
      mpdt-train evaluate runs/ml10-base --data ml10.h5 --evaluation.episodes 50
      mpdt-train evaluate runs/ml10-base --data ml10.h5 --keep ml10-seen.h5
      mpdt-train evaluate runs/ml10-base --data ml10.h5 --json
    """

    folder: tyro.conf.Positional[Path]
    """The run's folder, such as runs/ml10-base."""
    data: str
    """FILE or FILE:slice it was trained on."""
    keep: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """Keep the episodes as data: with FILE.h5 in FILE-own.h5 (training tasks, behind their own
    prompts), FILE-cross.h5, ...; own episodes of trials in FILE-trials-alone-3-own.h5."""
    json: bool = False
    """Print results.json instead of tables."""
    quiet: Annotated[bool, tyro.conf.arg(aliases=["-q"])] = False
    """No progress on stderr."""
    verbose: Annotated[bool, tyro.conf.arg(aliases=["-v"])] = False
    """Show tracebacks."""


@dataclass(frozen=True)
class Adapt(Evaluate):
    """Adapt a stored run to its test tasks without training, and judge those tasks alone.

    For example --adapt.starts infer, or --few-shot.qualities expert mixed.

    Examples:
      mpdt-train adapt runs/ml10-base --data ml10.h5 --adapt.starts infer
      mpdt-train adapt runs/ml10-base --data ml10.h5 --few-shot.qualities expert mixed
      mpdt-train adapt runs/ml10-base --data ml10.h5 --keep adapted.h5
    """


@dataclass(frozen=True, kw_only=True)
class EvaluatePolicy:
    """Judge a function or a bundle on the tasks of a file, beside the rows of every table.

    Every setting of --evaluation can be given.

    Examples:
      mpdt-train evaluate --policy theirs:act --data ml10.h5
      mpdt-train evaluate --policy policies/ml10 --data ml10.h5 --keep seen.h5
      mpdt-train evaluate --policy theirs:act --data ml10.h5 --reads nothing --json
    """

    policy: str
    """module:function to be judged, act(observations, rewards, starts, task) -> actions, imported
    from here or what is installed; or a bundle's folder or address."""
    data: str
    """FILE whose tasks, options and references count."""
    reads: Annotated[Said | None, tyro.conf.arg(metavar="WHAT")] = None
    """What a function of yours has read of a test task before its first step, which nobody but you
    can know: nothing, 'task id', X, X+rewards, 'labelled steps' or demonstration. The leaderboard
    compares by it."""
    keep: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """Keep the episodes as data."""
    json: bool = False
    """Print results instead of tables."""
    quiet: Annotated[bool, tyro.conf.arg(aliases=["-q"])] = False
    """No progress on stderr."""
    verbose: Annotated[bool, tyro.conf.arg(aliases=["-v"])] = False
    """Show tracebacks."""


@dataclass(frozen=True)
class Bundle:
    """Write a run's policy as one folder that acts anywhere: no data, no trainer, no network.

    Every run leaves one in its folder as policy/. From runs older than that it is made anew, for
    which their data is needed: their test tasks are adapted to again.

    Examples:
      mpdt-train bundle runs/ml10-base -o ml10-policy
      mpdt-train bundle runs/ml10-base -o ml10-small --without-backbone
      mpdt-train bundle runs/old -o old-policy --data data/ml10.h5
    """

    folder: tyro.conf.Positional[Path]
    """The run's folder, such as runs/ml10-base."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Folder to write; nothing may be there."""
    data: Annotated[str | None, tyro.conf.arg(metavar="FILE")] = None
    """FILE or FILE:slice it was trained on; default: the file of that name, here or beside the
    folder of runs."""
    without_backbone: bool = False
    """Leave the language model's blocks out and name them; loading reads them by name."""
    json: bool = False
    """Print what was written as JSON."""
    verbose: Annotated[bool, tyro.conf.arg(aliases=["-v"])] = False
    """Show tracebacks."""


@dataclass(frozen=True)
class Rollout:
    """Let a policy act in the simulator and keep its episodes as a data file.

    An ordinary one, of quality `policy`: verify, show, split, merge, exports and training take it.
    The bytes do not depend on the number of workers; an interrupted call goes on where it was.

    Examples:
      mpdt-train rollout runs/ml10-base -o ml10-policy.h5
      mpdt-train rollout policies/ant_dir -o ant.h5 --tasks test --start infer
      mpdt-train rollout runs/ml10-base -o noisy.h5 --episodes 200 --noise 0.1
    """

    policy: tyro.conf.Positional[str]
    """A bundle's folder or address, or the folder of a run."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"], metavar="FILE")]
    """Data file to write."""
    tasks: str = "train"
    """train, test, all, or names with commas between them."""
    start: Annotated[str | None, tyro.conf.arg(metavar="START")] = None
    """Prompts to act behind, such as own, cross or none; default: own, or none for tasks that
    were not trained on."""
    episodes: int = 50
    """Episodes per task."""
    noise: float = 0.0
    """Standard deviation of the Gaussian added to actions, in their own unit."""
    seed: int = 0
    """Number of these roll-outs; those of another number begin elsewhere, and merge with these."""
    workers: Annotated[int | None, tyro.conf.arg(metavar="N")] = None
    """Processes; default: one per core, 0 = in this one."""
    restart: bool = False
    """Throw away what an earlier call left."""
    json: bool = False
    """Print JSON instead of a table."""
    quiet: Annotated[bool, tyro.conf.arg(aliases=["-q"])] = False
    """No progress on stderr."""
    verbose: Annotated[bool, tyro.conf.arg(aliases=["-v"])] = False
    """Show tracebacks."""


@dataclass(frozen=True)
class Push:
    """Send a policy's bundle to a URL, as mpdt-data push sends data.

    sftp://, webdav(s)://, s3://, gs://, az://, a mounted folder, hf://OWNER/NAME, where the hub
    shows its card. It is proved before, read back and compared; a broken transfer goes on.

    Examples:
      mpdt-train push runs/ml10-base hf://me/ml10-policy
      mpdt-train push ml10-policy sftp://host/policies/
      mpdt-train push ml10-policy /mnt/share/ml10-policy --replace
    """

    folder: tyro.conf.Positional[Path]
    """The bundle, or the folder of a run, such as runs/ml10-base, whose policy/ is sent."""
    url: tyro.conf.Positional[str]
    """Where it shall be; one that ends with / gets the name of the folder."""
    replace: bool = False
    """Also if something else is there."""
    check: bool = True
    """Read back what was sent; otherwise only its size counts."""
    json: bool = False
    """Print what was sent as JSON."""
    quiet: Annotated[bool, tyro.conf.arg(aliases=["-q"])] = False
    """No progress on stderr."""
    verbose: Annotated[bool, tyro.conf.arg(aliases=["-v"])] = False
    """Show tracebacks."""


@dataclass(frozen=True)
class Pull:
    """Bring a policy's bundle from a URL; it appears when every byte is proved.

    Examples:
      mpdt-train pull hf://me/ml10-policy
      mpdt-train pull sftp://host/policies/ml10-policy -o here
      mpdt-train pull https://host/ml10-policy --json
    """

    url: tyro.conf.Positional[str]
    """What to bring; https:// as well."""
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"], metavar="PATH")] = None
    """Folder to put it in; default: its own name, here. Nothing is replaced."""
    json: bool = False
    """Print what came as JSON."""
    quiet: Annotated[bool, tyro.conf.arg(aliases=["-q"])] = False
    """No progress on stderr."""
    verbose: Annotated[bool, tyro.conf.arg(aliases=["-v"])] = False
    """Show tracebacks."""
