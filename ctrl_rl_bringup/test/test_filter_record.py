"""The filter in a drive: the chain of its topics, and what a bag tells about it."""

from pathlib import Path

import pytest
from ctrl_rl_bringup.corridor.surroundings import FILTER, GUARD, read_filter
from ctrl_rl_bringup.runner.stack import guards, policy_nodes
from ctrl_rl_core.ros import to_stamp
from rclpy.serialization import serialize_message

from ctrl_rl_bags import BagWriter, Topic, message_definition
from ctrl_rl_bringup import DriveConfig
from ctrl_rl_core import load_navigation_task
from ctrl_rl_msgs.msg import FlightStatus, SafetyStatus

KIND = "ctrl_rl_msgs/msg/SafetyStatus"
PASSED, CORRECTED = SafetyStatus.PASSED, SafetyStatus.CORRECTED


def test_the_filter_stands_between_driver_and_watchdog(tmp_path: Path) -> None:
    task = load_navigation_task("corridor_head_on")
    safety, watchdog = guards(DriveConfig(tmp_path, safety_filter=True), task)
    assert safety.remappings["cmd_vel"] == watchdog.remappings["cmd_vel_raw"] == "cmd_vel_safe"
    assert safety.parameters["robot"] == "turtlebot3_burger"
    assert safety.parameters["mover_speed"] == 0.2
    assert safety.parameters["use_map"]
    (alone,) = guards(DriveConfig(tmp_path), task)
    assert alone.remappings == {}


def test_the_guard_stands_between_pilot_and_watchdog(tmp_path: Path) -> None:
    task = load_navigation_task("quad_ttr")
    pilot, guard, watchdog = policy_nodes(DriveConfig(tmp_path, task.name, "quad_ttr", safety_filter=True), task)
    assert pilot.remappings["rotor_thrusts"] == "rotor_thrusts_raw"
    assert guard.remappings["rotor_thrusts"] == watchdog.remappings["rotor_thrusts_raw"] == "rotor_thrusts_safe"
    assert watchdog.parameters["largest_thrust"] == 12.26
    pilot, alone = policy_nodes(DriveConfig(tmp_path, task.name, "quad_ttr"), task)
    assert alone.remappings == {}
    assert alone.parameters["largest_thrust"] == 10.0


def test_a_bag_tells_what_the_guard_changed(tmp_path: Path) -> None:
    kind = "ctrl_rl_msgs/msg/FlightStatus"
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic(Topic(GUARD, kind, message_definition(kind)))
        for index, mode in enumerate((PASSED, CORRECTED, PASSED)):
            message = FlightStatus(mode=mode, raw_t1=7.0, raw_t2=8.0, t1=7.0 + index, t2=8.0, room=0.1 * index)
            message.header.stamp = to_stamp(index * 10**8)
            writer.write(GUARD, serialize_message(message), log_time=index + 1)
    found = read_filter(tmp_path / "bag", 0.0, 1.0, GUARD)
    assert found is not None
    assert found.sent.tolist() == [[7.0, 8.0], [8.0, 8.0], [9.0, 8.0]]
    assert found.as_dict()["corrected"] == 1
    assert "flight guard        3 answers: 66.7 % passed, 33.3 % corrected" in found.text()[0]


def test_a_bag_tells_what_the_filter_changed(tmp_path: Path) -> None:
    rows = [(PASSED, 0.2), (CORRECTED, 0.0), (CORRECTED, 0.0), (CORRECTED, 0.1), (PASSED, 0.2), (PASSED, 0.2)]
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic(Topic(FILTER, KIND, message_definition(KIND)))
        for index, (mode, speed) in enumerate(rows):
            message = SafetyStatus(mode=mode, raw_speed=0.2, speed=speed, margin=0.01 * index)
            message.header.stamp = to_stamp(index * 10**8)
            writer.write(FILTER, serialize_message(message), log_time=index + 1)
    found = read_filter(tmp_path / "bag", 0.0, 0.45)
    assert found is not None
    told = found.as_dict()
    assert (told["commands"], told["passed"], told["corrected"], told["changes"]) == (5, 2, 3, 2)
    assert told["held_s"] == pytest.approx(0.2)
    assert told["speed_taken_off_m_s"] == pytest.approx(0.1)
    assert "60.0 % corrected" in found.text()[0]
    assert read_filter(tmp_path / "bag", 5.0, 6.0) is None
