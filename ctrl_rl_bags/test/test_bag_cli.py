"""The `bag` command: info, recover, and play to a real subscriber."""

import os
import signal
import subprocess
import sys
import time

import pytest
import rclpy
from ctrl_rl_bags.cli import main
from ctrl_rl_bags.recording.qos import publisher_qos, subscription_qos
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message, serialize_message
from rosgraph_msgs.msg import Clock
from std_msgs.msg import String

from ctrl_rl_bags import BagWriter, Topic, message_definition, to_bag_qos

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
BEST_EFFORT = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
DOMAIN = 1 + os.getpid() % 100


def string_topic(name, qos):
    return Topic(name, "std_msgs/msg/String", message_definition("std_msgs/msg/String"), qos=(to_bag_qos(qos),))


def text(value):
    return serialize_message(String(data=value))


@pytest.fixture
def bag(tmp_path):
    """Bag of two seconds: a latched map at the start, 100 numbered ticks, and one topic of a type not installed."""
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic(string_topic("/map", LATCHED))
        writer.add_topic(string_topic("/tick", QoSProfile(depth=10)))
        writer.add_topic(Topic("/odd", "nowhere_msgs/msg/Odd", "bool odd\n"))
        start = 1_000 * 10**9
        writer.write("/map", text("map"), start)
        writer.write("/odd", b"\0\1\0\0\1", start)
        for i in range(100):
            writer.write("/tick", text(str(i)), start + i * 20_000_000)
    return tmp_path / "bag"


class Listener:
    """Node in a separate ROS domain that records messages and their arrival times."""

    def __init__(self, monkeypatch):
        monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        monkeypatch.setenv("ROS_DOMAIN_ID", str(DOMAIN))
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=DOMAIN)
        self.node = Node("listener", context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.heard = {}

    def listen(self, topic, qos=10, kind=String):
        messages = self.heard.setdefault(topic, [])
        self.node.create_subscription(
            kind, topic, lambda data: messages.append((time.monotonic(), data)), qos, raw=True
        )

    def texts(self, topic):
        return [deserialize_message(data, String).data for _, data in self.heard[topic]]

    def spin(self, until, limit=15.0):
        end = time.monotonic() + limit
        while not until() and time.monotonic() < end:
            self.executor.spin_once(timeout_sec=0.02)
        assert until()

    def close(self):
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()


@pytest.fixture
def listener(monkeypatch):
    listener = Listener(monkeypatch)
    yield listener
    listener.close()


def play(bag, *arguments):
    return subprocess.Popen(
        [sys.executable, "-m", "ctrl_rl_bags.cli", "play", bag, *arguments],
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )


def test_plays_the_bytes_in_their_rhythm(bag, listener):
    listener.listen("/tick", 1000)
    listener.listen("/map", LATCHED)
    process = play(bag, "--wait-for-subscribers", "20")
    listener.spin(lambda: len(listener.heard["/tick"]) == 100)
    output, errors = process.communicate(timeout=120)
    assert process.returncode == 0
    assert "101 messages played" in output
    assert errors.count("/odd is not played") == 1
    assert len(errors.strip().splitlines()) == 1
    for i, (_, data) in enumerate(listener.heard["/tick"]):
        # The middleware fills messages up to a multiple of four bytes on the way.
        assert data.ljust(16, b"\0") == text(str(i)).ljust(16, b"\0")
    times = [when for when, _ in listener.heard["/tick"]]
    assert times[-1] - times[0] > 1.5  # as recorded; on a busy machine the first are heard late


def test_latched_topics_are_played_latched(bag, listener):
    listener.listen("/tick", 1000)
    process = play(bag, "--rate", "0.1")
    listener.spin(lambda: len(listener.heard["/tick"]) > 5)
    listener.listen("/map", LATCHED)  # long after the map was played
    listener.spin(lambda: listener.heard["/map"])
    assert listener.texts("/map") == ["map"]
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=120)
    assert process.returncode == 0
    assert "Traceback" not in errors


def test_rate_remap_topics_offset_and_clock(bag, listener):
    listener.listen("/tock", 1000)
    listener.listen("/map", LATCHED)
    listener.listen("/clock", 1000, Clock)
    arguments = (
        "--topics",
        "/map",
        "/tick",
        "--remap",
        "/tick:=/tock",
        "--rate",
        "4",
        "--start-offset",
        "1",
        "--clock",
        "--wait-for-subscribers",
        "20",
    )
    process = play(bag, *arguments)
    listener.spin(lambda: len(listener.heard["/tock"]) == 50)
    assert listener.texts("/tock") == [str(i) for i in range(50, 100)]
    clocks = [deserialize_message(data, Clock).clock for _, data in listener.heard["/clock"]]
    seconds = [clock.sec + 1e-9 * clock.nanosec for clock in clocks]
    assert seconds == sorted(seconds)
    assert 1001.0 <= seconds[0] < 1002.0
    output, errors = process.communicate(timeout=120)
    assert "51 messages played" in output  # with the map, which was latched before the start
    assert errors == ""


