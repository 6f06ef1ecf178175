"""mpdt: multi-task offline-RL datasets and prompt-tuned Decision Transformers.

    data   = mpdt.open("cheetah_dir.h5")
    data   = mpdt.collect("cheetah_dir", "cheetah_dir.h5")
    batch  = mpdt.windows("cheetah_dir.h5:train", window=20, per_task=16).batch(0)
    policy = mpdt.load_policy("runs/cheetah_dir-base", task="forward")

Names are looked up when first used: `import mpdt` loads neither torch nor a simulator.
"""

import sys
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mpdt.data.interface import collect as collect
    from mpdt.data.interface import open as open
    from mpdt.data.interface import windows as windows
    from mpdt.data.spec.family import Family as Family
    from mpdt.data.spec.family import Task as Task
    from mpdt.data.spec.family import View as View
    from mpdt.data.spec.own import register_family as register_family
    from mpdt.train.run.load import load_policy as load_policy
    from mpdt.train.run.results import read_results as read_results

from mpdt.version import __version__ as __version__

_HOMES = {
    "open": "mpdt.data.interface",
    "collect": "mpdt.data.interface",
    "windows": "mpdt.data.interface",
    "Family": "mpdt.data.spec.family",
    "Task": "mpdt.data.spec.family",
    "View": "mpdt.data.spec.family",
    "register_family": "mpdt.data.spec.own",
    "load_policy": "mpdt.train.run.load",
    "read_results": "mpdt.train.run.results",
}

if "gymnasium" in sys.modules:
    import_module("mpdt.envs")  # `import gymnasium, mpdt` is enough for gymnasium.make


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'mpdt' has no attribute '{name}'")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOMES])
