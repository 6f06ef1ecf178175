"""Hardware: where an update is computed, and in which numbers. The defaults change nothing.

    windows --pinned, not waited for--> device --autocast--> loss --scaled--> gradients

On a machine without an accelerator everything here runs on the processor, where it is tested
for equality with the plain path; that nothing is left on the wrong device is tested with tensors
that have a device and no values. No accelerator has been used yet.
"""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager
from dataclasses import fields
from typing import Literal

import msgspec
import torch
from torch import Tensor, nn

from mpdt.data.slices.windows import WindowBatch
from mpdt.errors import UsageError
from mpdt.model.backbone import Backbone
from mpdt.model.policy import PolicyBatch
from mpdt.model.returns import ReturnTable
from mpdt.train.fit.group import ALONE, Group

_TYPES = {"bfloat16": torch.bfloat16, "float16": torch.float16}


class HardwareSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Device and arithmetic of training; judging stays on the processor."""

    device: Literal["cpu", "cuda"] = "cpu"
    autocast: Literal["none", "bfloat16", "float16"] = "none"
    """Compute products in this type though the weights are float32; float16 scales the loss."""
    compile: Literal["none", "eager", "aot_eager", "inductor"] = "none"
    """torch.compile for the blocks of the language model, with this backend."""


class Hardware:
    """The device of one training phase, and the processes that share it.

    Raises: UsageError for a device or a compiler this machine does not have.
    """

    def __init__(self, settings: HardwareSettings, group: Group = ALONE) -> None:
        if settings.device == "cuda" and not torch.cuda.is_available():
            raise UsageError("no such device here", where="hardware.device", found="cuda",
                             hint="--hardware.device cpu")  # fmt: skip
        if settings.compile == "inductor" and not any(map(shutil.which, _compilers())):
            raise _not_compiled("no C++ compiler: " + ", ".join(_compilers()))
        self.settings, self.group = settings, group
        self.device = torch.device(settings.device)
        # Without float16 the scaler hands everything through untouched.
        self.scaler = torch.amp.GradScaler(settings.device, enabled=settings.autocast == "float16")

    def autocast(self) -> AbstractContextManager[object]:
        """Around the forward pass and the loss."""
        if self.settings.autocast == "none":
            return contextlib.nullcontext()
        return torch.autocast(self.settings.device, _TYPES[self.settings.autocast])

    def tensor(self, values: Tensor) -> Tensor:
        """`values` on the device; the copy is not waited for, because its source is pinned."""
        if self.device.type == "cpu":
            return values
        return values.pin_memory().to(self.device, non_blocking=True)

    def batch(self, windows: WindowBatch) -> PolicyBatch:
        """The sampler's windows as tensors on the device."""
        batch = PolicyBatch.from_windows(windows)
        if self.device.type == "cpu":
            return batch
        moved = {field.name: self.tensor(getattr(batch, field.name)) for field in fields(batch)}
        return PolicyBatch(**moved)

    def returns(self, table: ReturnTable) -> ReturnTable:
        if self.device.type == "cpu":
            return table
        return ReturnTable(*(self.tensor(getattr(table, f.name)) for f in fields(table)))

    def accepts(self, norm: Tensor) -> bool:
        """Whether a gradient norm may be judged: the scaler skips updates that overflow float16
        and tries again with a smaller scale."""
        return not self.scaler.is_enabled() or bool(norm.isfinite())

    @contextlib.contextmanager
    def working(
        self, backbone: Backbone, optimizer: torch.optim.Optimizer, *modules: nn.Module
    ) -> Iterator[None]:
        """Modules and the optimizer's moments on the device, blocks compiled; undone afterwards.

        Parameters stay the same objects, so an optimizer made before goes on working.

        Raises: UsageError where the backend cannot compile them.
        """
        compiled = [] if self.settings.compile == "none" else list(backbone.blocks())
        self._move(self.device, optimizer, modules)
        for block in compiled:
            block.compile(backend=self.settings.compile)
        try:
            yield
        except Exception as error:
            if compiled and type(error).__module__.startswith(("torch._dynamo", "torch._inductor")):
                raise _not_compiled(str(error).strip().partition("\n")[0][:200]) from error
            raise
        finally:
            for block in compiled:
                block._compiled_call_impl = None
            self._move(torch.device("cpu"), optimizer, modules)

    def _move(
        self, device: torch.device, optimizer: torch.optim.Optimizer, modules: Iterable[nn.Module]
    ) -> None:
        if self.device.type == "cpu":
            return
        for module in modules:
            module.to(device)
        for state in optimizer.state.values():
            for name, value in state.items():
                if name != "step":  # torch keeps its count of updates on the processor
                    state[name] = value.to(device)


def _compilers() -> tuple[str, ...]:
    """Those that inductor would look for."""
    return (named,) if (named := os.environ.get("CXX")) else ("g++", "clang++")


def _not_compiled(found: str) -> UsageError:
    return UsageError("cannot be compiled here", where="hardware.compile", found=found,
                      hint="install a C++ compiler (g++), or leave it out: --hardware.compile none"
                      )  # fmt: skip


PROCESSOR = Hardware(HardwareSettings())
"""Plain float32 or bfloat16 weights, nothing compiled, one process."""
