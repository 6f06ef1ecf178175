"""What is done in each of a task's trials, and what is learnt after it.

    open        trained prompts for some steps, then the planner     (first; base while it is best)
    plan        the planner: refitted world model, echo of the prompts
    try         a clone acts alone; with `adapt.trials.mean` also the mean prompt, if none succeeded

    a success of the planner, or enough of a clone's own     ->  a new clone, tried next
    the best contender stands at 1/2 or better               ->  it is tried again, else planned

Where the simulator has no successes, mixtures of prompts are tried instead (climb.py); with
`adapt.trials.search plan` planning that earns more than the best contender's mean is cloned.
Trials never depend on how many will follow: K = 3 is the beginning of K = 10.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from mpdt.data.episode import Episode
from mpdt.data.sim.simulators import make_batch
from mpdt.data.spec.tasks import Task
from mpdt.model.prompts import AdaptedPrompts
from mpdt.model.returns import ReturnTable
from mpdt.seeding import SeedKey, Stream
from mpdt.train.adapt.infer import explain
from mpdt.train.adapt.trials.acts import by_policy, by_tour, relay
from mpdt.train.adapt.trials.climb import NEAREST, next_mixture
from mpdt.train.adapt.trials.clone import clone, demonstrations, stretch_of
from mpdt.train.adapt.trials.contenders import WORTH_TRYING, Contender, best
from mpdt.train.adapt.trials.inside import Inside
from mpdt.train.adapt.trials.live import Act, first_success, live, trial_key
from mpdt.train.adapt.trials.lived import Lived, Stretch
from mpdt.train.adapt.trials.own_model import OwnModel
from mpdt.train.adapt.trials.race import leader, next_runner, runners
from mpdt.train.adapt.trials.settings import TrialSettings
from mpdt.train.adapt.trials.store import TrialStore, Tried
from mpdt.train.evaluate.controller import PromptController
from mpdt.train.fit.reward import RewardModel, convex_fit, read_transitions
from mpdt.train.fit.trained import Trained

MOVED = "moved"


@dataclass(frozen=True)
class Ground:
    """What the trials of a run's tasks have in common.

    Args:
        window: K of the policy.
        tasks: training tasks that may share the weight, as `adapt.infer.tasks`.
        rewards: the model that explains the first trial; None: the world model's reward heads do.
        fingerprint: 32 bytes of what acts; kept with every episode.
    """

    trained: Trained
    inside: Inside
    settings: TrialSettings
    window: int
    horizon: int
    tasks: int
    fingerprint: bytes
    rewards: RewardModel | None = None


class TaskTrials:
    """The trials of one task.

    Args:
        returns: one row, what is asked of this task.
        tell: told (trials done, what comes) before each; raises to stop.
        weights: (1, N) that X gave; None: nothing of the task is known.
        x: X with its rewards, where it may be read.
        store: where they are kept after each; what is there already is gone on with.
        race: only try prompts.
    Attributes:
        tried: what there is so far.
    """

    def __init__(
        self, ground: Ground, task: Task, returns: ReturnTable, tell: Callable[[int, str], None],
        weights: Tensor | None = None, x: Sequence[Stretch] = (),
        store: TrialStore | None = None, race: bool = False,
    ) -> None:  # fmt: skip
        self._ground, self._task, self._returns = ground, task, returns
        self._store, self._race, self._tell = store, race, tell
        material = ground.trained.material
        self._family, self._material = material.family, material
        self._env = make_batch(self._family, [task], material.options)
        self._knows = weights is not None
        N = len(material.train_rows)
        self._model = OwnModel(ground.trained, ground.inside, ground.settings, ground.window,
                               returns, list(x))  # fmt: skip
        weights = torch.full((1, N), 1 / N) if weights is None else weights
        base = Contender("base" if self._knows else "mean", ground.trained.policy,
                         self._mixed(weights))  # fmt: skip
        contenders = [base]
        if self._knows and ground.settings.mean:
            contenders.append(self._mean())
        if race:
            contenders = runners(base.policy, base.prompt, ground.inside.voices)
        self.tried = Tried(contenders, [0], weights, [], [])
        if store is not None and (kept := store.load(base.policy)) is not None:
            self.tried = kept
            self._knows = self._knows or len(kept.episodes) > 0

    def trial(self) -> None:
        """The next one, and what is learnt from it."""
        tried, ground = self.tried, self._ground
        number = len(tried.episodes)
        key = trial_key(ground.settings.seed, self._family, self._task.index, number)
        kind, at = self._next()
        self._tell(number, f"{kind}{'' if at is None else ' ' + tried.contenders[at].name}")
        act = self._act(kind, at, key)
        goal_key = self._material.goal_key(key, "train")
        episode = live(self._env, self._family, key, goal_key, ground.horizon, act,
                       ground.fingerprint)  # fmt: skip
        tried.episodes.append(episode)
        tried.acts.append(kind if at is None else f"{kind} {tried.contenders[at].name}")
        self._learn(kind, at, episode, key)
        choose = (
            leader(tried.contenders)
            if self._race
            else best(tried.contenders, self._family.has_success)
        )
        tried.chosen.append(choose)
        if self._store is not None:
            self._store.save(tried, ground.trained.policy)

    def _next(self) -> tuple[str, int | None]:
        """open, try or plan; and whose turn it is."""
        tried, flags = self.tried, self._family.has_success
        if self._race:
            return "try", next_runner(tried.contenders)
        if not tried.episodes:
            return "open", 0
        if self._climbs:
            return "try", self._climb()
        at = best(tried.contenders, flags)
        waiting = [
            i
            for i, one in enumerate(tried.contenders)
            if not (one.retired or one.was_tried(flags)) and self._is_worth(i, at)
        ]
        # Base can open again and again without an episode of its own: it keeps nobody waiting.
        opened = self._base() if "open base" in tried.acts else None
        at = ([i for i in waiting if i != opened] or waiting or [at])[-1]
        plans = sum(act == "plan" for act in tried.acts)
        again = bool(waiting) or 2 * plans >= len(tried.acts)
        if flags:
            again = tried.contenders[at].worth(flags) >= WORTH_TRYING
        if not again:
            return "plan", None
        return ("open" if at == self._base() else "try"), at

    @property
    def _climbs(self) -> bool:
        return self._ground.settings.search == "climb" and not self._family.has_success

    def _climb(self) -> int:
        """Whose turn it is: what was not tried yet, else the best mixture moved a little."""
        tried, policy = self.tried, self._ground.trained.policy
        waiting = [i for i, one in enumerate(tried.contenders)
                   if not (one.retired or one.was_tried(has_success=False))]  # fmt: skip
        if waiting:
            return waiting[0]
        alive = [one for one in tried.contenders if not one.retired]
        before = sum(not one.name.startswith(MOVED) for one in alive)
        near = np.argsort(self._explained[1], kind="stable")[:NEAREST]
        alone = torch.eye(len(self._material.train_rows))[near]
        voices = torch.cat([self._mixed(weights[None]) for weights in alone])
        move, moved = next_mixture([one.prompt for one in alive],
                                   [one.returns[0] for one in alive], before, voices)  # fmt: skip
        row = self._material.train_rows[int(near[move.towards])]
        name = f"{MOVED} {move.share:g} to {self._material.dataset.tasks.names[row]}"
        tried.contenders.append(Contender(name, policy, moved))
        return len(tried.contenders) - 1

    def _is_worth(self, i: int, leader: int) -> bool:
        """Trying it: the mean prompt only while the leader has not succeeded."""
        one, other = self.tried.contenders[i], self.tried.contenders[leader]
        return one.name != "mean" or i == leader or not any(other.successes)

    def _base(self) -> int:
        names = [one.name for one in self.tried.contenders]
        return names.index("base") if "base" in names else 0

    def _mean(self) -> Contender:
        N = len(self._material.train_rows)
        return Contender("mean", self._ground.trained.policy,
                         self._mixed(torch.full((1, N), 1 / N)))  # fmt: skip

    def _act(self, kind: str, at: int | None, key: SeedKey) -> Act:
        ground, settings = self._ground, self._ground.settings
        if at is None:
            return self._planning(key, None)
        one = self.tried.contenders[at]
        if kind == "open" and one.name == "mean":
            voices = torch.cat([one.prompt, ground.inside.voices])
            act = by_tour(self._controller(one, voices), key, ground.horizon, len(voices),
                          settings.opening or ground.horizon)  # fmt: skip
        else:
            act = by_policy(self._controller(one, one.prompt), key, ground.horizon)
        if kind == "try" or self._climbs:
            return act
        return relay(act, settings.opening, lambda step, record: self._planning(
            key, Stretch(record.observations[0, : step + 1], record.actions[0, :step],
                         record.rewards[0, :step]) if step else None))  # fmt: skip

    def _controller(self, one: Contender, prompts: Tensor) -> PromptController:
        rows = torch.zeros(len(prompts), dtype=torch.long)
        return PromptController(one.policy, prompts, self._returns.select(rows),
                                self._ground.window, self._family.action_low,
                                self._family.action_high)  # fmt: skip

    def _planning(self, key: SeedKey, now: Stretch | None) -> Act:
        planned = sum(act == "plan" for act in self.tried.acts)
        return self._model.planning(self.tried.episodes, now, planned, key)

    def _learn(self, kind: str, at: int | None, episode: Episode, key: SeedKey) -> None:
        """Count it for whoever acted; make a clone where there is something new to learn from."""
        tried, settings, flags = self.tried, self._ground.settings, self._family.has_success
        before = max(one.worth(flags) for one in tried.contenders if not one.retired)
        step = first_success(episode)
        opened = kind == "open" and settings.opening < episode.length and not self._climbs
        planned = at is None or (opened and (step is None or step >= settings.opening))
        toured = kind == "open" and at is not None and tried.contenders[at].name == "mean"
        if at is not None and not toured:
            one = tried.contenders[at]
            if not opened:
                one.returns.append(episode.episode_return)
            if flags:
                one.successes.append(step is not None and not planned)
        if self._race:
            return
        if not self._knows:
            self._infer()
        new = step is not None if flags else planned and episode.episode_return > before
        if at is not None and not planned and flags:
            own = sum(tried.contenders[at].successes)
            new = bool(step is not None and settings.practice and own % settings.practice == 0)
        made = sum(one.name.startswith("clone") for one in tried.contenders)
        if new and made < settings.clones:
            self._clone(made, key)

    def _infer(self) -> None:
        """Base from the first trial: the mixture of tasks whose rewards explain its rewards."""
        tried = self.tried
        weights, _ = self._explained
        tried.weights, self._knows = torch.from_numpy(weights[None]).float(), True
        tried.contenders[0].retired = not self._ground.settings.mean
        tried.contenders.append(
            Contender("base", self._ground.trained.policy, self._mixed(tried.weights))
        )

    @cached_property
    def _explained(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """By X, else by the first trial: weights (N,) of the training tasks, and how far off each
        is (N,)."""
        ground, family = self._ground, self._family
        lived = Lived(self._model.x or [stretch_of(self.tried.episodes[0])])
        if ground.rewards is not None:
            steps = read_transitions(lived, np.arange(len(lived)), lived.steps.rewards,
                                     family.action_low, family.action_high)  # fmt: skip
            found = explain(ground.rewards, steps, ground.tasks)
            return found.weights, found.errors
        assert ground.inside.world is not None, "there are no reward heads"
        first = lived.as_steps()
        outputs = ground.inside.world.paid(first)
        target = first.rewards.double().numpy()
        errors = np.square(outputs - target[:, None]).mean(axis=0)
        nearest = np.argsort(errors, kind="stable")[: min(ground.tasks, len(errors))]
        weights = np.zeros(len(errors))
        weights[nearest] = convex_fit(outputs[:, nearest], target)
        return weights, errors

    def _mixed(self, weights: Tensor) -> Tensor:
        prompts = AdaptedPrompts(self._ground.trained.prompts, "infer", 1, weights)
        return prompts.task_prompts().detach()

    def _clone(self, made: int, key: SeedKey) -> None:
        tried, ground = self.tried, self._ground
        self._tell(len(tried.episodes), f"learning from own trials: clone {made + 1}")
        shown = demonstrations(tried.episodes, ground.settings)
        policy, prompt = clone(
            ground.trained.policy, ground.trained.prompts, tried.weights, shown, ground.window,
            self._returns, ground.settings, key.env_seed(Stream.UNIFORM),
        )  # fmt: skip
        tried.contenders.append(Contender(f"clone {made + 1}", policy, prompt))
