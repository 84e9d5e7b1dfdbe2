"""For any raw commands, the robot touches no static obstacle, and no mover while it moves itself."""

import dataclasses
import itertools
import math

import numpy as np
import pytest
from ctrl_rl_safety.models.motion import STANDS
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from light_world import LightWorld

from ctrl_rl_safety import ROBOTS, FilterOptions, Mode, Reading, SafetyError, SafetyFilter

LEAST = 0.0


def discs(random: np.random.Generator, radius: float, spread: float, movers: int, fastest: float) -> np.ndarray:
    """Return discs around the origin that leave the robot some space, and movers that approach it."""
    out = []
    for _ in range(10):
        r, angle = random.uniform(0.05, 0.4), random.uniform(-math.pi, math.pi)
        away = r + radius + random.uniform(0.1, spread)
        out.append((away * math.cos(angle), away * math.sin(angle), 0.0, 0.0, r))
    standing = np.array(out)
    return np.concatenate((standing, [mover(random, standing, fastest) for _ in range(movers)])) if movers else standing


def mover(random: np.random.Generator, standing: np.ndarray, fastest: float) -> tuple[float, ...]:
    """Return a disc that approaches the origin clear of all other discs, since inside one it would seem static."""
    radius, times = 0.2, np.arange(0.0, 9.0, 0.05)[:, None]
    while True:
        angle, speed = random.uniform(-math.pi, math.pi), random.uniform(0.1, fastest)
        away, back = random.uniform(1.5, 4.0), angle + math.pi + random.uniform(-0.4, 0.4)
        x, y, v_x, v_y = (r * f(a) for r, a in ((away, angle), (speed, back)) for f in (math.cos, math.sin))
        gaps = np.hypot(x + v_x * times - standing[:, 0], y + v_y * times - standing[:, 1]) - standing[:, 4] - radius
        if gaps.min() > 0.05:
            return x, y, v_x, v_y, radius


@pytest.mark.parametrize("robot", ["turtlebot3_burger", "jackal"])
@settings(max_examples=6, deadline=None, suppress_health_check=list(HealthCheck), derandomize=True)
@given(seed=st.integers(0, 10_000), movers=st.integers(0, 3), with_set=st.booleans(), full=st.booleans())
def test_no_raw_command_brings_a_contact(robot: str, seed: int, movers: int, with_set: bool, full: bool) -> None:
    standing, moving = least_clearances(robot, seed, movers, with_set, full)
    assert standing > LEAST
    assert moving > LEAST


def least_clearances(robot: str, seed: int, movers: int, with_set: bool, full: bool) -> tuple[float, float]:
    """Return the minimum clearances of a drive: from static discs, and from moving ones while the robot moves."""
    random, model = np.random.default_rng(seed), ROBOTS[robot]
    fastest = 0.6
    safety = SafetyFilter(model, FilterOptions(mover_speed=fastest if movers else 0.0, unblock_after=1.0))
    spread = 0.5 + 4.0 * model.stopping_distance(model.speed)
    world = LightWorld(model, discs(random, model.radius, spread, movers, fastest), safety, seed)
    raw = np.array((model.speed, 0.0))
    clearances = []
    for tick in range(150):
        if not full and tick % 8 == 0:
            raw = random.uniform(*model.limits)
        clearances.append(world.tick(raw, with_set)[1:])
    standing, moving = np.min(clearances, axis=0)
    return float(standing), float(moving)


def test_a_recoverable_command_passes_untouched_and_a_wall_stops_the_robot_without_chatter() -> None:
    model = ROBOTS["turtlebot3_burger"]
    wall = np.array([(1.0, y, 0.0, 0.0, 0.1) for y in np.arange(-1.0, 1.0, 0.1)])
    world = LightWorld(model, wall, SafetyFilter(model, FilterOptions(unblock_after=0.0)), 0)
    raw = np.array((model.speed, 0.0))
    modes, nearest = [], math.inf
    for _ in range(120):
        verdict, standing, _ = world.tick(raw, True)
        nearest = min(nearest, standing)
        modes.append(verdict.mode)
        if verdict.mode is Mode.PASSED:
            assert verdict.command.tolist() == raw.tolist()
    changed = modes.index(Mode.CORRECTED)
    assert set(modes[:changed]) == {Mode.PASSED}
    assert sum(a is not b and Mode.PASSED in (a, b) for a, b in itertools.pairwise(modes)) <= 2
    assert 0.0 < nearest < 0.1


@pytest.mark.parametrize("pushed", [0.0, 0.03])
def test_a_robot_that_is_held_for_a_minute_does_not_creep_into_the_wall(pushed: float) -> None:
    model, angles = ROBOTS["turtlebot2"], np.radians(np.arange(0.0, 360.0, 6.0))
    ring = np.column_stack((1.2 * np.cos(angles), 1.2 * np.sin(angles), *np.zeros((2, 60)), np.full(60, 0.1)))
    world = LightWorld(model, ring, SafetyFilter(model, FilterOptions(unblock_after=0.0)), 0)
    raw = np.array((model.speed, 0.0))
    for _ in range(100):
        world.tick(raw, False)
    world.state[:2] *= 1.0 + pushed / np.hypot(*world.state[:2])  # nearer than the filter would have let it
    assert min(world.tick(raw, False)[1] for _ in range(900)) > 0.0


