"""The filter of cars: what it certifies contains what the car does, and cars stop before walls, poles and people."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from ctrl_rl_safety.filter.car_certificate import CarSituation, certify_car
from ctrl_rl_safety.filter.safety_filter import STEP
from ctrl_rl_safety.models.car_model import next_of_car, steered_of
from ctrl_rl_safety.models.motion import motion_of
from ctrl_rl_safety.monitor.model_monitor import ModelMonitor
from ctrl_rl_safety.sets.distance_field import NONE
from numpy.typing import NDArray

from ctrl_rl_safety import (
    CarFilter,
    CarModel,
    FilterOptions,
    Growth,
    Mode,
    Reading,
    SafetyError,
    find_model,
    find_vehicle,
    make_filter,
    obstacles_around,
)

Array = NDArray[np.float64]
CARS = ("race_car", "road_car")
_FINE = 0.004
"""Step of the simulation, a fifth of the filter's [s]."""
_ROUGH = 0.005
"""Way by which the filter's longer steps may be off, which `range_error` covers otherwise [m]."""


def car(name: str) -> CarModel:
    model = find_vehicle(name)
    assert isinstance(model, CarModel)
    return model


def gaps(model: CarModel, state: tuple[float, ...], points: Array) -> Array:
    """Return the distances of points (n, 2) to a car's rectangle (n,)."""
    c, s = math.cos(state[2]), math.sin(state[2])
    away = np.abs((points - state[:2]) @ np.array(((c, -s), (s, c))) - (model.centre, 0.0)) - model.core
    return np.hypot(*np.maximum(away, 0.0).T)


class World:
    """A simulated car among points, whose filter stands between it and raw commands; pushed to one side at random."""

    def __init__(self, model: CarModel, points: Array, seed: int, options: FilterOptions | None = None) -> None:
        self.model, self.points, self.filter = model, points, make_filter(model, options)
        self.state, self.time, self.closest = (0.0, 0.0, 0.0, 0.0, 0.0), 0.0, math.inf
        self._motion, self._steered = motion_of(model, _FINE), steered_of(model, _FINE)
        self._random, self._waiting, self._held = np.random.default_rng(seed), [(0.0, np.zeros(2))], np.zeros(2)

    def scan(self) -> Array:
        x, y, theta = self.state[:3]
        c, s = math.cos(theta), math.sin(theta)
        seen = (self.points - (x, y)) @ np.array(((c, -s), (s, c)))
        away = np.hypot(*seen.T)
        error = self._random.uniform(-1.0, 1.0, len(seen)) * self.model.range_error
        near = (away > 0.05) & (away < 15.0)
        return seen[near] * (1.0 + error / np.maximum(away, 0.1))[near, None]

    def drive(self, raw: Array, seconds: float) -> list[Mode]:
        """Drive by a raw command, and return what the filter did at 20 Hz."""
        modes = []
        for tick in range(round(seconds / 0.05)):
            if tick % 2 == 0:
                self.filter.see(self.time, np.array(self.state[:3]), self.scan())
            x, y, theta, v, delta = self.state
            reading = Reading(np.array((x, y, theta)), v, v * math.tan(delta) / self.model.wheelbase)
            verdict = self.filter.decide(self.time, reading, raw)
            modes.append(verdict.mode)
            self.filter.sent(self.time, verdict.command)
            self._waiting.append((self.time + self.model.delay, verdict.command))
            push = self.model.disturbance * self._random.choice((-1.0, 1.0))
            for _ in range(round(0.05 / _FINE)):
                while self._waiting and self._waiting[0][0] <= self.time + 1e-9:
                    self._held = self._waiting.pop(0)[1]
                x, y, theta, v, delta = next_of_car(self.state, *self._held.tolist(), self._motion, self._steered)
                if abs(v) > 0.01:
                    x, y = x - push * _FINE * math.sin(theta), y + push * _FINE * math.cos(theta)
                self.state, self.time = (x, y, theta, v, delta), self.time + _FINE
                if len(self.points):
                    self.closest = min(self.closest, float(gaps(self.model, self.state, self.points).min()))
        return modes


