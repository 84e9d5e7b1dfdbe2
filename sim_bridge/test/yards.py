"""A yard for any robot."""

from ctrl_rl_core import NavigationTask


def yard(robot: str, theta: float = 0.0) -> NavigationTask:
    """Return the task of a robot in an empty yard, with its own lidar."""
    content = {
        "name": "yard",
        "kind": "navigation",
        "about": "A robot in an empty yard.",
        "source": "tests",
        "system": {"model": "dubins_car"},
        "robot": {"body": robot},
        "arena": {"x": "-40.0 .. 40.0 m", "y": "-40.0 .. 40.0 m", "wall_thickness": "0.2 m"},
        "start": {"x": "0.0 m", "y": "0.0 m", "theta": f"{theta} rad"},
        "goal": {"x": "100.0 m"},
        "episode": {"steps": 100000, "time_step": "0.1 s"},
        "rewards": {"goal": 1, "collision": -1},
    }
    return NavigationTask.model_validate(content)
