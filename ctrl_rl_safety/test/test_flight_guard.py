"""The guard of planar quadrotors: its predictions, the thrusts that it passes, and the crashes that it prevents."""

import dataclasses
import math
import re
from importlib.resources import files

import numpy as np
import pytest
from ctrl_rl_safety.flight.motion import craft_of, moved, room_at, shape_rows
from ctrl_rl_safety.models.quadrotor_model import HEIGHT, LENGTH

from ctrl_rl_core import Box, Disc, load_navigation_task
from ctrl_rl_safety import FlightGuard, FlightOptions, QuadrotorModel, SafetyError, quadrotor_of

pytest.importorskip("sim_bridge")

from sim_bridge import SimulatedWorld, SimulationOptions

TASKS = ("quad_ttr", "quad_navigation", "quad_trap")
TASK = load_navigation_task("quad_ttr")
MODEL = quadrotor_of(TASK)
FLOOR = Box((0.0, -0.1), (200.0, 0.2))
SETTINGS = SimulationOptions(engine="planar", rate=240)
HOVER = np.full(2, 0.5 * MODEL.mass * MODEL.gravity)


def world_of(name: str, seed: int) -> SimulatedWorld:
    return SimulatedWorld(load_navigation_task(name), seed, options=SETTINGS)


def guard_of(world: SimulatedWorld, model: QuadrotorModel | None = None) -> FlightGuard:
    return FlightGuard(model or quadrotor_of(world.task), (*world.geometry.walls, *world.geometry.obstacles))


def test_it_has_the_size_of_the_simulators_body() -> None:
    text = (files("sim_bridge") / "urdf" / "planar_quadrotor.urdf").read_text()
    assert re.findall(r'<collision>\s*<geometry><box size="(\S+) \S+ (\S+)"', text) == [(str(LENGTH), str(HEIGHT))]


@pytest.mark.parametrize("name", TASKS)
def test_its_steps_are_those_of_the_system(name: str) -> None:
    model, system = quadrotor_of(load_navigation_task(name)), load_navigation_task(name).system.build()
    state, thrusts = np.array((0.0, 3.0, 2.0, -2.0, 0.4, 3.0)), (model.most, 0.5 * model.most)
    wanted = state.copy()
    for _ in range(20):
        wanted = system.step(wanted, thrusts, dt=0.0125 / 20)
    assert moved(craft_of(model, 0.025), tuple(state), *thrusts, 0.0125) == pytest.approx(wanted, abs=2e-3)


def test_room_is_a_lower_bound_of_the_engines_distance_and_exact_beside_a_wall() -> None:
    world, random = world_of("quad_ttr", 0), np.random.default_rng(0)
    craft, rows = craft_of(MODEL, 0.025), shape_rows((*world.geometry.walls, *world.geometry.obstacles))
    loose = dataclasses.replace(MODEL, tilt_limit=1.57)
    for _ in range(60):
        x, z, psi = random.uniform(-4.5, 4.5), random.uniform(1.1, 9.3), random.uniform(-1.1, 1.1)
        world.reset(0, (x, 0.0, z, 0.0, psi, 0.0))
        distance, room = world.clearance(), room_at(craft_of(loose, 0.025), rows, x, z, psi)
        if distance > 0.0:
            assert min(0.5 * distance, (1.57 - abs(psi)) * 0.4) - 1e-9 <= room <= distance + 1e-9
        else:
            assert room <= 1e-9
    world.close()
    assert room_at(craft, shape_rows((FLOOR,)), 0.0, 1.0, 0.0) == pytest.approx(min(0.875, 1.2 * 0.4))
    assert room_at(craft, shape_rows((FLOOR,)), 0.0, 0.3, 0.5) == pytest.approx(
        0.3 - 0.4 * math.sin(0.5) - 0.125 * math.cos(0.5)
    )
    assert room_at(craft, shape_rows((Disc((0.9, 1.0), 0.2),)), 0.0, 1.0, 0.0) == pytest.approx(0.3)


def test_the_edge_of_a_fall_that_it_can_stop_is_that_of_the_closed_form() -> None:
    """Upright above a floor, only the vertical motion remains: braking from v takes v^2 / 2a."""
    model = dataclasses.replace(MODEL, drag=0.0)
    guard, up = FlightGuard(model, (FLOOR,)), 2.0 * model.most / model.mass - model.gravity
    for speed in (1.0, 3.0, 6.0):
        needed = speed**2 / (2.0 * up) + 0.5 * HEIGHT
        low, high = 0.0, 8.0
        while high - low > 1e-3:
            middle = 0.5 * (low + high)
            low, high = (low, middle) if guard.room((0.0, 0.0, middle, -speed, 0.0, 0.0)) >= 0.0 else (middle, high)
        assert needed <= high <= needed + 0.05 + 0.3 * speed**2 / (2.0 * up)


