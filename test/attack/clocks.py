"""Recorded drives on any clock: each scan has the command that answered it, or one line says why it has none."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
from _attack import Attack
from ctrl_rl_bags.datasets import (
    ExtractionOptions,
    Found,
    MessageMaker,
    ScanLayout,
    extract,
    find_layout,
    whole_episodes,
)

from ctrl_rl_bags import BagError, BagWriter

Random = np.random.Generator
SCAN = ScanLayout(beams=8, angle_min=-1.5, angle_increment=0.4, range_min=0.1, range_max=500.0, frame="scan")
SENSORS = (("/scan", "sensor_msgs/msg/LaserScan"), ("/odom", "nav_msgs/msg/Odometry"))
COMMANDS = ("geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped")
SECOND = 10**9


def run(random: Random, folder: Path) -> None:
    """Record twenty drives, each with faults of its clocks, and read them by stamps and by log times."""
    for _ in range(20):
        bag = folder / "bag"
        _write(random, bag)
        for clock in ("header", "log"):
            try:
                pairs = _pairs(bag, ExtractionOptions(clock=clock))  # type: ignore[arg-type]
            except BagError:
                continue
            wrong = [(scan, command) for scan, command in pairs if abs(scan - command) > 0.01]
            assert not wrong, f"by {clock}: scans and commands {wrong[:5]} of {len(pairs)}"
        shutil.rmtree(bag)


def _pairs(bag: Path, how: ExtractionOptions) -> list[tuple[float, float]]:
    return [
        (float(scan.min()), float(action[0]))
        for _, each in whole_episodes(extract([bag], find_layout(bag, how), how, Found()))
        for scan, action in zip(each["observation.scan"][:-1], each["action"][:-1], strict=True)
    ]


def _write(random: Random, folder: Path) -> None:
    """Write a drive in which scan k shows k + 1 m and is answered by k + 1."""
    make, kind, count = MessageMaker(), COMMANDS[int(random.integers(2))], int(random.integers(10, 60))
    start = int(random.choice([0, 13, 1_750_000_000])) * SECOND
    period, slow = int(random.choice([5, 10, 20])) * 10**7, float(random.choice([0.05, 0.5, 1.0, 4.0, 20.0]))
    offsets = dict.fromkeys(("/scan", "/odom", "/cmd_vel"), 0)
    if random.random() < 0.6 and slow >= 0.5:  # at twenty times real time, 2 s are the tenth of a second of a network
        offsets[str(random.choice(list(offsets)))] = int(random.choice([-30, -2, 2, 10, 8_294_400])) * SECOND
    zero = str(random.choice(["", *offsets]))
    reset = int(random.integers(2, 4 * count))
    unborn = int(random.choice([0, 0, 5])) if start > 10 * SECOND else 0
    events = []
    for k in range(count):
        time = (k + 1) * period
        world = time if k < reset else time - reset * period
        for name, late in (("/odom", -(10**6)), ("/scan", 0), ("/cmd_vel", int(random.integers(-period // 10, 10**7)))):
            stamp = 0 if name == zero else max(start + world + offsets[name], 0)
            received = 0 if k < unborn else start + SECOND + round(slow * (time + late))
            events.append((received, time + late, name, _message(make, name, kind, stamp, k)))
    with BagWriter(folder) as bag:
        for name, each in (*SENSORS, ("/cmd_vel", kind)):
            bag.add_topic(make.topic(name, each))
        for received, _, name, data in sorted(events, key=lambda event: event[:2]):
            bag.write(name, data, received)


def _message(make: MessageMaker, name: str, kind: str, stamp: int, k: int) -> bytes:
    if name == "/scan":
        return make.scan(stamp, np.full(SCAN.beams, k + 1.0, np.float32), SCAN)
    if name == "/odom":
        return make.odometry(stamp, np.array((*np.zeros(6), 1.0, *np.zeros(6))))
    return make.command(stamp, np.array((k + 1.0, 0.0)), kind)


ATTACKS = (
    Attack("clocks", "Each recorded scan has the command that answered it, or one line says which clock is off.", run),
)
