"""The commands of mpdt-train: one dataclass each, its docstrings are the help."""

from __future__ import annotations

import inspect
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from mpdt.data.verbs.completion import Shell, verb_lines
from mpdt.train.policy_options import (
    Adapt,
    Bundle,
    Evaluate,
    EvaluatePolicy,
    Pull,
    Push,
    Rollout,
)

PROG = "mpdt-train"
EVALUATE_POLICY = "evaluate --policy"
"""A command of its own: it takes no folder, which words behind an option would be taken for."""


@dataclass(frozen=True)
class Run:
    """Train on a data file, adapt to its unseen tasks, judge everything in the simulator.

    Runs by default, without a verb. A run with the same settings and data in the same folder
    continues where it stopped. Every setting can be given as well, such as --seed 1 or --quality
    medium, and with dots --prompts.length 9; see `mpdt-train settings` for all of them. After
    training, other settings of --adapt, --statistics and --evaluation judge the same weights again.

    Examples:
      mpdt-train --data cheetah_dir.h5
      mpdt-train --data ml10.h5 --method MPDT-ones --adapt infer --seed 1
      mpdt-train --data a.h5 b.h5 --preset smoke --name try
    """

    data: str
    """FILE or FILE:slice, as written by mpdt-data collect or split. Several files, a folder or a
    pattern ('parts/*.h5') are read as the one that merge would make of them."""
    preset: str = "base"
    """Settings to start from: smoke, demo, base, paper."""
    begin: Annotated[str | None, tyro.conf.arg(name="from", metavar="BUNDLE")] = None
    """Bundle (folder, address or folder of a run) to train on: of its family everything is taken,
    for another family what fits. What the policy is made of is then the bundle's, too."""
    method: Annotated[str | None, tyro.conf.arg(metavar="METHOD")] = None
    """MPDT, MPDT-E, MPDT-WP, Soft-Prompt, Prompt-DT, MT-BC, LaMo, ...: lays a method over the
    preset. `mpdt-train methods` tells of all; default: the preset's own."""
    adapt: Annotated[str | None, tyro.conf.arg(metavar="START")] = None
    """Start of adaptation, such as cross or infer. Short for --adapt.starts."""
    name: Annotated[str | None, tyro.conf.arg(metavar="NAME")] = None
    """Folder of the run inside the runs folder; default: FILE-preset or FILE-method."""
    runs_dir: Path = Path("runs")
    """Where runs are kept."""
    restart: bool = False
    """Throw away what an earlier run left in that folder."""
    steps: Annotated[int | None, tyro.conf.arg(metavar="N")] = None
    """Updates of P_c and P_k; the teacher keeps its share. Short for --multitask.steps."""
    time_limit_s: float = 0.0
    """End training after so many seconds and judge what there is; the same command trains on.
    0 = never."""
    log: Annotated[str | None, tyro.conf.arg(metavar="TRACKER[,TRACKER...]")] = None
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
    """Every setting of a preset with its value, as it can be given on the command line.

    Examples:
      mpdt-train settings
      mpdt-train settings --preset paper
      mpdt-train settings --json
    """

    preset: str = "base"
    """smoke, demo, base, paper."""
    json: bool = False
    """As JSON instead of one option a line."""
    verbose: Annotated[bool, tyro.conf.arg(aliases=["-v"])] = False
    """Show tracebacks."""


@dataclass(frozen=True)
class Methods:
    """Every method in one sentence, with what it reads at test time and its paper.

    Examples:
      mpdt-train methods
      mpdt-train methods --preset paper
      mpdt-train methods --json
    """

    preset: str = "base"
    """The preset the methods are laid over: smoke, demo, base, paper."""
    json: bool = False
    """As JSON."""
    verbose: Annotated[bool, tyro.conf.arg(aliases=["-v"])] = False
    """Show tracebacks."""


