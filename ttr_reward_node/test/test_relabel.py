"""Adding rewards to a recorded bag."""

import json
from pathlib import Path

import numpy as np
import pytest
from ament_index_python.packages import get_package_share_directory
from nav_msgs.msg import Odometry
from rclpy.serialization import serialize_message
from std_msgs.msg import String

from ctrl_rl_bags import (
    BagError,
    BagWriter,
    Topic,
    bag_info,
    message_definition,
    read_messages,
    read_serialized,
    to_bag_qos,
)
from ctrl_rl_core import RESULT, load_navigation_task
from ttr_reward_node import RewardEvaluator, TimeToReachError, relabel, solve_task

KIND = "nav_msgs/msg/Odometry"


def odometry(k: int) -> bytes:
    message = Odometry()
    message.header.stamp.sec = k
    message.pose.pose.position.x, message.pose.pose.position.y = -0.2, -4.5 + 0.05 * k
    return bytes(serialize_message(message))


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic(Topic("/robot/odom", KIND, message_definition(KIND)))
        writer.add_topic(Topic("/said", "std_msgs/msg/String", message_definition("std_msgs/msg/String")))
        for k in range(100):
            writer.write("/robot/odom", odometry(k), 10**9 + k, 10**9 + k - 1, k + 1)
            if k % 10 == 0:
                writer.write("/said", bytes(serialize_message(String(data=str(k)))), 10**9 + k)
    return tmp_path / "bag"


def test_every_odometry_message_gets_a_reward_and_nothing_else_changes(bag: Path, tmp_path: Path) -> None:
    function = solve_task("car_ttr", counts=(41, 41, 24))
    output = tmp_path / "labelled"
    count = relabel(bag, output, function, RewardEvaluator(load_navigation_task("car_ttr"), function), robot="robot")
    assert count == 100
    kept = [message for message in read_serialized(output) if message.topic in ("/robot/odom", "/said")]
    assert kept == list(read_serialized(bag))
    rewards = [message.data for message in read_messages(output, ["/robot/reward"])]
    states = np.column_stack((np.full(100, -0.2), -4.5 + 0.05 * np.arange(100), np.zeros(100)))
    phi = function.value(states)
    np.testing.assert_array_equal([reward.time_to_reach for reward in rewards], phi)
    running = np.array([reward.outcome.value == 0 for reward in rewards])
    paid = np.array([reward.reward for reward in rewards])
    np.testing.assert_allclose(paid[running], -np.minimum(phi[running], 30.0))
    assert set(paid[~running]) == {-400.0}  # the lower wall and the central cube
    assert [reward.header.stamp.sec for reward in rewards] == list(range(100))
    values = [message.data for message in read_messages(output, ["/robot/time_to_reach"])]
    np.testing.assert_allclose([value.state for value in values], states, atol=1e-12)
    info = bag_info(output)
    assert info.custom_data["digest.time_to_reach"] == function.digest
    # Same as the node's topics, so that a player offers the same QoS and other tools know the type.
    for topic, kind in (("/robot/reward", "TaskReward"), ("/robot/time_to_reach", "StateValue")):
        installed = Path(get_package_share_directory("ctrl_rl_msgs")) / "msg" / f"{kind}.json"
        hashes = {it["type_name"]: it["hash_string"] for it in json.loads(installed.read_text())["type_hashes"]}
        assert info.topics[topic].type_hash == hashes[f"ctrl_rl_msgs/msg/{kind}"]
        assert info.topics[topic].qos == (to_bag_qos(RESULT),)


def test_says_what_is_missing(bag: Path, tmp_path: Path) -> None:
    function = solve_task("car_ttr", counts=(21, 21, 12))
    label = RewardEvaluator(load_navigation_task("car_ttr"), function)
    with pytest.raises(TimeToReachError, match="no topic /odom of type nav_msgs/msg/Odometry; it has /robot/odom"):
        relabel(bag, tmp_path / "labelled", function, label)
    assert not (tmp_path / "labelled").exists()


def test_rewards_that_are_there_are_replaced_only_when_told(bag: Path, tmp_path: Path) -> None:
    task = load_navigation_task("car_ttr")
    old, new = (solve_task("car_ttr", counts=counts) for counts in ((21, 21, 12), (41, 41, 24)))
    first, second, fresh = (tmp_path / name for name in ("first", "second", "fresh"))
    relabel(bag, first, old, RewardEvaluator(task, old), robot="robot")
    with pytest.raises(TimeToReachError, match="already has a topic /robot/reward: add --replace to replace it"):
        relabel(first, second, new, RewardEvaluator(task, new), robot="robot")
    assert not second.exists()
    assert relabel(first, second, new, RewardEvaluator(task, new), robot="robot", replace=True) == 100
    relabel(bag, fresh, new, RewardEvaluator(task, new), robot="robot")
    assert list(read_serialized(second)) == list(read_serialized(fresh))
    assert bag_info(second).custom_data["digest.time_to_reach"] == new.digest


def test_labels_are_in_the_frame_of_the_function(bag: Path, tmp_path: Path) -> None:
    function = solve_task("car_ttr", counts=(21, 21, 12))
    label = RewardEvaluator(load_navigation_task("car_ttr"), function)
    relabel(bag, tmp_path / "labelled", function, label, robot="robot", frame="hall")
    found = read_messages(tmp_path / "labelled", ["/robot/reward", "/robot/time_to_reach"])
    assert {message.data.header.frame_id for message in found} == {"hall"}


@pytest.mark.fault
@pytest.mark.parametrize(
    ("definition", "data", "words"),
    [
        (message_definition(KIND), b"\0\1\0\0\1\2\3", "cannot be decoded"),
        ("int32 pose\n", b"\0\1\0\0\1\0\0\0", "is not what its type says"),
    ],
)
def test_odometry_that_is_none_is_refused(tmp_path: Path, definition: str, data: bytes, words: str) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic(Topic("/odom", KIND, definition))
        writer.write("/odom", data, 1)
    function = solve_task("car_ttr", counts=(21, 21, 12))
    with pytest.raises(BagError, match=words):
        relabel(
            tmp_path / "bag", tmp_path / "new", function, RewardEvaluator(load_navigation_task("car_ttr"), function)
        )
    assert not (tmp_path / "new").exists()


def test_odometry_without_an_orientation_is_refused(tmp_path: Path) -> None:
    function = solve_task("car_ttr", counts=(21, 21, 12))
    message = Odometry()
    message.pose.pose.orientation.w = 0.0
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic(Topic("/odom", KIND, message_definition(KIND)))
        writer.write("/odom", bytes(serialize_message(message)), 10**9)
    evaluator = RewardEvaluator(load_navigation_task("car_ttr"), function)
    with pytest.raises(BagError, match="/odom: odometry with a quaternion of length 0: must be 1"):
        relabel(tmp_path / "bag", tmp_path / "out", function, evaluator)
