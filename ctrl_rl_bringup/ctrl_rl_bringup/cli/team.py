"""The commands `options_demo`, `options_report` and `options_monitor`: a team of robots under its coordinator."""

from __future__ import annotations

import argparse
import json
from datetime import datetime
from pathlib import Path

from ctrl_rl_core.command import CommandError
from ctrl_rl_core.io.atomic_write import atomic_write
from ctrl_rl_core.tasks.task import load_navigation_task
from option_coordinator.teams.team_file import Work, load_team

from ctrl_rl_bringup.cli.drive import run_alone, run_here
from ctrl_rl_bringup.team.plot import draw_team
from ctrl_rl_bringup.team.report import read_team
from ctrl_rl_bringup.team.run import follow_running_team, run_team
from ctrl_rl_bringup.team.stack import TeamConfig

_DEFAULT = TeamConfig(Path())
_FASTEST = 1000.0


def demo() -> int:
    """Let a team of TurtleBots carry parcels under the coordinator once, record it, and say what happened."""
    parser = argparse.ArgumentParser(prog="options_demo", description=demo.__doc__)
    parser.add_argument("--output", type=Path, help="new folder of the run (default runs/options-<date>-<time>)")
    _add_team(parser)
    parser.add_argument(
        "--policy",
        default=_DEFAULT.policy,
        help="'spread' or 'uniform', not learnt, or a learnt one's name or file (default: the team's, else 'spread')",
    )
    parser.add_argument("--seed", type=int, default=0, help="of starts, noise and draws (default %(default)s)")
    parser.add_argument("--speed", type=float, default=2.0, help="times real time (default %(default)s)")
    parser.add_argument("--gui", action="store_true", help="show PyBullet's window")
    given = parser.parse_args()
    folder = given.output or Path("runs") / f"options-{datetime.now():%Y%m%d-%H%M%S}"
    options = TeamConfig(folder, given.team, given.room, given.policy, given.seed, given.speed, given.gui)
    return run_alone("options_demo", lambda: _demo(options))


def report() -> int:
    """Say again what the bag of a team's run says, and draw it."""
    parser = argparse.ArgumentParser(prog="options_report", description=report.__doc__)
    parser.add_argument("folder", type=Path, help="folder of the run, with its bag in 'bag'")
    _add_team(parser)
    given = parser.parse_args()
    options = TeamConfig(given.folder, given.team, given.room)
    return run_here("options_report", lambda: _report(options))


def monitor() -> int:
    """Wait until a team's nodes listen to each other, let the simulation go, and follow the work to its end."""
    parser = argparse.ArgumentParser(prog="options_monitor", description=monitor.__doc__)
    parser.add_argument("--team", default=_DEFAULT.team, help="name or .yaml file (default %(default)s)")
    given, _ = parser.parse_known_args()  # launch adds --ros-args
    return run_here("options_monitor", lambda: follow_running_team(load_team(given.team)))


def _add_team(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--team", default=_DEFAULT.team, help="name or .yaml file (default %(default)s)")
    parser.add_argument("--room", default=_DEFAULT.room, help="navigation task or .yaml file (default: the team's)")


def _demo(options: TeamConfig) -> int:
    if not 0.0 < options.speed <= _FASTEST:
        raise CommandError(f"--speed {options.speed:g}: must be more than 0 and at most {_FASTEST:g}")
    if options.seed < 0:
        raise CommandError(f"--seed {options.seed}: must be at least 0")
    print(
        f"options_demo: {options.team}, seed {options.seed}, {options.speed:g}x real time, in {options.folder}",
        flush=True,
    )
    run_team(options)
    return _report(options)


def _report(options: TeamConfig) -> int:
    team = load_team(options.team)
    idle = [name for name, option in team.options.items() if option.work is Work.WAIT]
    run = read_team(options.drive.bag, idle)
    file, picture = options.folder / "report.json", options.folder / "timeline.png"
    atomic_write(file, json.dumps(run.as_dict(), indent=1) + "\n")
    draw_team(run, load_navigation_task(options.task), team, picture)
    print(run.text())
    print(f"bag                 {options.drive.bag}")
    print(f"picture             {picture}")
    print(f"report              {file}")
    return 0 if run.finished else 1
