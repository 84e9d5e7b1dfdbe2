"""Long walls and narrow doors: a path through, clear between samples too, and reported by `oc data`."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from oc_baseline_node.cli import main

from ctrl_rl_core import load_navigation_task, signed_distance, task_file
from oc_baseline_node import Mpc, MpcSolution, OptimalControlProblem, draw_episode_start, draw_start, formulate


def wall(left: float, right: float, y: float) -> dict[str, dict[str, str]]:
    """Wall 0.3 m thick along x."""
    return {"box": {"centre": f"({(left + right) / 2}, {y}) m", "size": f"({right - left}, 0.3) m"}}


def write_maze(folder: Path, walls: list[dict[str, dict[str, str]]], horizon: int) -> str:
    """Write the car's task with walls instead of cubes, from one corner to the opposite one."""
    content = yaml.safe_load(task_file("car_navigation").read_text(encoding="utf-8"))
    content["name"], content["obstacles"] = "maze", walls
    content["start"] = {"x": "-4.3 .. -3.5 m", "y": "-4.3 .. -3.5 m", "theta": "0.0 .. 90.0 deg"}
    content["optimal_control"]["horizon"] = horizon
    file = folder / "maze.yaml"
    file.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    return str(file)


def nearest(problem: OptimalControlProblem, trajectory: MpcSolution) -> float:
    """Minimum distance to an obstacle [m], sampled ten times per step without the first step."""
    x, u = trajectory.states[1:-1], trajectory.controls[1:]
    dense = [problem.system.step(x, u, dt=part * trajectory.time_step) for part in np.linspace(0.0, 1.0, 11)]
    return float(signed_distance(problem.obstacles, np.array(dense)[..., problem.positions]).min())


def test_an_s_of_walls_is_driven_through(tmp_path: Path) -> None:
    problem = formulate(load_navigation_task(write_maze(tmp_path, [wall(-5, 3, -1.7), wall(-3, 5, 1.7)], 200)))
    trajectory = Mpc(problem, ("fatrop",)).solve(draw_episode_start(problem, np.random.default_rng(0)))
    assert trajectory.solved, trajectory.reason
    assert "a state cost that does not grow" in trajectory.reason, "this long, it is solved by steps"
    assert nearest(problem, trajectory) >= problem.clearance - 1e-3


def test_a_door_that_the_robot_fits_through_is_open(tmp_path: Path) -> None:
    problem = formulate(load_navigation_task(write_maze(tmp_path, [wall(-5, -0.4, 0.0), wall(0.4, 5, 0.0)], 140)))
    trajectory = Mpc(problem, ("fatrop",)).solve((-0.5, -3.0, 1.0))
    assert trajectory.solved, trajectory.reason
    assert trajectory.states[-1, 1] > 2.0


@pytest.mark.parametrize("name", ["car_navigation", "quad_navigation"])
def test_clearance_is_kept_between_the_samples(name: str) -> None:
    problem, random = formulate(load_navigation_task(name)), np.random.default_rng(5)
    mpc = Mpc(problem)
    solved = [trajectory for _ in range(8) if (trajectory := mpc.solve(draw_start(problem, random))).solved]
    assert len(solved) >= 6
    assert min(nearest(problem, each) for each in solved) >= problem.clearance - 1e-3


def test_oc_data_tells_how_the_start_set_fares(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """No path leads through a closed wall; starts beyond it have one."""
    task = write_maze(tmp_path, [wall(-5, 5, -2.5)], 20)
    assert main(["data", task, "--output", str(tmp_path / "data"), "--trajectories", "2", "--workers", "1"]) == 0
    said = capsys.readouterr().out
    assert "start set     0 of 10 starts of an episode have a trajectory" in said
