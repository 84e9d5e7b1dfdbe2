"""Measure what the suite costs on a robot: processor, memory, latency beside bare echoes, one process, and --help.

python test/robot_costs [--seconds 60] [--repeats 3] [--results docs/results/robot_side.json]

Controller, safety filter, watchdog and recorder drive a made-up robot round an endless corridor in real time, with ten
scans a second. Three echoes in a row answer the same scans, in the same minute. After each drive with four processes
comes one in which `stack` holds all nodes but the watchdog.
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rclpy
from ctrl_rl_core.command import OptionalFileToWrite, Positive
from geometry_msgs.msg import TwistStamped
from rclpy.node import Node
from sensor_msgs.msg import LaserScan

from ctrl_rl_core import COMMAND, SENSOR, Result, parse_options, run_command, write_results

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parent / "benchmarks"), str(HERE.parents[1] / "scripts" / "reference")]
from _common import executable  # noqa: E402  (a folder that is run, not installed)
from workspace import executables  # noqa: E402

NODES = {
    "controller": ("koopman_lqr_controller", "-r", "cmd_vel:=cmd_vel_raw"),
    "safety_filter": ("ctrl_rl_safety", "-r", "cmd_vel:=cmd_vel_safe"),
    "watchdog": ("ctrl_rl_core", "-r", "cmd_vel_raw:=cmd_vel_safe"),
    "recorder": ("ctrl_rl_bags", "-p", "output:=bag"),
}
STACKED = {
    "stack": ("ctrl_rl_bringup", "-p", "output:=bag"),
    "watchdog": NODES["watchdog"],
}
TOGETHER = "stack and watchdog"
HELD = "controller", "safety_filter", "recorder"
_START_S = 15.0
_TICKS = os.sysconf("SC_CLK_TCK")


@dataclass(frozen=True)
class Options:
    """Measure what the suite costs on a robot."""

    seconds: Positive = 60
    """Time of each measurement [s]."""
    repeats: Positive = 3
    """Number of measurements."""
    results: OptionalFileToWrite = None
    """JSON file of the results."""


class Observer:
    """Takes the time from a scan's arrival to that of the command with the scan's stamp, on some topics."""

    def __init__(self, node: Node, topics: tuple[str, ...]) -> None:
        self._scans: dict[tuple[int, int], float] = {}
        self.latencies: dict[str, list[float]] = {topic: [] for topic in topics}
        node.create_subscription(LaserScan, "scan", self._on_scan, SENSOR)
        for topic in topics:
            node.create_subscription(TwistStamped, topic, self._taker(topic), COMMAND)

    def _on_scan(self, message: LaserScan) -> None:
        self._scans[message.header.stamp.sec, message.header.stamp.nanosec] = time.perf_counter()

    def _taker(self, topic: str) -> object:
        answered: set[tuple[int, int]] = set()

        def take(message: TwistStamped) -> None:
            stamp = message.header.stamp.sec, message.header.stamp.nanosec
            if stamp in self._scans and stamp not in answered:  # the watchdog repeats the last command
                answered.add(stamp)
                self.latencies[topic].append(time.perf_counter() - self._scans[stamp])

        return take


@contextlib.contextmanager
def started(folder: Path, nodes: dict[str, tuple[str, ...]]) -> Iterator[dict[str, subprocess.Popen[bytes]]]:
    """Run the made-up robot, the echoes and some of the suite's processes."""
    chain = [("scan", "e1"), ("e1", "e2"), ("e2", "cmd_vel_echo")]
    commands = {"robot": [sys.executable, HERE / "_robot.py"]}
    for k, (taken, given) in enumerate(chain):
        commands[f"echo {k}"] = [sys.executable, HERE / "_echo.py", taken, given]
    for name, (package, *words) in nodes.items():
        held = HELD if name == "stack" else ()
        commands[name] = [executable(package, name), *held, "--ros-args", *words]
    processes = {}
    try:
        for name, command in commands.items():
            with (folder / f"{name}.log").open("wb") as log:
                processes[name] = subprocess.Popen(command, cwd=folder, stdout=log, stderr=log)
        yield processes
    finally:
        for process in processes.values():
            process.send_signal(signal.SIGINT)
        for process in processes.values():
            process.wait(60.0)


