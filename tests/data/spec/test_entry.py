import hashlib
import math

import msgspec
import pytest

from mpdt.data.spec.entry import (
    Behaviour,
    DatasetSpec,
    EpisodeCounts,
    TtaRule,
    canonical_json,
    spec_hash,
)
from mpdt.data.spec.goals import GoalSet
from mpdt.data.spec.smoke import smoke
from mpdt.errors import SpecError

SPEC = DatasetSpec(
    name="tiny", version="1.0.0", family="cheetah_dir", horizon=5, seed=7, block=3,
    behaviour=Behaviour(network="cheetah_dir"), episodes=EpisodeCounts(random=9, history=3),
    tta={"default": TtaRule(episodes=20)}, license="CC0-1.0",
)  # fmt: skip


def changed(**changes):
    return msgspec.structs.replace(SPEC, **changes)


def test_canonical_json_has_one_form():
    assert canonical_json({"b": 1, "a": [True, None, 0.5, "é"]}) == (
        b'{"a":[true,null,0.5,"\xc3\xa9"],"b":1}'
    )


@pytest.mark.parametrize("number", [math.nan, math.inf, -math.inf])
def test_canonical_json_refuses_what_json_lacks(number):
    with pytest.raises(ValueError, match="JSON compliant"):
        canonical_json({"a": number})


def test_spec_hash_is_of_the_canonical_json():
    text = (
        '{"behaviour":{"network":"cheetah_dir","noise":0.0,"rungs":20,"script":null},"block":3,'
        '"env":{},"episodes":{"expert":0,"history":3,"medium":0,"random":9},'
        '"family":"cheetah_dir","goals":null,"horizon":5,"license":"CC0-1.0","name":"tiny","reference":20,'
        '"seed":7,"tasks":"all","test":null,"tta":{"default":{"action_scale":1.0,"episodes":20,'
        '"horizon":null,"preset_return":"auto","tasks":"test"}},"version":"1.0.0"}'
    )
    assert spec_hash(SPEC) == hashlib.sha256(text.encode()).hexdigest()
    assert spec_hash(changed(seed=8)) != spec_hash(SPEC)


def test_tasks_resolve_in_family_order_without_repeats():
    assert [t.name for t in SPEC.resolve_tasks()] == ["forward", "backward"]
    picked = changed(family="cheetah_vel", tasks=(39, 9, "v0.075", 0, 31, 17, 5, 22, 38))
    assert [t.index for t in picked.resolve_tasks()] == [0, 5, 9, 17, 22, 31, 38, 39]


def test_an_entry_may_split_its_tasks_anew():
    spec = changed(family="ant_dir", tasks=(8, 41, 1, 4), test=(1, "dir-04"))
    assert [(t.index, t.role) for t in spec.resolve_tasks()] == [
        (1, "test"),
        (4, "test"),
        (8, "train"),
        (41, "train"),
    ]


@pytest.mark.parametrize(
    ("fields", "what"),
    [
        ({"tasks": (1, 2), "test": (3,)}, "test: not among the tasks: v0.300"),
        ({"tasks": (1, 2), "test": (1, 2)}, "test: leaves no training task"),
        ({"test": ()}, "test: empty"),
        ({"test": (99,)}, "test: unknown task '99'"),
        ({"goals": GoalSet(count=5, held_out=1)}, "goals: a task of cheetah_vel is its goal"),
        ({"family": "mt10", "goals": GoalSet(count=5, held_out=5)}, "goals: 5 of 5 goals"),
    ],
)
def test_wrong_splits_are_refused(fields, what):
    with pytest.raises(SpecError) as caught:
        changed(**({"family": "cheetah_vel"} | fields))
    assert what in str(caught.value)


def test_smoke_is_small_and_has_another_identity():
    small = smoke(changed(block=50))
    assert (small.name, small.version) == ("tiny-smoke", "1.0.0+smoke")
    assert small.episodes == EpisodeCounts(random=4, history=3)
    assert (small.block, small.reference, small.tta["default"].episodes) == (2, 2, 2)
    assert small.horizon == SPEC.horizon
    assert smoke(changed(version="1.0.0+x")).version == "1.0.0+x.smoke"


