"""The card of a bundle: README.md as model hubs read it, front matter and tables.

Licences are those of what is inside: our numbers, and the language model's blocks where they are.
What is not known is left out, not guessed.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import yaml

from mpdt.draw.table import Table, markdown_page
from mpdt.train.bundle.format import MODEL, OWN, BundleConfig
from mpdt.train.evaluate.score import EXPERT, MEAN, REFERENCES, Score
from mpdt.train.evaluate.tables import NORMALISED, build_tables

LICENSE = "mit"
"""Of the numbers that were trained here, as of this package."""
_LANGUAGE_MODELS = {  # name here -> id on the hub, SPDX id as hubs write it
    "smollm2-135m": ("HuggingFaceTB/SmolLM2-135M-Instruct", "apache-2.0"),
    "gpt2": ("openai-community/gpt2", "mit"),
}


def card_of(config: BundleConfig, scores: Sequence[Score]) -> str:
    """README.md. `scores` as in results.json: trivial rows and intervals among them."""
    matter = yaml.safe_dump(_front_matter(config, scores), sort_keys=False, allow_unicode=True)
    return f"---\n{matter}---\n\n{_page(config, scores)}"


def _front_matter(config: BundleConfig, scores: Sequence[Score]) -> dict[str, Any]:
    base, license = _language_model(config)
    licenses = list(dict.fromkeys(one for one in (LICENSE, license) if one))
    matter: dict[str, Any] = {
        "license": licenses[0] if len(licenses) == 1 else licenses,
        "library_name": "mpdt",
        "pipeline_tag": "reinforcement-learning",
        "tags": ["reinforcement-learning", "offline-rl", "multi-task", "decision-transformer",
                 "mpdt", config.family.name],
        "datasets": [config.data.name],
    }  # fmt: skip
    if base:
        matter["base_model"] = base
    metrics = [metric for score in scores if _is_mean(score) for metric in _metrics(score)]
    if metrics:
        matter["model-index"] = [{
            "name": config.name,
            "results": [{
                "task": {"type": "reinforcement-learning", "name": config.family.name},
                "dataset": {"name": config.data.name, "type": config.data.name,
                            "revision": config.data.content_hash},
                "metrics": metrics,
            }],
        }]  # fmt: skip
    return matter


def _is_mean(score: Score) -> bool:
    return score.task == MEAN and score.mean == score.mean


def _metrics(score: Score) -> list[dict[str, Any]]:
    """Mean return with its interval, and the share of successes; trivial rows are there too."""
    name = f"{score.block} tasks, {score.method}"
    interval = "" if score.low != score.low else f" [{score.low:.1f}, {score.high:.1f}]"
    rows = [{"type": "mean_reward", "name": f"mean return, {name}",
             "value": f"{score.mean:.1f}{interval}"}]  # fmt: skip
    if score.success is not None:
        rows.append({"type": "success_rate", "name": f"success, {name}",
                     "value": f"{score.success:.3f}"})  # fmt: skip
    return rows


def _language_model(config: BundleConfig) -> tuple[str, str]:
    """Its id and licence on the hub; empty where there is none, or none that is known."""
    name = config.backbone.name
    if name.startswith("random:"):
        return "", ""
    known = _LANGUAGE_MODELS.get(name)
    if known is None:
        return ("" if name.startswith((".", "/", "~")) else name), ""
    # Blocks that are not inside are under no licence of this bundle.
    return known[0], known[1] if config.backbone.shape is not None else ""


def _page(config: BundleConfig, scores: Sequence[Score]) -> str:
    began = config.training.settings.get("began_from")
    facts = {
        "name": config.name,
        "policy": f"{config.training.method} on {config.family.name}, window {config.window}",
        "language model": _said(config),
        "data": f"{config.data.name} {config.data.version}, content {config.data.content_hash}, "
        f"{config.data.quality}" + (f", slice {config.data.slice}" if config.data.slice else ""),
        **({"began from": f"a policy, seal {began}"} if began else {}),
        "updates": ", ".join(f"{phase} {n} of {config.training.updates_asked[phase]}"
                             for phase, n in config.training.updates.items()),
        "trained with": ", ".join(f"{k} {v}" for k, v in config.versions.items()),
    }  # fmt: skip
    closing = NORMALISED + "\nIntervals are of 95 %, over the seeds of evaluation; " + (
        f"{', '.join(REFERENCES[:-1])} know nothing, {EXPERT} made the data.\n\n"
    ) + _how_to_act(config)  # fmt: skip
    return markdown_page(facts, [_prompt_table(config), *build_tables(scores)], closing)


def _said(config: BundleConfig) -> str:
    facts = config.backbone
    depth = "all" if facts.depth is None else str(facts.depth)
    where = f"in {MODEL}" if facts.shape else "not inside: read by name, and compared"
    trained = {"none": "frozen", "additions": "trained by low-rank additions", "all": "trained"}
    text = f"{facts.name} {facts.revision}".strip()
    text += f", {depth} blocks, {facts.dtype}, {trained[facts.trained]}, {where}"
    return f"{text}; weights {facts.fingerprint}"


def _prompt_table(config: BundleConfig) -> Table:
    rows = tuple(
        (one.name, str(len(one.tasks)), one.reads or "training data of these tasks")
        for one in config.prompts
    )
    notes = [f"Not inside, a network of its own for each task: {', '.join(config.left_out)}"]
    return Table(
        "Prompts", ("start", "tasks", "made from"), rows, tuple(notes[: bool(config.left_out)])
    )


def _how_to_act(config: BundleConfig) -> str:
    first = config.prompts[0]
    start = "" if first.name == OWN else f', start="{first.name}"'
    return (
        "## Acting\n\n```python\nimport mpdt\n\n"
        f'policy = mpdt.load_policy("DIR", task="{first.tasks[0]}"{start})\n'
        "observation, reward, over = env.reset(seed=0)[0], None, False\n"
        "while not over:\n"
        "    observation, reward, terminated, truncated, _ = "
        "env.step(policy.act(observation, reward))\n"
        "    over = terminated or truncated\n```"
    )