def processor_s(pid: int) -> float:
    """Return the processor time of a process so far [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / _TICKS


def own_memory_mb(pid: int) -> float:
    """Return the memory that a process shares with nobody [MB]."""
    lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
    return sum(int(line.split()[1]) for line in lines if line.startswith("Private_")) / 1024.0


def drive(seconds: int, nodes: dict[str, tuple[str, ...]]) -> dict[str, float]:
    """Return the figures of one drive."""
    with tempfile.TemporaryDirectory() as folder, started(Path(folder), nodes) as processes:
        node = Node("observer")
        observer = Observer(node, ("cmd_vel", "cmd_vel_echo"))
        spin(node, _START_S)
        for latencies in observer.latencies.values():
            latencies.clear()
        before, begin = {name: processor_s(processes[name].pid) for name in nodes}, time.monotonic()
        spin(node, seconds)
        passed = time.monotonic() - begin
        out = {f"{name}: share": 100.0 * (processor_s(processes[name].pid) - before[name]) / passed for name in nodes}
        out |= {f"{name}: memory": own_memory_mb(processes[name].pid) for name in nodes}
        node.destroy_node()
    for topic, name in (("cmd_vel", "suite"), ("cmd_vel_echo", "echoes")):
        latencies = observer.latencies[topic]
        if len(latencies) < 5 * seconds:
            raise SystemExit(f"robot_costs: only {len(latencies)} answers on {topic} in {seconds} s")
        out[f"{name}: p99"] = 1e3 * float(np.percentile(latencies, 99))
    return out


def spin(node: Node, seconds: float) -> None:
    """Serve a node for some time [s]."""
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        rclpy.spin_once(node, timeout_sec=0.05)


def help_s() -> list[float]:
    """Return the processor time of --help of each executable [s]."""
    out = []
    for each in executables():
        process = subprocess.Popen(
            [executable(each.package, each.name), "--help"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        out.append(usage.ru_utime + usage.ru_stime)
    return out


def measure(options: Options) -> int:
    """Measure, print and write the figures."""
    rclpy.init()
    pairs = [tuple(drive(options.seconds, nodes) for nodes in (NODES, STACKED)) for _ in range(options.repeats)]
    drives, stacked = ([pair[k] for pair in pairs] for k in (0, 1))
    help_s()  # the build keeps these pages; after a change of the sources they are made anew
    helps = [help_s() for _ in range(options.repeats)]
    rclpy.try_shutdown()
    rows = []
    for metric, unit, part in (("processor share", "% of a core", "share"), ("own memory", "MB", "memory")):
        rows += [Result(name, metric, unit, [each[f"{name}: {part}"] for each in drives]) for name in NODES]
        sums = [
            [sum(each[f"{name}: {part}"] for name in nodes) for each in some]
            for some, nodes in ((drives, NODES), (stacked, STACKED))
        ]
        rows += [Result(name, metric, unit, values) for name, values in zip(("all four", TOGETHER), sums, strict=True)]
        ratios = [two / four for four, two in zip(*sums, strict=True)]
        rows.append(Result(TOGETHER, f"{metric} over all four", "1", ratios))
    latencies = [two["suite: p99"] / four["suite: p99"] for four, two in pairs]
    rows.append(Result(TOGETHER, "latency over all four", "1", latencies))
    both = ("suite", "echoes")
    rows += [Result(name, "latency, p99", "ms", [each[f"{name}: p99"] for each in drives]) for name in both]
    ratios = [each["suite: p99"] / each["echoes: p99"] for each in drives]
    rows.append(Result("suite", "latency over echoes", "1", ratios))
    rows.append(Result("slowest executable", "help seconds", "s", [max(each) for each in helps]))
    rows.append(Result("median executable", "help seconds", "s", [float(np.median(each)) for each in helps]))
    for row in rows:
        print(f"{row.method:<20} {row.metric:<22} {np.mean(row.values):8.3f} {row.unit}")
    if options.results is not None:
        write_results(options.results, "robot_side", range(options.repeats), rows)
    return 0


if __name__ == "__main__":
    given = parse_options("robot_costs", Options)
    sys.exit(run_command("robot_costs", lambda: measure(given)))
