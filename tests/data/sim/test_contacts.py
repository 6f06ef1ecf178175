from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from metaworld.sawyer_xyz_env import SawyerXYZEnv

from mpdt.data.sim.contacts import FingerContacts

LEFT, RIGHT, PUCK, TABLE = 4, 5, 7, 9


class Contacts(list):
    """Contacts as mujoco shows them: a list of records, and arrays over all of them."""

    def __init__(self, pairs, addresses):
        self.geom = np.array(pairs, dtype=np.int32).reshape(-1, 2)
        self.efc_address = np.array(addresses, dtype=np.int32)
        super().__init__(
            SimpleNamespace(geom1=a, geom2=b, efc_address=address)
            for (a, b), address in zip(self.geom, self.efc_address, strict=True)
        )


def make_env(pairs, addresses, forces):
    ids = {"leftpad_geom": LEFT, "rightpad_geom": RIGHT}
    data = SimpleNamespace(
        contact=Contacts(pairs, addresses),
        efc_force=np.array(forces),
        geom=lambda name: SimpleNamespace(id=ids[name]),
    )
    return SimpleNamespace(data=data)


@pytest.mark.parametrize(
    ("pairs", "forces", "expected"),
    [
        ([], [], False),
        ([(LEFT, PUCK), (PUCK, RIGHT)], [1.0, 2.0], True),
        ([(LEFT, PUCK), (PUCK, RIGHT)], [1.0, 0.0], False),  # the right finger only lies on it
        ([(LEFT, PUCK), (TABLE, RIGHT)], [1.0, 2.0], False),  # the right one presses the table
        ([(LEFT, PUCK), (LEFT, PUCK), (RIGHT, PUCK)], [3.0, -3.0, 1.0], False),  # sums to zero
        ([(LEFT, RIGHT), (PUCK, TABLE)], [1.0, 2.0], False),
    ],
)
def test_both_fingers_must_press_this_geom(pairs, forces, expected):
    env = make_env(pairs, range(len(pairs)), forces)
    assert FingerContacts(env)(PUCK) is expected
    assert bool(SawyerXYZEnv.touching_object(env, PUCK)) is expected


def test_agrees_with_the_contact_loop_on_random_scenes():
    generator = np.random.default_rng(0)
    answers = []
    for _ in range(300):
        count = int(generator.integers(0, 12))
        pairs = generator.choice([LEFT, RIGHT, PUCK, TABLE], (count, 2))
        # an address of -1 (a contact without constraint) reads the last force, there and here
        addresses = generator.integers(-1, count, count) if count else []
        env = make_env(pairs, addresses, generator.normal(size=count))
        answers.append(FingerContacts(env)(PUCK))
        assert answers[-1] == SawyerXYZEnv.touching_object(env, PUCK)
    assert 10 < sum(answers) < 290
