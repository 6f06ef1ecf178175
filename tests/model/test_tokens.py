from __future__ import annotations

from typing import Any

import pytest
import torch
from torch import Tensor

from mpdt.errors import BackboneError, ShapeError, SpecError
from mpdt.model.tokens import InputMap, InputSettings, choose_rows, word_rows

from .conftest import numbers

D, A, S = 5, 2, 32
WORDS = 3.0 + 0.5 * numbers(200, S, seed=7)  # a clear mean, as real tables have


def make(**settings: Any) -> InputMap:
    base = {"return_to_go": "none", "time_table": 0, **settings}
    return InputMap(InputSettings(**base), D, A, WORDS, torch.zeros(D), torch.ones(D))


def tokens_of(inputs: InputMap, **changes: Any) -> Tensor:
    K = 3
    fields: dict[str, Any] = {
        "observations": numbers(1, 1, K, D),
        "previous_actions": numbers(1, 1, K, A, seed=1),
        "returns_to_go": numbers(1, 1, K, seed=2),
        "timesteps": torch.arange(K)[None, None],
        "mask": torch.ones(1, 1, K, dtype=torch.bool),
        "actions": numbers(1, 1, K, A, seed=3),
        **changes,
    }
    tokens: Tensor = inputs(**fields)
    return tokens


def test_rows_are_words_in_even_steps() -> None:
    """200 words, 4 wanted: 0, 50, 100, 150; a duplicate of a chosen one gives way to its next."""
    assert choose_rows(WORDS, 4).tolist() == [0, 50, 100, 150]
    table = WORDS.clone()
    table[50] = table[0]
    assert choose_rows(table, 4).tolist() == [0, 51, 100, 150]


def test_words_at_the_mean_are_passed_over() -> None:
    table = WORDS.clone()
    table[100] = WORDS.mean(dim=0)
    assert choose_rows(table, 4).tolist() == [0, 50, 101, 150]


