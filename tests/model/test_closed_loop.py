from __future__ import annotations

import copy
from typing import Any

import numpy as np
import pytest
import torch
from torch import nn

from mpdt.errors import ShapeError, SpecError
from mpdt.model import moving_window
from mpdt.model.backbone import Backbone, load_backbone
from mpdt.model.blocks import least_rows
from mpdt.model.closed_loop import FEW_ROWS, ClosedLoop
from mpdt.model.policy import PolicyBatch, PromptPolicy
from mpdt.model.returns import ReturnTable

from .conftest import SHAPES, numbers
from .test_policy import LENGTH, A, D, make, unit_returns

STEPS, K = 13, 4
INDEX = torch.tensor([1, 0, 1])
TABLE = ReturnTable(  # one row per prompt
    torch.tensor([2.0, 5.0]), torch.tensor([-1.0, -9.0]),
    torch.tensor([3.0, 9.0]), torch.tensor([3.0, 4.0]),
)  # fmt: skip


def window_of(live: dict[str, np.ndarray], end: int) -> PolicyBatch:
    """Slow twin: the training window of K steps up to `end`, left-padded, cut from the record.

    observations (B, T, D), actions (B, T, A), rewards (B, T), targets (B,), starts (B, T) bool.
    """
    rows = range(live["observations"].shape[0])
    batch: dict[str, list[Any]] = {key: [] for key in ("s", "p", "a", "R", "t", "m")}
    for step in range(end - K + 1, end + 1):
        columns: dict[str, list[Any]] = {key: [] for key in batch}
        for row in rows:
            begun = int(np.flatnonzero(live["starts"][row, : end + 1])[-1])
            pad, t = step < begun, max(step, begun)
            action = live["actions"][row, t]
            columns["s"].append(np.zeros(D) if pad else live["observations"][row, t])
            columns["p"].append(np.zeros(A) if t == begun else live["actions"][row, t - 1])
            columns["a"].append(np.zeros(A) if pad else action)
            columns["R"].append(live["targets"][row] - live["rewards"][row, begun:t].sum())
            columns["t"].append(t - begun)
            columns["m"].append(not pad)
        for key, column in columns.items():
            batch[key].append(np.array(column))
    tensors = {k: torch.from_numpy(np.stack(v, axis=1)[:, None]) for k, v in batch.items()}
    return PolicyBatch(
        tensors["s"].float(), tensors["p"].float(), tensors["R"].float(),
        tensors["t"], tensors["m"], tensors["a"].float(),
    )  # fmt: skip


def live_through(
    loop: ClosedLoop,
    targets: np.ndarray,
    seed: int = 0,
    begins: tuple[tuple[int, ...], ...] = ((0,), (0,), (0,)),
) -> dict[str, np.ndarray]:
    """Act for STEPS steps on made-up observations and rewards; record as a data set would.

    begins: per row, the steps at which an episode of it begins.
    """
    observations = numbers(3, STEPS, D, seed=seed).numpy()
    rewards = numbers(3, STEPS, seed=seed + 1).numpy().astype(np.float64)
    starts = np.array([[t in own for t in range(STEPS)] for own in begins])
    loop.reset(targets)
    actions = [
        loop.act(observations[:, t], rewards[:, t - 1] if t else None,
                 starts[:, t] if starts[:, 1:].any() else None)
        for t in range(STEPS)
    ]  # fmt: skip
    return {
        "observations": observations, "rewards": rewards, "starts": starts,
        "actions": np.stack(actions, axis=1), "targets": targets,
    }  # fmt: skip


def twin_of(
    policy: PromptPolicy, prompts: torch.Tensor | None, live: dict[str, np.ndarray], end: int
) -> np.ndarray:
    """Actions (B, A) by the whole window behind prompts that are run again."""
    own = None if prompts is None else prompts[INDEX]
    with torch.no_grad():
        output = policy(window_of(live, end), own, TABLE.select(INDEX))
    asked = output.actions[:, 0, -1]
    return asked.numpy().clip(-0.3, 0.3)


# Windows that fill, are full from step 3 on, and hold nothing of the first eight steps at last;
# rows that begin together, one after another while others are full, again, and two at once.
TOGETHER = ((0,), (0,), (0,))
APART = ((0, 5), (0, 2, 12), (0, 5, 6))

# Float32 sums in another order: a few units of the last place of hidden vectors of size 1 to 5,
# through a head. Ten times what was seen (2e-6).
NEAR = 2e-5