def test_a_robot_that_is_held_turns_to_the_free_side() -> None:
    model = ROBOTS["turtlebot3_burger"]
    wall = np.array([(0.4, y, 0.0, 0.0, 0.1) for y in np.arange(-1.0, 1.0, 0.1)])
    world = LightWorld(model, wall, SafetyFilter(model, FilterOptions(unblock_after=1.0)), 0)
    modes = {world.tick(np.array((model.speed, 0.0)), True)[0].mode for _ in range(250)}
    assert Mode.UNBLOCKING in modes
    assert np.hypot(*world.state[:2]) > 0.5


def test_a_robot_that_brakes_for_longer_than_a_certificate_reaches_is_refused() -> None:
    slow = dataclasses.replace(ROBOTS["turtlebot4"], braking=1e-9)
    with pytest.raises(SafetyError, match=r"turtlebot4 takes 306\d{6} s to brake: at most 20 s"):
        SafetyFilter(slow)


def test_without_a_scan_there_is_no_answer() -> None:
    with pytest.raises(SafetyError, match="no scan yet"):
        SafetyFilter(ROBOTS["turtlebot4"]).decide(0.0, Reading(np.zeros(3), 0.0, 0.0), np.zeros(2))


def test_behind_somebody_slower_the_speed_is_steady_while_scans_grow_old() -> None:
    model = ROBOTS["turtlebot3_burger"]
    walker = np.array([(0.6, 0.05, 0.15, 0.0, 0.1)])  # too fast to be taken for standing, and to be passed
    world = LightWorld(model, walker, SafetyFilter(model, FilterOptions(0.075, 0.3)), 0)
    speeds, modes = [], []
    for _ in range(150):
        verdict, _, moving = world.tick(np.array((0.21, 0.0)), True)
        assert moving > LEAST
        speeds.append(verdict.command[0])
        modes.append(verdict.mode)
    assert Mode.CORRECTED in modes
    assert float(np.abs(np.diff(speeds)).sum()) < 3.0
    assert world.state[0] > 0.5


def test_it_leads_a_robot_past_somebody_who_stands_beside_its_way() -> None:
    model = ROBOTS["turtlebot3_burger"]
    safety = SafetyFilter(model, FilterOptions(mover_speed=0.6, unblock_after=0.0))
    world = LightWorld(model, np.array([(1.2, -0.25, 0.0, 0.0, 0.1)]), safety, 0)
    nearest = min(world.tick(np.array((model.speed, 0.0)), True)[1] for _ in range(220))
    assert nearest > 0.1  # of the 0.03 m that its own way leaves
    assert world.state[0] > 1.5


def test_what_a_map_has_never_moves_and_anything_else_may_come() -> None:
    model = ROBOTS["turtlebot3_burger"]
    wall = np.column_stack((np.full(40, 0.45), np.linspace(-1.0, 1.0, 40)))
    reading, raw = Reading(np.zeros(3), 0.2, 0.0), np.array((0.2, 0.0))

    def answer(fixed: object) -> Mode:
        safety = SafetyFilter(model, FilterOptions(mover_speed=1.0))
        safety.see(0.0, reading.pose, wall, fixed=fixed)
        return safety.decide(0.0, reading, raw).mode

    assert answer(lambda places: np.ones(len(places), bool)) is Mode.PASSED
    assert answer(lambda places: np.zeros(len(places), bool)) is not Mode.PASSED
    assert answer(None) is not Mode.PASSED


def test_without_a_map_a_surface_larger_than_any_mover_is_a_wall_once_it_has_stood() -> None:
    model = ROBOTS["turtlebot3_burger"]
    wall = np.column_stack((np.linspace(-1.0, 1.0, 60), np.full(60, 0.3)))
    reading, raw = Reading(np.zeros(3), 0.2, 0.0), np.array((0.2, 0.0))
    for size, mode in ((1.0, Mode.PASSED), (3.0, Mode.CORRECTED), (0.0, Mode.CORRECTED)):
        safety = SafetyFilter(model, FilterOptions(mover_speed=0.6, mover_size=size))
        modes = []
        for now in np.arange(0.0, 1.7, 0.2):
            safety.see(float(now), reading.pose, wall)
            modes.append(safety.decide(float(now), reading, raw).mode)
        assert modes[0] is not Mode.PASSED
        assert modes[-1] is mode


def test_a_jackal_drives_through_a_gap_that_is_narrower_than_its_disc() -> None:
    model = ROBOTS["jackal"]
    posts = np.array([(1.0, 0.38, 0.0, 0.0, 0.05), (1.0, -0.38, 0.0, 0.0, 0.05)])
    for name, shape in (("rectangle", model), ("disc", dataclasses.replace(model, length=0.0, width=0.0))):
        world = LightWorld(shape, posts, SafetyFilter(shape, FilterOptions(unblock_after=0.0)), 0)
        assert min(world.tick(np.array((0.6, 0.0)), True)[1] for _ in range(80)) > 0.0
        assert (world.state[0] > 1.5) == (name == "rectangle")