@pytest.mark.parametrize(
    ("changes", "where", "what"),
    [
        ({"version": "1.0"}, "tiny.version", "'1.0' is not SemVer"),
        ({"name": "a/b"}, "a/b.name", "cannot name a file"),
        ({"horizon": 0}, "tiny.horizon", "0 is too small"),
        ({"seed": -1}, "tiny.seed", "-1 is too small"),
        ({"block": 0}, "tiny.block", "0 is too small"),
        ({"license": ""}, "tiny.license", "empty"),
        ({"behaviour": Behaviour()}, "tiny.behaviour", "exactly one of network, script and bundle"),
        ({"behaviour": Behaviour(network="a", script="b")}, "tiny.behaviour", "exactly one"),
        ({"behaviour": Behaviour(script="a", rungs=1)}, "tiny.behaviour.rungs", "1 is too small"),
        ({"behaviour": Behaviour(script="a", noise=-0.1)}, "tiny.behaviour.noise", "-0.1"),
        ({"episodes": EpisodeCounts(medium=-1)}, "tiny.episodes.medium", "-1 is too small"),
        ({"horizon": 10**9}, "tiny.horizon", "1,000,000,000 is too large"),
        ({"seed": 2**70}, "tiny.seed", "is too large"),
        ({"block": 10**6}, "tiny.block", "is too large"),
        ({"reference": 10**12}, "tiny.reference", "is too large"),
        ({"episodes": EpisodeCounts(random=10**12)}, "tiny.episodes.random", "is too large"),
        ({"episodes": EpisodeCounts(random=10**6), "block": 1}, "tiny.episodes", "blocks of work"),
        ({"tta": {"a": TtaRule(episodes=10**9)}}, "tiny.tta.a.episodes", "is too large"),
        ({"tta": {"a": TtaRule(episodes=1, horizon=10**9)}}, "tiny.tta.a.horizon", "too large"),
        ({"behaviour": Behaviour(script="a", rungs=10**9)}, "tiny.behaviour.rungs", "too large"),
        ({"family": "cheetah"}, "tiny.family", r"'cheetah' \(did you mean 'cheetah_"),
        ({"tasks": ("forwrd",)}, "tiny.tasks", r"'forwrd' \(did you mean 'forward'\?\)"),
        ({"tasks": (2,)}, "tiny.tasks", "unknown task '2'"),
        ({"tasks": ()}, "tiny.tasks", "empty"),
        ({"env": {"terminate": True}}, "tiny.env.terminate", "unknown key 'terminate'"),
        ({"tta": {"a/b": TtaRule(episodes=1)}}, "tiny.tta.a/b", "cannot name a set"),
        ({"tta": {"a": TtaRule(episodes=0)}}, "tiny.tta.a.episodes", "0 is too small"),
        ({"tta": {"a": TtaRule(episodes=1, action_scale=0.0)}}, "tiny.tta.a.action_scale", "0.0"),
        ({"tta": {"a": TtaRule(episodes=1, horizon=0)}}, "tiny.tta.a.horizon", "0 is too small"),
        ({"family": "ml10", "horizon": 501}, "tiny.horizon", "501 steps are too many"),
    ],
)
def test_impossible_specs_name_their_key(changes, where, what):
    with pytest.raises(SpecError, match=what) as caught:
        changed(**changes)
    assert caught.value.where == where
    assert caught.value.exit_code == 2


def test_env_options_of_the_robot_pass():
    ant = changed(family="ant_dir", env={"terminate": False, "control_cost": 0.1})
    assert ant.env == {"terminate": False, "control_cost": 0.1}


def test_several_mistakes_come_at_once():
    with pytest.raises(SpecError) as caught:
        changed(version="1", horizon=0, tasks=("forwrd",))
    text = str(caught.value)
    assert text.startswith("3 mistakes")
    assert all(key in text for key in ("tiny.version", "tiny.horizon", "tiny.tasks"))