@pytest.fixture(params=[(shape, depth) for shape in SHAPES for depth in (1, 2)], ids=str)
def any_backbone(request: pytest.FixtureRequest) -> Backbone:
    """One block, where old tokens are only looked at, and two; rotary and learned positions."""
    shape, depth = request.param
    return load_backbone(shape, depth, "float32", seed=3)


@pytest.mark.parametrize("begins", [TOGETHER, APART], ids=["together", "apart"])
@pytest.mark.parametrize(
    "way",
    [
        {},
        {"tokens_per_step": 3},
        {"tokens_per_step": 3, "return_clip": False, "previous_action": False},
        {"previous_action": False},
        {"return_to_go": "none", "time_table": 0},
        {"kind": "mlp", "observation_clip": 0.0},
    ],
    ids=lambda way: ",".join(map(str, way.values())) or "default",
)
@pytest.mark.parametrize("prompted", [True, False], ids=["prompt", "bare"])
def test_acting_equals_training_windows(
    any_backbone: Backbone, way: dict[str, Any], prompted: bool, begins: Any
) -> None:
    policy = make(any_backbone, **way)
    prompts = numbers(2, LENGTH, any_backbone.width) if prompted else None
    loop = ClosedLoop(policy, prompts, INDEX, K, TABLE, action_low=-0.3, action_high=0.3)
    live = live_through(loop, np.array([2.0, 3.5, -1.0]), begins=begins)
    assert (np.abs(live["actions"]) == 0.3).any()  # some were clipped: the record must show it
    for end in range(STEPS):
        expected = twin_of(policy, prompts, live, end)
        np.testing.assert_allclose(live["actions"][:, end], expected, atol=NEAR, err_msg=str(end))


@pytest.mark.parametrize("begins", [TOGETHER, APART], ids=["together", "apart"])
@pytest.mark.parametrize("kind", ["demonstration", "hyper", "lora"])
def test_other_methods_too(any_backbone: Backbone, kind: str, begins: Any) -> None:
    """Prompt-DT's tokens of a demonstration, HDT's adapters, and low-rank additions."""
    backbone = copy.deepcopy(any_backbone)
    policy = make(backbone)
    layers, width = backbone.num_layers, backbone.width
    prompts = numbers(2, 7, width)
    if kind == "hyper":
        backbone.reads_adapters = True
        prompts = 0.3 * numbers(2, layers * 2 * 2, width)
    if kind == "lora":
        backbone.add_low_rank(2, 8.0, seed=1)
        for name, value in backbone.named_parameters():
            if name.endswith(".up"):
                nn.init.normal_(value, generator=torch.Generator().manual_seed(1))
    loop = ClosedLoop(policy, prompts, INDEX, K, TABLE, action_low=-0.3, action_high=0.3)
    live = live_through(loop, np.array([2.0, 3.5, -1.0]), begins=begins)
    plain = make(any_backbone)
    moved = 0.0
    for end in range(STEPS):
        expected = twin_of(policy, prompts, live, end)
        np.testing.assert_allclose(live["actions"][:, end], expected, atol=NEAR, err_msg=str(end))
        moved += float(np.abs(expected - twin_of(plain, None, live, end)).max())
    assert moved > 0.1  # the method says something


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("depth", [1, 2])
def test_in_bfloat16_as_near_to_float32_as_the_whole_window(shape: str, depth: int) -> None:
    """Two roundings cannot agree to the last bit; neither may be further from the truth."""
    half, exact = (load_backbone(shape, depth, dtype, seed=3) for dtype in ("bfloat16", "float32"))
    prompts = numbers(2, LENGTH, half.width)
    policy, truth = make(half), make(exact)
    loop = ClosedLoop(policy, prompts, INDEX, K, TABLE, action_low=-0.3, action_high=0.3)
    live = live_through(loop, np.array([2.0, 3.5, -1.0]), begins=APART)
    errors = []
    for end in range(STEPS):
        expected = twin_of(truth, prompts, live, end)
        errors.append(
            (live["actions"][:, end] - expected, twin_of(policy, prompts, live, end) - expected)
        )
    ours, whole = (float(np.square(error).mean() ** 0.5) for error in zip(*errors, strict=True))
    assert 0 < ours < 1.2 * whole


