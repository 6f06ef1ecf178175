"""Importing this registers our tasks with gymnasium; nothing else is loaded before one is made.

    import gymnasium, mpdt.envs
    env = gymnasium.make("mpdt/CheetahVel-v0", task="v1.500")
    env = gymnasium.make("mpdt/MetaWorld-v0", task="reach", goal_hidden=True, horizon=200)
    env = gymnasium.make("mpdt/Task-v0", family="mine", task="left")       one's own family
    envs = gymnasium.make_vec("mpdt/AntDir-v0", num_envs=8, task="dir-00")     the batched engine

Without any import: gymnasium.make("mpdt.envs:mpdt/CheetahVel-v0", ...). gymnasium 1.4.0 looks for
no plugins, so some import it has to be; `import mpdt` does it too where gymnasium came before.
"""

from __future__ import annotations

from gymnasium import register, registry

LOCOMOTION = {"CheetahVel": "cheetah_vel", "CheetahDir": "cheetah_dir", "AntDir": "ant_dir"}
SINGLE = "mpdt.data.sim.gym:make"

for _name, _family in LOCOMOTION.items():
    if f"mpdt/{_name}-v0" not in registry:  # after a reload; gymnasium would warn
        register(
            f"mpdt/{_name}-v0",
            entry_point=SINGLE,
            vector_entry_point="mpdt.data.sim.vector:LocomotionVector",
            kwargs={"family": _family},
        )
if "mpdt/MetaWorld-v0" not in registry:
    # All fifty tasks, goal visible and 500 steps; family="ml10" and the like say otherwise.
    register("mpdt/MetaWorld-v0", entry_point=SINGLE, kwargs={"family": "mt50"})
if "mpdt/Task-v0" not in registry:
    register("mpdt/Task-v0", entry_point=SINGLE)
