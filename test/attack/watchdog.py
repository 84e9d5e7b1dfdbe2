"""Kills, freezes, silences and hostile numbers against the watchdog and whoever drives through it."""

from __future__ import annotations

import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from _attack import Attack

_SOURCE = Path(__file__).resolve().parents[2] / "ctrl_rl_core" / "test" / "command_source.py"
_TIMEOUT, _RATE = 0.3, 20.0
_GENEROUS_S = 10.0
"""For what takes half a second where the machine has nothing else to do."""
_HOSTILE = (math.nan, math.inf, -math.inf, 1e308, -1e-300 - 1.0, 0.3, -7.0)


def run(generator: np.random.Generator, _folder: Path) -> None:
    """Attack five times in a row; after each the robot's last command is zero, and a new driver drives on."""
    os.environ["ROS_DOMAIN_ID"] = str(1 + os.getpid() % 100)
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    rig = _Rig(generator)
    try:
        for _ in range(5):
            rig.drive()
            getattr(rig, str(generator.choice([name for name in dir(_Rig) if name.startswith("attack_")])))()
    finally:
        rig.close()


class _Rig:
    """A base, a watchdog and a driver, each in its own process."""

    def __init__(self, generator: np.random.Generator) -> None:
        import rclpy
        from geometry_msgs.msg import TwistStamped

        from ctrl_rl_core import COMMAND

        self._rclpy, self._kind, self._random = rclpy, TwistStamped, generator
        rclpy.init()
        self._node = rclpy.create_node("base")
        self._speeds: list[float] = []
        self._node.create_subscription(
            TwistStamped, "cmd_vel", lambda message: self._speeds.append(message.twist.linear.x), COMMAND
        )
        self._raw = self._node.create_publisher(TwistStamped, "cmd_vel_raw", COMMAND)
        self._driver: subprocess.Popen | None = None
        self._watchdog = self._start_watchdog()

    def drive(self) -> None:
        """Let a driver drive, whatever was before."""
        if self._watchdog.poll() is not None:
            self._watchdog = self._start_watchdog()
        if self._driver is not None:
            self._driver.kill()
            self._driver.wait()
        self._driver = subprocess.Popen([sys.executable, _SOURCE])
        self._until(lambda: bool(self._speeds) and self._speeds[-1] > 0.0, "a new driver does not drive")
        self._spin(float(self._random.uniform(0.0, 0.5)))

    def attack_kill_driver(self) -> None:
        self._driver.kill()
        self._stands("the driver was killed")

    def attack_freeze_driver(self) -> None:
        self._driver.send_signal(signal.SIGSTOP)
        self._stands("the driver was frozen")
        self._driver.send_signal(signal.SIGCONT)
        self._until(lambda: self._speeds[-1] > 0.0, "a driver that thawed does not drive")

    def attack_hostile_numbers(self) -> None:
        self._driver.kill()
        for _ in range(20):
            message = self._kind()
            part = message.twist.linear if self._random.random() < 0.5 else message.twist.angular
            setattr(part, str(self._random.choice(list("xyz"))), float(self._random.choice(_HOSTILE)))
            self._raw.publish(message)
            self._spin(0.01)
        self._stands("the numbers were hostile")
        sent = {speed for speed in self._speeds if not math.isfinite(speed) or abs(speed) > 7.0}
        assert not sent, f"went to the robot: {sent}"
        assert self._watchdog.poll() is None, "a number ended the watchdog"

    def attack_stop_watchdog(self) -> None:
        self._watchdog.send_signal(int(self._random.choice([signal.SIGINT, signal.SIGTERM])))
        assert self._watchdog.wait(_GENEROUS_S) == 0
        self._stands("the watchdog was stopped")

    def attack_kill_watchdog_and_start_another(self) -> None:
        self._watchdog.kill()
        self._watchdog.wait()
        self._driver.kill()
        self._watchdog = self._start_watchdog()
        self._stands("another watchdog began")

    def attack_freeze_both(self) -> None:
        self._watchdog.send_signal(signal.SIGSTOP)
        self._spin(_TIMEOUT + float(self._random.uniform(0.1, 1.0)))
        self._driver.kill()
        self._spin(0.05)
        self._speeds.clear()
        self._watchdog.send_signal(signal.SIGCONT)
        self._stands("the watchdog thawed")
        assert set(self._speeds) == {0.0}, "a command that had waited went to the robot"

    def close(self) -> None:
        for process in (self._driver, self._watchdog):
            if process is not None and process.poll() is None:
                process.kill()
                process.wait()
        self._node.destroy_node()
        self._rclpy.try_shutdown()

    def _stands(self, after: str) -> None:
        """Wait for a zero, and see that it stays the last word for some periods."""
        seen = len(self._speeds)
        self._until(lambda: len(self._speeds) > seen and self._speeds[-1] == 0.0, f"{after}, and the robot drives on")

    def _until(self, condition: Callable[[], bool], otherwise: str) -> None:
        deadline = time.monotonic() + _GENEROUS_S
        while not condition():
            assert time.monotonic() < deadline, f"{otherwise}: {self._speeds[-5:]}"
            self._rclpy.spin_once(self._node, timeout_sec=0.02)

    def _spin(self, seconds: float) -> None:
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            self._rclpy.spin_once(self._node, timeout_sec=0.01)

    @staticmethod
    def _start_watchdog() -> subprocess.Popen:
        from ament_index_python.packages import get_package_prefix

        path = Path(get_package_prefix("ctrl_rl_core")) / "lib" / "ctrl_rl_core" / "watchdog"
        parameters = (f"timeout:={_TIMEOUT}", f"zero_rate:={_RATE}")
        return subprocess.Popen([path, "--ros-args", *(part for each in parameters for part in ("-p", each))])


ATTACKS = (
    Attack(
        "watchdog",
        "Whoever of driver and watchdog is killed, frozen or stopped, and whatever numbers come, the robot's last "
        "command becomes zero, and a new driver drives on.",
        run,
    ),
)
