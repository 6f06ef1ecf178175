"""Two processes with gloo train like one with the same global batch."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from mpdt.data.slices.windows import WindowBatch
from mpdt.errors import UsageError
from mpdt.train.fit.group import ALONE, Group

STEPS = 3


def windows(per_task):
    """Two tasks; the window's number is in every array."""
    number = np.arange(2 * per_task).reshape(2, per_task)
    one, row = number[..., None], number[..., None, None].astype(np.float32)
    return WindowBatch(row, row, row, one.astype(np.float32), one, one % 2 == 0, np.arange(2),
                       np.arange(2), number, number)  # fmt: skip


def test_shares_cover_the_batch_and_leave_tasks_alone():
    whole = windows(4)
    parts = [Group(rank, 2).share(whole) for rank in (0, 1)]
    assert [part.starts.tolist() for part in parts] == [[[0, 1], [4, 5]], [[2, 3], [6, 7]]]
    for name in ("observations", "mask", "timesteps", "returns_to_go"):
        joined = np.concatenate([getattr(part, name) for part in parts], axis=1)
        np.testing.assert_array_equal(joined, getattr(whole, name))
    assert all(part.tasks.tolist() == [0, 1] for part in parts)
    with pytest.raises(UsageError, match=r"a multiple of 2.*found 3"):
        Group(0, 2).share(windows(3))


def test_a_group_of_one_changes_nothing():
    whole = windows(3)
    assert ALONE.share(whole) is whole
    assert ALONE.weight(torch.zeros(1)) == 1.0 and ALONE.any([True, False]) == [True, False]
    assert ALONE.total(torch.tensor(2.5)) == 2.5


def run_updates(path: Path, group: Group) -> dict[str, object]:
    """Losses and prompts after some updates with a teacher; the pads differ between ranks."""
    from mpdt.model.backbone import load_backbone
    from mpdt.model.policy import PromptPolicy
    from mpdt.model.prompts import DecomposedPrompts, TeacherPrompts
    from mpdt.train.fit.data import load_material, return_table
    from mpdt.train.fit.device import Hardware, HardwareSettings
    from mpdt.train.fit.loop import OptimiserSettings, Update, fit, make_optimizer
    from mpdt.train.fit.teacher import Teacher, TeacherSettings
    from mpdt.train.run.presets import smoke

    torch.set_num_threads(1)
    config, material = smoke(), load_material(str(path), "expert")
    backbone = load_backbone("random:tiny", dtype="float32")
    stats = material.dataset.stats["observations"]
    policy = PromptPolicy(backbone, config.inputs, config.head, stats["mean"], stats["std"], 6)
    prompts = DecomposedPrompts(config.prompts, 2, backbone.width, 0.2, seed=1)
    settings = OptimiserSettings(warmup_steps=1, lr=1e-2)
    taught = TeacherPrompts(config.prompts, 2, backbone.width, 0.2)
    found: list[dict[str, float]] = []
    sampler = material.sampler(config.sampler, 1)
    update = Update(policy, prompts, return_table(material, "task", 0.9), sampler.seed,
                    Teacher(policy, taught, TeacherSettings()), 0.01,
                    Hardware(HardwareSettings(), group))  # fmt: skip
    fit(update, sampler, make_optimizer(policy, prompts, settings), settings, range(STEPS),
        lambda done, parts: found.append(parts) or False)  # fmt: skip
    return {"losses": found, "cross": prompts.cross.detach().tolist()}


@pytest.mark.long
def test_torchrun_gives_the_losses_of_one_process(tiny_file, tmp_path):
    command = [sys.executable, __file__, str(tiny_file), str(tmp_path)]
    # All on the loopback: a machine's own name need not resolve.
    environment = os.environ | {
        "OMP_NUM_THREADS": "1", "PYTHONWARNINGS": "ignore", "GLOO_SOCKET_IFNAME": "lo",
    }  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, env=environment,
                          check=False)  # fmt: skip
    assert done.returncode == 0, done.stderr[-3000:]
    ranks = [json.loads((tmp_path / f"{rank}.json").read_text()) for rank in (0, 1)]
    assert ranks[0] == ranks[1]
    alone = run_updates(tiny_file, ALONE)
    for ours, theirs in zip(ranks[0]["losses"], alone["losses"], strict=True):
        assert ours == pytest.approx(theirs, rel=2e-5)
    np.testing.assert_allclose(ranks[0]["cross"], alone["cross"], atol=2e-5)


def rank(path: Path, folder: Path) -> None:
    """What each of the processes runs."""
    group = Group.join()
    found = run_updates(path, group)
    group.leave()
    (folder / f"{group.rank}.json").write_text(json.dumps(found))


def main() -> None:
    """What `torchrun --standalone --nproc-per-node 2` does, but the ranks are forked.

    So torch and transformers are imported once and not three times.
    """
    from torch.distributed.launcher.api import LaunchConfig, elastic_launch

    from mpdt.model.backbone import load_backbone

    load_backbone("random:tiny", dtype="float32")
    config = LaunchConfig(
        min_nodes=1, max_nodes=1, nproc_per_node=2, run_id="test", start_method="fork",
        rdzv_backend="c10d", rdzv_endpoint="127.0.0.1:0", local_addr="127.0.0.1", max_restarts=0,
    )  # fmt: skip
    elastic_launch(config, rank)(Path(sys.argv[1]), Path(sys.argv[2]))


if __name__ == "__main__":
    main()
