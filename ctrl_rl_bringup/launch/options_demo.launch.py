"""ros2 launch ctrl_rl_bringup options_demo.launch.py [team:=...] [policy:=...] [speed:=1.0]: the demo of a team."""

from pathlib import Path

from ctrl_rl_bringup.runner.launching import Launch, description
from ctrl_rl_bringup.runner.stack import recorder
from ctrl_rl_bringup.team.run import agents, coordinator, new_team_run, team_simulator, watchdogs
from launch import LaunchDescription

from ctrl_rl_bringup import TeamConfig

ARGUMENTS = {
    "team": (TeamConfig.team, "team name or .yaml file"),
    "room": (TeamConfig.room, "navigation task or .yaml file, empty for the team's"),
    "policy": (
        TeamConfig.policy,
        "'spread' or 'uniform', not learnt, or a learnt one's name or file; empty for the team's",
    ),
}


def generate_launch_description() -> LaunchDescription:
    """Return the launch description of a team's demo."""
    return description("options", ARGUMENTS, _prepare)


def _prepare(folder: Path, team: str, room: str, policy: str, seed: int, speed: float, gui: bool) -> Launch:
    options = TeamConfig(folder, team, room, policy, seed, speed, gui)
    robots, digests = new_team_run(options)
    return Launch(
        recorder=recorder(options.drive, digests),
        nodes=[
            coordinator(options),
            *watchdogs(options, robots),
            *agents(options, robots),
            team_simulator(options, robots),
        ],
        monitor=("options_monitor", "--team", team),
        report=("options_report", str(folder), "--team", team, "--room", options.task),
    )
