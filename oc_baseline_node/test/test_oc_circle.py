"""States on a circle: the same problem one full turn away, in goals, bounds, starts, plans and checks."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from oc_baseline_node.cli import main
from oc_baseline_node.problems import coordinates
from oc_baseline_node.values.returns import rewards

from ctrl_rl_core import SYSTEM_MODELS, Interval, NavigationTask, Quantity, Region, SystemModel, load_navigation_task
from oc_baseline_node import Mpc, OptimalControlProblem, RecedingHorizon, formulate

TURN = 2.0 * np.pi


def half_turn(folder: Path, goal: str = "170 .. 190 deg", bounds: str = "") -> NavigationTask:
    """Return a car's task in an empty room, from (2, 0) to (-2, 0), with a goal heading."""
    limits = {"x": "-4.7 .. 4.7 m", "y": "-4.7 .. 4.7 m"} | ({"theta": bounds} if bounds else {})
    content = {
        "name": "half_turn",
        "kind": "navigation",
        "about": "A car arrives with a heading beside the seam of the circle.",
        "source": "robomechanics/quad-sdk issues 345, 204",
        "system": {"model": "dubins_car", "controls": {"v": "1 m/s", "omega": "-2 .. 2 rad/s"}},
        "robot": {"body": "turtlebot2", "commands": {"v": "-0.8 .. 2 m/s", "omega": "-0.5 .. 0.5 rad/s"}},
        "arena": {"x": "-5 .. 5 m", "y": "-5 .. 5 m", "wall_thickness": "0.2 m"},
        "start": {"x": "1.9 .. 2.1 m", "y": "-0.1 .. 0.1 m", "theta": "150 .. 210 deg"},
        "goal": {"x": "-2.2 .. -1.8 m", "y": "-0.2 .. 0.2 m", "theta": goal},
        "obstacles": [],
        "episode": {"steps": 75, "time_step": "0.4 s"},
        "rewards": {"goal": 1000, "collision": -400},
        "lidar": {"beams": 8, "field": "-90 .. 90 deg", "range": "0.1 .. 10 m", "rate": "10 Hz"},
        "optimal_control": {
            "horizon": 60, "time_step": "0.1 s", "gamma": 1.0, "discount": 0.97, "state_weight": 10,
            "control_weight": 1, "clearance": "0.277 m", "trajectories": 24,
            "controls": {"v": "0 .. 2 m/s", "omega": "-1 .. 1 rad/s"}, "bounds": limits,
        },
    }  # fmt: skip
    file = folder / "half_turn.yaml"
    file.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    return load_navigation_task(str(file))


@pytest.fixture(scope="module")
def mpc(tmp_path_factory: pytest.TempPathFactory) -> Mpc:
    return Mpc(formulate(half_turn(tmp_path_factory.mktemp("task"))))


def start(degrees: float) -> np.ndarray:
    return np.array([2.0, 0.0, np.deg2rad(degrees)])


@pytest.mark.parametrize("degrees", [-180, -160, -100, -80, 0, 100])
def test_a_start_costs_the_same_a_turn_further(mpc: Mpc, degrees: float) -> None:
    here, there = (mpc.solve(start(degrees + turns)) for turns in (0.0, 360.0))
    assert here.solved, here.reason
    assert here.cost == pytest.approx(there.cost, rel=1e-3)
    for trajectory, first in ((here, degrees), (there, degrees + 360.0)):
        assert trajectory.states[0, 2] == pytest.approx(np.deg2rad(first), abs=1e-4), "it goes on from where it was"
        assert np.abs(np.diff(trajectory.states[:, 2])).max() <= 0.1 + 1e-4
        assert mpc.problem.terminal_violation(trajectory.states[-1]) <= 1e-4


def test_a_mirrored_start_costs_the_same(mpc: Mpc) -> None:
    costs = [[mpc.solve(start(180.0 + side * angle)).cost for angle in (40.0, 90.0, 150.0)] for side in (-1.0, 1.0)]
    assert costs[0] == pytest.approx(costs[1], rel=1e-3)


