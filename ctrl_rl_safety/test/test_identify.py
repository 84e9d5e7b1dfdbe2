"""The command that identifies a robot: on a bag of a simulated one with known constants, and rejected input."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from ctrl_rl_bags.datasets import MessageMaker, ScanLayout
from ctrl_rl_safety.cli.identify import main
from numpy.typing import NDArray

from ctrl_rl_bags import BagWriter
from ctrl_rl_core import load_navigation_task, make_odometry
from ctrl_rl_safety import RobotModel, find_model

pytest.importorskip("sim_bridge")
from ctrl_rl_safety.identification.drive import STEP, Drive
from ctrl_rl_safety.identification.fit import fit_drives
from ctrl_rl_safety.trials.episodes import CAR
from ctrl_rl_safety.trials.robot import MOTOR_LAG, TICK, Base
from ctrl_rl_safety.trials.sources import Random
from ctrl_rl_safety.trials.worlds import room

from sim_bridge import OdometryReading, SimulatedWorld, SimulationOptions

KNOWN = RobotModel("known", 0.177, 0.6, 0.3, 1.5, 0.8, 1.2, 2.5, 0.05, 0.15)
PERIOD = 0.05
KINDS = {
    "/cmd_vel": "geometry_msgs/msg/Twist",
    "/odom": "nav_msgs/msg/Odometry",
    "/scan": "sensor_msgs/msg/LaserScan",
}
LAYOUT = ScanLayout(beams=90, angle_min=0.0, angle_increment=0.0698, range_min=0.1, range_max=5.0)


class Recording:
    """Bag of commands, odometry and scans."""

    def __init__(self, folder: Path, topics: tuple[str, ...] = tuple(KINDS)) -> None:
        self.writer, self._make = BagWriter(folder), MessageMaker()
        for name in topics:
            self.writer.add_topic(self._make.topic(name, KINDS[name]))

    def command(self, time: float, v: float, omega: float) -> None:
        stamp = round(1e9 * time)
        self.writer.write("/cmd_vel", self._make.command(stamp, (v, omega), KINDS["/cmd_vel"]), 10**12 + stamp)

    def scan(self, time: float, lost: NDArray[np.bool_]) -> None:
        stamp, ranges = round(1e9 * time), np.where(lost, np.inf, 2.0).astype(np.float32)
        self.writer.write("/scan", self._make.scan(stamp, ranges, LAYOUT), 10**12 + stamp)

    def odometry(self, time: float, reading: OdometryReading) -> None:
        stamp, numbers = round(1e9 * time), make_odometry(reading.pose, reading.velocity)
        self.writer.write("/odom", self._make.odometry(stamp, numbers), 10**12 + stamp)


def record(
    folder: Path, model: RobotModel, commands: list[tuple[float, float]], hold: float = 1.5, lost: float = 0.0
) -> Path:
    """Drive a simulated robot with commands, each for a duration [s], and record it with a share of beams lost."""
    random = np.random.default_rng(0)
    world = SimulatedWorld(
        room("boxes", "turtlebot2", dataclasses.replace(model, speed=1.0), 0),
        options=SimulationOptions(engine="planar", rate=200, motor_lag=MOTOR_LAG),
    )
    base, recording = Base(model, 1.0 / 200), Recording(folder)
    with recording.writer:
        for v, omega in commands:
            for _ in range(round(hold / PERIOD)):
                now = world.elapsed
                recording.odometry(now, world.odometry())
                recording.command(now, v, omega)
                recording.scan(now, random.random(LAYOUT.beams) < lost)
                base.send(now, np.array((v, omega)))
                for _ in range(round(PERIOD * 200)):
                    world.command(0, base.advance(world.elapsed))
                    world.step()
    world.close()
    return folder


DRIVE = [(0.6, 0.0), (0.0, 0.0), (-0.3, 0.0), (0.6, 1.5), (0.6, -1.5), (0.0, 0.0), (0.3, 1.5), (0.0, -1.5), (0.6, 0.0)]


@pytest.mark.parametrize("track", [0.0, 0.4])
def test_constants_that_are_known_are_found_within_a_tenth(
    track: float, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    known = dataclasses.replace(KNOWN, track=track)
    bag, file = record(tmp_path / "drive", known, [*DRIVE, (0.0, 0.0)], lost=0.2), tmp_path / "mine.yaml"
    assert main([str(bag), "--radius", "0.177", "--track", str(track), "--output", str(file)]) == 0
    found = find_model(str(file))
    for name in ("speed", "reverse_speed", "turn_rate", "acceleration", "braking", "turn_acceleration", "delay"):
        assert getattr(found, name) == pytest.approx(getattr(KNOWN, name), rel=0.1), name
    assert found.disturbance < 0.02
    assert found.missing_rate == pytest.approx(0.2, abs=0.03)
    out = capsys.readouterr().out
    assert "of the variance" in out
    assert "beams missed the surface that they hit" in out


@pytest.mark.parametrize(
    ("commands", "reason"),
    [
        ([(0.0, 0.0)] * 2, "the robot never drove at 0.05 m/s"),
        ([(0.5, 0.0), (0.0, 0.0)], "the robot never turned at 0.1 rad/s"),
        ([(0.5, 0.0), (0.5, 1.5), (0.5, -1.5)], "the drive shows no stop"),
    ],
)
def test_a_drive_that_shows_too_little_is_refused(
    commands: list[tuple[float, float]], reason: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = record(tmp_path / "drive", KNOWN, commands)
    assert main([str(bag), "--radius", "0.177", "--output", str(tmp_path / "a.yaml")]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert reason in line
    assert not (tmp_path / "a.yaml").exists()


def test_missing_topics_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recording = Recording(tmp_path / "bag", ("/cmd_vel",))
    with recording.writer:
        recording.command(0.0, 0.1, 0.0)
    words = [str(tmp_path / "bag"), "--radius", "0.2", "--output", str(tmp_path / "a.yaml")]
    assert main(words) == 1
    assert "no topic named odom of nav_msgs/msg/Odometry: --odometry one of none" in capsys.readouterr().err
    assert main([*words, "--commands", "/twist"]) == 1
    assert "no messages of geometry_msgs/msg/Twist" in capsys.readouterr().err
    assert main([str(tmp_path / "none"), "--radius", "0.2"]) == 1
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_the_cars_own_constants_hold_for_its_wheels() -> None:
    task = load_navigation_task("car_ttr").model_copy(update={"obstacles": ()})
    world = SimulatedWorld(task, 0, options=SimulationOptions(engine="planar", rate=200))
    source, rows = Random(CAR, 3), []
    for _ in range(466):
        command = source.command()
        for _ in range(round(TICK / STEP)):
            world.command(0, command)
            world.step(round(STEP * 200))
            reading = world.odometry()
            rows.append((*command, *reading.pose, reading.velocity[0], reading.velocity[2]))
    world.close()
    told, poses, speeds = np.split(np.array(rows), (2, 5), axis=1)
    poses[:, 2] = np.unwrap(poses[:, 2])
    found = fit_drives([Drive(told, poses, speeds)], CAR.track)
    assert found.disturbance <= CAR.disturbance
    assert found.acceleration == pytest.approx(CAR.acceleration, rel=0.1)
    assert found.braking == pytest.approx(CAR.braking, rel=0.1)
