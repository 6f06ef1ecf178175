"""Build the wheel, install it outside the checkout and try it there.

    make wheel                             its dependencies are borrowed from .venv: a minute
    python tools/wheel.py --full      everything is installed from the index: minutes, 1 GB
    python tools/wheel.py --act RUN   and the bundle of that run acts there as it was judged
    python tools/wheel.py --extras    each extra alone and all together, each in an environment of
                                      its own, from the index (by uv where it is, which is quicker)

What is tried: the files inside; in an empty folder `mpdt-data list`, `collect cheetah_dir --smoke`,
`verify`, `import mpdt`, a smoke run of `mpdt-train`; ten lines of a stranger's under `mypy
--strict`. The run's bundle, copied into another folder, has to earn what results.json says
(`tools/act.py`). With --extras: `mpdt-data info --check` lacks nothing of what was asked for.
Prints one line per step; exit code 1 on failure.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import sysconfig
import tempfile
import zipfile
from pathlib import Path

ROOT = Path(__file__).parent.parent
DIST = ROOT / "build/dist"
INSIDE = (
    "mpdt/py.typed",
    "mpdt/datasets.yaml", "mpdt/data/weights/metaworld.json", "mpdt/data/weights/references.json",
    "mpdt/data/weights/cheetah_dir.safetensors", "mpdt/data/weights/cheetah_vel.safetensors",
    "mpdt/data/weights/ant_dir.safetensors", "mpdt/data/weights/cheetah_dir.json",
)  # fmt: skip
OUTSIDE = ("tests/", "benchmarks/", "docs/", "results/", "policies/", "constraints.txt")
MOST_MB = 10  # without the weights of a language model
EXTRAS = ("behaviour", "ray", "remote", "pages", "tensorboard", "wandb", "trackio")
STRANGER = """\
import numpy as np

import mpdt


def best(path: str, task: str) -> tuple[float, tuple[int, ...]]:
    data = mpdt.open(path)
    ids = data.select(task=task, quality="expert")
    episode = data.episode(int(ids[np.argmax(data.episodes.returns[ids])]))
    batch = mpdt.windows(data, window=20, per_task=4, seed=1).batch(0)
    return episode.episode_return, batch.observations.shape
