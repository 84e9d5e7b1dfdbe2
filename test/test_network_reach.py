"""The table of docs/security.md: who on another computer is heard, in two network namespaces joined by a veth pair."""

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

HERE, THERE = "ctrl_rl_here", "ctrl_rl_there"
PROFILE = {"FASTRTPS_DEFAULT_PROFILES_FILE": str(Path(__file__).parent / "loopback_udp.xml")}
LOCALHOST, SUBNET = ({"ROS_AUTOMATIC_DISCOVERY_RANGE": each} for each in ("LOCALHOST", "SUBNET"))
NAMES_IT = SUBNET | {"ROS_STATIC_PEERS": "10.77.0.1"}
CODE = """
import sys, time, rclpy
from rclpy.node import Node
from std_msgs.msg import Empty
rclpy.init()
node, heard = Node("node"), []
listens = sys.argv[1] == "listen"
if listens:
    node.create_subscription(Empty, "words", heard.append, 10)
else:
    publisher = node.create_publisher(Empty, "words", 10)
deadline = time.monotonic() + 8.0
while time.monotonic() < deadline and not heard:
    if not listens:
        publisher.publish(Empty())
    rclpy.spin_once(node, timeout_sec=0.1)
print(bool(heard))
"""


def ip(*words: str) -> None:
    subprocess.run(["ip", *words], check=True, capture_output=True)


@pytest.fixture(scope="module")
def network() -> Iterator[None]:
    try:
        for name in (HERE, THERE):
            ip("netns", "add", name)
        ip("link", "add", "here", "netns", HERE, "type", "veth", "peer", "name", "there", "netns", THERE)
        for name, card, address in ((HERE, "here", "10.77.0.1/24"), (THERE, "there", "10.77.0.2/24")):
            ip("-n", name, "addr", "add", address, "dev", card)
            for link in ("lo", card):
                ip("-n", name, "link", "set", link, "up")
            ip("-n", name, "route", "add", "224.0.0.0/4", "dev", card)
        yield
    except (OSError, subprocess.CalledProcessError) as error:
        pytest.skip(f"no network namespaces here: {error}")
    finally:
        for name in (HERE, THERE):
            subprocess.run(["ip", "netns", "delete", name], check=False, capture_output=True)


def start(namespace: str, word: str, settings: dict[str, str]) -> "subprocess.Popen[str]":
    kept = {
        name: value for name, value in os.environ.items() if not name.startswith(("ROS_AUTO", "ROS_STATIC", "FAST"))
    }
    command = ["ip", "netns", "exec", namespace, sys.executable, "-c", CODE, word]
    return subprocess.Popen(command, env=kept | settings, stdout=subprocess.PIPE, text=True)


@pytest.mark.slow
@pytest.mark.realtime
@pytest.mark.parametrize(
    ("mine", "of_the_other", "heard"),
    [
        (LOCALHOST, LOCALHOST, False),
        (LOCALHOST, SUBNET, False),
        (LOCALHOST, NAMES_IT, True),
        (SUBNET, SUBNET, True),
        (SUBNET | PROFILE, SUBNET, False),
        (SUBNET | PROFILE, NAMES_IT, False),
    ],
)
@pytest.mark.usefixtures("network")
def test_who_is_heard_from_another_computer(mine: dict[str, str], of_the_other: dict[str, str], heard: bool) -> None:
    other = start(THERE, "speak", of_the_other)
    try:
        out, _ = start(HERE, "listen", mine).communicate(timeout=60.0)
    finally:
        other.kill()
        other.communicate()
    assert out.strip() == str(heard)
