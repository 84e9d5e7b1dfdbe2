"""The commands that drive one robot (`demo`, `trials`, `record_drives`), follow a drive or report on it."""

from __future__ import annotations

import os
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from ctrl_rl_core.command import OptionalFileToWrite, at_least
from ctrl_rl_core.tasks import require

from ctrl_rl_bringup.cli.running import own_arguments, run_alone, run_folder, run_here
from ctrl_rl_bringup.corridor.drive import drive, drive_seeds, follow_running, record_scripted, write_artifacts
from ctrl_rl_bringup.corridor.report import DriveReport, read_drive
from ctrl_rl_bringup.runner.beside import page_beside
from ctrl_rl_bringup.runner.stack import DriveConfig
from ctrl_rl_core import (
    CtrlRlError,
    Result,
    atomic_write,
    load_navigation_task,
    parse_options,
    results_page,
    write_results,
)
from ctrl_rl_msgs.msg import TaskOutcome
from koopman_lqr_controller import DEFAULT_POLICY

_RunFolder = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FOLDER")]
_SIMULATOR_PARAMETERS = {
    "engine": "engine",
    "lidar": "lidar",
    "scan_rate": "scan_rate",
    "dropout": "scan_dropout",
    "noise": "scan_noise",
    "drift": "odom_drift",
    "delay": "command_delay",
}
"""Parameters of the simulator, by the options that set them."""
_Drives = at_least(1)


class IncompleteError(CtrlRlError):
    """A recording lacks messages that its nodes should have published."""


@dataclass(frozen=True)
class _RunOptions:
    """Options of every command that drives."""

    output: Path | None = None
    """New folder of the run; by default runs/<command>-<date>-<time>."""

    task: str = "curved_corridor"
    """Task name or .yaml file."""

    speed: float = 1.0
    """Simulation time per wall time."""

    width: float = 0.0
    """Width of the corridor [m]; 0 for the task's."""

    random_width: bool = False
    """Draw the corridor's width from the task's range."""

    engine: Literal["pybullet", "mujoco"] | None = None
    """Physics engine of the simulator; by default PyBullet, or MuJoCo if PyBullet is not installed."""

    filter: bool = False
    """Put the safety filter between the driver and the robot, or the flight guard between the pilot and a quadrotor."""

    gui: bool = False
    """Show PyBullet's window."""

    lidar: str | None = None
    """Lidar that the simulator imitates, lds01 or lds02; by default the task's."""

    scan_rate: float | None = None
    """Scans per second [Hz]; by default the task's."""

    dropout: float | None = None
    """Probability that a beam returns no echo, 0 to 1."""

    noise: float | None = None
    """Standard deviation of a range [m]."""

    drift: float | None = None
    """Standard deviation of the odometry's relative errors."""

    delay: float | None = None
    """Time from a command to its effect [s]."""

    truncation: bool = False
    """Cut commands to 0.01 m/s and 0.01 rad/s, as the robot's firmware does."""

    ready_limit: float = DriveConfig.ready_limit
    """Time within which all nodes must be ready [s]; a busy machine may take minutes."""

    def config(self, name: str, seed: int, policy: str = "") -> DriveConfig:
        """Return the configuration of a run; `name` is part of its default folder."""
        task = load_navigation_task(self.task)
        return DriveConfig(
            folder=run_folder(self.output, name),
            task=self.task,
            policy=policy or (task.name if task.corridor is None or task.doorways else DEFAULT_POLICY),
            seed=seed,
            speed=self.speed,
            width=self.width,
            gui=self.gui,
            randomise_width=self.random_width,
            safety_filter=self.filter,
            simulation=self._simulation(),
            ready_limit=self.ready_limit,
        )

    def _simulation(self) -> dict[str, Any]:
        """Return the simulator parameters that were given; the simulator checks their values."""
        given = {name: getattr(self, option) for option, name in _SIMULATOR_PARAMETERS.items()}
        given["command_truncation"] = self.truncation or None
        return {name: value for name, value in given.items() if value is not None}


@dataclass(frozen=True)
class DemoOptions(_RunOptions):
    """Drive, or fly, a robot through a task in the simulator, record it and report."""

    task: str = ""
    """Task name or .yaml file; by default curved_corridor, or with --filter one with an oncoming person."""

    policy: str = ""
    """Policy name or file; by default the one trained on the task."""

    seed: int = 0
    """Seed of start pose and noise."""

    view: bool = False
    """Show the drive in a browser, as `view` does."""


@dataclass(frozen=True)
class TrialsOptions(_RunOptions):
    """Drive from many random starts and count how often the goal is reached."""

    speed: float = 6.0
    """Simulation time per wall time."""

    policy: str = ""
    """Policy name or file; by default the one trained on the task."""

    seeds: _Drives = 20  # type: ignore[valid-type]
    """Number of drives, with seeds from 0."""

    at_least: int | None = None
    """Exit with 1 if fewer drives reach the goal; by default 95 % of them."""

    results: OptionalFileToWrite = None
    """JSON file to write the metrics to."""