def wall(x: float, half: float = 6.0) -> Array:
    aside = np.arange(-half, half, 0.02)
    return np.column_stack((np.full(len(aside), x), aside))


@pytest.mark.parametrize("name", CARS)
@pytest.mark.parametrize("count", [400, pytest.param(1500, marks=pytest.mark.slow)])
def test_the_certified_sweep_contains_the_driven_one(name: str, count: int) -> None:
    """Whatever is certified, the same car, simulated in finer steps and pushed aside, touches no echo."""
    model, random, certified, close = car(name), np.random.default_rng(1), 0, 0
    motion, steered = motion_of(model, _FINE), steered_of(model, _FINE)
    ways = motion_of(model, STEP), steered_of(model, STEP)
    size = 2.0 * model.length
    for _ in range(count):
        points = random.uniform(-size, size, (int(random.integers(3, 15)), 2))
        begin = (
            0.0,
            0.0,
            random.uniform(-math.pi, math.pi),
            random.uniform(-model.reverse_speed, model.speed),
            random.uniform(-1.0, 1.0) * model.steering_angle,
        )
        obstacles = obstacles_around(points, NONE, NONE, (0.0, 0.0), 0.1)
        situation = CarSituation(obstacles, Growth(model.disturbance), ways[0], ways[1], model.core, _ROUGH, model.lag)
        command = (random.uniform(-model.reverse_speed, model.speed), random.uniform(-1.0, 1.0) * model.turn_rate)
        steps = int(random.integers(1, 12))
        margin = certify_car(situation, begin, 0.0, command, steps, 0.0)
        if margin < 0.0:
            continue
        certified += 1
        state, push, least = begin, random.choice((-1.0, 1.0)) * model.disturbance * _FINE, math.inf
        for k in range(2000):
            held = command if k < steps * round(STEP / _FINE) else (0.0, 0.0)
            x, y, theta, v, delta = next_of_car(state, *held, motion, steered)
            state = (x - push * math.sin(theta), y + push * math.cos(theta), theta, v, delta)
            least = min(least, float(gaps(model, state, points).min()))
            if held == (0.0, 0.0) and abs(v) < 1e-3:
                break
        assert least > 0.0
        close += least < 0.15
    assert certified > count / 5
    assert close > count / 50  # or else it would hold for want of anything near


@pytest.mark.parametrize("name", CARS)
@pytest.mark.parametrize("turn", [0.0, 0.5])
def test_a_car_stops_before_a_wall(name: str, turn: float) -> None:
    model = car(name)
    world = World(model, wall(3.0 * model.length), 2)
    # Beside the wall's end a turning car goes by, so there the wall is all around.
    if turn:
        world.points = np.concatenate((world.points, wall(-3.0 * model.length), wall(3.0 * model.length)[:, ::-1]))
    world.drive(np.array((model.speed, turn * model.turn_rate)), 12.0)
    assert world.closest > 0.0
    assert turn or (world.closest < 0.4 and world.state[3] == pytest.approx(0.0, abs=0.02))


@pytest.mark.parametrize("name", CARS)
def test_a_pole_ahead_is_passed_or_waited_for_but_not_touched(name: str) -> None:
    model = car(name)
    for seed, aside in enumerate((-0.4, -0.1, 0.0, 0.3)):
        pole = np.array(((3.0 * model.length, aside * model.width),)) + np.array(((0.0, 0.0), (0.0, 0.02)))
        world = World(model, pole, seed)
        world.drive(np.array((model.speed, 0.0)), 6.0)
        assert world.closest > 0.0


def test_in_the_open_every_command_passes() -> None:
    for name in CARS:
        model = car(name)
        world = World(model, wall(40.0 * model.length, 60.0)[::10], 3)
        random = np.random.default_rng(4)
        for _ in range(20):
            v = random.uniform(-model.reverse_speed, model.speed)
            modes = world.drive(np.array((v, random.uniform(-1.0, 1.0) * abs(v) / model.turning_radius)), 0.25)
            assert set(modes) == {Mode.PASSED}