@pytest.mark.parametrize("goal", ["-190 .. -170 deg", "530 .. 550 deg"])
def test_a_goal_is_the_same_a_turn_further(mpc: Mpc, goal: str, tmp_path: Path) -> None:
    moved = Mpc(formulate(half_turn(tmp_path, goal)))
    for degrees in (170.0, -150.0):
        assert moved.solve(start(degrees)).cost == pytest.approx(mpc.solve(start(degrees)).cost, rel=1e-4)


def test_the_cheaper_way_round_is_taken(mpc: Mpc) -> None:
    """At half a turn both ways are equally long; driving backwards is impossible, so it is no shortcut."""
    problem, first = mpc.problem, start(10.0)
    bounds = problem.bounds_around(first)
    ways = [region for _, region in problem.ways_round(first, bounds)]
    assert len(ways) == 2
    costs = [mpc._solve_way(way, first, bounds, mpc._guesses(first), []).cost for way in ways]
    assert mpc.solve(first).cost == pytest.approx(np.nanmin(costs), rel=1e-6)


def test_bounds_hold_a_turn_further(tmp_path: Path) -> None:
    problem = formulate(half_turn(tmp_path, bounds="100 .. 260 deg"))
    for degrees in (-170.0, 190.0, 550.0):
        assert problem.refusal(start(degrees)) == ""
    assert "theta = 0 is out of bounds" in problem.refusal(start(0.0))
    trajectory = Mpc(problem).solve(start(-110.0))
    assert trajectory.solved, trajectory.reason
    headings = np.rad2deg(trajectory.states[1:, 2])
    assert headings.min() >= -260.01
    assert headings.max() <= -99.99


def test_bounds_of_a_whole_turn_bind_nothing(tmp_path: Path, mpc: Mpc) -> None:
    whole = Mpc(formulate(half_turn(tmp_path, bounds="-180 .. 180 deg")))
    assert whole.solve(start(-160.0)).cost == pytest.approx(mpc.solve(start(-160.0)).cost, rel=1e-4)


def test_a_plan_a_turn_away_is_a_warm_start(mpc: Mpc) -> None:
    plan = mpc.solve(start(-160.0))
    for turns in (-1, 1, 2):
        moved = plan.states + np.array([0.0, 0.0, turns * TURN])
        found = mpc.solve(start(-160.0), (moved, plan.controls))
        assert found.reason == "sqp: solved"
        assert found.cost == pytest.approx(plan.cost, rel=1e-3)
        assert found.states[0] == pytest.approx(start(-160.0), abs=1e-4)


def test_a_receding_horizon_crosses_the_seam_with_wrapped_states(mpc: Mpc) -> None:
    controller, state, costs = RecedingHorizon(mpc), start(-120.0), []
    for _ in range(35):
        u = controller.control(state)
        assert controller.solved, controller.reason
        costs.append(controller.plan.cost)
        state = mpc.problem.system.wrap(mpc.problem.system.step(state, u, dt=mpc.problem.time_step))
    assert abs(state[2]) > np.deg2rad(150.0)
    assert max(np.diff(costs)) <= 0.01 * costs[0], "the plan goes on, it does not turn back"


def test_no_start_is_dropped_for_the_way_its_heading_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    half_turn(tmp_path)
    arguments = ["data", str(tmp_path / "half_turn.yaml"), "--output", str(tmp_path / "data")]
    assert main([*arguments, "--trajectories", "12", "--workers", "1"]) == 0
    said = capsys.readouterr().out
    assert "success       100.0% of 12 random starts" in said
    assert "10 of 10 starts of an episode" in said


def ring(period: float) -> OptimalControlProblem:
    """Return the problem of a point mass in the plane with a pointer on a circle of any period."""

    def equations(_math: object, _parameters: object) -> object:
        return lambda _x, u, d: (u[0] + d[0], u[1] + d[1], u[2] + d[2])

    pointer = Quantity("pointer", "m", 0.0, period, periodic=True)
    SYSTEM_MODELS["ring"] = SystemModel(
        states=(Quantity("x", "m"), Quantity("y", "m"), pointer),
        controls=tuple(Quantity(f"u_{name}", "m/s", -1.0, 1.0) for name in ("x", "y", "p")),
        parameters=(),
        equations=equations,
    )
    base = load_navigation_task("car_navigation")
    pointing = f"{period - 0.3} .. {period + 0.3} m"
    changes = {
        "system": base.system.model_validate({"model": "ring"}),
        "goal": base.goal.model_validate({"x": "1 .. 2 m", "y": "1 .. 2 m", "pointer": pointing}),
        "obstacles": (),
        "optimal_control": base.optimal_control.model_copy(
            update={"horizon": 30, "controls": {}, "terminal_set": None, "gamma": 1.0}
        ),
    }  # fmt: skip
    return formulate(base.model_copy(update=changes))


