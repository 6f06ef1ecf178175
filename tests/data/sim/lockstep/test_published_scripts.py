"""Our rules of Meta-World's scripts against its own, on scenes around every threshold."""

from __future__ import annotations

import numpy as np
import pytest

from mpdt.data.sim.lockstep.sight import answer
from mpdt.data.sim.metaworld import find_class, quiet
from mpdt.data.sim.scripts import SCRIPTS
from mpdt.data.spec.tasks import get_family

NAMES = [task.name for task in get_family("mt50").tasks]


def scenes(count):
    """Observations (count, 39): objects and goals from 0.1 mm to 0.5 m from the hand."""
    generator = np.random.default_rng(0)

    def near(points, *distances):
        way = generator.normal(size=(count, 3)) * generator.choice([0, 0.3, 1], (count, 3))
        return points + way * generator.choice(distances, (count, 1))

    seen = generator.normal(size=(count, 39))
    seen[:, :3] = generator.uniform([-0.4, 0.4, 0.05], [0.4, 0.95, 0.4], (count, 3))
    seen[:, 3] = generator.uniform(0, 1, count)
    seen[:, 4:7] = near(seen[:, :3], 0.005, 0.02, 0.05, 0.15, 0.4)
    seen[:, 11:14] = near(seen[:, 4:7], 0.005, 0.02, 0.05)
    seen[:, 36:39] = near(seen[:, :3], 0.005, 0.03, 0.1, 0.3)
    return seen


def test_every_task_has_a_script():
    assert sorted(SCRIPTS) == sorted(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_answers_have_the_bytes_of_the_published_script(name):
    seen = scenes(100)
    published = find_class(name, "script")()
    with quiet():
        wanted = np.array([published.get_action(scene.copy()) for scene in seen])
    before = seen.copy()
    assert answer(SCRIPTS[name], seen).tobytes() == wanted.tobytes()
    assert seen.tobytes() == before.tobytes(), "a script changes nothing that it is shown"