@dataclass(frozen=True)
class RecordOptions(_RunOptions):
    """Record drives of the scripted driver as training data for a model."""

    speed: float = 8.0
    """Simulation time per wall time."""

    episodes: _Drives = 12  # type: ignore[valid-type]
    """Number of drives."""

    seed: int = 1000
    """Seed of the first drive."""


@dataclass(frozen=True)
class ReportOptions:
    """Report on a recorded drive, and draw it."""

    folder: _RunFolder
    """Folder of the run, with its bag in 'bag'."""


@dataclass(frozen=True)
class MonitorOptions:
    """Wait until a drive's nodes are connected, start the simulation, and follow the drive to its end."""

    topics: str = ""
    """Further topics that the drive waits for, separated by commas."""

    ready_limit: float = DriveConfig.ready_limit
    """Time within which all nodes must be ready [s]."""


@dataclass(frozen=True)
class ResultsOptions:
    """Write the results page from the JSON files."""

    folder: _RunFolder
    """Folder of the JSON files."""

    page: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FILE")]
    """Markdown page to write."""


def demo() -> int:
    """Drive the corridor once, record it and report."""
    options = parse_options("demo", DemoOptions)
    if not options.task:
        options = replace(options, task="corridor_head_on" if options.filter else DriveConfig.task)
    return run_alone("demo", lambda: _demo(options.config("demo", options.seed, options.policy), options.view))


def trials() -> int:
    """Drive from many random starts and report how often the goal is reached."""
    options = parse_options("trials", TrialsOptions)
    return run_alone("trials", lambda: _trials(options))


def record_drives() -> int:
    """Record the scripted driver as training data."""
    options = parse_options("record_drives", RecordOptions)
    return run_alone("record_drives", lambda: _record_drives(options))


def report() -> int:
    """Report on the bag of a drive."""
    config = DriveConfig(parse_options("report", ReportOptions).folder)
    return run_here("report", lambda: _report(read_drive(config.bag), config))


def monitor() -> int:
    """Start the simulation once a drive's nodes are connected, and follow the drive to its end."""
    options = parse_options("monitor", MonitorOptions, own_arguments("monitor"))
    return run_here(
        "monitor", lambda: follow_running(list(filter(None, options.topics.split(","))), options.ready_limit)
    )


def results() -> int:
    """Write the results page from the JSON files."""
    options = parse_options("results", ResultsOptions)

    def work() -> int:
        link = os.path.relpath(options.folder, options.page.parent)
        atomic_write(options.page, results_page(options.folder, link))
        return 0

    return run_here("results", work)


def _demo(config: DriveConfig, view: bool) -> int:
    print(f"demo: {config.task}, seed {config.seed}, {config.speed:g}x real time, in {config.folder}")
    with page_beside(load_navigation_task(config.task).robot.body) if view else nullcontext():
        result = drive(config)
    return _report(result, config)


def _report(result: DriveReport, config: DriveConfig) -> int:
    artifacts = write_artifacts(result, config.folder)
    print(f"{result.text()}\nbag                 {config.bag}")
    print(f"picture             {artifacts.picture}")
    print(f"report              {artifacts.report}")
    if lacks := result.lacks:
        raise IncompleteError(f"the report is incomplete: {'; '.join(lacks)}. The nodes' logs are in {config.folder}")
    return 0 if result.reached else 1


def _trials(options: TrialsOptions) -> int:
    run = options.config("trials", 0, options.policy)
    seeds = range(options.seeds)
    episodes = drive_seeds(run, seeds)
    reached = [float(episode.outcome == TaskOutcome.GOAL) for episode in episodes]
    times = [episode.elapsed for episode in episodes]
    clearances = [episode.smallest_clearance for episode in episodes]
    method = ", ".join((f"policy {Path(run.policy).stem}", *_conditions(run)))
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
    """Describe the conditions of a drive."""
    width = "random" if run.randomise_width else f"{run.width:g} m" if run.width else "nominal"
    return [f"width {width}", *(f"{name} {value}".lower() for name, value in run.simulation.items())]


def _record_drives(options: RecordOptions) -> int:
    # A model of corridors needs several widths: each drive has its own unless one is given.
    require("ctrl_rl_bringup record_drives", load_navigation_task(options.task))
    own_widths = options.random_width or not options.width
    config = replace(options.config("drives", options.seed), randomise_width=own_widths)
    episodes = record_scripted(config, range(options.seed, options.seed + options.episodes))
    seconds = sum(episode.elapsed for episode in episodes)
    print(f"recorded            {len(episodes)} drives, {seconds:.0f} s of driving")
    print(f"bag                 {config.bag}")
    return 0