"""
TRAINING = (
    "--data cheetah_dir-smoke.h5 --preset smoke --name tried --quiet --teacher.steps 2"
    " --multitask.steps 4 --adapt.starts none --evaluation.no-constants"
)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--full", action="store_true", help="install the dependencies too")
    parser.add_argument("--act", metavar="RUN", type=Path, help="folder of a run with its bundle")
    parser.add_argument("--extras", nargs="*", metavar="EXTRA",
                        help="these together; none named: each alone, then all")  # fmt: skip
    options = parser.parse_args()
    wheel = build()
    look_inside(wheel)
    if options.extras is not None:
        every = [*([one] for one in EXTRAS), list(EXTRAS)]
        named = [list(EXTRAS) if options.extras == ["all"] else options.extras]
        for extras in named if options.extras else every:
            try_extras(wheel, extras)
        return 0
    with tempfile.TemporaryDirectory(prefix="mpdt-wheel-") as folder:
        place = Path(folder)
        bin_folder = install(wheel, place / "venv", options.full)
        try_it(bin_folder, place)
        check_types(bin_folder, place)
        for run_folder in filter(None, [place / "work/runs/tried", options.act]):
            act_elsewhere(bin_folder, run_folder, place / "elsewhere" / run_folder.resolve().name)
    print(f"works  {wheel.relative_to(ROOT)}   {wheel.stat().st_size / 1e6:.1f} MB")
    return 0


def build() -> Path:
    """The wheel of the tree as it is."""
    shutil.rmtree(DIST, ignore_errors=True)
    run([sys.executable, "-m", "pip", "wheel", "--quiet", "--disable-pip-version-check",
         "--no-deps", "-w", DIST, ROOT])  # fmt: skip
    return next(DIST.glob("mpdt-*.whl"))


def look_inside(wheel: Path) -> None:
    """What the code reads at run time is in it, what belongs to the checkout is not."""
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
        missing = [name for name in INSIDE if name not in names]
        sources = {str(path.relative_to(ROOT)) for path in (ROOT / "mpdt").rglob("*")
                   if path.is_file() and "__pycache__" not in path.parts}  # fmt: skip
        missing += sorted(sources - names)
        surplus = [name for name in names if name.startswith(OUTSIDE)]
        licence = any(name.endswith("licenses/LICENSE") for name in names)
        assert archive.read("mpdt/datasets.yaml") == (ROOT / "datasets.yaml").read_bytes()
    assert not missing and not surplus and licence, (missing, surplus, licence)
    assert wheel.stat().st_size < MOST_MB * 1e6, wheel.stat().st_size
    print(f"inside  {len(names)} files: spec, weights, rates and references among them")


def install(wheel: Path, venv: Path, full: bool) -> Path:
    """A clean environment with the wheel; its folder of programs."""
    run([sys.executable, "-m", "venv", venv])
    python = venv / "bin/python"
    pip = [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    if full:
        run([*pip, "-c", ROOT / "constraints.txt", wheel])
    else:
        run([*pip, "--no-deps", wheel])
        code = "import sysconfig; print(sysconfig.get_paths()['purelib'])"
        site = Path(run([python, "-c", code]).strip())
        # A plain path: .venv's own .pth files, and with them the checkout, are not read.
        (site / "borrowed.pth").write_text(sysconfig.get_paths()["purelib"] + "\n")
    return venv / "bin"


def try_it(programs: Path, place: Path) -> None:
    work = place / "work"
    work.mkdir()
    code = "import mpdt; print(mpdt.__file__)"
    where = run([programs / "python", "-c", code], work).strip()
    assert where.startswith(str(place)), where  # the wheel's own, not the checkout's
    data = programs / "mpdt-data"
    steps = [
        ([data, "list"], "cheetah_dir"),
        ([data, "info"], "a wheel"),
        ([data, "collect", "cheetah_dir", "--smoke", "--workers", "0", "-q"], "packed"),
        ([data, "verify", "cheetah_dir-smoke.h5", "--replay", "1"], "12 passed"),
        ([data, "plan", "ml10"], "ml10 2"),  # rates and references of Meta-World
        ([programs / "mpdt-train", "--help"], "mpdt-train"),
        ([programs / "mpdt-train", *TRAINING.split()], "MPDT"),
        ([programs / "python", "-m", "mpdt.data.cli", "--version"], "mpdt "),
    ]
    for command, expected in steps:
        found = run(command, work)
        assert expected in found, (command, found)
        print("ran    ", command[0].name, *command[1:])


def check_types(programs: Path, place: Path) -> None:
    """A stranger's code is checked against the wheel's own types, and a mistake in it is seen."""
    folder = place / "stranger"
    folder.mkdir()
    (folder / "good.py").write_text(STRANGER)
    (folder / "bad.py").write_text(STRANGER.replace("window=20", 'window="20"'))
    check = [sys.executable, "-m", "mypy", "--strict", "--python-executable", programs / "python"]
    print("typed  ", run([*check, "good.py"], folder).strip())
    assert "window" in run([*check, "bad.py"], folder, fails=True)


def try_extras(wheel: Path, extras: list[str]) -> None:
    """A fresh environment of the index alone has what these extras are for."""
    with tempfile.TemporaryDirectory(prefix="mpdt-extras-") as folder:
        python = Path(folder) / "venv/bin/python"
        wanted = f"{wheel}[{','.join(extras)}]"
        lines = (ROOT / "constraints.txt").read_text().splitlines(keepends=True)
        allowed = Path(folder) / "constraints.txt"
        # trackio asks for pillow below 13, which nothing else does.
        allowed.write_text("".join(line for line in lines if not line.startswith("pillow==")))
        constraints = ["-c", allowed]
        run([sys.executable, "-m", "venv", python.parent.parent])
        if uv := shutil.which("uv"):
            run([uv, "pip", "install", "--quiet", "--python", python, *constraints, wanted])
        else:
            run([python, "-m", "pip", "install", "--quiet", *constraints, wanted])
        text = run([python.parent / "mpdt-data", "info", "--check", "--json"], Path(folder))
        parts = {one["part"]: one["lacks"] for one in json.loads(text)}
        assert all(parts[name] == [] for name in ("mpdt itself", *extras)), parts
        others = [name for name in EXTRAS if name not in extras and parts[name] == []]
        print(f"extra   {','.join(extras)}: there" + (f"; {', '.join(others)} too" * bool(others)))


def act_elsewhere(programs: Path, run_folder: Path, far: Path) -> None:
    """A bundle alone, in a folder where nothing else lies, acts as results.json says."""
    shutil.copytree(run_folder / "policy", far / "policy")
    shutil.copy(run_folder / "results.json", far)
    shutil.copy(ROOT / "tools/act.py", far)
    found = run([programs / "python", "act.py", "policy", "--results", "results.json"], far)
    for line in found.splitlines():
        print("acted  ", line)


def run(command: list[object], folder: Path | None = None, fails: bool = False) -> str:
    """Its output; what it says to stderr is shown if it fails, unless it is meant to."""
    environment = {k: v for k, v in os.environ.items() if not k.startswith("PYTHON")}
    done = subprocess.run([*map(str, command)], cwd=folder, env=environment, text=True,
                          capture_output=True, check=False)  # fmt: skip
    if bool(done.returncode) != fails:
        raise SystemExit(f"{' '.join(map(str, command))}\n{done.stdout}{done.stderr}")
    return done.stdout


if __name__ == "__main__":
    sys.exit(main())
