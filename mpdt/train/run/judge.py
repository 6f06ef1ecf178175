"""After training: adapt to the test tasks, run everybody in the simulator, fill the table.

training tasks   zero, random, best constant, expert | the method, each task behind its own prompt
test tasks       zero, random, best constant, expert | every one of `adapt/candidates.py`

Seeds and the rows beside the method are those of `bench.py`.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec

from mpdt.train.adapt.candidates import Candidate, Candidates
from mpdt.train.bundle.contents import ActingPrompts, own_prompts, prompts_of
from mpdt.train.bundle.format import OWN
from mpdt.train.evaluate.controller import TrainedActor
from mpdt.train.evaluate.score import Block, Reads, Score, with_verdicts
from mpdt.train.fit.trained import Trained
from mpdt.train.run.bench import Bench
from mpdt.train.run.config import TrainConfig
from mpdt.train.run.keep import Keeper
from mpdt.train.run.progress import Progress


@dataclass
class Judge:
    """The phases after training.

    Args:
        log: takes what adaptation tells; None = nobody does.
        kept: folder in which trials are kept, to go on with after a stop; None = nowhere.
        keeper: keeps the episodes of the method's rows, each row in a file; None = nobody does.
    Attributes:
        acting: the prompts that `scores` has judged.
        adaptation_s: what making the candidates took.
    """

    trained: Trained
    config: TrainConfig
    progress: Progress
    log: list[Mapping[str, Any]] | None = None
    keeper: Keeper | None = None
    kept: Path | None = None
    acting: list[ActingPrompts] = field(default_factory=list)
    adaptation_s: float = 0.0

    def __post_init__(self) -> None:
        self.bench = Bench(self.trained.material, self.config.evaluation, self.progress)

    def scores(self) -> list[Score]:
        """All rows of the final table. Raises: Stopped after a signal."""
        material, config = self.trained.material, self.config
        blocks = config.evaluation.blocks
        candidates = Candidates(self.trained, config, self.progress.update, self.log, self.kept)
        scores, references = list[Score](), list[Score]()
        self.acting = [own_prompts(self.trained)]
        if "train" in blocks:
            own = candidates.own()
            references = self.bench.references("train", material.train_rows)
            scores = references + self._score("train", config.method, OWN, material.train_rows, own)
        if not material.test_rows or "test" not in blocks:
            return with_verdicts(scores)
        same = config.evaluation.train_episodes in (0, config.evaluation.episodes)
        if material.goals is not None:  # the tasks are known, their goals are not
            scores += self._score(
                "test", f"{config.method} own prompts", f"{OWN}-unseen-goals", material.test_rows,
                candidates.own(), "task id",
            )  # fmt: skip
        if references and same and material.one_table:
            # The same episodes: a trivial policy is run on a task once.
            scores += [msgspec.structs.replace(score, block="test") for score in references]
        else:
            scores += self.bench.references("test", material.test_rows)
        for candidate in self._adapted(candidates):
            self.acting.append(prompts_of(candidate, material.test_rows, candidates.returns))
            method = f"{config.method} {candidate.label}"
            found = self._score(
                "test", method, candidate.name, material.test_rows, candidate.controller,
                candidate.reads,
            )  # fmt: skip
            scores += _with_own_steps(found, candidate.own_steps)
            if candidate.tried and self.keeper is not None:
                self._keep_trials(candidate, method)
        return with_verdicts(scores)

    def _adapted(self, candidates: Candidates) -> Iterator[Candidate]:
        """Each as soon as it is made; what making it took is added up."""
        following = iter(candidates)
        while True:
            began_s = time.monotonic()
            candidate = next(following, None)
            self.adaptation_s += time.monotonic() - began_s
            if candidate is None:
                return
            yield candidate

    def _keep_trials(self, candidate: Candidate, method: str) -> None:
        """The own episodes that a row read, as data of their own."""
        assert self.keeper is not None
        rows = self.trained.material.test_rows
        with self.keeper.row(
            self.bench, f"{candidate.name}-own", f"{method}, own episodes",
            candidate.tried[0].policy, rows, len(candidate.tried) // len(rows), candidate.reads,
            self.config.adapt.trials.seed,
        ) as row:  # fmt: skip
            row.kept.episodes += candidate.tried
            row.write()

    def _score(
        self,
        block: Block,
        method: str,
        name: str,
        rows: Sequence[int],
        actor: TrainedActor,
        reads: Reads | None = None,
    ) -> list[Score]:
        """A row of the table; `name` is that of its prompts."""
        if self.keeper is None:
            return self.bench.score(block, method, rows, actor, reads)
        episodes = self.bench.episodes(block)
        with self.keeper.row(
            self.bench, name, method, actor.fingerprint, rows, episodes, reads
        ) as row:
            scores = self.bench.score(block, method, rows, actor, reads, row.kept)
            row.write()
        return scores


def _with_own_steps(scores: list[Score], steps: Sequence[int]) -> list[Score]:
    """Args: steps: of own episodes of each task; empty = none were asked for."""
    if not steps:
        return scores
    told = [*map(float, steps), sum(steps) / len(steps)]
    return [msgspec.structs.replace(score, own_steps=own)
            for score, own in zip(scores, told, strict=True)]  # fmt: skip
