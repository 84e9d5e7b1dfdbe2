"""The nodes of a team's run under its coordinator."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from option_coordinator.teams.team_file import room_file

from ctrl_rl_bringup.runner.stack import RAW, DriveConfig, NodeSpec, simulator, watchdog
from option_coordinator import TeamFile, load_team, shipped_policies

_LEASE = 0.5
_HEARTBEAT = 0.1
_LONGEST_STALE, _LONGEST_SENSOR_TIMEOUT = 600.0, 10.0
"""Largest values that the nodes take [s]; at such speeds the world goes as fast as it can."""


@dataclass(frozen=True)
class TeamConfig:
    """Configuration of a team's run.

    Attributes:
        folder: New folder of the run, for bag, logs, report and picture.
        team: Name or file of the team.
        room: Name or file of a navigation task; empty for the team's own.
        policy: Policy parameter of the coordinator; if empty the team's policy of the package, else 'spread'.
        seed: Seed of starts, noise and draws.
        speed: Simulation time per wall time.
        gui: Whether PyBullet shows a window.
        engine: Physics engine of the simulator, "auto" for PyBullet where it is installed, else MuJoCo.
        ready_limit: Longest time until all nodes must be ready [s].
    """

    folder: Path
    team: str = "delivery_team"
    room: str = ""
    policy: str = ""
    seed: int = 0
    speed: float = 1.0
    gui: bool = False
    engine: str = "auto"
    ready_limit: float = DriveConfig.ready_limit

    @cached_property
    def task(self) -> str:
        """Name or file of the room."""
        return room_file(self.room) if self.room else load_team(self.team).room_file

    @property
    def policy_name(self) -> str:
        """Name or file of the policy that is used."""
        return self.policy or (self.team if self.team in shipped_policies() else "spread")

    @property
    def drive(self) -> DriveConfig:
        """The part of the configuration that a single robot has too."""
        return DriveConfig(
            self.folder,
            task=self.task,
            policy=self.policy_name,
            seed=self.seed,
            speed=self.speed,
            gui=self.gui,
            simulation={"engine": self.engine},
        )


def team_simulator(options: TeamConfig, team: TeamFile) -> NodeSpec:
    """Return the bridge with the team's robots, each in its namespace; it starts paused."""
    spec = simulator(options.drive)
    parameters = {**spec.parameters, "robots": list(team.robots), "odom_rate": 10.0}
    return NodeSpec(spec.package, spec.executable, parameters)


def coordinator(options: TeamConfig) -> NodeSpec:
    """Return the coordinator. Stamps are of simulated time, so that an observation ages as fast as that goes."""
    parameters = {
        "use_sim_time": True,
        "team": options.team,
        "policy": options.policy_name,
        "seed": options.seed,
        "lease": _LEASE,
        "lost_after": 4.0 * _LEASE,
        "stale": min(4.0 * _LEASE * max(1.0, options.speed), _LONGEST_STALE),
        "repeat": _HEARTBEAT,
    }
    return NodeSpec("option_coordinator", "coordinator", parameters)


def agents(options: TeamConfig, team: TeamFile) -> list[NodeSpec]:
    """Return the robots' own nodes."""
    parameters = {
        "use_sim_time": True,
        "team": options.team,
        "heartbeat": _HEARTBEAT,
        "patience": 8.0 * _LEASE,
        "sensor_timeout": min(max(1.0, options.speed), _LONGEST_SENSOR_TIMEOUT),
    }
    return [
        NodeSpec("option_coordinator", "navigation_agent", parameters, namespace=name, remappings={"cmd_vel": RAW})
        for name in team.robots
    ]


def watchdogs(options: TeamConfig, team: TeamFile) -> list[NodeSpec]:
    """Return the watchdog of each robot."""
    return [watchdog(options.speed, namespace=name) for name in team.robots]
