"""What an accelerator does with an update and with acting; started by accelerator.sh.

    python benchmarks/speed/accelerator.py --device cuda [--processes 2]

updates    training's loop at 1, 12 and 30 blocks of GPT-2 small in bfloat16, beside one matrix
           product of a block's size alone on the same device; 16 tasks x 16 windows
acting     the policy on whole windows of K = 20, 1, 100 and 10,000 rows. mpdt judges on the
           processor (decision 0015); this is what a loop on the device could reach
processes  `torchrun` with so many training processes, updates a second of all together

Times include waiting for the device. On a processor everything is smaller and goes to build/bench/.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from typing import Any

import rounds
import training

DEPTHS = {"cuda": (1, 12, 30), "cpu": (1, 2)}
ROWS = {"cuda": (1, 100, 10_000), "cpu": (1, 100)}
LEAST_S = {"cuda": 5.0, "cpu": 0.5}
TASKS = {"cuda": 16, "cpu": 4}
STEPS = {"cuda": (200, 1200), "cpu": (2, 6)}
"""Updates of the short and the long run of several processes; their difference is timed."""


def rate(run: Callable[[], object], seconds: float, wait: Callable[[], object]) -> float:
    """Calls a second, after two that make everything ready."""
    for _ in range(2):
        run()
    wait()
    began, done = time.perf_counter(), 0
    while time.perf_counter() - began < seconds:
        run()
        done += 1
        wait()
    return done / (time.perf_counter() - began)


def facts(device: str) -> list[dict[str, Any]]:
    import torch

    from mpdt.train.fit.device import Hardware, HardwareSettings

    hardware = Hardware(HardwareSettings(device=device))  # type: ignore[arg-type]
    wait = torch.cuda.synchronize if device == "cuda" else lambda: None
    found: list[dict[str, Any]] = []

    def fact(name: str, value: float, unit: str) -> None:
        found.append({"fact": name, "value": value, "unit": unit})
        print(f"{name:58} {value:,.4g} {unit}", flush=True)

    training.TASKS = TASKS[device]
    product, work = training.product(torch.bfloat16, device)
    alone = work * rate(product, LEAST_S[device], wait)
    fact("matrix product alone, bfloat16", alone, "FLOP/s")
    with training.data() as dataset:
        for depth in DEPTHS[device]:
            run = training.Run(dataset, "random:gpt2", "bfloat16", depth, hardware)
            with hardware.working(run.backbone, run.optimizer, run.policy, run.prompts):
                blocks = f"{depth} block{'s' * (depth > 1)}"
                updates = rate(run.run, LEAST_S[device], wait)
                fact(f"update, {blocks}", updates, "updates/s")
                share = updates * run.flops / alone
                fact(f"update, {blocks}: share of the product alone", share, "")
                for rows in ROWS[device]:
                    acting = rate(whole_windows(run, hardware, rows), LEAST_S[device], wait)
                    fact(f"acting, {blocks}, {rows:,} rows", acting * rows, "actions/s")
    return found


def whole_windows(run: Any, hardware: Any, rows: int) -> Callable[[], None]:
    """One step of `rows` episodes: prompt cached, window recomputed, actions fetched."""
    import torch

    from mpdt.model.policy import PolicyBatch

    policy, shape = run.policy, (rows, 1, training.K)
    with torch.no_grad():
        prompts = run.prompts.task_prompts()
        prefix = run.backbone.encode_prefix(prompts).select(torch.arange(rows) % training.TASKS)
    batch = PolicyBatch(*(hardware.tensor(values) for values in (
        torch.randn(*shape, policy.observation_size), torch.zeros(*shape, policy.action_size),
        torch.zeros(shape), torch.arange(training.K).expand(shape).contiguous(),
        torch.ones(shape, dtype=torch.bool))))  # fmt: skip

    def act() -> None:
        with torch.no_grad():
            tokens, mask = policy.tokens(batch)
            hidden, _ = run.backbone.forward_with_cache(prefix, tokens[:, 0], mask[:, 0])
            policy.head(hidden[:, -1:]).cpu()

    return act


def several(device: str, processes: int) -> list[dict[str, Any]]:
    """Updates a second of a whole training in `processes` processes; start-up is taken out."""
    with training.data() as dataset, tempfile.TemporaryDirectory(dir=rounds.scratch()) as folder:
        seconds = []
        for steps in STEPS[device]:
            words = [sys.executable, "-m", "torch.distributed.run", "--standalone",
                     f"--nproc-per-node={processes}", "-m", "mpdt.train.cli",
                     "--data", str(dataset.path), "--preset", "smoke", "--name", f"n{steps}",
                     "--quiet", "--hardware.device", device, "--teacher.steps", "0",
                     "--multitask.steps", str(steps), "--adapt.starts", "none",
                     "--evaluation.no-constants", "--evaluation.episodes", "1"]  # fmt: skip
            began = time.perf_counter()
            subprocess.run(words, check=True, cwd=folder, stdout=subprocess.DEVNULL)
            seconds.append(time.perf_counter() - began)
    (few, many), (short, long) = STEPS[device], seconds
    value = (many - few) / max(long - short, 1e-9)
    print(f"{processes} processes {value:,.4g} updates/s")
    return [{"fact": f"training, {processes} processes", "value": value, "unit": "updates/s"}]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--device", choices=("cuda", "cpu"), default="cuda")
    parser.add_argument("--processes", type=int, default=1)
    options = parser.parse_args()
    import torch

    target = (rounds.RESULTS if options.device == "cuda" else rounds.BUSY) / "accelerator.json"
    if options.processes == 1:
        name = torch.cuda.get_device_name() if options.device == "cuda" else "a processor"
        record = {"device": name, "versions": rounds.versions(), "facts": facts(options.device)}
    else:
        record = json.loads(target.read_text())
        record["facts"] += several(options.device, options.processes)
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text(json.dumps(record, indent=1) + "\n")


if __name__ == "__main__":
    main()
