"""The checks of the pre-flight on a robot that moves, each on a drive of the pattern with one fault."""

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest
from ctrl_rl_bringup.preflight.finding import Finding, Level, Limits
from ctrl_rl_bringup.preflight.inspection import as_text, inspect_moving, may_go
from ctrl_rl_bringup.preflight.motion_checks import Motion
from ctrl_rl_bringup.preflight.mover import PATTERN, Part, mover_parameters
from ctrl_rl_bringup.preflight.recording import OdometrySample, Recording, ScanSample, Times
from ctrl_rl_bringup.preflight.scan_checks import shift_mismatches, turn_mismatches

from ctrl_rl_core import ScanGeometry

LIMITS = Limits(lidar_x=0.0)
BEAMS = 360
STEP = 1.0 / 30.0


@dataclass(frozen=True)
class Robot:
    """A robot in a room of 5 m by 4 m, and what is wrong with it."""

    speed: float = 1.0
    turn: float = 1.0
    pose: float = 1.0
    delay: float = 0.05
    lidar_yaw: float = 0.0
    mirrored: bool = False
    obeys_zero: bool = True
    times_out: bool = True
    long_room: bool = False
    odometry_speed: float = 1.0
    odometry_turn: float = 1.0


def room(robot: Robot, x: float, y: float, yaw: float, random: np.random.Generator) -> np.ndarray:
    """Return the ranges that its lidar measures."""
    bearings = np.arange(BEAMS) * 2.0 * np.pi / BEAMS
    angles = yaw + robot.lidar_yaw + (-bearings if robot.mirrored else bearings)
    long = 1000.0 if robot.long_room else 2.5
    ways = []
    for place, part, half in ((x - 0.3, np.cos(angles), long), (y - 0.2, np.sin(angles), 2.0)):
        with np.errstate(divide="ignore"):
            ways += [(sign * half - place) / part for sign in (-1.0, 1.0)]
    ranges = np.min([np.where(way > 0.0, way, np.inf) for way in ways], axis=0)
    return (ranges + random.normal(0.0, 0.01, BEAMS)).astype(np.float32)


def drive(robot: Robot, stop_after: int = len(PATTERN), reason: str = "") -> Motion:
    """Return the pattern as a robot drives it, from odometry at 30 Hz and scans at 5 Hz."""
    heard, parts, random = Recording(), [], np.random.default_rng(0)
    now, state, moved, count = 0.0, np.zeros(3), np.zeros(3), 0
    commands = [(-1.0, 0.0, 0.0)]
    for phase in PATTERN[:stop_after]:
        begin = now
        going = phase.silent and not robot.times_out
        stuck = phase.name == "rest" and not robot.obeys_zero
        if not (going or stuck):
            commands.append((begin, phase.v, phase.omega))
        while now < begin + phase.seconds - 1e-9:
            v, omega = next(command[1:] for command in reversed(commands) if command[0] <= now - robot.delay)
            v, omega = robot.speed * v, robot.turn * omega
            state += STEP * np.array((v * math.cos(state[2]), v * math.sin(state[2]), omega))
            twist = (robot.odometry_speed * v, robot.odometry_turn * omega)
            heading = moved[2]
            moved += STEP * np.array((twist[0] * math.cos(heading), twist[0] * math.sin(heading), twist[1]))
            now, count = now + STEP, count + 1
            times = Times(now, 0.01, 100.0 + now)
            pose = (float(robot.pose * moved[0]), float(robot.pose * moved[1]), float(moved[2]))
            heard.odometry.append(OdometrySample(times, "odom", "base_footprint", pose, twist))
            if count % 6 == 0:
                geometry = ScanGeometry(BEAMS, 0.0, 2.0 * math.pi / BEAMS, 0.12, 3.5)
                heard.scans.append(ScanSample(times, "base_scan", room(robot, *state, random), geometry))
        parts.append(Part(phase, begin, now))
    if reason:
        parts[-1] = replace(parts[-1], stopped=reason)
    return Motion(heard, parts)


def findings(robot: Robot, limits: Limits = LIMITS, on_the_floor: bool = True) -> dict[str, Finding]:
    return {each.check: each for each in inspect_moving(drive(robot), limits, on_the_floor)}


def test_a_healthy_robot_may_go() -> None:
    found = findings(Robot())
    assert {each.level for each in found.values()} == {Level.OK}, as_text(list(found.values()))
    assert len(found) == 9


def test_with_the_wheels_in_the_air_no_scan_is_held_to_the_drive() -> None:
    found = findings(Robot(mirrored=True), on_the_floor=False)
    assert may_go(list(found.values()))
    assert "turn by scan" not in found


