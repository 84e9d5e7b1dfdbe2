"""The recorder as a process with real publishers: stopped, rejected and killed."""

import json
import os
import shutil
import signal
import time

from recording import record, stop

from ctrl_rl_bags import bag_info, read_messages, recover
from ctrl_rl_core import load_task, task_digest, task_file

# Sends scans numbered in their frame, at a rate, and one latched text before them.
PUBLISHER = """
import sys, time
from array import array
import rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import LaserScan
from std_msgs.msg import String

name, rate, count, reliability = sys.argv[1], float(sys.argv[2]), int(sys.argv[3]), sys.argv[4]
rclpy.init()
node = rclpy.create_node(name)
latch = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
latched = node.create_publisher(String, name + "/note", latch)
latched.publish(String(data="note of " + name))
print("noted", flush=True)
scans = node.create_publisher(LaserScan, "scan", QoSProfile(depth=1000, reliability=ReliabilityPolicy[reliability]))
while scans.get_subscription_count() == 0:
    time.sleep(0.01)
time.sleep(0.3)
message = LaserScan(ranges=array("f", [1.5] * 360), intensities=array("f", [0.0] * 360))
def hear(_message):
    print("diagnosed", flush=True)
    node.destroy_subscription(diagnostics)
diagnostics = node.create_subscription(DiagnosticArray, "/diagnostics", hear, 10)
begin = time.monotonic()
for i in range(count):
    if i == 500:
        print("many", flush=True)
    message.header.frame_id = f"{name} {i}"
    scans.publish(message)
    time.sleep(max(0.0, begin + (i + 1) / rate - time.monotonic()))
scans.wait_for_all_acked()
print("sent", flush=True)
while True:
    rclpy.spin_once(node, timeout_sec=0.1)
"""


def publish(start, name="sender", rate=300, count=300, reliability="RELIABLE"):
    """Start a publisher and wait until it has sent its message."""
    process = start("-c", PUBLISHER, name, rate, count, reliability)
    assert process.stdout.readline() == "noted\n"
    return process


def wait_for(file, *words):
    """Wait until a file contains the given text."""
    end = time.monotonic() + 120.0
    while not all(word in file.read_bytes() for word in words):
        assert time.monotonic() < end, words
        time.sleep(0.05)


def numbers(bag, name="sender"):
    frames = [message.data.header.frame_id.split() for message in read_messages(bag, ["/scan"])]
    return [int(number) for sender, number in frames if sender == name]


def test_records_everything_and_stops_in_good_order(start, tmp_path):
    shutil.copy(task_file("car_ttr"), tmp_path / "car_ttr.yaml")
    publisher = publish(start)  # the note is published before anyone listens
    recorder = record(
        start, tmp_path / "bag", f"digest_files:=['task={tmp_path}/car_ttr.yaml']", "exclude:=['/rosou.']"
    )
    assert publisher.stdout.readline() == "sent\n"
    assert publisher.stdout.readline() == "diagnosed\n"
    wait_for(tmp_path / "bag" / "bag_0.mcap", b"parameters./sender", b"parameters./recorder")
    code, _, errors = stop(recorder, signal.SIGTERM)
    assert (code, "Traceback" in errors) == (0, False)
    assert "0 lost" in errors
    assert numbers(tmp_path / "bag") == list(range(300))
    info = bag_info(tmp_path / "bag")
    assert info.topics["/sender/note"].qos[0]["durability"] == "transient_local"
    assert info.topics["/sender/note"].message_count == 1
    assert info.topics["/scan"].qos[0]["reliability"] == "reliable"
    assert info.topics["/scan"].type_hash.startswith("RIHS01_")
    assert info.topics["/diagnostics"].message_count >= 1
    assert "/parameter_events" in info.topics
    assert "/rosout" not in info.topics
    assert info.custom_data["digest.task"] == task_digest(load_task("car_ttr"))
    assert json.loads(info.custom_data["parameters./sender"])["use_sim_time"] is False
    assert json.loads(info.custom_data["parameters./recorder"])["queue_depth"] == 2000
    status = next(read_messages(tmp_path / "bag", ["/diagnostics"])).data.status[0]
    assert {"messages", "lost", "bytes", "topics", "file"} <= {pair.key for pair in status.values}


def test_a_killed_recorder_loses_less_than_its_last_second(start, tmp_path):
    recorder = record(start, tmp_path / "bag")
    assert publish(start, rate=400, count=100_000).stdout.readline() == "many\n"
    killed_at = time.time_ns()
    recorder.kill()
    recorder.wait()
    found = recover(tmp_path / "bag")
    got = numbers(found.folder)
    assert len(got) > 200
    assert got == list(range(len(got)))
    last = max(message.log_time for message in read_messages(found.folder, ["/scan"]))
    assert killed_at - 1_000_000_000 < last <= killed_at
    assert bag_info(found.folder).topics["/sender/note"].qos[0]["durability"] == "transient_local"


def test_asks_for_less_when_a_best_effort_publisher_joins(start, tmp_path):
    first = publish(start, "first", 100, 100)
    recorder = record(start, tmp_path / "bag", "topics:=[scan]")
    assert first.stdout.readline() == "sent\n"
    second = start("-c", PUBLISHER.replace("time.sleep(0.3)", "time.sleep(1.0)"), "second", 100, 100, "BEST_EFFORT")
    assert second.stdout.readline() == "noted\n"
    # The second publisher waits for a subscription that fits it: it gets one from the recorder only.
    assert second.stdout.readline() == "sent\n"
    assert stop(recorder)[0] == 0
    assert numbers(tmp_path / "bag", "first") == list(range(100))
    assert len(numbers(tmp_path / "bag", "second")) > 90
    assert list(bag_info(tmp_path / "bag").topics) == ["/scan"]


REFUSALS = (
    ("queue_depth:=0", 2, "queue_depth"),
    ("exclude:=['(']", 2, "no regular expression"),
    ("digest_files:=['task=/nowhere/task.yaml']", 2, "cannot be read"),
    ("digest_files:=['task={folder}/pipe']", 2, "is no regular file"),
    ("digest_files:=['task']", 2, "NAME=PATH"),
    ("output:=.", 1, "exists"),
)


def test_refusals_are_one_line(in_turn, tmp_path):
    os.mkfifo(tmp_path / "pipe")  # nobody writes into it: to open it plainly would wait forever
    given = [parameter.replace("{folder}", str(tmp_path)) for parameter, _, _ in REFUSALS]
    cases = [["--ros-args", "-p", f"output:={tmp_path}/bag", "-p", parameter] for parameter in given]
    ends = in_turn("ctrl_rl_bags.recording.recorder_node", cases)
    for (code, errors, _), (_, expected, words) in zip(ends, REFUSALS, strict=True):
        assert (code, words in errors) == (expected, True), errors
        assert len(errors.strip().splitlines()) == 1
    assert not (tmp_path / "bag").exists()


def test_stops_with_a_whole_bag_when_the_disk_fills(start, tmp_path):
    recorder = record(start, tmp_path / "bag", "min_free_mb:=1000000")
    _, errors = recorder.communicate(timeout=120)
    assert recorder.returncode == 1
    assert "left on the disk" in errors
    assert "Traceback" not in errors
    assert bag_info(tmp_path / "bag").topics
