"""A team's run under its coordinator: its nodes, started, watched and ended together."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from ctrl_rl_core.ros import seconds
from option_coordinator.nodes import EXCHANGE
from option_coordinator.protocol import GrantStatus
from option_coordinator.scripted import SCRIPTED
from option_coordinator.teams import Work, load_room, room_file

from ctrl_rl_bringup.runner.monitor import RECORDER, Monitor, MonitorError, ProgressDisplay
from ctrl_rl_bringup.runner.prepare import new_run
from ctrl_rl_bringup.runner.processes import Processes, ros
from ctrl_rl_bringup.runner.stack import RAW, DriveConfig, NodeSpec, recorder, simulator, watchdog
from ctrl_rl_core import task_file
from ctrl_rl_msgs.msg import AgentStatus, JointOptionStep, OptionGrant
from option_coordinator import OptionPolicy, TeamFile, load_team, policy_file, shipped_policies, team_file

_LEASE = 0.5
_HEARTBEAT = 0.1
_LONGEST_STALE, _LONGEST_SENSOR_TIMEOUT = 600.0, 10.0
"""Maximum values of the nodes' parameters [s]; at such speeds the world runs as fast as it can."""


@dataclass(frozen=True)
class TeamConfig:
    """Configuration of a team's run.

    Attributes:
        folder: New folder of the run, for bag, logs, report and picture.
        team: Name or file of the team.
        room: Name or file of a navigation task; empty for the team's own.
        policy: Policy parameter of the coordinator; if empty the package's policy for the team, or 'spread'.
        seed: Seed of starts, noise and draws.
        speed: Simulation time per wall time.
        gui: Whether PyBullet shows a window.
        engine: Physics engine of the simulator, "auto" for PyBullet where it is installed, else MuJoCo.
        ready_limit: Time within which all nodes must be ready [s].
        limit: Simulated time after which the run is cut off [s]; 0 for three of the team's episodes.
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
    limit: int = 0

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
        """The configuration of a run with one robot."""
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
    """Return the coordinator. Stamps are in simulated time, so observations age at the simulation's speed."""
    parameters = {
        "use_sim_time": True,
        "team": options.team,
        "policy": options.policy_name,
        "seed": options.seed,
        "lease": _LEASE,
        "lost_after": 4.0 * _LEASE,
        "stale": min(4.0 * _LEASE * max(1.0, options.speed), _LONGEST_STALE),
        "repeat": _HEARTBEAT,
        "memory" if load_team(options.team).deliveries else "work": str((options.folder / "work.sqlite").absolute()),
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
        NodeSpec(
            "option_coordinator",
            "navigation_agent",
            {**parameters, "memory": str((options.folder / f"work_{name}.sqlite").absolute())},
            namespace=name,
            remappings={"cmd_vel": RAW},
        )
        for name in team.robots
    ]


def watchdogs(options: TeamConfig, team: TeamFile) -> list[NodeSpec]:
    """Return the watchdog of each robot."""
    return [watchdog(options.speed, namespace=name) for name in team.robots]


_SILENT_S = 60.0
_EPISODES = 3.0
"""Default limit of a run [episodes of the team]."""


class TeamMonitor(Monitor):
    """Follows a team until its coordinator reports that the work is over or cut off, or the limit has passed.

    Args:
        check: Called repeatedly; raises if a node of the run has died.
        team: Team to follow.
        ready_limit: Time within which all nodes must be ready [s].
        limit: Simulated time after which the run is cut off [s]; 0 for three of the team's episodes.
    """

    def __init__(self, check: Callable[[], None], team: TeamFile, ready_limit: float, limit: float = 0.0) -> None:
        super().__init__(check, ready_limit=ready_limit)
        self._team = team
        self._limit_s = limit or _EPISODES * team.learning.episode
        self._began: float | None = None
        own = [f"{robot}/{topic}" for robot in team.robots for topic in ("scan", "odom", RAW, "cmd_vel", "episode")]
        self._topics = ("clock", "joint_option_step", "option_grants", *own)
        self._shared = ("option_requests", "agent_status")
        self._over = False
        self._granted: set[tuple[str, int]] = set()
        self._node.create_subscription(JointOptionStep, "joint_option_step", self._on_step, EXCHANGE)
        self._node.create_subscription(OptionGrant, "option_grants", self._on_grant, EXCHANGE)
        self._node.create_subscription(AgentStatus, "agent_status", self._on_status, EXCHANGE)

    def follow_team(self) -> None:
        """Show progress until the work is over.

        Raises:
            MonitorError: The robots' messages stopped.
        """
        self._heard = time.monotonic()
        display = ProgressDisplay("working", 10)
        wanted = len(self._team.robots) * (2 * self._team.deliveries + 1) if self._team.deliveries else math.inf
        try:
            while not self._over:
                self._spin()
                if time.monotonic() - self._heard > _SILENT_S:
                    raise MonitorError(f"no message from any robot for {_SILENT_S:g} s: do they still run?")
                display.show(min(1.0, len(self._granted) / wanted), f"{len(self._granted)} options granted")
        finally:
            display.close()

    def _on_step(self, message: JointOptionStep) -> None:
        self._over = self._over or message.terminated or message.truncated

    def _on_status(self, message: AgentStatus) -> None:
        self._heard, now = time.monotonic(), seconds(message.header.stamp)
        self._began = now if self._began is None else min(self._began, now)
        self._over = self._over or now - self._began > self._limit_s

    def _on_grant(self, message: OptionGrant) -> None:
        if message.status == GrantStatus.GRANTED and self._team.options[message.option_name].work is not Work.WAIT:
            self._granted.add((message.agent, message.grant_id))

    def _missing(self) -> str:
        missing = super()._missing()
        if missing:
            return missing
        for topic in self._shared:
            if self._node.count_publishers(topic) < len(self._team.robots):
                return f"not all robots publish {topic}"
            if RECORDER not in self._subscribers(topic):
                return f"the recorder does not hear {topic}"
        return ""


def new_team_run(options: TeamConfig) -> tuple[TeamFile, dict[str, Path]]:
    """Make the folder of a run; return its team, and the files whose digests go into its bag.

    Raises:
        CtrlRlError: Team, room or policy cannot be read, or the folder exists.
    """
    team = load_team(options.team)
    load_room(team, options.room)
    digests = {"task": task_file(options.task), "team": team_file(options.team)}
    if options.policy_name not in SCRIPTED:
        digests["policy"] = policy_file(options.policy_name)
        OptionPolicy.load_for(options.policy_name, (robot.agent for robot in team.coordinated))
    new_run(options.drive)
    return team, digests


def run_team(options: TeamConfig) -> None:
    """Run a team once and record everything."""
    team, digests = new_team_run(options)
    others = [coordinator(options), *watchdogs(options, team), *agents(options, team)]
    with ros(), Processes(options.folder) as processes:
        processes.start([recorder(options.drive, digests), team_simulator(options, team), *others])
        _follow(TeamMonitor(processes.check, team, options.ready_limit, options.limit))
        for name in (*(node.name for node in reversed(others)), "bridge", "recorder"):
            processes.stop(name)


def follow_running_team(team: TeamFile, ready_limit: float, limit: float) -> int:
    """Follow a team whose nodes run already; return 0 once its work is over or cut off."""
    with ros():
        _follow(TeamMonitor(lambda: None, team, ready_limit, limit))
    return 0


def _follow(monitor: TeamMonitor) -> None:
    with monitor.session():
        monitor.run()
        monitor.follow_team()
