"""The recorder under load: high message rates, a slow disk, many files, and topics with changing types."""

import os
import tracemalloc

import pytest
from ctrl_rl_bags.recording.write_queue import BagQueue
from recording import record, stop

from ctrl_rl_bags import BagError, BagWriter, Topic, bag_info, read_messages, read_raw

pytestmark = [pytest.mark.realtime, pytest.mark.fault]
# The file that the recorder writes to takes its time, as a worn card does.
SLOW = """
import io, pathlib, sys, time
class Slow(io.FileIO):
    def write(self, data):
        time.sleep(0.4)
        return super().write(data)
fast = pathlib.Path.open
def open_(self, mode="r", *rest, **more):
    return Slow(self, mode) if self.suffix == ".mcap" and "x" in mode else fast(self, mode, *rest, **more)
pathlib.Path.open = open_
from ctrl_rl_bags.recording.recorder_node import main
sys.exit(main())
"""
LARGE = """
import os, time, rclpy
from rclpy.qos import QoSProfile
from std_msgs.msg import UInt8MultiArray
rclpy.init()
node = rclpy.create_node("camera")
images = node.create_publisher(UInt8MultiArray, "image", QoSProfile(depth=3))
image = UInt8MultiArray(data=os.urandom(4_000_000))
while images.get_subscription_count() == 0:
    time.sleep(0.01)
for i in range(60):
    images.publish(image)
    time.sleep(1 / 30)
print("sent", flush=True)
while True:
    time.sleep(1)
"""
RETYPED = """
import sys, time, rclpy
from diagnostic_msgs.msg import DiagnosticArray
from std_msgs.msg import Int32, String
rclpy.init()
node = rclpy.create_node("talker")
retyped = set()
def hear(message):
    retyped.update(pair.value for status in message.status for pair in status.values if pair.key == "retyped_topics")
node.create_subscription(DiagnosticArray, "/diagnostics", hear, 10)
for kind, message in ((String, String(data="hi")), (Int32, Int32(data=7))):
    publisher = node.create_publisher(kind, "talk", 10)
    while publisher.get_subscription_count() == 0:
        time.sleep(0.01)
    time.sleep(0.3)
    publisher.publish(message)
    publisher.wait_for_all_acked()
    if kind is Int32:
        while not any(retyped):
            rclpy.spin_once(node)
    print("sent", flush=True)
    sys.stdin.readline()
    node.destroy_publisher(publisher)
"""


def string_topic(name):
    return Topic(name, "std_msgs/msg/String", "string data\n")


def largest_memory(process):
    """Return the peak memory of a process [bytes]."""
    with open(f"/proc/{process.pid}/status", encoding="utf-8") as status:
        return next(int(line.split()[1]) << 10 for line in status if line.startswith("VmHWM"))


def test_large_messages_and_a_slow_disk_end_and_take_no_memory(start, tmp_path):
    recorder = record(start, tmp_path / "bag", "max_queue_mb:=64", "topics:=[image]", program=("-c", SLOW))
    camera = start("-c", LARGE)
    assert camera.stdout.readline() == "sent\n"
    most = largest_memory(recorder)
    code, _, errors = stop(recorder)
    assert (code, "Traceback" in errors) == (0, False), errors
    assert most < 350_000_000  # 70 MB of Python and ROS, the queue, the message that is being written and taken
    assert errors.count("messages are dropped") == 1
    assert " dropped, in" in errors
    messages = list(read_raw(tmp_path / "bag"))
    assert 0 < len(messages) == bag_info(tmp_path / "bag").message_count < 60
    assert all(len(message.data) >= 4_000_000 for message in messages)


def test_a_queue_drops_what_is_too_heavy_and_counts_it(tmp_path):
    said = []
    queue = BagQueue(BagWriter(tmp_path / "bag"), 10_000, said.append)
    queue.add_topic(string_topic("/talk"))
    queue.write("/talk", bytes(20_000), 1, 1, 1)
    for i in range(3):
        queue.write("/talk", bytes(100), i, i, i)
    assert queue.close(20.0)
    assert (queue.dropped["/talk"], said) == (1, ["/talk"])
    assert len(list(read_raw(tmp_path / "bag"))) == 3


def test_a_bag_that_fails_says_so(tmp_path):
    queue = BagQueue(BagWriter(tmp_path / "bag", min_free_bytes=2**62, flush_s=0.0), 10_000)
    queue.add_topic(string_topic("/talk"))
    queue.write("/talk", bytes(100), 1, 1, 1)
    with pytest.raises(BagError, match="left on the disk"):
        queue.close(20.0)
    with pytest.raises(BagError, match="left on the disk"):
        queue.check()
    assert len(list(read_raw(tmp_path / "bag"))) == 1


def test_a_disk_that_never_answers_does_not_keep_the_recorder(tmp_path):
    writer = BagWriter(tmp_path / "bag")
    queue = BagQueue(writer, 10_000)
    reader, _ = os.pipe()
    writer.add_topic = lambda _topic: os.read(reader, 1)  # never ends
    queue.add_topic(string_topic("/talk"))
    assert not queue.close(0.1)


def test_what_a_file_needs_goes_with_it(tmp_path):
    def grown(bag, times):
        before = tracemalloc.get_traced_memory()[0]
        for time_ in times:
            bag.write("/talk", b"\0\1\0\0\1\0\0\0\0", time_)
            bag.flush()
        return tracemalloc.get_traced_memory()[0] - before

    for name, max_file_s, most in (("one", 0.0, 400 * 14_400), ("split", 1e-6, 1_000_000)):
        with BagWriter(tmp_path / name, max_file_s=max_file_s) as bag:
            bag.add_topic(string_topic("/talk"))
            bag.write("/talk", b"\0\1\0\0\1\0\0\0\0", 0)
            tracemalloc.start()
            # A table of Python's own that grows now and then does so in one of them at most.
            size = min(grown(bag, range(1, 3000)), grown(bag, range(3000, 6000)))
            tracemalloc.stop()
        assert size / 3000 < most / 14_400, f"{name}: {size / 3000:.0f} bytes a chunk"
        assert bag_info(tmp_path / name).message_count == 6000


def test_a_topic_that_changes_its_type_is_recorded_under_another_name(start, tmp_path):
    recorder = record(start, tmp_path / "bag", "topics:=[talk, diagnostics]")
    talker = start("-c", RETYPED)
    assert talker.stdout.readline() == "sent\n"
    talker.stdin.write("\n")
    talker.stdin.flush()
    assert talker.stdout.readline() == "sent\n"
    code, _, errors = stop(recorder)
    assert code == 0
    assert "/talk is a std_msgs/msg/Int32 now, not a std_msgs/msg/String: recorded as /talk/as/std_msgs/Int32" in errors
    said = {m.topic: m.data.data for m in read_messages(tmp_path / "bag", ["/talk", "/talk/as/std_msgs/Int32"])}
    assert said == {"/talk": "hi", "/talk/as/std_msgs/Int32": 7}
    status = list(read_messages(tmp_path / "bag", ["/diagnostics"]))[-1].data.status[0]
    assert {pair.key: pair.value for pair in status.values}["retyped_topics"] == "/talk/as/std_msgs/Int32"