@pytest.mark.parametrize(
    ("robot", "check", "words"),
    [
        (Robot(odometry_turn=-1.0), "turn rate by odometry", "-1.00 times commands: wrong sign"),
        (Robot(odometry_turn=1.4), "turn rate by odometry", "1.40 times commands"),
        (Robot(odometry_turn=1.4), "turn by scan", "0.7"),
        (Robot(speed=-1.0), "speed by odometry", "wrong sign"),
        (Robot(odometry_speed=1.5), "speed by odometry", "1.50 times commands: at most 20 % apart"),
        (Robot(speed=0.0), "speed by odometry", "nothing moves"),
        (Robot(pose=0.0), "way by odometry", "nothing moves"),
        (Robot(pose=-1.0), "way by odometry", "wrong sign"),
        (Robot(delay=0.7), "delay", "after 0.7"),
        (Robot(obeys_zero=False), "stands after zero", "m/s"),
        (Robot(times_out=False), "stands without commands", "the robot goes on: 0.50 rad/s"),
        (Robot(mirrored=True), "turn by scan", "the scan turns the wrong way"),
        (Robot(lidar_yaw=0.5 * math.pi), "way by scan", "turned by 1.57 rad, not 0.00"),
        (Robot(lidar_yaw=math.pi), "way by scan", "turned by 3.14 rad"),
        (Robot(lidar_yaw=-0.6), "way by scan", "turned by -0.6"),
    ],
)
def test_a_fault_is_a_no_go(robot: Robot, check: str, words: str) -> None:
    finding = findings(robot)[check]
    assert finding.level is Level.NO_GO, finding
    assert words in finding.text.replace("-3.14", "3.14")
    assert finding.advice


def test_a_lidar_that_the_controllers_are_told_of_may_be_turned() -> None:
    found = findings(Robot(lidar_yaw=0.5 * math.pi), Limits(lidar_x=0.0, lidar_yaw=0.5 * math.pi))
    assert may_go(list(found.values())), as_text(list(found.values()))


def test_between_two_long_walls_the_scans_accuse_nobody() -> None:
    found = findings(Robot(long_room=True))
    assert may_go(list(found.values())), as_text(list(found.values()))


def test_a_drive_that_was_cut_off_is_a_no_go_and_breaks_no_check() -> None:
    for count in range(1, len(PATTERN)):
        motion = drive(Robot(), count, "obstacle 0.2 m ahead")
        found = {each.check: each for each in inspect_moving(motion, LIMITS, on_the_floor=True)}
        assert found["drive"].level is Level.NO_GO
        assert "obstacle 0.2 m ahead" in found["drive"].text


def test_a_drive_without_odometry_and_scans_breaks_no_check() -> None:
    motion = drive(Robot())
    motion.heard.odometry.clear()
    motion.heard.scans.clear()
    assert not may_go(inspect_moving(motion, LIMITS, on_the_floor=True))


def test_the_pattern_ends_with_a_zero_and_stays_within_a_metre() -> None:
    assert (PATTERN[-1].v, PATTERN[-1].omega, PATTERN[-1].silent) == (0.0, 0.0, False)
    assert abs(sum(phase.v * phase.seconds for phase in PATTERN)) < 1e-9
    assert max(abs(phase.v) * phase.seconds for phase in PATTERN) < 0.2
    assert sum(phase.seconds for phase in PATTERN) < 20.0


def test_only_with_the_wheels_in_the_air_obstacles_do_not_stop_it() -> None:
    assert "robot_radius:=0.0" in tuple(mover_parameters(True, False, LIMITS))
    on_the_floor = tuple(mover_parameters(False, True, LIMITS))
    assert "enable_stamped_cmd_vel:=false" in on_the_floor
    assert not any(each.startswith(("robot_radius", "frozen")) for each in on_the_floor)


def test_the_least_mismatch_is_at_the_true_turn_and_shift() -> None:
    before = np.random.default_rng(1).uniform(-2.0, 2.0, (200, 2))
    angle, shift = 0.4, np.array((0.1, -0.05))
    rotation = np.array(((math.cos(angle), -math.sin(angle)), (math.sin(angle), math.cos(angle))))
    turns = np.array((-0.4, 0.0, 0.4))
    assert turn_mismatches(before, before @ rotation, turns).argmin() == 2
    shifts = np.array(((0.1, 0.05), (0.1, -0.05), (0.0, 0.0)))
    mismatch = shift_mismatches(before, before - shift, shifts)
    assert mismatch.argmin() == 1
    assert mismatch[1] == pytest.approx(0.0, abs=1e-12)
