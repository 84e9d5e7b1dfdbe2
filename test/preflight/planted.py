"""Faults planted into a simulated robot, and whether the pre-flight finds them."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ament_index_python.packages import get_package_prefix
from preloaded import Preloaded

HERE = Path(__file__).parent
REMAPPINGS = ("scan:=raw/scan", "odom:=raw/odom", "cmd_vel:=raw/cmd_vel", "/tf:=/raw/tf", "/tf_static:=/raw/tf_static")
"""Topics of the simulator that the relay takes from there."""


@dataclass(frozen=True)
class Fault:
    """A fault of a robot.

    Attributes:
        found_by: Checks of which one must say no-go; empty for a healthy robot, of which none may.
        moves: Whether it shows only when the robot moves.
        relay: Whether messages pass the relay, which breaks them as its entry of this fault's name says.
        parameters: Parameters of the simulator.
    """

    found_by: tuple[str, ...]
    moves: bool = False
    relay: bool = True
    parameters: tuple[str, ...] = ()


HEALTHY = Fault((), moves=True)
FAULTS = {
    "no scan": Fault(("scan topic",)),
    "slow scan": Fault(("scan rate",)),
    "odometry with gaps": Fault(("odom rate",)),
    "Twist instead of TwistStamped": Fault(
        ("command type",), relay=False, parameters=("enable_stamped_cmd_vel:=false",)
    ),
    "commands with another QoS": Fault(("QoS",)),
    "clock behind": Fault(("scan stamps",)),
    "clock ahead": Fault(("scan stamps",)),
    "no static frames": Fault(("frame tree",)),
    "two parents": Fault(("frame tree",)),
    "lidar turned in TF": Fault(("lidar mounting",)),
    "covered lidar": Fault(("echoes",)),
    "lost beams": Fault(("echoes",)),
    "frozen lidar": Fault(("scan changes",)),
    "two lidars": Fault(("one lidar",)),
    "odometry not finite": Fault(("odometry",)),
    "second driver": Fault(("only driver",)),
    "empty battery": Fault(("battery",)),
    "map of another place": Fault(("map and pose",)),
    "mirrored lidar": Fault(("turn by scan",), moves=True),
    "lidar mounted turned": Fault(("way by scan",), moves=True),
    "swapped wheels": Fault(("turn rate by odometry",), moves=True),
    "wrong wheel radius": Fault(("speed by odometry",), moves=True),
    "pose stands still": Fault(("way by odometry", "odometry and TF"), moves=True),
    "motors off": Fault(("speed by odometry",), moves=True),
    "slow commands": Fault(("delay",), moves=True, relay=False, parameters=("command_delay:=0.9",)),
    "no time-out of commands": Fault(
        ("stands without commands",), moves=True, relay=False, parameters=("cmd_vel_timeout:=0.0",)
    ),
}
"""Faults by name."""


@dataclass(frozen=True)
class Answer:
    """What the pre-flight said.

    Attributes:
        code: Exit code.
        findings: Findings as in its report.
        output: What it printed.
    """

    code: int
    findings: list[dict[str, Any]]
    output: str

    def no_gos(self) -> list[str]:
        """Return the names of the checks that said no-go."""
        return [finding["check"] for finding in self.findings if finding["level"] == "NO-GO"]

    def finds(self, fault: Fault) -> bool:
        """Return whether a fault was found, or a healthy robot passed."""
        if not fault.found_by:
            return self.code == 0 and not self.no_gos()
        return self.code == 1 and bool(set(fault.found_by) & set(self.no_gos()))


def look_at(name: str, folder: Path, domain: int, seed: int = 0, options: tuple[str, ...] = ()) -> Answer:
    """Start a robot with a fault ("healthy" for none) in a ROS domain, run the pre-flight on it, and end both."""
    fault = FAULTS.get(name, HEALTHY)
    environment = {**os.environ, "ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    output = folder / name.replace(" ", "_")
    move = ("--move", "floor", "--yes") if fault.moves else ()
    command = [_executable("ctrl_rl_bringup", "preflight"), "--output", str(output), *move, *options]
    folder.mkdir(parents=True, exist_ok=True)
    with _robot(name, fault, environment, seed, folder / "robot.log"):
        process = Preloaded(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        out, errors = process.communicate(timeout=300)
    report = output / "preflight.json"
    content = json.loads(report.read_text()) if report.exists() else {"findings": []}
    return Answer(process.returncode, content["findings"], out + errors)


@contextmanager
def _robot(name: str, fault: Fault, environment: dict[str, str], seed: int, log: Path) -> Iterator[None]:
    """Run the simulator, and the relay where the fault needs it, and end them.

    Raises:
        RuntimeError: One of them ended by itself.
    """
    arguments = ["--ros-args", "-p", f"seed:={seed}"]
    arguments += [word for each in fault.parameters for word in ("-p", each)]
    arguments += [word for each in REMAPPINGS if fault.relay for word in ("-r", each)]
    commands = [[_executable("sim_bridge", "bridge"), *arguments]]
    if fault.relay:
        commands.append([sys.executable, str(HERE / "relay.py"), name if name in FAULTS else "none"])
    with log.open("ab") as stream:
        processes = [Preloaded(each, env=environment, stdout=stream, stderr=subprocess.STDOUT) for each in commands]
    try:
        yield
        if any(process.poll() is not None for process in processes):
            raise RuntimeError(log.read_text(errors="replace"))
    finally:
        for process in processes:
            process.send_signal(signal.SIGINT)
        for process in processes:
            try:
                process.wait(30.0)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def _executable(package: str, name: str) -> str:
    return str(Path(get_package_prefix(package)) / "lib" / package / name)
