"""The house keeps its shape: import arrows, small files, no drawers, a quick `--help`."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
SOURCES = sorted((ROOT / "mpdt").rglob("*.py"))
HEAVY = {"torch", "transformers", "mujoco", "metaworld", "h5py", "pyarrow", "gymnasium"}


def test_imports_point_one_way() -> None:
    """The contracts in pyproject.toml: layers, and no deep-learning library below the model."""
    command = [str(Path(sys.executable).parent / "lint-imports"), "--no-cache"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout


def test_files_are_small_and_named_after_a_noun() -> None:
    drawers = {"util", "utils", "helper", "helpers", "common", "misc"}
    assert [path for path in SOURCES if path.stem in drawers] == []
    assert [path for path in SOURCES if path.read_text().count("\n") > 330] == []


def test_a_module_says_what_it_is() -> None:
    told = {path: path.read_text() for path in SOURCES}
    assert [path for path, text in told.items()
            if text.strip() and not ast.get_docstring(ast.parse(text))] == []  # fmt: skip


def lost_paths(page: str) -> list[str]:
    """Paths in `page` that lead nowhere; a name alone lies where the one before it does."""
    lost = []
    for line in page.splitlines():
        folders = [ROOT, *(ROOT / name for name in ("mpdt", "mpdt/data", "mpdt/train"))]
        for name in re.findall(r"`([\w./]+(?:/|\.(?:py|svg|json|md)))`", line):
            found = [folder / name for folder in folders if (folder / name).exists()]
            lost += [] if found else [name]
            folders += [found[0] if name.endswith("/") else found[0].parent] if found else []
    return lost


def test_the_map_names_every_folder_and_nothing_that_is_gone() -> None:
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    tree = page.split("```")[1]
    folders = {path.parent.name for path in SOURCES} - {"mpdt"}
    assert not [name for name in sorted(folders) if f"{name}/" not in tree]
    there = {*ROOT.iterdir(), *(ROOT / "benchmarks").iterdir(), *(ROOT / "mpdt").rglob("*/")}
    assert not set(re.findall(r"(\w+)/", tree)) - {path.name for path in there}
    assert not lost_paths(page)
    assert lost_paths("`data/gone.py`, `data/sim/play.py`, `batch.py`, `none.py`") == [
        "data/gone.py", "none.py"
    ]  # fmt: skip


@pytest.mark.parametrize("module", ["mpdt.data.cli", "mpdt.train.cli"])
def test_help_imports_nothing_heavy(module: str) -> None:
    code = (
        "import sys, importlib\n"
        f"main = importlib.import_module({module!r}).main\n"
        "sys.argv = ['prog', '--help']\n"
        "try:\n    main()\nexcept SystemExit as stop:\n    assert not stop.code, stop.code\n"
        f"print('HEAVY', sorted({HEAVY!r} & set(sys.modules)))\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "HEAVY []"


UNPICKLES = {  # by the last names of whatever is called
    *("pickle.load", "pickle.loads", "Unpickler", "torch.load", "joblib.load", "read_pickle"),
    *("PPO.load", "VecNormalize.load", "load_from_zip_file", "load_from_pkl", "hub.load"),
}


def unpicklers(source: str) -> list[str]:
    """Calls in `source` that may run what a file says; `Connection.recv` reads no file."""
    ends, unsafe = tuple(f".{name}" for name in UNPICKLES), {"allow_pickle", "trust_remote_code"}
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Call):
            name = ast.unparse(node.func)
            found += [name] if f".{name}".endswith(ends) else []
            given = {keyword.arg: ast.unparse(keyword.value) for keyword in node.keywords}
            found += [name for key in unsafe if given.get(key, "False") != "False"]
        elif isinstance(node, ast.ImportFrom) and node.module in ("pickle", "cloudpickle", "dill"):
            found += [f"{node.module}.{alias.name}" for alias in node.names]
    return found


def test_no_file_is_ever_unpickled() -> None:
    assert [path for path in SOURCES if unpicklers(path.read_text())] == []


@pytest.mark.parametrize(
    ("source", "found"),
    [
        ("model = PPO.load(path)", ["PPO.load"]),
        ("VecNormalize.load(path, env)", ["VecNormalize.load"]),
        ("torch.load(path, weights_only=True)", ["torch.load"]),
        ("np.load(file, allow_pickle=True)", ["np.load"]),
        ("np.load(file, allow_pickle=False)", []),
        ("AutoModel.from_pretrained(n, trust_remote_code=x)", ["AutoModel.from_pretrained"]),
        ("pickle.loads(b)", ["pickle.loads"]),
        ("from pickle import load", ["pickle.load"]),
        ("pickle.dumps(x); safetensors.numpy.load(b); subject.load(tensors)", []),
    ],
)
def test_the_search_for_unpicklers(source: str, found: list[str]) -> None:
    assert unpicklers(source) == found


NAMED_NUMPY = {"Generator", "SeedSequence", "PCG64", "BitGenerator", "get_state"}
TORCH_DRAWS = {
    *("rand", "randn", "randint", "randperm", "rand_like", "randn_like", "randint_like"),
    *("normal", "bernoulli", "multinomial", "poisson"),
}
DRAWS_IN_PLACE = {"normal_", "uniform_", "bernoulli_", "random_", "exponential_", "trunc_normal_"}


def global_draws(source: str) -> list[str]:
    """Whatever in `source` would draw from a generator that everybody shares."""
    tree = ast.parse(source)
    forks = "fork_rng" in {n.attr for n in ast.walk(tree) if isinstance(n, ast.Attribute)}
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found += [a.name for a in node.names if a.name in ("random", "numpy.random")]
        elif isinstance(node, ast.ImportFrom):
            names = {alias.name for alias in node.names}
            if node.module == "random" and not node.level:
                found.append("random")
            elif node.module == "numpy.random":
                found += names - NAMED_NUMPY
            elif node.module in ("numpy", "torch"):
                found += names & {"random", *TORCH_DRAWS, "manual_seed"}
        elif isinstance(node, ast.Attribute):
            name = ast.unparse(node)
            if re.fullmatch(r"(np|numpy)\.random\.\w+", name) and node.attr not in NAMED_NUMPY:
                found.append(name)
            elif name in ("torch.manual_seed", "torch.random.manual_seed", "torch.seed"):
                # Layers that only know the global generator: fork it.
                found += [] if forks else [name]
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            drawn = ast.unparse(node.func)
            is_draw = drawn in {f"torch.{name}" for name in TORCH_DRAWS}
            if is_draw or node.func.attr in DRAWS_IN_PLACE:
                given = {keyword.arg for keyword in node.keywords}
                found += [] if "generator" in given else [drawn]
    return found


def test_no_global_random_generator_is_used() -> None:
    """All randomness comes from named seeds; these calls would draw from global state."""
    assert [path for path in SOURCES if global_draws(path.read_text())] == []


MADE_IN_SEEDING = {  # by the last names of whatever is called
    *("PCG64", "SeedSequence", "default_rng", "RandomState", "manual_seed", "fork_rng"),
    *("random.Generator", "torch.Generator", "seeding.np_random"),
}


def made_generators(source: str) -> list[str]:
    """Calls in `source` that make or seed a generator, which is for `mpdt/seeding.py` to do."""
    called = [ast.unparse(n.func) for n in ast.walk(ast.parse(source)) if isinstance(n, ast.Call)]
    return [
        name for name in called if any(f".{name}".endswith(f".{own}") for own in MADE_IN_SEEDING)
    ]


def test_generators_are_made_in_one_file() -> None:
    """So that every stream has a name there and no two users share one by accident."""
    made = [path for path in SOURCES if made_generators(path.read_text())]
    assert made == [ROOT / "mpdt/seeding.py"]


@pytest.mark.parametrize(
    ("source", "found"),
    [
        ("np.random.Generator(np.random.PCG64(0))", ["np.random.Generator", "np.random.PCG64"]),
        ("PCG64(0)", ["PCG64"]),
        ("numpy.random.SeedSequence([1, 2])", ["numpy.random.SeedSequence"]),
        ("torch.Generator().manual_seed(0)", ["torch.Generator().manual_seed", "torch.Generator"]),
        ("with torch.random.fork_rng(devices=[]): ...", ["torch.random.fork_rng"]),
        ("gymnasium.utils.seeding.np_random(0)", ["gymnasium.utils.seeding.np_random"]),
        ("def f(g: np.random.Generator) -> torch.Generator: ...", []),
        ("seeding.generator_of(0)", []),
        ("key.generator(Stream.GOAL)", []),
        ("collections.abc.Generator()", []),
    ],
)
def test_the_search_for_made_generators(source: str, found: list[str]) -> None:
    assert made_generators(source) == found


@pytest.mark.parametrize(
    ("source", "found"),
    [
        ("x = np.random.rand(3)", ["np.random.rand"]),
        ("f(np.random.default_rng())", ["np.random.default_rng"]),
        ("numpy.random.seed(0)", ["numpy.random.seed"]),
        ("draw = np.random.choice", ["np.random.choice"]),
        ("from numpy.random import rand, PCG64", ["rand"]),
        ("from numpy import random", ["random"]),
        ("np.random.Generator(np.random.PCG64(np.random.SeedSequence(0)))", []),
        ("def f(g: np.random.BitGenerator): ...", []),
        ("import random", ["random"]),
        ("from random import choice", ["random"]),
        ("from mpdt.data.random import x", []),
        ("torch.randn(3)", ["torch.randn"]),
        ("torch.randn(3, generator=g)", []),
        ("torch.randperm(3)", ["torch.randperm"]),
        ("w.normal_(0, 1)", ["w.normal_"]),
        ("w.normal_(0, 1, generator=g)", []),
        ("from torch import randn", ["randn"]),
        ("torch.manual_seed(0)", ["torch.manual_seed"]),
        ("# fork_rng\ntorch.manual_seed(0)", ["torch.manual_seed"]),
        ("with torch.random.fork_rng():\n    torch.manual_seed(0)", []),
        ("torch.Generator().manual_seed(0)", []),
    ],
)
def test_the_search_for_global_draws(source: str, found: list[str]) -> None:
    assert global_draws(source) == found