def test_every_input_is_identifiable() -> None:
    for num in (D + A, S // 2):
        rows, _ = word_rows(InputSettings(), WORDS, num, seed=0)
        assert int(torch.linalg.matrix_rank(rows)) == num


def test_too_narrow_a_table_is_refused() -> None:
    with pytest.raises(BackboneError, match="33 independent rows of width 32, found"):
        choose_rows(WORDS, 33)


@pytest.mark.parametrize("start", ["words", "random"])
@pytest.mark.parametrize("scale", [1.0, 0.5])
def test_unit_inputs_give_tokens_of_the_size_of_words(start: str, scale: float) -> None:
    """E|token|^2 = |mean|^2 + scale^2 E|word - mean|^2: at scale 1 exactly a word's."""
    centre = WORDS.mean(dim=0)
    expected = centre.square().sum() + scale**2 * (WORDS - centre).square().sum(1).mean()
    tokens = tokens_of(
        make(scale=scale, start=start),
        observations=numbers(1, 1, 4000, D),
        previous_actions=numbers(1, 1, 4000, A, seed=1),
        timesteps=torch.zeros(1, 1, 4000, dtype=torch.long),
        mask=torch.ones(1, 1, 4000, dtype=torch.bool),
    )
    assert float(tokens.square().sum(-1).mean()) == pytest.approx(float(expected), rel=0.02)


def test_a_token_is_the_mean_word_plus_a_mixture_of_words() -> None:
    """Only observation 2 is not zero: the token moves along the centred word of its row."""
    observations = torch.zeros(1, 1, 3, D)
    observations[0, 0, 1, 2] = 2.0
    tokens = tokens_of(make(), observations=observations, previous_actions=torch.zeros(1, 1, 3, A))
    centre = WORDS.mean(dim=0)
    word = WORDS[int(choose_rows(WORDS, D + A)[2])] - centre
    size = (WORDS - centre).square().sum(dim=1).mean().sqrt()
    expected = centre + 2.0 * size * word / word.norm() / (D + A) ** 0.5
    torch.testing.assert_close(tokens[0, 0, 1], expected)
    torch.testing.assert_close(tokens[0, 0, 0], centre)


def test_observations_are_standardised_and_cut() -> None:
    """(7 - 1) / 2 = 3. Without spread, divided by 1e-6: 1 - 1 stays 0, 2 - 1 is cut at 10."""
    mean, std = torch.ones(D), torch.full((D,), 2.0)
    std[3:] = 0.0
    inputs = InputMap(InputSettings(return_to_go="none", time_table=0), D, A, WORDS, mean, std)
    plain = make()
    raw, cooked = torch.ones(1, 1, 3, D), torch.zeros(1, 1, 3, D)
    raw[..., 0], cooked[..., 0] = 7.0, 3.0
    raw[..., 4], cooked[..., 4] = 2.0, 10.0
    torch.testing.assert_close(
        tokens_of(inputs, observations=raw), tokens_of(plain, observations=cooked)
    )


def test_pads_are_blank_whatever_stands_there() -> None:
    mask = torch.tensor([[[False, True, True]]])
    settings = {"return_to_go": "task", "return_dropout": 0.1, "time_table": 9}
    inputs = make(**settings)
    assert inputs.time is not None
    torch.nn.init.ones_(inputs.time[1:])
    clean = tokens_of(inputs, mask=mask)
    dirty = numbers(1, 1, 3, D)
    dirty[0, 0, 0] = torch.nan
    steps = torch.tensor([[[8, 1, 2]]])
    assert torch.equal(tokens_of(inputs, mask=mask, observations=dirty), clean)
    assert torch.equal(tokens_of(inputs, mask=mask, timesteps=steps), clean)


def test_previous_action_and_return_are_seen_only_if_asked() -> None:
    other = {"previous_actions": numbers(1, 1, 3, A, seed=8), "returns_to_go": torch.ones(1, 1, 3)}
    for name, settings in (
        ("previous_actions", {"previous_action": False}),
        ("returns_to_go", {"return_to_go": "none"}),
    ):
        change = {name: other[name]}
        seeing, blind = make(return_to_go="task"), make(**{"return_to_go": "task", **settings})
        assert not torch.equal(tokens_of(seeing), tokens_of(seeing, **change)), name
        assert torch.equal(tokens_of(blind), tokens_of(blind, **change)), name


def test_return_dropout_hides_whole_windows_and_repeats() -> None:
    inputs = make(return_to_go="task", return_dropout=0.5)
    M = 400
    fields = {
        "observations": torch.zeros(1, M, 2, D),
        "previous_actions": torch.zeros(1, M, 2, A),
        "returns_to_go": torch.ones(1, M, 2),
        "timesteps": torch.zeros(1, M, 2, dtype=torch.long),
        "mask": torch.ones(1, M, 2, dtype=torch.bool),
    }
    seen = inputs(**fields)[0, 0, 0]
    unknown = inputs(**{**fields, "returns_to_go": None})[0, 0, 0]
    assert not torch.allclose(seen, unknown)
    dropped = inputs(**fields, generator=torch.Generator().manual_seed(1))
    hidden = (dropped == unknown).all(dim=-1)
    assert torch.equal(hidden[..., 0], hidden[..., 1])
    assert 0.4 < float(hidden.float().mean()) < 0.6
    again = inputs(**fields, generator=torch.Generator().manual_seed(1))
    assert torch.equal(dropped, again)


def test_a_missing_return_needs_a_model_that_knows_of_it() -> None:
    with pytest.raises(SpecError, match="got none"):
        tokens_of(make(return_to_go="task"), returns_to_go=None)


def test_three_tokens_interleave_return_state_action() -> None:
    """Token 3t depends on R_t alone, 3t+1 on s_t, 3t+2 on a_t."""
    inputs = make(return_to_go="task", tokens_per_step=3)
    base = tokens_of(inputs)
    assert base.shape == (1, 1, 9, S)
    for place, name in enumerate(("returns_to_go", "observations", "actions")):
        shape = {"returns_to_go": (1, 1, 3), "observations": (1, 1, 3, D), "actions": (1, 1, 3, A)}
        changed = numbers(*shape[name], seed=20)
        moved = (tokens_of(inputs, **{name: changed}) - base).abs().amax(dim=-1)[0, 0] > 0
        assert moved.nonzero().flatten().tolist() == [place, place + 3, place + 6], name
    assert torch.equal(tokens_of(inputs, previous_actions=torch.ones(1, 1, 3, A)), base)
    blank = tokens_of(inputs, actions=torch.zeros(1, 1, 3, A))
    assert torch.equal(tokens_of(inputs, actions=None), blank)


def test_time_table_starts_silent_and_learns() -> None:
    inputs = make(time_table=4)
    assert torch.equal(tokens_of(inputs), tokens_of(make()))
    tokens_of(inputs, timesteps=torch.tensor([[[1, 1, 3]]])).sum().backward()
    assert inputs.time is not None and inputs.time.grad is not None
    assert inputs.time.grad[:, 0].tolist() == [0, 2, 0, 1]
    with pytest.raises(ShapeError, match="steps below 4, found 4") as caught:
        tokens_of(inputs, timesteps=torch.tensor([[[2, 3, 4]]]))
    assert "raise time_table" in caught.value.hint


def test_kinds_start_alike_and_differ_in_what_learns() -> None:
    """F = 7 inputs, s = 32. trained: 7*32 rows + 32 centre. mlp adds 7*32+32 and 32*32+32."""
    maps = {kind: make(kind=kind) for kind in ("frozen", "trained", "mlp")}
    counts = {
        kind: sum(p.numel() for p in inputs.parameters() if p.requires_grad)
        for kind, inputs in maps.items()
    }
    assert counts == {"frozen": 0, "trained": 256, "mlp": 256 + 256 + 1056}
    start = tokens_of(maps["frozen"])
    assert all(torch.equal(tokens_of(inputs), start) for inputs in maps.values())
    with torch.no_grad():
        maps["mlp"].maps[0].block[2].weight.fill_(0.1)  # type: ignore[index, union-attr]
    assert not torch.allclose(tokens_of(maps["mlp"]), start)


def test_random_starts_leave_the_global_generator_alone() -> None:
    state = torch.get_rng_state()
    one, two = make(kind="mlp", start="random"), make(kind="mlp", start="random")
    assert torch.equal(state, torch.get_rng_state())
    assert torch.equal(tokens_of(one), tokens_of(two))