def test_what_cannot_be_steered_is_cut_and_a_standing_car_does_not_turn() -> None:
    model = car("race_car")
    safety = make_filter(model)
    safety.see(0.0, np.zeros(3), wall(10.0))
    at_rest = Reading(np.zeros(3), 0.0, 0.0)
    v, omega = safety.decide(0.0, at_rest, np.array((1.0, 9.0))).command
    assert omega == pytest.approx(v / model.turning_radius)
    assert safety.decide(0.0, at_rest, np.array((0.0, 1.0))).command.tolist() == [0.0, 0.0]


def test_a_car_that_stands_too_close_may_leave_but_not_approach() -> None:
    model = car("race_car")
    nose = model.centre + model.core[0]
    safety = make_filter(model)
    for now in (0.0, 0.1, 0.2):
        safety.see(now, np.zeros(3), wall(nose + 0.01))
    at_rest = Reading(np.zeros(3), 0.0, 0.0)
    assert safety.decide(0.2, at_rest, np.array((0.5, 0.0))).command[0] <= 0.0
    back = safety.decide(0.2, at_rest, np.array((-0.5, 0.0)))
    assert back.command[0] < 0.0


def test_a_mover_that_comes_from_the_side_is_waited_for() -> None:
    model = car("race_car")
    points = np.column_stack((np.full(20, 2.0), np.linspace(-0.6, -0.3, 20)))
    world = World(model, points, 5, FilterOptions(mover_speed=1.0, mover_size=0.0))
    modes = world.drive(np.array((1.5, 0.0)), 3.0)
    assert Mode.PASSED in modes
    assert len(set(modes)) > 1  # slower than asked beside what may move


def test_robots_and_cars_get_their_own_filters() -> None:
    assert isinstance(make_filter(find_vehicle("road_car")), CarFilter)
    assert not isinstance(make_filter(find_vehicle("jackal")), CarFilter)
    with pytest.raises(SafetyError, match="is a car"):
        find_model("race_car")
    with pytest.raises(SafetyError, match="length and width"):
        replace(car("race_car"), length=0.0, width=0.0)


def test_the_monitor_of_a_car_finds_a_longer_delay_and_no_fault_in_turns() -> None:
    stated = car("race_car")
    for late in (0.0, 0.3):
        monitor, state, time = ModelMonitor(stated, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0, 0.0), 0.0
        motion, steered = motion_of(stated, _FINE), steered_of(stated, _FINE)
        waiting, held, random = [(0.0, (0.0, 0.0))], (0.0, 0.0), np.random.default_rng(6)
        for tick in range(400):
            if tick % 20 == 0:
                v = random.choice((1.5, 0.0, -0.8, 0.6))
                command = (float(v), float(random.uniform(-1.0, 1.0) * abs(v) / stated.turning_radius))
            monitor.sent(time, np.array(command))
            waiting.append((time + stated.delay + late, command))
            for _ in range(round(0.05 / _FINE)):
                while waiting and waiting[0][0] <= time + 1e-9:
                    held = waiting.pop(0)[1]
                state = next_of_car(state, *held, motion, steered)
                time += _FINE
            monitor.measure(time, np.array(state[:3]), state[3], state[3] * math.tan(state[4]) / stated.wheelbase)
        assert monitor.problem == ""
        assert (monitor.model.delay >= stated.delay + 0.25) == (late > 0.0)


def test_echoes_of_its_own_wheels_do_not_stop_a_car() -> None:
    model = car("road_car")
    wheels = np.array([(model.wheelbase, side * 0.65) for side in (-1.0, 1.0)])
    safety = make_filter(model)
    for now in (0.0, 0.1):
        safety.see(now, np.zeros(3), np.concatenate((wheels, wall(40.0))))
    assert safety.decide(0.1, Reading(np.zeros(3), 0.0, 0.0), np.array((1.0, 0.0))).mode is Mode.PASSED
