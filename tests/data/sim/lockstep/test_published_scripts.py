"""Our rules of Meta-World's scripts against its own, on scenes around every threshold."""

from __future__ import annotations

import numpy as np
import pytest

from mpdt.data.sim.lockstep.sight import answer
from mpdt.data.sim.metaworld import find_class, quiet
from mpdt.data.sim.scripts import SCRIPTS
from mpdt.data.spec.tasks import get_family

NAMES = [task.name for task in get_family("mt50").tasks]


def scenes(count=400):
    """Observations (count, 39) of a hand beside, over and far from what a script looks at.

    In a third of them each way the distance in z, or in x and y, grows by half a millimetre from
    scene to scene and the others are small, so that no threshold can move by 2 mm unseen.
    """
    generator = np.random.default_rng(0)
    growing = np.linspace(0.0, 0.175, count)

    def near(points, scale=1.0):
        way = generator.normal(size=(count, 3)) * generator.choice([0.002, 0.008, 0.03], (count, 3))
        kind = np.arange(count) % 3
        way[kind == 0, 2] = growing[kind == 0]
        way[kind == 1, generator.integers(0, 2)] = growing[kind == 1]
        return points + scale * way * generator.choice([-1, 1], (count, 3))

    seen = generator.normal(size=(count, 39))
    seen[:, :3] = generator.uniform([-0.4, 0.4, 0.05], [0.4, 0.95, 0.4], (count, 3))
    seen[:, 3] = generator.uniform(0, 1, count)
    order = generator.permutation(count)  # what is near and what is at the goal are not the same
    seen[:, 4:7] = near(seen[:, :3])
    seen[:, 11:14] = near(seen[:, 4:7])
    seen[:, 36:39] = near(seen[:, :3])[order] - seen[order, :3] + seen[:, :3]
    return seen


def test_every_task_has_a_script():
    assert sorted(SCRIPTS) == sorted(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_answers_have_the_bytes_of_the_published_script(name):
    seen = scenes()
    published = find_class(name, "script")()
    with quiet():
        wanted = np.array([published.get_action(scene.copy()) for scene in seen])
    before = seen.copy()
    assert answer(SCRIPTS[name], seen).tobytes() == wanted.tobytes()
    assert seen.tobytes() == before.tobytes(), "a script changes nothing that it is shown"