def test_where_nothing_is_known_any_more_the_last_certified_escape_is_driven() -> None:
    model = ROBOTS["jackal"]
    safety = SafetyFilter(model)
    assert safety.stopping(0.0).tolist() == [0.0, 0.0]
    post = np.column_stack((np.full(9, 1.15), np.linspace(-0.2, 0.1, 9)))
    safety.see(0.0, np.zeros(3), post)
    verdict = safety.decide(0.0, Reading(np.zeros(3), 1.6, 0.0), np.array((1.6, 1.0)))
    assert verdict.margin >= 0.0
    path = safety.escape(verdict)
    assert abs(path[-1, 3]) < 0.011
    for time in (0.1, 0.2, 0.3):
        v, omega = safety.stopping(time)
        assert (v, omega) == (0.0, path[int(time / 0.02 + 1e-6), 4])
    assert safety.stopping(5.0).tolist() == [0.0, 0.0]


@pytest.mark.parametrize(("nearer", "goes_on"), [(0.12, True), (0.3, False)])
def test_what_nothing_certifies_goes_on_with_its_escape_unless_a_bound_does_not_hold(
    nearer: float, goes_on: bool
) -> None:
    """A post seems nearer in the second scan, by twice the noise of two scans or beyond every bound."""
    model, raw, pose = ROBOTS["jackal"], np.array((1.6, 1.0)), np.array((0.096, 0.0, 0.0))
    post = np.column_stack((np.full(9, 0.85), np.linspace(0.0, 0.3, 9)))
    safety = SafetyFilter(model)
    safety.see(0.0, np.zeros(3), post)
    verdict = safety.decide(0.0, Reading(np.zeros(3), 1.6, 0.0), raw)
    safety.sent(0.0, verdict.command)
    assert verdict.margin >= 0.0
    escape = safety.stopping(0.06)
    assert escape[1] != 0.0
    safety.see(0.06, pose, post - pose[:2] - (nearer, 0.0))
    verdict = safety.decide(0.06, Reading(pose, 1.6, 0.0), raw)
    assert verdict.mode is Mode.ESCAPING
    assert verdict.margin < 0.0
    assert (verdict.command.tolist() == escape.tolist()) == goes_on


def test_a_rectangle_that_stands_stops_turning_where_nothing_is_certified() -> None:
    model = ROBOTS["jackal"]
    safety = SafetyFilter(model, FilterOptions(mover_speed=0.6))
    near = np.column_stack((np.linspace(-0.3, 0.3, 13), np.full(13, 0.3)))
    safety.see(0.0, np.zeros(3), near)
    verdict = safety.decide(0.0, Reading(np.zeros(3), 0.0, 1.0), np.array((0.0, 2.0)))
    assert verdict.mode is Mode.ESCAPING
    assert verdict.margin < 0.0
    assert verdict.command.tolist() == [0.0, 0.0]


def test_a_disc_that_is_to_stand_is_not_turned_by_its_escape() -> None:
    """A mover approaches in a corridor: no escape is certified, and turning a disc gains no clearance."""
    model = ROBOTS["turtlebot3_burger"]
    walls = [(x, y, 0.0, 0.0, 0.1) for x in np.arange(-1.0, 3.0, 0.1) for y in (-0.5, 0.5)]
    safety = SafetyFilter(model, FilterOptions(mover_speed=0.4, unblock_after=0.0))
    world = LightWorld(model, np.array([*walls, (1.5, 0.2, -0.1, 0.0, 0.15)]), safety, 0)
    for _ in range(60):
        world.tick(np.array((0.2, 0.0)), True)
    raw, escapes = np.array((0.0, 0.6)), 0
    for _ in range(140):
        verdict, _, moving = world.tick(raw, True)
        assert moving > LEAST
        if verdict.mode is Mode.ESCAPING and abs(verdict.state[3]) < STANDS:
            escapes += 1
            assert verdict.command.tolist() == raw.tolist()
    assert escapes > 0


def test_a_robot_that_stands_goes_out_of_the_way_where_it_may() -> None:
    model = ROBOTS["turtlebot3_burger"]

    def nearest(evades: bool) -> tuple[float, set[Mode]]:
        safety = SafetyFilter(model, FilterOptions(mover_speed=0.3, evade=evades))
        world = LightWorld(model, np.array([(1.5, 0.0, -0.15, 0.0, 0.1)]), safety, 0)
        least, modes = math.inf, set()
        for _ in range(170):
            verdict, _, moving = world.tick(np.zeros(2), False)
            assert moving > LEAST
            modes.add(verdict.mode)
            x, y = np.array((1.5 - 0.15 * world.time, 0.0)) - world.state[:2]
            least = min(least, math.hypot(x, y) - 0.1 - model.radius)
        return least, modes

    touched, modes = nearest(False)
    assert touched < 0.0
    assert modes == {Mode.PASSED}
    clear, modes = nearest(True)
    assert clear > 0.05
    assert modes == {Mode.PASSED, Mode.EVADING}