@pytest.mark.parametrize("name", TASKS)
def test_random_thrusts_hit_nothing_and_what_is_promised_is_kept(name: str) -> None:
    for seed in range(2):
        world, random = world_of(name, seed), np.random.default_rng(seed)
        guard, promised = guard_of(world), 0.0
        while world.episode().outcome.name == "RUNNING" and world.elapsed < 5.0:
            raw = random.uniform(5.0, 11.0, 2) if random.random() < 0.5 else np.full(2, random.uniform(5.0, 11.0))
            for _ in range(8):
                verdict = guard.decide(world.state(), raw)
                assert verdict.room >= promised - 0.01
                promised = min(verdict.room, guard.options.margin)
                world.command(0, verdict.thrusts)
                world.step(6)
        assert world.episode().outcome.name != "COLLISION"
        world.close()


def test_a_heavier_quadrotor_hits_nothing_where_the_guard_is_told_the_bound() -> None:
    world = world_of("quad_ttr", 0)
    mass = 0.97 * MODEL.mass
    bound = 2.0 * MODEL.most * (1.0 / mass - 1.0 / MODEL.mass)
    guard = guard_of(world, dataclasses.replace(MODEL, mass=mass, disturbance=bound))
    for command in (np.zeros(2), HOVER, np.full(2, MODEL.most), np.full(2, math.nan)):
        for _ in range(80):
            world.command(0, guard.decide(world.state(), command).thrusts)
            world.step(6)
    assert world.episode().outcome.name != "COLLISION"
    world.close()


def test_what_is_safe_passes_untouched_and_a_goal_lets_it_arrive_fast() -> None:
    world = world_of("quad_ttr", 0)
    guard = guard_of(world)
    verdict = guard.decide((0.0, 0.0, 5.0, 0.0, 0.0, 0.0), HOVER)
    assert not verdict.changed
    assert verdict.thrusts.tolist() == HOVER.tolist()
    arriving = (3.3, 6.5, 8.4, 3.0, 0.8, 0.0)
    shapes = (*world.geometry.walls, *world.geometry.obstacles)
    assert guard.room(arriving) < 0.0 < FlightGuard(MODEL, shapes, goal=TASK.goal.region).room(arriving)
    world.close()


def test_what_it_cannot_use_is_one_line() -> None:
    guard = FlightGuard(MODEL, (FLOOR,))
    for state in ((0.0,) * 5, (math.nan,) * 6):
        with pytest.raises(SafetyError, match="six finite numbers"):
            guard.decide(state, HOVER)
    with pytest.raises(SafetyError, match="cannot hover"):
        dataclasses.replace(MODEL, least=7.0, most=10.0)
    for name in ("mass", "tilt_limit", "disturbance"):
        with pytest.raises(SafetyError, match=name):
            dataclasses.replace(MODEL, **{name: -1.0})
    with pytest.raises(SafetyError, match="no planar quadrotor"):
        quadrotor_of(load_navigation_task("car_ttr"))
    for wrong in ({"tick": 0.0}, {"margin": math.inf}, {"hysteresis": -0.1}):
        with pytest.raises(SafetyError, match=next(iter(wrong))):
            FlightOptions(**wrong)


def test_without_usable_thrusts_it_brakes_and_stays() -> None:
    world = world_of("quad_ttr", 0)
    world.reset(0, (-3.0, 3.0, 5.0, -2.0, 0.3, 0.0))
    guard = guard_of(world)
    for _ in range(160):
        world.command(0, guard.decide(world.state(), np.full(2, math.nan)).thrusts)
        world.step(6)
    stopped = world.state()
    assert np.hypot(stopped[1], stopped[3]) < 0.1
    for _ in range(80):
        world.command(0, guard.decide(world.state(), np.full(2, math.nan)).thrusts)
        world.step(6)
    assert world.state()[[0, 2]] == pytest.approx(stopped[[0, 2]], abs=0.1)
    assert world.episode().smallest_clearance > 0.0


def test_the_last_escape_goes_on_without_a_state_until_it_hovers_and_other_thrusts_may_come_within_a_tick() -> None:
    world = world_of("quad_ttr", 0)
    guard = guard_of(world)
    assert guard.escape_on() is None
    for _ in range(30):
        world.command(0, guard.decide(world.state(), np.full(2, MODEL.most)).thrusts)
        world.step(6)
    assert guard.change(world.state(), np.full(2, math.nan)) is None
    thrusts = guard.escape_on()
    while thrusts is not None:
        world.command(0, thrusts)
        world.step(6)
        thrusts = guard.escape_on()
    assert np.hypot(*world.state()[[1, 3]]) < 0.3
    changed = guard.change(world.state(), HOVER)
    assert changed is not None
    assert not changed.changed