@pytest.mark.parametrize("dtype", ["float32", "bfloat16"])
@pytest.mark.parametrize("tokens_per_step", [1, 3])
def test_a_row_acts_the_same_to_the_bit_whatever_else_is_there(
    any_backbone: Backbone, tokens_per_step: int, dtype: Any
) -> None:
    """Alone, by two and by five, or beside 36 others that begin at other times."""
    name, depth = any_backbone.name, any_backbone.num_layers
    policy = make(load_backbone(name, depth, dtype, seed=3), tokens_per_step=tokens_per_step)
    prompts, index = numbers(2, LENGTH, any_backbone.width), torch.arange(37) % 2
    seen, rewards = numbers(STEPS, 37, D).numpy(), numbers(STEPS, 37, seed=1).numpy()
    starts = np.array([[t == 0 or t == row % 11 for row in range(37)] for t in range(STEPS)])

    def acted(rows: slice) -> np.ndarray:
        loop = ClosedLoop(policy, prompts, index[rows], K, TABLE)
        steps = zip(seen[:, rows], rewards[:, rows], starts[:, rows], strict=True)
        return np.stack([loop.act(*step) for step in steps], axis=1)

    together = acted(slice(None))
    for rows in (slice(0, 1), slice(5, 6), slice(36, 37), slice(8, 10), slice(20, 25)):
        assert np.array_equal(acted(rows), together[rows]), rows


def test_as_wide_as_a_language_model_with_a_short_window_too() -> None:
    """Four columns of a lone row are few rows of a product in every block but the first."""
    policy = make(load_backbone("random:smollm2-135m", 2, "float32", seed=3))
    prompts, index = numbers(2, LENGTH, policy.backbone.width), torch.arange(6) % 2
    seen, rewards = numbers(STEPS, 6, D).numpy(), numbers(STEPS, 6, seed=1).numpy()
    starts = np.repeat(np.arange(STEPS)[:, None] == 0, 6, axis=1)

    def acted(rows: slice) -> np.ndarray:
        loop = ClosedLoop(policy, prompts, index[rows], K, TABLE)
        steps = zip(seen[:, rows], rewards[:, rows], starts[:, rows], strict=True)
        return np.stack([loop.act(*step) for step in steps], axis=1)

    assert np.array_equal(acted(slice(2, 3)), acted(slice(None))[2:3])


@pytest.mark.parametrize(("wide", "out"), [(576, 1536), (192, 576), (256, 64), (64, 8)])
def test_so_many_rows_round_as_any_number_of_rows(wide: int, out: int) -> None:
    """Shapes that were not asked about."""
    weight, many = numbers(out, wide), numbers(96, wide, seed=1)
    whole = torch.nn.functional.linear(many, weight)
    for rows in range(least_rows(), 96):
        assert torch.equal(torch.nn.functional.linear(many[:rows].clone(), weight), whole[:rows])


