"""Measure `bag export` and `bag import` on an hour of driving, and check that every array comes back bit for bit.

    python test/bag_export FOLDER [--results FILE]

The bag is a burger's: 360 beams at 5 Hz, odometry and rewards at 30 Hz, a command for each scan, an episode a minute.
Each measurement is a process of its own; the least of several counts, since other work on the machine only adds.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from ctrl_rl_bags.datasets import (
    ExtractionOptions,
    Found,
    Frames,
    MessageMaker,
    ScanLayout,
    extract,
    find_layout,
    read_dataset,
    whole_episodes,
)
from tqdm import tqdm

from ctrl_rl_bags import BagWriter
from ctrl_rl_core import Result, parse_options, write_results

HOUR, RATE, SCAN_EVERY, EPISODE = 3600, 30, 6, 60 * 30
COMMAND = "geometry_msgs/msg/TwistStamped"
KINDS = {
    "/scan": "sensor_msgs/msg/LaserScan",
    "/odom": "nav_msgs/msg/Odometry",
    "/cmd_vel": COMMAND,
    "/goal_pose": "geometry_msgs/msg/PoseStamped",
    "/reward": "ctrl_rl_msgs/msg/TaskReward",
    "/episode": "ctrl_rl_msgs/msg/EpisodeStatus",
}
STEP, LEAST = float(np.float32(np.pi / 180)), float(np.float32(0.12))
SCAN = ScanLayout(beams=360, angle_min=0.0, angle_increment=STEP, range_min=LEAST, range_max=3.5)
MEASURE = """
import json, resource, sys, time
from ctrl_rl_bags.cli import main
began = time.monotonic()
code = main(sys.argv[1:])
used = resource.getrusage(resource.RUSAGE_SELF)
print(json.dumps([time.monotonic() - began, used.ru_utime + used.ru_stime, used.ru_maxrss / 1024]))
sys.exit(code)
"""


@dataclass(frozen=True, kw_only=True)
class Options:
    """Measure the export of an hour's bag."""

    folder: Annotated[Path, tyro.conf.Positional]
    """Folder for bag and datasets; a bag that is there is used again."""
    results: Path | None = None
    """JSON file to write the figures to."""
    runs: int = 3
    """Measurements of each."""


def main() -> int:
    """Measure, check and write."""
    options = parse_options("bag_export", Options)
    bag = options.folder / "hour"
    if not bag.exists():
        write_hour(bag)
    size = sum(file.stat().st_size for file in bag.iterdir())
    rows = [Result("bag", "size", "MB", [size / 1e6])]
    for kind in ("lerobot", "minari"):
        folder = options.folder / f"hour_{kind}"
        for what in ("export", "import"):
            target = folder if what == "export" else options.folder / f"hour_{kind}_back"
            given = [str(bag), "--format", kind] if what == "export" else [str(folder)]
            found = [measure(target, [what, *given, "--output", str(target)]) for _ in range(options.runs)]
            told = (options.folder / "told").read_text()
            gigabytes = float(told.split(" MB of messages")[0].rpartition("of ")[2]) / 1e3
            name = f"{what} {kind}"
            rows += [
                Result(name, "minutes per gigabyte", "min/GB", [each[0] / 60.0 / gigabytes for each in found]),
                Result(
                    name, "processor minutes per gigabyte", "min/GB", [each[1] / 60.0 / gigabytes for each in found]
                ),
                Result(name, "messages", "GB", [gigabytes]),
                Result(name, "memory", "MB", [each[2] for each in found]),
                Result(name, "size", "MB", [sum(f.stat().st_size for f in target.rglob("*") if f.is_file()) / 1e6]),
            ]
        layout, frames = read_dataset(folder)
        count = check_same(original(bag), frames) + check_same(original(bag), original(target / "bag_0"))
        rows.append(Result(f"round trip {kind}", "arrays with the same bits", "1", [float(count)]))
        print(f"{kind}: {layout.task}, {count} arrays with the same bits")
    for row in rows:
        print(f"{row.method:<20} {row.metric:<32} {min(row.values):.4g} {row.unit}")
    if options.results is not None:
        write_results(options.results, "bag_export", [0], rows)
    return 0


def measure(target: Path, arguments: list[str]) -> list[float]:
    """Return wall time [s], processor time [s] and memory [MB] of a command in a process of its own."""
    if target.exists():
        subprocess.run(["rm", "-r", str(target)], check=True)
    answer = subprocess.run([sys.executable, "-c", MEASURE, *arguments], capture_output=True, text=True, check=True)
    (target.parent / "told").write_text(answer.stdout)
    return [float(each) for each in json.loads(answer.stdout.splitlines()[-1])]


def original(bag: Path) -> Iterator[Frames]:
    """Return the frames of a bag."""
    how = ExtractionOptions()
    return extract([bag], find_layout(bag, how), how, Found())


def check_same(ours: Iterator[Frames], theirs: Iterator[Frames]) -> int:
    """Compare two streams of frames episode by episode, and return the number of arrays."""
    count = 0
    for (_, one), (_, other) in zip(whole_episodes(ours), whole_episodes(theirs), strict=True):
        for name, values in one.items():
            if (values.dtype, values.shape, values.tobytes()) != (
                other[name].dtype,
                other[name].shape,
                other[name].tobytes(),
            ):
                raise SystemExit(f"bag_export: {name} differs")
            count += 1
    return count


def write_hour(folder: Path) -> None:
    """Write an hour of driving as the recorder does."""
    make, random, t = MessageMaker(), np.random.default_rng(0), 1_700_000_000 * 10**9
    pose, walls = np.zeros(13), random.uniform(0.2, 3.4, SCAN.beams)
    pose[6] = 1.0
    with BagWriter(folder) as bag:
        for name, kind in KINDS.items():
            bag.add_topic(make.topic(name, kind))
        bag.set_custom_data("task", "curved_corridor")
        for tick in tqdm(range(HOUR * RATE), "an hour of driving", disable=None):
            t += 10**9 // RATE
            number, inside = divmod(tick, EPISODE)
            if inside == 0:
                bag.write("/episode", make.episode(t, number, 0), t)
                bag.write("/goal_pose", make.goal(t, random.normal(size=7)), t)
            pose[:2] += random.normal(0.0, 0.005, 2)
            pose[7], pose[12] = random.normal(0.2, 0.01), random.normal()
            bag.write("/odom", make.odometry(t, pose), t)
            bag.write("/reward", make.reward(t, float(random.normal()), 0), t)
            if inside == EPISODE - 10:
                bag.write("/episode", make.episode(t, number, 1), t)
            if tick % SCAN_EVERY == 0:
                ranges = (walls + random.normal(0.0, 0.01, SCAN.beams)).astype(np.float32)
                bag.write("/scan", make.scan(t, ranges, SCAN), t + 1000)
                bag.write("/cmd_vel", make.command(t, random.normal(size=2), COMMAND), t + 5_000_000)


if __name__ == "__main__":
    began = time.monotonic()
    code = main()
    print(f"{time.monotonic() - began:.0f} s")
    sys.exit(code)