@pytest.mark.parametrize("period", [1.5, 10.0])
def test_a_circle_of_any_period_counts(period: float) -> None:
    mpc = Mpc(ring(period))
    low, high = (mpc.solve((1.5, 1.5, place)) for place in (0.6, period - 0.6))
    assert low.solved, low.reason
    assert low.cost == pytest.approx(high.cost, rel=1e-3)
    assert np.abs(np.diff(low.states[:, 2])).max() <= 0.1 + 1e-4
    assert -0.3 <= low.states[-1, 2] <= 0.3
    for trajectory in (low, high):
        assert rewards(mpc.problem.task, trajectory.states[-1])[0] == 1000.0, "V_oc's data count the arrival"


def test_ways_round_are_the_nearest_ones_within_bounds() -> None:
    region, free = Region({"a": Interval(3.0, 3.2)}), np.array([[-np.inf], [np.inf]])
    period = np.array([TURN])
    ways = coordinates.ways_round(region, ("a",), period, np.array([-2.0]), free)
    assert [way.intervals["a"].low for _, way in ways] == pytest.approx([3.0 - TURN, 3.0])
    (only,) = coordinates.ways_round(region, ("a",), period, np.array([-2.0]), np.array([[-2.5], [3.5]]))
    assert only[1].intervals["a"].low == pytest.approx(3.0)
    ((distance, whole),) = coordinates.ways_round(
        Region({"a": Interval(0.0, 7.0)}), ("a",), period, np.array([-2.0]), free
    )
    assert distance == 0.0
    assert whole.intervals == {}


def test_values_are_moved_by_whole_periods_where_there_is_one() -> None:
    moved = coordinates.nearest_turn([10.0, 10.0], [0.0, 0.0], np.array([TURN, np.inf]))
    assert moved == pytest.approx([10.0 - 2 * TURN, 10.0])


def test_a_plan_keeps_the_bounds_of_the_models_own_states(monkeypatch: pytest.MonkeyPatch) -> None:
    """A car with its speed as a state limited to 0.5 m/s and a motor that could exceed it; the task sets no limit."""

    def equations(m: Any, _parameters: object) -> object:
        return lambda x, u, _d: (x[3] * m.cos(x[2]), x[3] * m.sin(x[2]), u[1], u[0])

    states = (Quantity("x", "m"), Quantity("y", "m"), Quantity("theta", "rad", -np.pi, np.pi, periodic=True))
    monkeypatch.setitem(
        SYSTEM_MODELS,
        "slow",
        SystemModel(
            states=(*states, Quantity("v", "m/s", -0.5, 0.5)),
            controls=(Quantity("a", "m/s^2", -2.0, 2.0), Quantity("omega", "rad/s", -2.0, 2.0)),
            parameters=(),
            equations=equations,
        ),
    )
    base = load_navigation_task("car_navigation")
    changes = {
        "system": base.system.model_validate({"model": "slow"}),
        "obstacles": (),
        "optimal_control": base.optimal_control.model_copy(
            update={"horizon": 60, "time_step": 0.2, "controls": {}, "terminal_set": None, "gamma": 1.0}
        ),
    }  # fmt: skip
    problem = formulate(base.model_copy(update=changes))
    plan = Mpc(problem).solve(np.array([0.0, 0.0, 0.8, 0.0]))
    assert plan.solved, plan.reason
    assert np.abs(plan.states[:, 3]).max() == pytest.approx(0.5, abs=1e-3)
    assert "v = 0.7 is out of bounds, -0.5 .. 0.5" in problem.refusal([0.0, 0.0, 0.8, 0.7])
