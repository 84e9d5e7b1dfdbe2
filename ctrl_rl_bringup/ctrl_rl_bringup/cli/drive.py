"""The commands `demo`, `trials` and `record_drives`: the whole suite at work, on one machine."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from datetime import datetime
from pathlib import Path
from typing import Any

from ctrl_rl_core.command import check_least, file_to_write, run_command
from ctrl_rl_core.errors import CtrlRlError
from ctrl_rl_core.io.atomic_write import atomic_write
from ctrl_rl_core.io.results import Result, as_markdown, read_benchmarks, read_results, write_results
from koopman_lqr_controller.policies.policy_file import DEFAULT_POLICY

from ctrl_rl_bringup.corridor.drive import drive, drive_seeds, follow_running, record_scripted, write_artifacts
from ctrl_rl_bringup.corridor.report import DriveReport, read_drive
from ctrl_rl_bringup.runner.domain import own_domain, stay_local
from ctrl_rl_bringup.runner.stack import DriveConfig
from ctrl_rl_msgs.msg import TaskOutcome

_AS_REAL = ("lidar", "scan_rate", "scan_dropout", "scan_noise", "odom_drift", "command_delay", "command_truncation")
"""Parameters of the simulator that options ask for."""


class IncompleteError(CtrlRlError):
    """A run did not record what its nodes should have said."""


def demo() -> int:
    """Drive the corridor once, record it, and say what happened."""
    parser = _parser("demo", "Drive a TurtleBot3 through the corridor in the simulator, record it, report.")
    _add_policy(parser)
    parser.add_argument("--seed", type=int, default=0, help="of start pose and noise (default %(default)s)")
    options = parser.parse_args()
    return run_alone("demo", lambda: _demo(_options(options, "demo", options.seed)))


def trials() -> int:
    """Drive the corridor from many random starts and write how often the goal is reached."""
    parser = _parser("trials", "Drive from many random starts and count how often the goal is reached.", 6.0)
    _add_policy(parser)
    parser.add_argument("--seeds", type=int, default=20, help="how many, from 0 (default %(default)s)")
    parser.add_argument("--at-least", type=int, help="exit with 1 if fewer reach the goal (default: 95 %%)")
    parser.add_argument("--results", type=file_to_write, help="JSON file to write the figures to")
    options = parser.parse_args()
    return run_alone("trials", lambda: _trials(options))


def record_drives() -> int:
    """Record the scripted driver, to learn from."""
    parser = _parser("record_drives", "Record drives of the scripted driver, to learn a model from.", 8.0)
    parser.add_argument("--episodes", type=int, default=12, help="how many drives (default %(default)s)")
    parser.add_argument("--seed", type=int, default=1000, help="of the first drive (default %(default)s)")
    options = parser.parse_args()
    return run_alone("record_drives", lambda: _record_drives(options))


def report() -> int:
    """Say again what the bag of a drive says."""
    parser = argparse.ArgumentParser(prog="report", description="Report on a recorded drive, and draw it.")
    parser.add_argument("folder", type=Path, help="folder of the run, with its bag in 'bag'")
    options = DriveConfig(parser.parse_args().folder)
    return run_here("report", lambda: _report(read_drive(options.bag), options))


def monitor() -> int:
    """Wait until the nodes of a drive listen to each other, let the simulation go, and follow it to its end."""
    parser = argparse.ArgumentParser(prog="monitor", description=monitor.__doc__)
    parser.add_argument("--topics", default="", help="that the drive waits for besides its own, with commas between")
    options, _ = parser.parse_known_args()  # launch adds --ros-args
    return run_here("monitor", lambda: follow_running(list(filter(None, options.topics.split(",")))))


def results() -> int:
    """Write the page of results from their JSON files."""
    parser = argparse.ArgumentParser(prog="results", description=results.__doc__)
    parser.add_argument("folder", type=Path, help="folder of the JSON files")
    parser.add_argument("page", type=Path, help="Markdown page to write")
    options = parser.parse_args()

    def work() -> int:
        page = as_markdown(read_results(options.folder), read_benchmarks(options.folder / "bench.json"))
        atomic_write(options.page, page)
        return 0

    return run_here("results", work)


def _parser(program: str, description: str, speed: float = 1.0) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog=program, description=description)
    parser.add_argument("--output", type=Path, help="new folder of the run (default runs/<command>-<date>-<time>)")
    parser.add_argument("--task", default="curved_corridor", help="task name or .yaml file (default %(default)s)")
    parser.add_argument("--speed", type=float, default=speed, help="times real time (default %(default)s)")
    parser.add_argument("--width", type=float, default=0.0, help="of the corridor [m] (default: the task's)")
    parser.add_argument("--random-width", action="store_true", help="draw the width from the task's range")
    parser.add_argument("--gui", action="store_true", help="show PyBullet's window")
    real = parser.add_argument_group("what the simulator does as a real robot does")
    real.add_argument("--lidar", help="lds01 or lds02: what reads like these (default: the task's)")
    real.add_argument("--scan-rate", type=float, help="scans per second [Hz] (default: the task's)")
    real.add_argument("--dropout", type=float, dest="scan_dropout", help="probability that a beam is lost")
    real.add_argument("--noise", type=float, dest="scan_noise", help="standard deviation of a range [m]")
    real.add_argument("--drift", type=float, dest="odom_drift", help="of odometry's relative errors")
    real.add_argument("--delay", type=float, dest="command_delay", help="from a command to its effect [s]")
    real.add_argument(
        "--truncation",
        action="store_const",
        const=True,
        dest="command_truncation",
        help="cut commands to 0.01 m/s and 0.01 rad/s, as the firmware does",
    )
    return parser


def _add_policy(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--policy", default=DEFAULT_POLICY, help="policy name or file (default %(default)s)")


def _options(options: argparse.Namespace, name: str, seed: int) -> DriveConfig:
    folder = options.output or Path("runs") / f"{name}-{datetime.now():%Y%m%d-%H%M%S}"
    return DriveConfig(
        folder=folder,
        task=options.task,
        policy=getattr(options, "policy", DEFAULT_POLICY),  # the scripted driver of record_drives needs none
        seed=seed,
        speed=options.speed,
        width=options.width,
        gui=options.gui,
        randomise_width=options.random_width,
        simulation=_simulation(options),
    )


def _simulation(options: argparse.Namespace) -> dict[str, Any]:
    """Return the parameters of the simulator that were asked for; it refuses by itself what it does not take."""
    return {name: getattr(options, name) for name in _AS_REAL if getattr(options, name) is not None}


def run_here(program: str, work: Callable[[], int]) -> int:
    """Run a command whose nodes talk on this machine, and return its exit code."""
    stay_local()
    return run_command(program, work, failure=2)


def run_alone(program: str, work: Callable[[], int]) -> int:
    """Run a command that starts nodes, in a ROS domain of its own, and return its exit code."""

    def alone() -> int:
        with own_domain(program):
            return work()

    return run_here(program, alone)


def _demo(options: DriveConfig) -> int:
    print(f"demo: {options.task}, seed {options.seed}, {options.speed:g}x real time, in {options.folder}", flush=True)
    return _report(drive(options), options)


def _report(result: DriveReport, options: DriveConfig) -> int:
    artifacts = write_artifacts(result, options.folder)
    print(result.text())
    print(f"bag                 {options.bag}")
    print(f"picture             {artifacts.picture}")
    print(f"report              {artifacts.report}")
    if lacks := result.lacks:
        raise IncompleteError(f"the report is not whole: {'; '.join(lacks)}. The nodes' logs are in {options.folder}")
    return 0 if result.reached else 1


def _trials(options: argparse.Namespace) -> int:
    check_least(options, seeds=1)
    run = _options(options, "trials", 0)
    seeds = range(options.seeds)
    episodes = drive_seeds(run, seeds)
    reached = [float(episode.outcome == TaskOutcome.GOAL) for episode in episodes]
    times = [episode.elapsed for episode in episodes]
    clearances = [episode.smallest_clearance for episode in episodes]
    method = ", ".join((f"policy {Path(options.policy).stem}", *_conditions(run)))
    if options.results:
        rows = [
            Result(method, "goal reached", "1", reached),
            Result(method, "time", "s", times),
            Result(method, "smallest clearance", "m", clearances),
        ]
        write_results(options.results, f"{options.task}_trials", list(seeds), rows)
    print(f"goal reached        {int(sum(reached))} of {len(reached)}")
    print(f"smallest clearance  {min(clearances):.3f} m (mean {sum(clearances) / len(clearances):.3f} m)")
    print(f"time                {sum(times) / len(times):.1f} s mean")
    print(f"bag                 {run.bag}")
    needed = options.at_least if options.at_least is not None else 0.95 * len(reached)
    return 0 if sum(reached) >= needed else 1


def _conditions(run: DriveConfig) -> list[str]:
    """Return in words what a drive is like."""
    width = "random" if run.randomise_width else f"{run.width:g} m" if run.width else "nominal"
    return [f"width {width}", *(f"{name} {value}".lower() for name, value in run.simulation.items())]


def _record_drives(options: argparse.Namespace) -> int:
    check_least(options, episodes=1)
    # A model of corridors wants corridors: each drive has a width of its own unless one is asked for.
    options.random_width = options.random_width or not options.width
    run = _options(options, "drives", options.seed)
    episodes = record_scripted(run, range(options.seed, options.seed + options.episodes))
    seconds = sum(episode.elapsed for episode in episodes)
    print(f"recorded            {len(episodes)} drives, {seconds:.0f} s of driving")
    print(f"bag                 {run.bag}")
    return 0
