"""The recoverable set against braking in front of a wall, dense roll-outs, and an iterated viability kernel."""

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
from ctrl_rl_safety.models.motion import motion_of
from ctrl_rl_safety.sets.recoverable_set import HEADINGS, LEVELS
from light_world import roll_out

from ctrl_rl_safety import ROBOTS, Growth, RobotModel, SafetyError, find_model, obstacles_around, solve_set

NONE = np.empty((0, 2))
MODEL = RobotModel("test", 0.15, 1.0, 1.0, 2.0, 1.5, 1.5, 100.0)
CELL = 0.04
GROWTH = Growth(0.0)


def some_echoes(seed: int, count: int = 25) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-1.1, 1.1, (count, 2))


def test_in_front_of_a_wall_it_is_the_braking_distance() -> None:
    wall = np.column_stack((np.full(400, 0.9), np.linspace(-4.0, 4.0, 400)))
    model = dataclasses.replace(MODEL, turn_rate=1e-3)
    found = solve_set(obstacles_around(NONE, wall, NONE, (0.0, 0.0), CELL), model, GROWTH)
    for v in (0.0, 0.4, 0.8, 1.0):
        exact = 0.9 - model.radius - v * v / (2.0 * model.braking)
        assert found.value(np.array((0.0, 0.0, 0.0, v))) == pytest.approx(exact, abs=0.4 * CELL)
        assert found.value(np.array((0.0, 0.0, math.pi, -v))) == pytest.approx(exact, abs=0.4 * CELL)


