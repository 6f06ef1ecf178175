"""Can Meta-World's state be set from an observation, well enough for one step to be compared?

    python experiments/metaworld_one_step.py mt50.h5 --tasks reach,drawer-open

For cheetah and ant `verify` steps our simulator once from stored states of an import. Meta-World's
39 numbers have no joint angles, no velocities and not the place of the mocap body that pulls the
hand. Of our own episodes, whose reset vector is known:

    replayed   the actions before it played from the reset: all of the state; has to be 0
    carried    the same, but before every step objects are put where the observation says, with the
               speeds that the one before tells: what a whole episode allows
    seen       the hand pulled to where it is seen and settled, speed by the Jacobian, mocap ahead
               of it by `--lead` steps, fingers and objects as seen: what one observation allows

Each: largest difference of the 18 numbers that are now, and of the reward; median and worst.
`moved` is how far these 18 move in a step, which a difference has to be small against.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

import mpdt
from mpdt.data.episode import Episode
from mpdt.data.sim.metaworld import MetaworldEnv
from mpdt.draw.table import markdown_table
from mpdt.errors import MpdtError

Floats = NDArray[np.float64]
NOW, BEFORE = slice(0, 18), slice(18, 36)
ARM, FINGERS, FREE = 7, (7, 8), 0
SETTLE = 40  # steps of the environment
STATE = mujoco.mjtState.mjSTATE_INTEGRATION


@dataclass
class Apart:
    """(observation, reward) differences of one way."""

    seen: list[float] = field(default_factory=list)
    paid: list[float] = field(default_factory=list)

    def add(self, inner: Any, episode: Episode, at: int) -> None:
        observation, reward, *_ = inner.step(episode.actions[at])
        wanted = episode.observations[at + 1].astype(np.float64)
        self.seen.append(float(np.abs(observation[NOW] - wanted[NOW]).max()))
        self.paid.append(abs(float(reward) - float(episode.rewards[at])))

    def cells(self) -> tuple[str, str]:
        return tuple(f"{np.median(x):.2g} / {max(x):.2g}" for x in (self.seen, self.paid))  # type: ignore[return-value]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("file", type=Path)
    parser.add_argument("--tasks", default="reach,push,pick-place,drawer-open,door-open")
    parser.add_argument("--quality", default="expert")
    parser.add_argument("--episodes", type=int, default=3)
    parser.add_argument("--states", type=int, default=20)
    parser.add_argument("--lead", type=float, default=2.0)
    asked = parser.parse_args()
    try:
        data, rows = mpdt.open(asked.file), []
    except MpdtError as error:
        sys.exit(error.render())
    for task in asked.tasks.split(","):
        ids = data.select(task=task, quality=asked.quality)[: asked.episodes]
        found = [Apart() for _ in range(3)]
        moved: list[float] = []
        rewards: list[float] = []
        envs = [MetaworldEnv(task) for _ in range(3)]
        for id in ids.tolist():
            episode = data.episode(id)
            at = np.unique(np.linspace(1, episode.length - 2, asked.states).astype(int))
            compare(episode, at.tolist(), envs, found, asked.lead)
            now = episode.observations[:, NOW].astype(np.float64)
            moved += np.abs(np.diff(now, axis=0)).max(axis=1)[at].tolist()
            rewards += episode.rewards.tolist()
        cells = [cell for one in found for cell in one.cells()]
        rows.append((task, f"{np.median(moved):.2g}", f"{np.std(rewards):.2g}", *cells))
    ways = ("replayed", "carried", "seen")
    head = [f"{way}, {what}" for way in ways for what in ("observation", "reward")]
    print(markdown_table(("task", "moved", "spread of reward", *head), rows))


def compare(
    episode: Episode, at: list[int], envs: list[MetaworldEnv], found: list[Apart], lead: float
) -> None:
    """One step from each of these, in three ways."""
    goal = episode.goal.astype(np.float64)
    for env in envs:
        env.reset(goal)
    whole, carried, seen = (env.inner for env in envs)
    start = np.zeros(mujoco.mj_stateSize(seen.model, STATE))
    mujoco.mj_getState(seen.model, seen.data, start, STATE)
    for step in range(max(at) + 1):
        observation = episode.observations[step].astype(np.float64)
        place_objects(carried, observation)
        if step not in at:
            whole.step(episode.actions[step])
            carried.step(episode.actions[step])
            continue
        mujoco.mj_setState(seen.model, seen.data, start, STATE)
        seen.curr_path_length, seen._prev_obs = step, observation[NOW].copy()
        place_hand(seen, observation, lead)
        place_objects(seen, observation)
        for one, inner in zip(found, (whole, carried, seen), strict=True):
            one.add(inner, episode, step)


def place_hand(inner: Any, observation: Floats, lead: float) -> None:
    """The hand where it is seen, as fast as it was; fingers as far apart."""
    model, data = inner.model, inner.data
    hand, before = observation[:3], observation[BEFORE][:3]
    body = model.body("hand").id
    opening = observation[3]
    data.ctrl[:] = (-1, 1)  # open: from there the fingers are closed as far as seen
    pulled = hand.copy()
    for _ in range(6):
        data.mocap_pos[0], data.mocap_quat[0] = pulled, (1, 0, 1, 0)
        mujoco.mj_step(model, data, nstep=SETTLE * inner.frame_skip)
        mujoco.mj_forward(model, data)
        pulled += hand - data.xpos[body]
    fingers(inner, opening)
    data.qvel[:] = 0
    jacobian = np.zeros((6, model.nv))
    mujoco.mj_jacBody(model, data, jacobian[:3], jacobian[3:], body)
    speed = np.concatenate([(hand - before) / seconds(inner), np.zeros(3)])
    data.qvel[:ARM] = np.linalg.pinv(jacobian[:, :ARM]) @ speed
    data.mocap_pos[0] = pulled + lead * (hand - before)
    mujoco.mj_forward(model, data)


def fingers(inner: Any, opening: float) -> None:
    """Both moved alike until they are as far apart as seen; not where the number is at its end."""
    if not 0.01 < opening < 0.99:
        return
    model, data = inner.model, inner.data
    places = [model.jnt_qposadr[joint] for joint in FINGERS]

    def apart() -> float:
        mujoco.mj_forward(model, data)
        return float(np.linalg.norm(data.body("rightclaw").xpos - data.body("leftclaw").xpos)) / 0.1

    for _ in range(5):
        here = apart()
        data.qpos[places] += (1e-4, -1e-4)
        slope = (apart() - here) / 1e-4
        step = float(np.clip((opening - here) / slope, -0.02, 0.02)) - 1e-4
        data.qpos[places] += (step, -step)
    apart()


def place_objects(inner: Any, observation: Floats) -> None:
    """Objects where they are seen, with the speeds that the observation before tells."""
    model, data = inner.model, inner.data
    warm = data.qacc_warmstart.copy()  # every look writes it anew, which moves the next step
    before, now = solve(inner, observation[BEFORE]), solve(inner, observation[NOW])
    for joint in range(ARM + 2, model.njnt):
        place, dof = model.jnt_qposadr[joint], model.jnt_dofadr[joint]
        size = 3 if model.jnt_type[joint] == FREE else 1
        there = slice(place, place + size)
        data.qvel[dof : dof + size] = (now[there] - before[there]) / seconds(inner)
        if size == 3:
            data.qvel[dof + 3 : dof + 6] = 0
    mujoco.mj_forward(model, data)
    data.qacc_warmstart[:] = warm


def solve(inner: Any, seen: Floats) -> Floats:
    """Joint places at which the objects are seen there: exact for free ones, else least squares."""
    model, data = inner.model, inner.data
    joints = range(ARM + 2, model.njnt)
    free = [joint for joint in joints if model.jnt_type[joint] == FREE]
    scalar = [model.jnt_qposadr[joint] for joint in joints if joint not in free]
    for thing, joint in enumerate(free[:2]):
        at, start = 4 + 7 * thing, model.jnt_qposadr[joint]
        data.qpos[start : start + 3] = seen[at : at + 3]
        turn(inner, start, seen, at)
        for _ in range(2):
            data.qpos[start : start + 3] += seen[at : at + 3] - look(inner)[at : at + 3]
    for _ in range(6 if scalar else 0):
        here = look(inner)
        gradient = np.zeros((18, len(scalar)))
        for column, place in enumerate(scalar):
            data.qpos[place] += 1e-4
            gradient[:, column] = (look(inner) - here) / 1e-4
            data.qpos[place] -= 1e-4
        data.qpos[scalar] += np.linalg.lstsq(gradient[4:], (seen - here)[4:], rcond=1e-6)[0]
    look(inner)
    found: Floats = data.qpos.copy()
    return found


def turn(inner: Any, start: int, seen: Floats, at: int) -> None:
    """The object's turn: tasks store quaternions in two orders, so the better one is taken."""
    stored = seen[at + 3 : at + 7]
    norm = float(np.linalg.norm(stored))
    if norm < 1e-6:
        return
    ways = [stored / norm, np.roll(stored, 1) / norm]
    errors = []
    for way in ways:
        inner.data.qpos[start + 3 : start + 7] = way
        errors.append(float(np.abs(look(inner)[at + 3 : at + 7] - stored).max()))
    inner.data.qpos[start + 3 : start + 7] = ways[int(np.argmin(errors))]


def look(inner: Any) -> Floats:
    mujoco.mj_forward(inner.model, inner.data)
    found: Floats = inner._get_curr_obs_combined_no_goal()
    return found


def seconds(inner: Any) -> float:
    return float(inner.frame_skip * inner.model.opt.timestep)


if __name__ == "__main__":
    main()
