"""The suite's navigation tasks by name for `gymnasium.make` and `gymnasium.make_vec`.

import ctrl_rl.environments                                            # registers them
environment = gymnasium.make("ctrl_rl/car_ttr-v0")
environments = gymnasium.make_vec("ctrl_rl/car_ttr-v0", num_envs=16)
same = gymnasium.make("ctrl_rl.environments:ctrl_rl/car_ttr-v0")       # without the import
"""

from __future__ import annotations

from gymnasium.envs.registration import register, registry

FLEET = ("car_navigation", "car_ttr", "quad_navigation", "quad_trap", "quad_ttr")
"""Tasks whose world stays as it is, so that a fleet simulates many robots at once."""
ALONE = ("car_ttr_randomised", "walkers")
"""Tasks of one robot at a time."""


def register_environments() -> None:
    """Register all tasks as `ctrl_rl/TASK-v0`; nothing is imported before one is made."""
    for task in (*FLEET, *ALONE):
        name = f"ctrl_rl/{task}-v0"
        if name not in registry:
            register(
                name,
                entry_point="ctrl_rl_learning.sb3:make_task_environment",
                vector_entry_point="ctrl_rl_learning.sb3:TaskVectorEnv" if task in FLEET else None,
                kwargs={"task": task},
            )


register_environments()
