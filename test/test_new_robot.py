"""A robot that the suite has never heard of, by one file: simulated, filtered, navigated, through pre-flight."""

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml
from commands import check_refused, command
from ctrl_rl_navigation.cli import DriveSimulation, Errors, task_content
from ctrl_rl_navigation.driving import Goal, NavigatorState

from ctrl_rl_core import (
    NavigationTask,
    OccupancyMap,
    RobotError,
    Sectors,
    TaskError,
    find_robot,
    load_navigation_task,
    task_digest,
)
from ctrl_rl_safety import Reading, SafetyError, SafetyFilter, find_model
from sim_bridge import ENGINES, PlanarFleet, SimulatedWorld, SimulationOptions

COURIER = """
name: courier
source: this test
radius: 0.20 m
speed: 0.5 m/s
reverse_speed: 0.3 m/s
turn_rate: 2.0 rad/s
acceleration: 1.0 m/s^2
braking: 1.0 m/s^2
turn_acceleration: 4.0 rad/s^2
lag: 0.05 s
delay: 0.05 s
disturbance: 0.02 m/s
range_error: 0.03 m
planning: {turn_rate: 1.5 rad/s, braking: 0.7 m/s^2}
mass: 6.0 kg
wheels: {radius: 0.05 m, separation: 0.30 m, torque: 3.0 N m, lag: 0.05 s}
lidar: {x: 0.06 m, z: 0.25 m, yaw: 90.0 deg, beams: 360, field: -180.0 .. 180.0 deg, range: 0.1 .. 8.0 m, rate: 10.0 Hz}
"""
ROOM = """
name: courier_room
kind: navigation
about: A courier in a room of 6 m x 4 m.
source: this test
system: {model: dubins_car, controls: {v: 0.5 m/s, omega: -2.0 .. 2.0 rad/s}}
robot: {body: courier.yaml}
arena: {x: -3.0 .. 3.0 m, y: -2.0 .. 2.0 m, wall_thickness: 0.2 m}
start: {x: 0.0 m, y: 0.0 m, theta: 0.0 rad}
goal: {x: 2.9 .. 3.0 m}
episode: {steps: 1000, time_step: 0.1 s}
rewards: {goal: 1, collision: -1}
"""


@pytest.fixture
def courier(tmp_path: Path) -> Path:
    file = tmp_path / "courier.yaml"
    file.write_text(COURIER)
    return file


@pytest.fixture
def room(courier: Path) -> NavigationTask:
    file = courier.with_name("courier_room.yaml")
    file.write_text(ROOM)
    return load_navigation_task(file)


def test_a_task_takes_limits_and_lidar_of_the_robot_it_names(room: NavigationTask, tmp_path: Path) -> None:
    assert room.robot.commands == {"v": (-0.3, 0.5), "omega": (-2.0, 2.0)}
    assert (room.robot.radius, room.lidar.beams) == (0.2, 360)
    other = tmp_path / "elsewhere"
    other.mkdir()
    for name, text in (("courier.yaml", COURIER), ("courier_room.yaml", ROOM)):
        (other / name).write_text(text)
    assert task_digest(load_navigation_task(other / "courier_room.yaml")) == task_digest(room)
    (other / "courier.yaml").write_text(COURIER.replace("radius: 0.20", "radius: 0.21"))
    assert task_digest(load_navigation_task(other / "courier_room.yaml")) != task_digest(room)


@pytest.mark.parametrize("engine", ENGINES)
def test_it_drives_turns_and_sees_in_every_engine(room: NavigationTask, engine: str) -> None:
    world = SimulatedWorld(room, seed=1, options=SimulationOptions(engine=engine, scan_noise=0.0, scan_dropout=0.0))
    rate = world.options.rate
    try:
        seen = world.sensors()
        around = Sectors((0.0, 0.5 * math.pi, math.pi, -0.5 * math.pi), 0.02, 10.0).distances(seen.ranges, seen.scan)
        assert around == pytest.approx([2.94, 2.0, 3.06, 2.0], abs=0.02), "its zero bearing points to the left"
        world.command(0, (0.3, 0.0))
        world.step(2 * rate)
        assert world.pose()[0] == pytest.approx(0.3 * 2.0, abs=0.04)
        world.command(0, (9.0, 0.0))
        world.step(rate)
        assert world.velocity()[0] == pytest.approx(0.5, abs=0.02), "its own limit"
        world.command(0, (0.0, 1.0))
        world.step(2 * rate)
        assert world.pose()[2] == pytest.approx(2.0, abs=0.2)
    finally:
        world.close()


def test_a_fleet_of_it_moves_and_sees_the_same(room: NavigationTask) -> None:
    fleet = PlanarFleet(room, 3)
    for robot in range(3):
        fleet.begin(robot, robot)
    ahead = fleet.observations()[:, -360:][:, 90]
    assert ahead == pytest.approx([2.94] * 3, abs=0.02), "beam 90 looks ahead, as its zero bearing points to the left"
    for _ in range(10):
        fleet.step(np.tile((1.0, 0.0), (3, 1)))
    assert fleet.states()[:, 0] == pytest.approx([0.5] * 3, abs=0.1)