@dataclass(frozen=True)
class Study:
    """Run the cells of a study that are not done yet; stop it at any time, it goes on.

    Cells without a data file are listed and left out.

    Examples:
      mpdt-train study one-block --dry-run
      mpdt-train study one-block --data-dir data --workers 2
      mpdt-train study one-block --only cheetah_vel.MPDT-ones.s0 --restart
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
    address: Annotated[str | None, tyro.conf.arg(metavar="HOST:PORT")] = None
    """Of a running Ray cluster; auto = the one of this machine."""
    json: bool = False
    """Print all outcomes as JSON, when the last cell is done."""
    quiet: Annotated[bool, tyro.conf.arg(aliases=["-q"])] = False
    """No progress on stderr."""
    verbose: Annotated[bool, tyro.conf.arg(aliases=["-v"])] = False
    """Show tracebacks."""


@dataclass(frozen=True)
class Report:
    """The tables of a finished run, or of all cells of a study.

    Examples:
      mpdt-train report runs/ml10-base
      mpdt-train report runs/ml10-base --html ml10.html
      mpdt-train report results/studies/one-block -o tables
    """

    folder: tyro.conf.Positional[Path]
    """A run's folder, such as runs/ml10-base, a study's results (results/studies/one-block), or
    those of all studies together (results/studies)."""
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"], metavar="FOLDER")] = None
    """Write tables.md, tables.csv and pictures (SVG) of a study there, or the maps of a
    run's prompts."""
    html: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """Write one page with tables, bars, curves and maps of prompts there; it needs no network."""
    json: bool = False
    """Print results.json instead of tables."""
    verbose: Annotated[bool, tyro.conf.arg(aliases=["-v"])] = False
    """Show tracebacks."""


@dataclass(frozen=True)
class Submit:
    """Add the rows of finished runs, cells of a study or judged policies to a leaderboard.

    A row is one method with one seed on one data set under one protocol (what was read of the test
    tasks). Only data that datasets.lock holds counts, so that others can make the row again.

    Examples:
      mpdt-train submit runs/ml10-base
      mpdt-train submit runs/ml10-mine --as mine --board results/leaderboard.csv
      mpdt-train submit mine.json --lock datasets.lock
    """

    results: tyro.conf.Positional[tuple[Path, ...]]
    """Folders of runs, or files with a result."""
    board: Annotated[Path, tyro.conf.arg(metavar="FILE")] = Path("leaderboard.csv")
    """The leaderboard; begun if it is not there."""
    lock: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """The lock that has to hold the data; default: datasets.lock beside datasets.yaml."""
    label: Annotated[str | None, tyro.conf.arg(name="as", metavar="NAME")] = None
    """Another name for the method, where the board has a row of the same name and seed."""
    replace: bool = False
    """Put these rows in the place of those with the same name and seed."""
    json: bool = False
    """Print the rows that were added as JSON."""
    verbose: Annotated[bool, tyro.conf.arg(aliases=["-v"])] = False
    """Show tracebacks."""


@dataclass(frozen=True)
class Watch:
    """Show what a run is doing: updates, losses, time left; its tables when it ends.

    It reads the run's folder and changes nothing, from any terminal of the machine. Leave it with
    Ctrl-C; the run goes on. What is left is known once two lines of its log have come.

    Examples:
      mpdt-train watch runs/ml10-base
      mpdt-train watch runs/ml10-base --once
      mpdt-train watch runs/ml10-base --json
    """

    folder: tyro.conf.Positional[Path]
    """The run's folder, such as runs/ml10-base."""
    once: bool = False
    """One look, as where the output is no terminal."""
    json: bool = False
    """One look, as JSON."""
    verbose: Annotated[bool, tyro.conf.arg(aliases=["-v"])] = False
    """Show tracebacks."""


@dataclass(frozen=True)
class Completion:
    """Print a script that makes a shell complete verbs and options.

    It knows the options of the day: print it again after an update. Those of a run come behind
    `mpdt-train run`.

    Examples:
      mpdt-train completion bash > ~/.local/share/bash-completion/completions/mpdt-train
      mpdt-train completion zsh > ~/.zfunc/_mpdt-train
      mpdt-train completion fish > ~/.config/fish/completions/mpdt-train.fish
    """

    shell: Shell
    """The shell that shall read it."""
    json: bool = False
    """As JSON."""
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
    | Submit
    | Watch
    | Bundle
    | Rollout
    | Push
    | Pull
    | Completion
)
COMMANDS: dict[str, type[Command]] = {
    "run": Run, "methods": Methods, "settings": Settings, "adapt": Adapt, "evaluate": Evaluate,
    EVALUATE_POLICY: EvaluatePolicy, "study": Study, "report": Report, "submit": Submit,
    "watch": Watch, "bundle": Bundle, "rollout": Rollout, "push": Push, "pull": Pull,
    "completion": Completion,
}  # fmt: skip


def overview() -> str:
    """The help of `mpdt-train` itself, above the options of a run."""
    return "\n".join([inspect.cleandoc(Run.__doc__ or ""), "", "Verbs:", *verb_lines(COMMANDS)])
