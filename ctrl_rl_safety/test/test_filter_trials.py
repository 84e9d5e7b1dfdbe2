"""The command that counts contacts: counts, resuming, and rejected input."""

import dataclasses
import math
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from ctrl_rl_safety.trials.command import main
from ctrl_rl_safety.trials.episodes import filter_of
from ctrl_rl_safety.trials.robot import MOTOR_LAG, TrialRobot
from ctrl_rl_safety.trials.sources import Constant
from ctrl_rl_safety.trials.worlds import room

from ctrl_rl_core import drive, read_results
from ctrl_rl_safety import ROBOTS, FilterOptions
from sim_bridge import SimulatedWorld, SimulationOptions

pytest.importorskip("tyro")
MODEL = ROBOTS["turtlebot2"]
SETTINGS = SimulationOptions(engine="planar", rate=60, motor_lag=MOTOR_LAG)


def run(monkeypatch: pytest.MonkeyPatch, *words: object) -> int:
    monkeypatch.setattr(sys, "argv", ["trials", *map(str, words)])
    return main()


def test_it_counts_contacts_goes_on_and_keeps_other_rows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    results = tmp_path / "out" / "safety_filter.json"
    words = ("--sources", "full_speed", "--places", "boxes", "--robots", "turtlebot2", "--folder", tmp_path / "runs")
    assert run(monkeypatch, *words, "--episodes", 1, "--results", results) == 0
    assert run(monkeypatch, *words, "--episodes", 2, "--guards", "none", "--results", results) == 0
    (experiment,) = read_results(results.parent)
    contacts = {row.method: row.values for row in experiment.rows if row.metric == "avoidable collisions"}
    assert contacts == {
        "full_speed, boxes, turtlebot2, filter": [0.0],
        "full_speed, boxes, turtlebot2, no filter": [1.0, 1.0],
    }
    log = tmp_path / "runs" / "full_speed-boxes-turtlebot2-no-filter-planar.jsonl"
    assert len(log.read_text().splitlines()) == 3
    assert run(monkeypatch, *words, "--seed", 5, "--episodes", 1) == 1
    assert "has drives with other settings" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (("--sources", "nobody"), "no source 'nobody': there are full_speed, random"),
        (("--sources", "car_ttr@quad_trap"), "policy 'car_ttr' is for a differential_drive: 'quad_trap' flies"),
        (("--sources", "quad_ttr", "--guards", "late"), "guard 'late' is for robots on wheels: flights have none"),
        (("--sources", "attacker@car_ttr"), "the attacker has learnt in rooms: give it no task"),
    ],
)
def test_what_cannot_be_driven_is_one_line(
    words: tuple[str, ...],
    reason: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert run(monkeypatch, *words, "--episodes", 1, "--folder", tmp_path / "runs") == 1
    assert reason in capsys.readouterr().err.splitlines()[-1]


def test_a_late_robot_with_wheels_of_its_own_and_one_that_meets_nobody(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    results = tmp_path / "out" / "safety_filter.json"
    common = ("--episodes", 1, "--seed", 1, "--folder", tmp_path / "runs", "--results", results)
    assert run(monkeypatch, "--sources", "random@car_ttr", "--guards", "late", *common) == 0
    assert run(monkeypatch, "--sources", "curved_corridor@corridor_crossing", "--guards", "none", "alone", *common) == 0
    (experiment,) = read_results(results.parent)
    values = {(row.method, row.metric): row.values for row in experiment.rows}
    assert values["random, car_ttr, filter, commands 0.7 s late", "avoidable collisions"] == [0.0]
    assert values["curved_corridor, corridor_crossing, nobody there", "success"] == [1.0]
    assert values["curved_corridor, corridor_crossing, no filter", "run into while standing"] == [1.0]


def test_a_policy_flies_to_its_goal_with_and_without_the_guard_and_an_adversary_hits_without_it_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    results = tmp_path / "out" / "safety_filter.json"
    words = ("--sources", "quad_navigation@quad_trap", "full_speed@quad_trap", "--episodes", 1)
    assert run(monkeypatch, *words, "--folder", tmp_path / "runs", "--results", results) == 0
    (experiment,) = read_results(results.parent)
    values = {(row.method, row.metric): row.values for row in experiment.rows}
    assert values["quad_navigation, quad_trap, filter", "success"] == [1.0]
    assert abs(values["quad_navigation, quad_trap, filter", "time lost"][0]) < 0.05
    contacts = [values[f"full_speed, quad_trap, {guard}", "avoidable collisions"] for guard in ("no filter", "filter")]
    assert contacts == [[1.0], [0.0]]


def test_among_people_a_lidar_of_more_scans_loses_less_time_and_movers_may_be_added(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    results = tmp_path / "out" / "safety_filter.json"
    common = ("--episodes", 1, "--folder", tmp_path / "runs", "--results", results)
    assert run(monkeypatch, "--sources", "curved_corridor@corridor_sudden", "--scan-rate", 10, *common) == 0
    assert run(monkeypatch, "--sources", "car_ttr", "--movers", 2, *common) == 0
    (experiment,) = read_results(results.parent)
    values = {(row.method, row.metric): row.values for row in experiment.rows}
    sudden, car = "curved_corridor, corridor_sudden, filter, 10 scans a second", "car_ttr, filter, 2 movers"
    assert values[sudden, "success"] == values[car, "success"] == [1.0]
    assert values[sudden, "avoidable collisions"] == values[car, "avoidable collisions"] == [0.0]
    assert values[sudden, "time lost"][0] < 0.8  # of simulated time; more than 1 with five scans a second


def test_the_base_moves_by_its_model_whatever_the_physics_engine_would_do() -> None:
    slow = dataclasses.replace(MODEL, acceleration=0.5, braking=0.5, delay=0.2)
    world = SimulatedWorld(room("boxes", MODEL.name, MODEL, 1), 1, options=SETTINGS)
    robot = TrialRobot(world, slow)
    robot.hold(np.array((0.7, 0.0)), 0.2)
    assert world.velocity()[0] == pytest.approx(0.0, abs=1e-3)
    robot.hold(np.array((0.7, 0.0)), 0.5)
    assert world.velocity()[0] == pytest.approx(0.25, abs=0.01)
    world.close()


def test_a_mover_that_runs_into_a_robot_that_stands_is_no_fault_of_the_filter() -> None:
    outcomes = set()
    for seed in range(6):
        world = SimulatedWorld(room("movers", MODEL.name, MODEL, seed), seed, options=SETTINGS)
        make_filter = partial(filter_of, world, MODEL, FilterOptions(mover_speed=0.4), math.inf)
        robot = TrialRobot(world, MODEL, make_filter, blind=True)
        (episode,) = drive(robot, Constant(np.zeros(2)), seeds=(seed,))
        assert not episode.info["avoidable"]
        outcomes.add(episode.info["run_into"])
        world.close()
    assert True in outcomes
