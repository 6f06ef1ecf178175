"""The commands of mpdt-train: one dataclass each, its docstrings are the help."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

PROG = "mpdt-train"
EVALUATE_POLICY = "evaluate --policy"
"""A command of its own: it takes no folder, which words behind an option would be taken for."""


@dataclass(frozen=True)
class Run:
    """Train on a data file, adapt to its unseen tasks, judge everything in the simulator.

    Runs by default, without a subcommand. A run with the same settings and data in the same
    folder continues where it stopped. Every setting of every part can be given as well, for
    example --seed 1, --quality medium, --inputs.return-to-go none, --prompts.length 9;
    `mpdt-train settings` lists them all. After training, other --adapt, --statistics and
    --evaluation settings judge the same weights again. Other commands: methods, settings, adapt,
    evaluate, study, report, bundle, rollout, push, pull.
    """

    data: str
    """FILE or FILE:slice, as written by mpdt-data collect or split. Several files, a folder or a
    pattern ('parts/*.h5') are read as the one that merge would make of them."""
    preset: str = "base"
    """Settings to start from: smoke, demo, base, paper."""
    begin: Annotated[str | None, tyro.conf.arg(name="from")] = None
    """Bundle (folder, address or folder of a run) to train on: of its family everything is taken,
    for another family what fits. What the policy is made of is then the bundle's, too."""
    method: str | None = None
    """MPDT, MPDT-E, MPDT-WP, Soft-Prompt, Prompt-DT, MT-BC, LaMo, ...: lays a method over the
    preset. `mpdt-train methods` tells of all; default: the preset's own."""
    adapt: str | None = None
    """Start of adaptation, such as cross or infer. Short for --adapt.starts."""
    name: str | None = None
    """Folder of the run inside the runs folder; default: FILE-preset or FILE-method."""
    runs_dir: Path = Path("runs")
    """Where runs are kept."""
    restart: bool = False
    """Throw away what an earlier run left in that folder."""
    steps: int | None = None
    """Updates of P_c and P_k; the teacher keeps its share. Short for --multitask.steps."""
    time_limit_s: float = 0.0
    """End training after so many seconds and judge what there is; the same command trains on.
    0 = never."""
    log: str | None = None
    """Trackers that are told of it while it goes, with commas between them: tensorboard, wandb,
    trackio. metrics.jsonl is written anyway; a finished run is told of, too."""
    json: bool = False
    """Print results.json instead of tables."""
    quiet: Annotated[bool, tyro.conf.arg(aliases=["-q"])] = False
    """No progress on stderr."""
    verbose: Annotated[bool, tyro.conf.arg(aliases=["-v"])] = False
    """Show tracebacks."""


@dataclass(frozen=True)
class Settings:
    """Every setting of a preset with its value, as it can be given on the command line."""

    preset: str = "base"
    """smoke, demo, base, paper."""
    json: bool = False
    """As JSON instead of one option a line."""
    verbose: Annotated[bool, tyro.conf.arg(aliases=["-v"])] = False
    """Show tracebacks."""


@dataclass(frozen=True)
class Methods:
    """Every method in one sentence, with what it reads at test time and its paper."""

    preset: str = "base"
    """The preset the methods are laid over: smoke, demo, base, paper."""
    json: bool = False
    """As JSON."""
    verbose: Annotated[bool, tyro.conf.arg(aliases=["-v"])] = False
    """Show tracebacks."""


@dataclass(frozen=True)
class Evaluate:
    """Judge a stored run again without training, with other settings of judging.

    Every setting of --adapt, --few-shot, --statistics and --evaluation can be given. Somebody
    else's policy is judged by --policy in place of the folder.
    """

    folder: tyro.conf.Positional[Path]
    """The run's folder, such as runs/ml10-base."""
    data: str
    """FILE or FILE:slice it was trained on."""
    keep: Path | None = None
    """Keep the episodes as data: with FILE.h5 in FILE-own.h5, FILE-cross.h5, ..."""
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
    """


@dataclass(frozen=True, kw_only=True)
class EvaluatePolicy:
    """Judge a function or a bundle on the tasks of a file, beside the rows of every table.

    Every setting of --evaluation can be given.
    """

    policy: str
    """module:function to be judged, act(observations, rewards, starts, task) -> actions, imported
    from here or what is installed; or a bundle's folder or address."""
    data: str
    """FILE whose tasks, options and references count."""
    keep: Path | None = None
    """Keep the episodes as data."""
    json: bool = False
    """Print results instead of tables."""
    quiet: Annotated[bool, tyro.conf.arg(aliases=["-q"])] = False
    """No progress on stderr."""
    verbose: Annotated[bool, tyro.conf.arg(aliases=["-v"])] = False
    """Show tracebacks."""