def test_many_rows_go_through_in_parts(
    any_backbone: Backbone, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Full windows and filling ones; nine rows in two parts, and what they would be in one."""
    policy, index = make(any_backbone), torch.tensor([0, 1, 0, 0, 1, 1, 1, 0, 1])
    prompts, seen = numbers(2, LENGTH, any_backbone.width), numbers(STEPS, 9, D).numpy()
    acted = []
    for at_once in (4, 10**6):
        monkeypatch.setattr(moving_window, "_AT_ONCE", at_once)
        loop = ClosedLoop(policy, prompts, index, K, TABLE)
        late = np.arange(9) % 2 == 1
        acted.append([loop.act(row, np.zeros(9), late & (t == 9)) for t, row in enumerate(seen)])
    assert np.array_equal(*acted)


def test_a_second_episode_remembers_nothing(gpt2_shaped: Backbone) -> None:
    loop = ClosedLoop(make(gpt2_shaped), numbers(2, LENGTH, 64), INDEX, K, TABLE)
    first = live_through(loop, np.zeros(3), seed=0)
    other = live_through(loop, np.zeros(3), seed=5)
    again = live_through(loop, np.zeros(3), seed=0)
    assert np.array_equal(first["actions"], again["actions"])
    assert not np.allclose(first["actions"], other["actions"])


def test_targets_default_to_those_of_the_row_s_task(gpt2_shaped: Backbone) -> None:
    """Prompt indices 1, 0, 1 and targets 3, 4: rows start at 4, 3, 4."""
    loop = ClosedLoop(make(gpt2_shaped), numbers(2, LENGTH, 64), INDEX, K, TABLE)
    observation = numbers(3, D).numpy()
    default = loop.act(observation)
    loop.reset(np.array([4.0, 3.0, 4.0]))
    assert np.array_equal(loop.act(observation), default)
    loop.reset(np.array([0.0, 0.0, 0.0]))
    assert not np.allclose(loop.act(observation), default)


def test_rewards_lower_the_return_to_go_and_none_keeps_it(gpt2_shaped: Backbone) -> None:
    loop = ClosedLoop(make(gpt2_shaped), None, INDEX, K, TABLE)
    loop.reset(np.array([2.0, 2.0, 2.0]))
    loop.act(np.zeros((3, D)))
    loop.act(np.zeros((3, D)), np.array([0.5, -1.0, 0.0]))
    loop.act(np.zeros((3, D)))
    assert loop._last is not None
    assert loop._last.returns_to_go.tolist() == [1.5, 3, 2]
    assert loop._last.timesteps.tolist() == [2, 2, 2]


def test_rows_do_not_influence_each_other(gpt2_shaped: Backbone) -> None:
    """A finished row may hold anything, even NaN."""
    loop = ClosedLoop(make(gpt2_shaped), numbers(2, LENGTH, 64), INDEX, K, TABLE)
    observation = numbers(3, D).numpy()
    clean = loop.act(observation)
    loop.reset()
    observation[2] = np.nan
    np.testing.assert_allclose(loop.act(observation)[:2], clean[:2], atol=1e-6)


def test_no_gradient_and_float32(gpt2_shaped: Backbone) -> None:
    prompts = numbers(2, LENGTH, 64).requires_grad_()
    loop = ClosedLoop(make(gpt2_shaped), prompts, INDEX, K, TABLE)
    action = loop.act(np.zeros((3, D), dtype=np.float64))
    assert (action.dtype, action.shape) == (np.float32, (3, A))
    assert prompts.grad is None and prompts.requires_grad


def test_mistakes_of_the_caller(gpt2_shaped: Backbone) -> None:
    policy = make(gpt2_shaped)
    with pytest.raises(ShapeError, match="indices below 1, found 1"):
        ClosedLoop(policy, numbers(1, LENGTH, 64), INDEX, K, unit_returns(2))
    loop = ClosedLoop(policy, numbers(2, LENGTH, 64), INDEX, K, TABLE)
    with pytest.raises(ShapeError, match=r"observations of a closed loop; expected \(3, 5\)"):
        loop.act(np.zeros((2, D)))
    with pytest.raises(SpecError, match="before the first step"):
        loop.act(np.zeros((3, D)), np.zeros(3))
    with pytest.raises(ShapeError, match="targets"):
        loop.reset(np.zeros(2))
    with pytest.raises(SpecError, match="without a table"):
        ClosedLoop(policy, None, INDEX, K).reset(np.zeros(3))


def test_a_row_that_begins_again_forgets_even_what_is_no_number(any_backbone: Backbone) -> None:
    for tokens_per_step in (1, 3):
        policy = make(any_backbone, tokens_per_step=tokens_per_step)
        loop = ClosedLoop(policy, None, INDEX, K, TABLE)
        observation = numbers(3, D).numpy()
        clean = loop.act(observation)
        broken = observation.copy()
        broken[1] = np.nan
        assert np.isnan(loop.act(broken, np.zeros(3))[1]).all()
        again = loop.act(observation, np.full(3, np.nan), np.array([True, True, True]))
        np.testing.assert_allclose(again, clean, atol=NEAR)
        loop.act(broken, np.zeros(3))
        alone = loop.act(observation, np.zeros(3), np.array([False, True, False]))
        np.testing.assert_allclose(alone[1], clean[1], atol=NEAR)


@pytest.mark.parametrize(("rows", "inside"), [(1, 1), (FEW_ROWS, 1), (FEW_ROWS + 1, 3)])
def test_threads_are_left_as_they_were(rows: int, inside: int, gpt2_shaped: Backbone) -> None:
    policy, seen = make(gpt2_shaped, return_to_go="none"), []
    loop = ClosedLoop(policy, None, torch.zeros(rows, dtype=torch.long), K)
    policy.head.register_forward_hook(lambda *_: seen.append(torch.get_num_threads()))
    before = torch.get_num_threads()
    torch.set_num_threads(3)
    try:
        loop.act(np.zeros((rows, D), np.float32))
        with pytest.raises(ShapeError):
            loop.act(np.zeros((rows, D + 1), np.float32))
        assert (seen, torch.get_num_threads()) == ([inside], 3)
    finally:
        torch.set_num_threads(before)
