"""Whatever a run reads is part of its identity, in the part it belongs to."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from mpdt.data.reference import REFERENCE_POLICIES
from mpdt.train.adapt.align import AdaptSettings
from mpdt.train.adapt.infer import InferSettings
from mpdt.train.fit.data import load_material
from mpdt.train.fit.reward import RewardSettings
from mpdt.train.run.config import TrainConfig, to_plain
from mpdt.train.run.identity import identify, plain_settings


def with_dataset(material, **changes):
    return replace(material, dataset=replace(material.dataset, **changes))


def with_set(material, **changes):
    x = {"default": replace(material.dataset.tta["default"], **changes)}
    return with_dataset(material, tta=x)


def with_tasks(material, **changes):
    return with_dataset(material, tasks=replace(material.dataset.tasks, **changes))


def with_reference(material, name):
    first, *rest = material.dataset.tasks.references
    bumped = replace(first[name], mean=first[name].mean + 1e-9)
    changed = replace(first, by_name=first.by_name | {name: bumped})
    return with_tasks(material, references=(changed, *rest))


def with_constant_action(material, action):
    references = material.dataset.tasks.references
    return with_tasks(
        material, references=tuple(replace(each, constant_action=action) for each in references)
    )


def with_stats(material, name):
    info = material.dataset.stats_info
    fields = {key: dict(value) for key, value in info.fields.items()}
    fields["observations"][name] = fields["observations"][name] + 1e-9
    return with_dataset(material, stats_info=replace(info, fields=fields))


def with_ids(material):
    first, *_rest = material.train_rows
    ids = dict(material.episode_ids)
    ids[first] = ids[first][1:]
    return replace(material, episode_ids=ids)


def with_spec(material, **changes):
    return with_dataset(material, spec={**material.dataset.spec, **changes})


def bumped(values):
    return values + np.float32(1)


@pytest.fixture(scope="module")
def material(tiny_file):
    return load_material(str(tiny_file), "auto")


def identity_of(config, material):
    return identify(config, plain_settings(config), material)


def changed(config, material, config2, material2):
    """Names of the parts that differ."""
    one, two = identity_of(config, material), identity_of(config2, material2)
    return {part for part in one.hashes if one.hashes[part] != two.hashes[part]}


SETTINGS = [
    (f"{part}.{name}" if isinstance(values, dict) else part)
    for part, values in to_plain(TrainConfig()).items()
    for name in (values if isinstance(values, dict) else [part])
]


def with_setting(key):
    """TrainConfig with another value of one setting; checks of values are passed by."""
    part, _, name = key.partition(".")
    config = TrainConfig()
    if not name:
        return msgspec.structs.replace(config, **{part: OTHERS.get(part, 0)})
    own = msgspec.structs.asdict(getattr(config, part))
    value = own[name]
    kinds = {bool: lambda v: not v, int: lambda v: v + 1, float: lambda v: v + 0.5}
    other = kinds.get(type(value), lambda v: OTHERS[key])(value)
    return msgspec.structs.replace(
        config, **{part: type(getattr(config, part))(**own | {name: other})}
    )


OTHERS = {
    "backbone.name": "gpt2", "backbone.depth": 3, "backbone.dtype": "float32",
    "inputs.kind": "mlp", "inputs.start": "random", "inputs.return_to_go": "none",
    "inputs.tokens_per_step": 3, "head.hidden": 7, "prompts.init_std": 1.0,
    "prompts.task_init": "ones", "sampler.order": "sequential", "optimiser.schedule": "cosine",
    "teacher.distillation": "none", "statistics.source": "random", "statistics.axes": "position",
    "adapt.starts": ("none",), "adapt.layers": (0,), "adapt.returns": "decrement",
    "adapt.target": "training", "adapt.infer": InferSettings(tasks=3), "prompts.kind": "shared",
    "evaluation.blocks": ("test",), "mixing.model": RewardSettings(tasks=3),
    "hardware.device": "cuda", "hardware.autocast": "bfloat16", "hardware.compile": "eager",
    "few_shot.qualities": ("expert",), "few_shot.start": "cross_mean", "few_shot.tuned": "all",
    "seed": 1, "method": "X", "began_from": "0" * 64, "validation": "few",
}  # fmt: skip


JUDGED = ("method", "adapt", "few_shot", "statistics", "evaluation")


@pytest.mark.parametrize(
    "key",
    [
        k
        for k in SETTINGS
        if k not in ("quality", "adapt.set", "adapt.trials", "inputs.tokens_per_step", "patience")
    ],
)
def test_every_setting_counts_in_its_part(material, key):
    part = "judging" if key.partition(".")[0] in JUDGED else "training"
    assert changed(TrainConfig(), material, with_setting(key), material) == {part}


@pytest.mark.parametrize(
    ("change", "part"),
    [
        (with_ids, "training"),
        (lambda m: with_stats(m, "mean"), "training"),
        (lambda m: with_stats(m, "std"), "training"),
        (lambda m: with_dataset(m, content_hash="0" * 64), "training"),
        (lambda m: replace(m, slice="few"), "training"),
        (lambda m: replace(m, quality="medium"), "training"),
        (lambda m: with_set(m, content_hash="0" * 64), "judging"),
        (lambda m: with_set(m, preset_return=bumped(m.dataset.tta["default"].preset_return)),
         "judging"),
        *((lambda m, n=name: with_reference(m, n), "judging") for name in REFERENCE_POLICIES),
        (lambda m: with_constant_action(m, (1.0, *[0.0] * 5)), "judging"),
        (lambda m: replace(m, test_rows=(0,)), "judging"),
        (lambda m: with_spec(m, horizon=7), "judging"),
        (lambda m: with_spec(m, env={"x": True}), "judging"),
    ],
)  # fmt: skip
def test_all_data_that_is_read_counts_in_its_part(material, change, part):
    assert changed(TrainConfig(), material, TrainConfig(), change(material)) == {part}


def test_the_same_episodes_of_other_tasks_are_another_run(material):
    a, b = material.train_rows
    swapped = {a: material.episode_ids[b], b: material.episode_ids[a]}
    other = replace(material, episode_ids=swapped)
    assert changed(TrainConfig(), material, TrainConfig(), other) == {"training"}


def test_what_is_not_read_does_not_count(material, tmp_path):
    plain = msgspec.convert({"adapt": {"starts": ["none"]}}, TrainConfig)
    assert not changed(plain, material, plain, with_set(material, content_hash="0" * 64))
    assert not changed(plain, material, plain, with_dataset(material, tta={}))
    moved = with_dataset(material, path=tmp_path / "moved.h5")
    assert not changed(TrainConfig(), material, TrainConfig(), moved)
    # `auto` stood for expert: typing it out is no other run.
    assert not changed(TrainConfig(), material, TrainConfig(quality="expert"), material)


def test_one_and_one_point_zero_are_one_setting(material):
    whole, real = (
        msgspec.structs.replace(TrainConfig(), target_quantile=value) for value in (1, 1.0)
    )
    assert not changed(whole, material, real, material)


def test_runs_from_before_tasks_could_be_told_by_steps_are_who_they_were():
    assert "by" not in plain_settings(TrainConfig())["adapt"]["infer"] == InferSettings().facts
    by_steps = TrainConfig(adapt=AdaptSettings(infer=InferSettings(by="steps")))
    assert plain_settings(by_steps)["adapt"]["infer"] == by_steps.adapt.infer.facts
    assert by_steps.adapt.infer.facts["by"] == "steps"