@dataclass(frozen=True)
class Study:
    """Run the cells of a study that are not done yet; stop it at any time, it goes on.

    Cells without a data file are listed and left out.
    """

    name: tyro.conf.Positional[str]
    """Name of the study; an unknown one lists all."""
    data_dir: Path = Path()
    """Where the files NAME.h5 lie."""
    runs_dir: Path = Path("runs")
    """Where runs are kept."""
    results_dir: Path = Path("results")
    """Where STUDY/CELL.json are written."""
    only: str = ""
    """Only cells whose name holds this text, such as the whole name of one."""
    restart: bool = False
    """Train and judge again what is done as well; its results are replaced."""
    dry_run: bool = False
    """Say what is done and what is to do."""
    workers: int = 1
    """Cells at once, each in a process of its own; 1 = one after another in this one."""
    engine: Literal["processes", "ray"] = "processes"
    """processes: on this machine. ray: as many cells at once as a cluster has cores for; data,
    runs and results lie where every node sees them."""
    address: str | None = None
    """Of a running Ray cluster; auto = the one of this machine."""
    quiet: Annotated[bool, tyro.conf.arg(aliases=["-q"])] = False
    """No progress on stderr."""
    verbose: Annotated[bool, tyro.conf.arg(aliases=["-v"])] = False
    """Show tracebacks."""


@dataclass(frozen=True)
class Report:
    """The tables of a finished run, or of all cells of a study."""

    folder: tyro.conf.Positional[Path]
    """A run's folder, such as runs/ml10-base, or a study's results: results/studies/one-block."""
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """Write tables.md, tables.csv and pictures (SVG) of a study there, or the maps of a
    run's prompts."""
    html: Path | None = None
    """Write one page with tables, bars, curves and maps of prompts there; it needs no network."""
    json: bool = False
    """Print results.json instead of tables."""
    verbose: Annotated[bool, tyro.conf.arg(aliases=["-v"])] = False
    """Show tracebacks."""


@dataclass(frozen=True)
class Bundle:
    """Write a run's policy as one folder that acts anywhere: no data, no trainer, no network.

    Every run leaves one in its folder as policy/. From runs older than that it is made anew, for
    which their data is needed: their test tasks are adapted to again.
    """

    folder: tyro.conf.Positional[Path]
    """The run's folder, such as runs/ml10-base."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Folder to write; nothing may be there."""
    data: str | None = None
    """FILE or FILE:slice it was trained on; default: the file of that name, here or beside the
    folder of runs."""
    without_backbone: bool = False
    """Leave the language model's blocks out and name them; loading reads them by name."""
    verbose: Annotated[bool, tyro.conf.arg(aliases=["-v"])] = False
    """Show tracebacks."""


@dataclass(frozen=True)
class Rollout:
    """Let a policy act in the simulator and keep its episodes as a data file.

    An ordinary one, of quality `policy`: verify, show, split, merge, exports and training take it.
    The bytes do not depend on the number of workers; an interrupted call goes on where it was.
    """

    policy: tyro.conf.Positional[str]
    """A bundle's folder or address, or the folder of a run."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Data file to write."""
    tasks: str = "train"
    """train, test, all, or names with commas between them."""
    start: str | None = None
    """Prompts to act behind, such as own, cross or none; default: own, or none for tasks that
    were not trained on."""
    episodes: int = 50
    """Episodes per task."""
    noise: float = 0.0
    """Standard deviation of the Gaussian added to actions, in their own unit."""
    seed: int = 0
    """Number of these roll-outs; those of another number begin elsewhere, and merge with these."""
    workers: int | None = None
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
    """

    folder: tyro.conf.Positional[Path]
    """The bundle, or the folder of a run, such as runs/ml10-base, whose policy/ is sent."""
    url: tyro.conf.Positional[str]
    """Where it shall be; one that ends with / gets the name of the folder."""
    replace: bool = False
    """Also if something else is there."""
    check: bool = True
    """Read back what was sent; otherwise only its size counts."""
    quiet: Annotated[bool, tyro.conf.arg(aliases=["-q"])] = False
    """No progress on stderr."""
    verbose: Annotated[bool, tyro.conf.arg(aliases=["-v"])] = False
    """Show tracebacks."""


@dataclass(frozen=True)
class Pull:
    """Bring a policy's bundle from a URL; it appears when every byte is proved."""

    url: tyro.conf.Positional[str]
    """What to bring; https:// as well."""
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """Folder to put it in; default: its own name, here. Nothing is replaced."""
    quiet: Annotated[bool, tyro.conf.arg(aliases=["-q"])] = False
    """No progress on stderr."""
    verbose: Annotated[bool, tyro.conf.arg(aliases=["-v"])] = False
    """Show tracebacks."""


Command = (
    Run
    | Methods
    | Settings
    | Evaluate
    | EvaluatePolicy
    | Study
    | Report
    | Bundle
    | Rollout
    | Push
    | Pull
)
COMMANDS: dict[str, type[Command]] = {
    "run": Run, "methods": Methods, "settings": Settings, "adapt": Adapt, "evaluate": Evaluate,
    EVALUATE_POLICY: EvaluatePolicy, "study": Study, "report": Report, "bundle": Bundle,
    "rollout": Rollout, "push": Push, "pull": Pull,
}  # fmt: skip