@pytest.mark.parametrize("engine", ENGINES)
def test_behind_the_filter_it_stops_before_the_wall(room: NavigationTask, courier: Path, engine: str) -> None:
    safety = SafetyFilter(find_model(str(courier)))
    world = SimulatedWorld(room, seed=1, options=SimulationOptions(engine=engine))
    tick, fastest = world.options.rate // 20, 0.0
    try:
        for number in range(300):
            pose, (forward, _, turn) = world.odometry().pose, world.odometry().velocity
            if number % 2 == 0:
                sensors = world.sensors()
                near = np.flatnonzero(np.isfinite(sensors.ranges))
                bearings = sensors.scan.angle_min + sensors.scan.angle_increment * near
                ranges = sensors.ranges[near]
                points = np.column_stack((0.06 + ranges * np.cos(bearings), ranges * np.sin(bearings)))
                safety.see(world.elapsed, pose, points)
            verdict = safety.decide(world.elapsed, Reading(pose, forward, turn), np.array((0.5, 0.0)))
            safety.sent(world.elapsed, verdict.command)
            world.command(0, verdict.command)
            world.step(tick)
            fastest = max(fastest, float(world.velocity()[0]))
            assert world.clearance() > 0.0
        assert fastest > 0.4
        assert world.pose()[0] > 2.0, "it came near the wall before it stopped"
    finally:
        world.close()


def test_the_navigator_drives_it_to_a_goal(courier: Path, tmp_path: Path) -> None:
    cells = np.zeros((80, 120), np.int8)
    cells[[0, -1]], cells[:, [0, -1]] = 100, 100
    cells[:50, 58:62] = 100
    OccupancyMap(cells, 0.05, (-3.0, -2.0, 0.0)).save(tmp_path / "map.yaml")
    simulation = DriveSimulation(tmp_path / "map.yaml", (-2.0, -1.0, 0.0), 1, Errors(), robot=str(courier))
    try:
        drive = simulation.drive(Goal((2.0, -1.0)), 90.0)
    finally:
        simulation.close()
    assert (drive.state, drive.collided) == (NavigatorState.REACHED, False)
    assert simulation.limits.radius == 0.2


def test_its_nodes_pass_the_preflight(run_node: Callable, courier: Path, tmp_path: Path) -> None:
    cells = np.zeros((80, 120), np.int8)
    cells[[0, -1]], cells[:, [0, -1]] = 100, 100
    OccupancyMap(cells, 0.05, (-3.0, -2.0, 0.0)).save(tmp_path / "map.yaml")
    task = tmp_path / "drive_on_a_map.yaml"
    task.write_text(yaml.safe_dump(task_content(tmp_path / "map.yaml", (0.0, 0.0, 0.0), str(courier))))
    run_node("sim_bridge", "bridge", f"task:={task}", "scan_noise:=0.01")
    patient = ("--largest-gap", "5", "--largest-age", "5", "--largest-lead", "5")
    options = ("--seconds", "2", "--wait", "60", "--robot", courier, *patient, "--scan-rate", "0.5", "--odom-rate", "1")
    answer = command("preflight", *options, "--output", tmp_path / "run")
    assert "NO-GO" not in answer.stdout, answer.stdout
    assert answer.returncode == 0, answer.stderr
    other = command("preflight", *options[:-4], "--robot", "turtlebot3_burger", "--output", tmp_path / "other")
    assert "lidar mounting" in other.stdout
    assert other.returncode == 1, "the lidar sits elsewhere on a burger"


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("radius: 0.20 m", "radius: 0.20", "radius: '0.2' has no unit|radius: 0.2"),
        ("radius: 0.20 m", "radius: -0.2 m", "radius: "),
        ("radius: 0.20 m", "", "radius"),
        ("speed: 0.5 m/s\nrev", "rev", "lacks 'speed': a robot on wheels needs speed"),
        ("turn_rate: 1.5", "turn_rate: 2.5", "planning.turn_rate: 2.5 is more than the robot's own 2"),
        ("mass: 6.0 kg", "", "wheels: without a URDF the simulator needs the robot's mass"),
        ("separation: 0.30", "separation: 0.50", "wheels: are farther apart than the robot is wide"),
        ("x: 0.06 m, ", "x: 5.0 m, ", "lidar.x: "),
        ("name: courier", "name: courier\nwings: 2", "wings: "),
        ("name: courier", "name: [", "is not valid YAML"),
    ],
)
def test_a_wrong_file_is_one_line_that_names_file_and_key(
    courier: Path, room: NavigationTask, old: str, new: str, words: str
) -> None:
    assert old in COURIER
    assert room.robot.robot is not None
    courier.write_text(COURIER.replace(old, new, 1))
    for read, error in (
        (lambda: find_robot(courier), RobotError),
        (lambda: find_model(str(courier)), SafetyError),
        (lambda: load_navigation_task(courier.with_name("courier_room.yaml")), TaskError),
    ):
        with pytest.raises(error, match=words) as caught:
            read()
        assert "\n" not in str(caught.value)
        assert "courier" in str(caught.value)


def test_an_unknown_robot_is_refused_by_name(tmp_path: Path) -> None:
    check_refused("no robot 'nobody': there are jackal", "preflight", "--robot", "nobody", "--output", tmp_path)


def test_an_installed_package_offers_a_robot_by_name(
    courier: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    package = tmp_path / "installed"
    offer = package / "couriers-1.0.dist-info"
    offer.mkdir(parents=True)
    (package / "couriers.py").write_text(
        f"from ctrl_rl_core import Robot\nCOURIER = Robot.load({str(courier)!r})\nNOT = 7\n"
    )
    (offer / "METADATA").write_text("Metadata-Version: 2.1\nName: couriers\nVersion: 1.0\n")
    (offer / "entry_points.txt").write_text("[ctrl_rl.robots]\ncourier = couriers:COURIER\nnone = couriers:NOT\n")
    monkeypatch.syspath_prepend(package)
    assert find_robot("courier") == find_robot(courier)
    assert find_model("courier").radius == 0.2
    with pytest.raises(RobotError, match=r"robot 'none' \(couriers:NOT\) is no"):
        find_robot("none")