def test_loops_until_stopped(bag, listener):
    listener.listen("/tick", 1000)
    process = play(bag, "--topics", "/tick", "--rate", "20", "--loop", "--wait-for-subscribers", "20")
    listener.spin(lambda: len(listener.heard["/tick"]) > 250)
    process.send_signal(signal.SIGTERM)
    output, _ = process.communicate(timeout=120)
    assert process.returncode == 0
    assert "messages played" in output
    assert listener.texts("/tick")[:250] == [str(i % 100) for i in range(250)]


def test_info(bag, capsys):
    assert main(["info", str(bag)]) == 0
    output = capsys.readouterr().out
    assert "messages  102" in output
    assert "duration  1.980 s" in output
    assert "std_msgs/msg/String  (reliable, transient_local)" in output


def test_recover(bag, capsys):
    assert main(["recover", str(bag)]) == 0
    assert "is complete" in capsys.readouterr().out
    (bag / "metadata.yaml").unlink()
    file = bag / "bag_0.mcap"
    file.write_bytes(file.read_bytes()[:-100])
    assert main(["info", str(bag)]) == 1
    assert "bag recover" in capsys.readouterr().err
    assert main(["recover", str(bag), "-o", str(bag.parent / "mended")]) == 0
    output = capsys.readouterr().out
    assert "102 messages" in output
    assert "cut off: bag_0.mcap" in output
    assert main(["info", str(bag.parent / "mended")]) == 0


def test_a_reader_that_has_seen_enough_is_no_error(bag):
    command = f"set -o pipefail; {sys.executable} -m ctrl_rl_bags.cli info {bag} | true"
    answer = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=False)
    assert (answer.returncode, answer.stderr) == (0, "")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["info", "/nowhere"], "there is no such bag"),
        (["play", "BAG", "--rate", "0"], "--rate must be positive"),
        (["play", "BAG", "--topics", "/tack"], "no topic /tack"),
        (["play", "BAG", "--start-offset", "9"], "--start-offset must be"),
        (["recover", "/nowhere"], "there is no such bag"),
    ],
)
def test_refusals(bag, capsys, arguments, words):
    assert main([str(bag) if argument == "BAG" else argument for argument in arguments]) == 1
    assert words in capsys.readouterr().err


def test_a_wrong_remap_is_wrong_usage(bag, capsys):
    with pytest.raises(SystemExit) as exit_:
        main(["play", str(bag), "--remap", "tick=tock"])
    assert exit_.value.code == 2
    assert "--remap 'tick=tock' must be OLD:=NEW" in capsys.readouterr().err


class TestQos:
    def test_request_matches_every_offer(self):
        both = subscription_qos([LATCHED, LATCHED], 7)
        assert (both.reliability, both.durability, both.depth) == (
            ReliabilityPolicy.RELIABLE,
            DurabilityPolicy.TRANSIENT_LOCAL,
            7,
        )
        mixed = subscription_qos([LATCHED, BEST_EFFORT], 7)
        assert (mixed.reliability, mixed.durability) == (ReliabilityPolicy.BEST_EFFORT, DurabilityPolicy.VOLATILE)

    def test_offer_matches_every_request_that_was_matched(self):
        mixed = publisher_qos([to_bag_qos(LATCHED), to_bag_qos(BEST_EFFORT)], 7)
        assert (mixed.reliability, mixed.durability) == (ReliabilityPolicy.RELIABLE, DurabilityPolicy.TRANSIENT_LOCAL)
        assert publisher_qos([to_bag_qos(BEST_EFFORT)], 7).reliability == ReliabilityPolicy.BEST_EFFORT
        assert publisher_qos([], 7).reliability == ReliabilityPolicy.RELIABLE


@pytest.mark.fault
def test_a_topic_whose_name_is_none_is_not_played(tmp_path):
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic(string_topic("/bad name\n", LATCHED))
        writer.write("/bad name\n", text("hi"), 1)
    process = play(tmp_path / "bag")
    _, errors = process.communicate(timeout=120)
    assert process.returncode == 1
    first, second = errors.strip().splitlines()
    assert first.startswith("bag play: /bad name\\n is not played: Invalid topic name")
    assert second.endswith("there is nothing to play")


@pytest.mark.fault
def test_a_bag_whose_first_messages_have_time_zero_is_played_at_once(tmp_path, capsys):
    with BagWriter(tmp_path / "bag") as bag:
        bag.add_topic(Topic("/talk", "std_msgs/msg/String", message_definition("std_msgs/msg/String")))
        for k in range(10):
            bag.write("/talk", serialize_message(String(data=str(k))), 0 if k < 5 else 1_750_000_000 * 10**9 + k)
    assert main(["play", str(tmp_path / "bag"), "--wait-for-subscribers", "0"]) == 0
    said = capsys.readouterr()
    assert "10 messages played" in said.out
    assert "s without messages are skipped" in said.err
