"""Presets, and the difference between two configurations."""

import msgspec
import pytest

from mpdt.errors import SpecError, UsageError
from mpdt.train.run.config import TrainConfig, from_plain, to_plain
from mpdt.train.run.methods import merge
from mpdt.train.run.presets import PRESETS, get_preset, paper


@pytest.mark.parametrize("name", PRESETS)
def test_presets_survive_json(name):
    config = get_preset(name)
    assert from_plain(msgspec.json.decode(msgspec.json.encode(to_plain(config)))) == config


def test_paper_holds_the_published_numbers():
    config = paper()
    assert (config.sampler.window, config.sampler.per_task) == (20, 16)
    assert (config.prompts.length, config.prompts.rank, config.prompts.init_std) == (30, 1, 1.0)
    assert config.optimiser.lr_cross == config.optimiser.lr_task == 1e-4
    assert (config.optimiser.weight_decay, config.optimiser.clip) == (1e-4, 0.25)
    assert config.evaluation.episodes == 5 and config.backbone.name == "gpt2"
    assert config.adapt.starts == ("cross",)


def test_unknown_preset_names_the_nearest():
    with pytest.raises(UsageError, match=r"unknown preset 'bass' \(did you mean 'base'\?\)"):
        get_preset("bass")


def test_refusals():
    with pytest.raises(SpecError, match="target_quantile: setting out of range"):
        TrainConfig(target_quantile=1.5)
    with pytest.raises(SpecError, match="not a training configuration"):
        from_plain({"sede": 1})


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"prompts": {"kind": "none"}}, "few-shot has no prompt to tune"),
        ({"few_shot": {"start": "infer_aligned"}}, "none is inferred"),
        ({"few_shot": {"start": "none"}}, "this start tunes nothing"),
    ],
)
def test_few_shot_that_cannot_work_is_refused_before_training(changes, text):
    plain = merge(to_plain(TrainConfig()), {"few_shot": {"qualities": ["expert"]}})
    with pytest.raises(UsageError, match=text):
        from_plain(merge(plain, changes))
