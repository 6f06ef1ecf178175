from __future__ import annotations

import pytest
import torch

from mpdt.errors import ShapeError, SpecError
from mpdt.model.prompts import (
    AdaptedPrompts,
    DecomposedPrompts,
    MixedPrompts,
    PromptSettings,
    SharedPrompt,
    TaughtParts,
    TeacherPrompts,
)

SMALL = PromptSettings(length=2, rank=1, init_std=1.0)


@pytest.fixture
def by_hand() -> DecomposedPrompts:
    """Two tasks, l = s = 2, r = 1.

    P_c = 1 2    task 0: v = (1, 2), u = (3, 4)  ->  P_0 = 3 4    P*_0 =  3  8
          3 4                                              6 8           18 32
                 task 1: v = (0, 1), u = (1, -1) ->  P_1 = 0  0   P*_1 =  0  0
                                                           1 -1           3 -4
    """
    prompts = DecomposedPrompts(SMALL, num_tasks=2, width=2, spread=1.0)
    with torch.no_grad():
        prompts.cross.copy_(torch.tensor([[1.0, 2], [3, 4]]))
        prompts.task_v.copy_(torch.tensor([[[1.0], [2]], [[0], [1]]]))
        prompts.task_u.copy_(torch.tensor([[[3.0, 4]], [[1, -1]]]))
    return prompts


def test_composition_worked_by_hand(by_hand: DecomposedPrompts) -> None:
    assert by_hand.task_parts().tolist() == [[[3, 4], [6, 8]], [[0, 0], [1, -1]]]
    assert by_hand.task_prompts().tolist() == [[[3, 8], [18, 32]], [[0, 0], [3, -4]]]
    rows = torch.tensor([1, 0, 1])
    assert torch.equal(by_hand.task_prompts(rows), by_hand.task_prompts()[rows])


def test_mixtures_worked_by_hand(by_hand: DecomposedPrompts) -> None:
    """Task 0 as a quarter of itself and three quarters of task 1; task 1 never mixes.

    0.25 P_0 + 0.75 P_1 = 0.75 1      times P_c = 0.75 2
                          2.25 1.25               6.75 5
    """
    mixed = MixedPrompts(SMALL, num_tasks=2, width=2, spread=1.0)
    mixed.load_state_dict(by_hand.state_dict())
    none = torch.zeros(0, 2)
    mixed.mix([torch.tensor([[0.25, 0.75]]), none], share=1.0, seed=3)
    own = by_hand.task_prompts()
    found = mixed.task_prompts(torch.tensor([1, 0]), step=5)
    assert found.tolist() == [own[1].tolist(), [[0.75, 2], [6.75, 5]]]
    assert torch.equal(mixed.task_prompts(), own)  # no step: not in training

    mixed.mix([torch.tensor([[0.25, 0.75], [0, 1]]), none], share=0.6, seed=3)
    rows = torch.zeros(200, dtype=torch.int64)
    first = mixed.task_prompts(rows, step=5)
    assert torch.equal(first, mixed.task_prompts(rows, step=5))
    assert not torch.equal(first, mixed.task_prompts(rows, step=6))
    # P_0, the first mixture and P_1 begin with 3, 0.75 and 0. 200 draws: deviation 0.03.
    for value, share in ((3, 0.4), (0.75, 0.3), (0, 0.3)):
        assert abs((first[:, 0, 0] == value).float().mean() - share) < 0.1


def test_gradients_worked_by_hand(by_hand: DecomposedPrompts) -> None:
    """d sum(P*_0) / d P_c = P_0; / d v = rows of P_c times u: (1*3+2*4, 3*3+4*4) = (11, 25);
    / d u = columns of v times P_c: (1*1+2*3, 1*2+2*4) = (7, 10). Task 1 is untouched."""
    by_hand.task_prompts(torch.tensor([0])).sum().backward()
    assert by_hand.cross.grad.tolist() == [[3, 4], [6, 8]]
    assert by_hand.task_v.grad.tolist() == [[[11], [25]], [[0], [0]]]
    assert by_hand.task_u.grad.tolist() == [[[7, 10]], [[0, 0]]]


def test_rank_two_adds_two_outer_products() -> None:
    """v = (1 0; 0 1), u = (1 2; 3 4): P_k = u; with P_c = 2 everywhere the prompt is 2u."""
    prompts = DecomposedPrompts(
        PromptSettings(length=2, rank=2, init_std=1.0), num_tasks=1, width=2, spread=1.0
    )
    with torch.no_grad():
        prompts.cross.fill_(2.0)
        prompts.task_v.copy_(torch.eye(2)[None])
        prompts.task_u.copy_(torch.tensor([[[1.0, 2], [3, 4]]]))
    assert prompts.task_prompts().tolist() == [[[2, 4], [6, 8]]]


@pytest.mark.parametrize("rank", [1, 4])
@pytest.mark.parametrize("task_init", ["normal", "ones"])
def test_embedding_start_has_the_spread_of_words(rank: int, task_init: str) -> None:
    settings = PromptSettings(rank=rank, task_init=task_init)  # type: ignore[arg-type]
    prompts = DecomposedPrompts(settings, num_tasks=40, width=300, spread=0.14)
    assert float(prompts.task_prompts().detach().std()) == pytest.approx(0.14, rel=0.12)
    if task_init == "ones":
        assert float(prompts.task_parts().detach().mean()) == pytest.approx(1.0, abs=0.02)


