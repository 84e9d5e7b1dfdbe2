"""The commands `options_demo`, `options_report` and `options_monitor`: a team of robots under its coordinator."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro
from ctrl_rl_core.command import at_least
from ctrl_rl_core.io import with_digest
from option_coordinator.teams import Work

from ctrl_rl_bringup.cli.running import own_arguments, run_alone, run_folder, run_here
from ctrl_rl_bringup.team.report import read_team
from ctrl_rl_bringup.team.run import TeamConfig, follow_running_team, run_team
from ctrl_rl_core import CommandError, atomic_write, load_navigation_task, parse_options
from option_coordinator import load_team

_FASTEST = 1000.0


@dataclass(frozen=True)
class _TeamOptions:
    """Options of every command about a team."""

    team: str = TeamConfig.team
    """Team name or .yaml file."""


@dataclass(frozen=True)
class DemoOptions(_TeamOptions):
    """Let a team of TurtleBots carry parcels under the coordinator; record the run and report on it."""

    output: Path | None = None
    """New folder of the run; by default runs/options-<date>-<time>."""

    room: str = TeamConfig.room
    """Navigation task or .yaml file of the room; the team's if empty."""

    policy: str = TeamConfig.policy
    """Scripted policy 'spread' or 'uniform', or name or file of a learned one; if empty the team's, or 'spread'."""

    seed: at_least(0) = 0  # type: ignore[valid-type]
    """Seed of starts, noise and draws."""

    speed: float = 2.0
    """Simulation time per wall time."""

    gui: bool = False
    """Show PyBullet's window."""

    engine: Literal["auto", "pybullet", "mujoco"] = "auto"
    """Physics engine of the simulator; auto is PyBullet if installed, else MuJoCo."""

    ready_limit: float = TeamConfig.ready_limit
    """Time within which all nodes must be ready [s]; a busy machine may take minutes."""

    limit: at_least(0) = TeamConfig.limit  # type: ignore[valid-type]
    """Simulated time after which the run is cut off [s]; 0 for three of the team's episodes."""


@dataclass(frozen=True)
class ReportOptions(_TeamOptions):
    """Report on the bag of a team's run, and draw it."""

    folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FOLDER")] = tyro.MISSING
    """Folder of the run, with its bag in 'bag'."""

    room: str = TeamConfig.room
    """Navigation task or .yaml file of the room; the team's if empty."""


@dataclass(frozen=True)
class MonitorOptions(_TeamOptions):
    """Wait until a team's nodes are connected, start the simulation, and follow the work to its end."""

    ready_limit: float = TeamConfig.ready_limit
    """Time within which all nodes must be ready [s]."""

    limit: at_least(0) = TeamConfig.limit  # type: ignore[valid-type]
    """Simulated time after which the run is cut off [s]; 0 for three of the team's episodes."""


def demo() -> int:
    """Let a team of TurtleBots carry parcels under the coordinator; record the run and report on it."""
    given = parse_options("options_demo", DemoOptions)
    chosen = {key: value for key, value in vars(given).items() if key != "output"}
    config = TeamConfig(run_folder(given.output, "options"), **chosen)
    return run_alone("options_demo", lambda: _demo(config))


def report() -> int:
    """Report on the bag of a team's run, and draw it."""
    given = parse_options("options_report", ReportOptions)
    config = TeamConfig(given.folder, given.team, given.room)
    return run_here("options_report", lambda: _report(config))


def monitor() -> int:
    """Start the simulation once a team's nodes are connected, and follow the work to its end."""
    options = parse_options("options_monitor", MonitorOptions, own_arguments("options_monitor"))
    team, limits = options.team, (options.ready_limit, options.limit)
    return run_here("options_monitor", lambda: follow_running_team(load_team(team), *limits))


def _demo(config: TeamConfig) -> int:
    if not 0.0 < config.speed <= _FASTEST:
        raise CommandError(f"--speed {config.speed:g}: must be more than 0 and at most {_FASTEST:g}")
    print(
        f"options_demo: {config.team}, seed {config.seed}, {config.speed:g}x real time, in {config.folder}",
    )
    run_team(config)
    return _report(config)


def _report(config: TeamConfig) -> int:
    team = load_team(config.team)
    idle = [name for name, option in team.options.items() if option.work is Work.WAIT]
    run = read_team(config.drive.bag, idle)
    file, picture = config.folder / "report.json", config.folder / "timeline.png"
    atomic_write(file, json.dumps(with_digest(run.as_dict()), indent=1) + "\n")
    from ctrl_rl_bringup.team.plot import draw_team  # matplotlib takes long to load

    draw_team(run, load_navigation_task(config.task), team, picture)
    print(run.text())
    print(f"bag                 {config.drive.bag}")
    print(f"picture             {picture}")
    print(f"report              {file}")
    return 0 if run.finished or not team.deliveries else 1
