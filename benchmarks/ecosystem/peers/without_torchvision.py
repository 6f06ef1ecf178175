"""lerobot 0.4.4 without torchvision, which has no build that loads beside PyTorch's CPU wheel.

Used by read_lerobot.py and ../write_lerobot.py, whose trees have no images.
"""

import importlib.machinery
import os
import sys
import types


class Empty(types.ModuleType):
    """Whatever is imported from it is an empty class."""

    def __getattr__(self, name):
        if name.startswith("__"):
            raise AttributeError(name)
        return type(name, (), {})


def stand_in():
    """Put empty modules in its place; to be called before lerobot is imported."""
    os.environ["HF_HUB_OFFLINE"] = "1"
    import transformers  # noqa: F401 - asks for torchvision by name, so before it seems to be there

    for name in ("torchvision", "torchvision.transforms", "torchvision.transforms.v2"):
        module = Empty(name)
        module.__path__, module.__spec__ = [], importlib.machinery.ModuleSpec(name, None)
        sys.modules[name] = module
        parent, _, last = name.rpartition(".")
        if parent:
            setattr(sys.modules[parent], last, module)