def test_start_of_the_paper_is_standard_normal() -> None:
    settings = PromptSettings(init_std=1.0)
    prompts = DecomposedPrompts(settings, num_tasks=9, width=768, spread=0.14, seed=2)
    for part in prompts.parameters():
        assert float(part.detach().std()) == pytest.approx(1.0, abs=0.06)
    sizes = {name: part.numel() for name, part in prompts.named_parameters()}
    assert sizes == {"cross": 23040, "task_v": 9 * 30, "task_u": 9 * 768}  # 798 per task
    again = DecomposedPrompts(settings, num_tasks=9, width=768, spread=0.14, seed=2)
    other = DecomposedPrompts(settings, num_tasks=9, width=768, spread=0.14, seed=3)
    assert torch.equal(prompts.task_u, again.task_u)
    assert not torch.equal(prompts.task_u, other.task_u)


def test_teacher_has_a_full_prompt_per_task() -> None:
    teacher = TeacherPrompts(PromptSettings(), num_tasks=3, width=64, spread=0.2)
    assert teacher.task_prompts().shape == (3, 30, 64)
    assert float(teacher.prompts.detach().std()) == pytest.approx(0.2, rel=0.05)


def test_parts_of_a_teacher_are_copied_and_only_the_cross_prompt_is_trained() -> None:
    """P_c = (1 2) o (3 4) = (3 8); what becomes of the teacher's own tensor does not matter."""
    prompts = TaughtParts(PromptSettings(length=1), 2, 2, spread=0.1)
    teacher = torch.tensor([[[1.0, 2]], [[5, 6]]])
    prompts.take(teacher)
    teacher.zero_()
    prompts.cross.data = torch.tensor([[3.0, 4]])
    assert prompts.task_prompts(torch.tensor([0])).tolist() == [[[3, 8]]]
    assert prompts.task_prompts().tolist() == [[[3, 8]], [[15, 24]]]
    assert [name for name, _ in prompts.named_parameters()] == ["cross"]
    assert set(prompts.state_dict()) == {"cross", "parts"}, "what is loaded again"


def test_starts_of_adaptation_worked_by_hand(by_hand: DecomposedPrompts) -> None:
    """mean P_k = (1.5 2; 3.5 3.5), so P_c o mean = (1.5 4; 10.5 14)."""
    starts = {
        "cross": ([[1, 2], [3, 4]], None),
        "cross_mean": ([[1.5, 4], [10.5, 14]], None),
        "none": ([[1.5, 4], [10.5, 14]], None),
        "cross_one": ([[0, 0], [3, -4]], [0.0, 1.0]),
        "infer": ([[1.5, 4], [10.5, 14]], [0.5, 0.5]),
        "infer_aligned": ([[0, 0], [3, -4]], [0.0, 1.0]),
    }
    for start, (expected, row) in starts.items():
        weights = None if row is None else torch.tensor([row])
        adapted = AdaptedPrompts(by_hand, start, 1, weights)  # type: ignore[arg-type]
        assert adapted.task_prompts().tolist() == [expected], start
        tuned = [name for name, p in adapted.named_parameters() if p.requires_grad]
        assert tuned == ([] if start in ("none", "infer") else ["cross"]), start


def test_random_part_is_tuned_behind_a_fixed_cross_prompt(by_hand: DecomposedPrompts) -> None:
    adapted = AdaptedPrompts(by_hand, "cross_random", 2, seed=1)
    tuned = [name for name, p in adapted.named_parameters() if p.requires_grad]
    assert tuned == ["task_v", "task_u"]
    ratio = adapted.task_prompts() / by_hand.cross
    torch.testing.assert_close(ratio, adapted.task_v @ adapted.task_u)
    assert not torch.allclose(ratio[0], ratio[1])


def test_copies_are_independent_and_the_trained_prompts_stay(by_hand: DecomposedPrompts) -> None:
    adapted = AdaptedPrompts(by_hand, "cross", 2)
    optimiser = torch.optim.SGD([adapted.cross], lr=1.0)
    adapted.task_prompts()[1].sum().backward()
    optimiser.step()
    assert adapted.task_prompts().tolist() == [[[1, 2], [3, 4]], [[0, 1], [2, 3]]]
    assert by_hand.cross.tolist() == [[1, 2], [3, 4]]


def test_weights_belong_to_some_starts(by_hand: DecomposedPrompts) -> None:
    with pytest.raises(SpecError, match="weights only for cross_one, infer, infer_aligned"):
        AdaptedPrompts(by_hand, "cross", 1, torch.ones(1, 2))
    with pytest.raises(SpecError, match="start infer: weights of training tasks"):
        AdaptedPrompts(by_hand, "infer", 1)


def test_one_row_of_weights_per_task(by_hand: DecomposedPrompts) -> None:
    with pytest.raises(ShapeError, match=r"expected \(2, 2\), found \(1, 2\)"):
        AdaptedPrompts(by_hand, "cross_one", 2, torch.ones(1, 2))


def test_a_shared_prompt_is_the_same_for_every_task_and_may_be_empty() -> None:
    shared = SharedPrompt(PromptSettings(kind="shared", length=2), 3, width=4, spread=1.0)
    assert shared.task_prompts(torch.tensor([2, 0])).shape == (2, 2, 4)
    assert torch.equal(shared.task_prompts()[2], shared.cross)
    empty = SharedPrompt(PromptSettings(kind="none"), 3, width=4, spread=1.0)
    assert empty.task_prompts().shape == (3, 0, 4)
    assert not any(p.requires_grad for p in empty.parameters())
    assert AdaptedPrompts(empty, "none", 2).task_prompts().shape == (2, 0, 4)