def test_what_it_calls_recoverable_stops_in_dense_roll_outs_and_what_not_does_not() -> None:
    echoes, random = some_echoes(1), np.random.default_rng(2)
    found = solve_set(obstacles_around(NONE, echoes, NONE, (0.0, 0.0), CELL), MODEL, GROWTH)
    motion = motion_of(MODEL, 0.02)
    steps = math.ceil(MODEL.speed / MODEL.braking / 0.02) + 1
    wrong = 0
    for _ in range(60):
        state = np.array((*random.uniform(-0.6, 0.6, 2), random.uniform(-3.0, 3.0), random.uniform(0.0, 1.0), 0.0))
        best = -math.inf
        for first in np.linspace(-MODEL.turn_rate, MODEL.turn_rate, 9):
            for second in np.linspace(-MODEL.turn_rate, MODEL.turn_rate, 9):
                turns = np.where(np.arange(steps) < steps // 3, first, second)
                state[4] = first
                path = roll_out(state, np.column_stack((np.zeros(steps), turns)), motion)
                gaps = np.hypot(*(path[:, None, :2] - echoes).transpose(2, 0, 1)).min() - MODEL.radius
                best = max(best, float(gaps))
        value = found.value(state)
        wrong += (value > CELL and best < 0.0) or (value < -CELL and best > 0.0)
    assert wrong == 0


def test_it_shrinks_with_growth_speed_and_echoes() -> None:
    obstacles = obstacles_around(NONE, some_echoes(3), NONE, (0.0, 0.0), CELL)
    found = solve_set(obstacles, MODEL, GROWTH)
    assert (np.diff(found.values, axis=0) <= 0.5 * CELL).all()
    grown = solve_set(obstacles, MODEL, Growth(0.1))
    assert (grown.values <= found.values + 1e-5).all()
    both = np.concatenate((some_echoes(3), some_echoes(4)))
    more = solve_set(obstacles_around(NONE, both, NONE, (0.0, 0.0), CELL), MODEL, GROWTH)
    assert (more.values <= found.values + 1e-5).all()


def test_a_rectangle_fits_lengthways_where_its_disc_does_not_and_not_crossways() -> None:
    jackal = dataclasses.replace(MODEL, radius=0.333, length=0.508, width=0.43)
    posts = np.array(((0.0, 0.32), (0.0, -0.32)))
    for echoes in ((posts, NONE, NONE), (NONE, posts, NONE), (NONE, NONE, posts)):
        found = solve_set(obstacles_around(*echoes, (0.0, 0.0), CELL), jackal, GROWTH)
        assert found.value(np.array((0.0, 0.0, 0.0, 0.3))) == pytest.approx(0.32 - 0.231, abs=CELL)
        assert found.value(np.array((0.0, 0.0, 0.5 * math.pi, 0.3))) == pytest.approx(0.32 - 0.4, abs=CELL)


def test_it_is_the_viability_kernel_that_an_iteration_over_all_accelerations_finds() -> None:
    """Independent of the single pass: speeds may rise, stay or fall, and values are iterated to convergence."""
    found = solve_set(obstacles_around(NONE, some_echoes(5), NONE, (0.0, 0.0), CELL), MODEL, GROWTH)
    nodes = found.values.shape[-1]
    gap = found.values[0, 0].astype(np.float64)
    kernel = np.broadcast_to(gap, found.values.shape).copy()
    speeds = np.linspace(0.0, MODEL.speed, LEVELS + 1)
    rows, columns = np.mgrid[:nodes, :nodes].astype(np.float64)

    def at(plane: np.ndarray, dx: float, dy: float) -> np.ndarray:
        column, row = np.clip(columns + dx, 0, nodes - 1.001), np.clip(rows + dy, 0, nodes - 1.001)
        j, i = column.astype(int), row.astype(int)
        a, b = column - j, row - i
        lower = (1 - a) * plane[i, j] + a * plane[i, j + 1]
        return (1 - b) * lower + b * ((1 - a) * plane[i + 1, j] + a * plane[i + 1, j + 1])

    time = MODEL.speed / LEVELS / MODEL.braking
    for _ in range(12):
        before = kernel.copy()
        for level in range(1, LEVELS + 1):
            for heading in range(HEADINGS):
                best = np.full((nodes, nodes), -np.inf)
                theta = 2.0 * math.pi * heading / HEADINGS
                for change in (-1, 0, 1):
                    to = level + change
                    if to > LEVELS:
                        continue
                    way = 0.5 * (speeds[level] + speeds[to]) * time
                    for omega in np.linspace(-MODEL.turn_rate, MODEL.turn_rate, 5):
                        turn = theta + omega * time
                        dx, dy = (way * f(theta + 0.5 * omega * time) / CELL for f in (math.cos, math.sin))
                        place = turn / (2.0 * math.pi) * HEADINGS
                        k, share = math.floor(place), place - math.floor(place)
                        plane = (1 - share) * kernel[to, k % HEADINGS] + share * kernel[to, (k + 1) % HEADINGS]
                        half = at(gap, 0.5 * dx, 0.5 * dy)
                        best = np.maximum(best, np.minimum(at(plane, dx, dy), half))
                kernel[level, heading] = np.minimum(gap, best)
        if np.abs(kernel - before).max() < 0.1 * CELL:
            break
    inner = (slice(None), slice(None), slice(15, -15), slice(15, -15))
    ours, other = found.values[inner], kernel[inner]
    decided = (np.abs(ours) > CELL) & (ours < gap[15:-15, 15:-15] - 0.5 * CELL)
    assert decided.sum() > 1000
    assert (np.sign(ours) == np.sign(other))[decided].mean() > 0.99


def test_models_are_read_written_and_refused(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    ROBOTS["turtlebot2"].save(file)
    assert find_model(str(file)) == ROBOTS["turtlebot2"]
    file.write_text(file.read_text().replace("0.7 m/s", "-0.7 m/s"))
    with pytest.raises(SafetyError, match=r"mine.yaml: speed: .*greater than or equal to 0"):
        find_model(str(file))
    with pytest.raises(SafetyError, match=r"0.7 x 0.4 m is not in a disc of 0.3 m"):
        dataclasses.replace(MODEL, radius=0.3, length=0.7, width=0.4)
    with pytest.raises(SafetyError, match="needs both length and width"):
        dataclasses.replace(MODEL, width=0.1)
    with pytest.raises(SafetyError, match="no robot 'r2d2': there are jackal"):
        find_model("r2d2")
