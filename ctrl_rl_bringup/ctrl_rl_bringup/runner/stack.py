"""The nodes of a run, for `processes.py`, which starts them without ROS's launch, and for `demo.launch.py`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ctrl_rl_core import NavigationTask, load_navigation_task
from koopman_lqr_controller import DEFAULT_POLICY

RAW = "cmd_vel_raw"
"""Topic of the driver's commands, which the watchdog forwards to the robot as cmd_vel."""
SAFE = "cmd_vel_safe"
"""Topic of the safety filter's commands, which the watchdog forwards if there is a filter."""
RAW_THRUSTS = "rotor_thrusts_raw"
"""Topic of the pilot's commands, which the watchdog forwards to the quadrotor as rotor_thrusts."""
SAFE_THRUSTS = "rotor_thrusts_safe"
"""Topic of the flight guard's commands, which the watchdog forwards if there is a guard."""
_ODOMETRY, _MOST_ODOMETRY = 30.0, 240.0
"""Default and maximum rate of the bridge's odometry [Hz]."""
_GUARDED_ODOMETRY = 120.0
"""Minimum rate of odometry for the flight guard [Hz]: three a period."""
_UNGUARDED = {"robot_radius": 0.0, "min_echo_share": 0.0, "largest_gap": 6.3, "frozen_scans": 0}
_WATCHDOG_S = 2.0
"""Time-out [s]: a busy machine may stall for a second, in which a simulated robot does not move either."""


@dataclass(frozen=True)
class NodeSpec:
    """One node of a run.

    Attributes:
        package: Name of the node's package.
        executable: Executable as `ros2 run PACKAGE EXECUTABLE` names it.
        parameters: Parameter values by name.
        publishes: Topics of the node that a drive waits for.
        namespace: Namespace of the node, empty for none.
        remappings: New names of topics, by the node's names.
    """

    package: str
    executable: str
    parameters: Mapping[str, Any] = field(default_factory=dict)
    publishes: tuple[str, ...] = ()
    namespace: str = ""
    remappings: Mapping[str, str] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Name of its process, unique where several share one executable."""
        return f"{self.namespace}.{self.executable}" if self.namespace else self.executable


@dataclass(frozen=True)
class DriveConfig:
    """Configuration of a drive.

    Attributes:
        folder: New folder of the run, for bag, logs, report and picture.
        task: Name or file of the task.
        policy: Name or file of the policy.
        seed: Seed of start pose and noise.
        speed: Simulation time per wall time; 0 for as fast as possible.
        width: Width of the corridor [m]; 0 for the task's.
        gui: Whether PyBullet shows a window.
        randomise_width: Whether each reset draws the corridor's width from the task's range.
        safety_filter: Whether the safety filter stands between the driver and the watchdog.
        simulation: Further parameters of the simulator by name: lidar, drop-outs, delay and so on.
        ready_limit: Time within which all nodes must be ready [s].
    """

    folder: Path
    task: str = "curved_corridor"
    policy: str = DEFAULT_POLICY
    seed: int = 0
    speed: float = 1.0
    width: float = 0.0
    gui: bool = False
    randomise_width: bool = False
    safety_filter: bool = False
    simulation: Mapping[str, Any] = field(default_factory=dict)
    ready_limit: float = 600.0

    @property
    def bag(self) -> Path:
        """Where the bag is written."""
        return self.folder / "bag"


def simulator(options: DriveConfig) -> NodeSpec:
    """Return the bridge; it starts paused, so that nothing happens before everyone listens.

    Odometry comes with each scan of the task's lidar, or at the bridge's default rate if that is higher.
    """
    task = load_navigation_task(options.task)
    scans, least = task.lidar.rate, _GUARDED_ODOMETRY if options.safety_filter and task.plane == "xz" else _ODOMETRY
    parameters = {
        "odom_rate": min(scans * math.ceil(least / scans), _MOST_ODOMETRY),
        "task": options.task,
        "seed": options.seed,
        "speed_factor": float(options.speed),
        "corridor_width": float(options.width),
        "gui": options.gui,
        "randomise_width": options.randomise_width,
        "start_paused": True,
        **options.simulation,
    }
    return NodeSpec("sim_bridge", "bridge", parameters)


def recorder(options: DriveConfig, digests: Mapping[str, Path]) -> NodeSpec:
    """Return the recorder of every topic; `digests` names the files whose SHA-256 the bag is to hold."""
    files = [f"{name}={path}" for name, path in digests.items()]
    parameters = {"use_sim_time": True, "output": str(options.bag), "digest_files": files}
    return NodeSpec("ctrl_rl_bags", "recorder", parameters)


def safety_filter(task: NavigationTask) -> NodeSpec:
    """Return the safety filter between a driver and its watchdog, for the speed of the task's movers.

    If there are movers, the map tells walls from people; the simulator's odometry starts in the map's frame.
    """
    parameters = {
        "use_sim_time": True,
        "robot": task.robot.body,
        "mover_speed": _fastest_mover(task),
        "use_map": bool(task.movers),
    }
    return NodeSpec("ctrl_rl_safety", "safety_filter", parameters, (SAFE,), remappings={"cmd_vel": SAFE})


def _fastest_mover(task: NavigationTask) -> float:
    """Return the maximum speed of a task's movers [m/s]."""
    tracks = [each.track or each.wander for each in task.movers]
    return max((each.speed.high for each in tracks if each is not None), default=0.0)


def controller(options: DriveConfig) -> NodeSpec:
    """Return the Koopman-LQR controller.

    Behind the safety filter it does without its guards against scans unlike those of training or of its prediction:
    a person who passes causes such scans, and the robot would stand for good where it was turned aside.
    """
    parameters: dict[str, Any] = {"use_sim_time": True, "policy": options.policy}
    if options.safety_filter:
        parameters |= {"largest_distance": 0.0, "largest_error": 0.0}
    return NodeSpec("koopman_lqr_controller", "controller", parameters, (RAW,), remappings={"cmd_vel": RAW})


def policy_nodes(options: DriveConfig, task: NavigationTask) -> list[NodeSpec]:
    """Return the node that drives or flies any policy, and its robot's watchdog.

    Policies for arenas have learnt to keep clear of obstacles. Their obstacle stop is off, because their speeds are too
    high and their beams too few for it. In a corridor it is on.
    """
    parameters: dict[str, Any] = {"use_sim_time": True, "policy": options.policy}
    if task.robot.robot is not None and task.plane == "xy":
        parameters["robot"] = task.robot.body
    if task.corridor is None:
        parameters |= _UNGUARDED
    elif task.doorways is not None:
        parameters |= through_doorways(task)
    if task.plane == "xz":
        pilot = NodeSpec(
            "ctrl_rl_core", "policy", parameters, (RAW_THRUSTS,), remappings={"rotor_thrusts": RAW_THRUSTS}
        )
        if not options.safety_filter:
            return [pilot, thrust_watchdog(options.speed, task)]
        return [pilot, flight_guard(options.task), thrust_watchdog(options.speed, task, SAFE_THRUSTS)]
    driver = NodeSpec("ctrl_rl_core", "policy", parameters, (RAW,), remappings={"cmd_vel": RAW})
    speed, turn = (max(abs(each.low), abs(each.high)) for each in task.robot.commands.values())
    return [driver, *guards(options, task, largest_speed=speed, largest_turn_rate=turn)]


def through_doorways(task: NavigationTask) -> dict[str, float]:
    """Return driver parameters with which the obstacle stop lets the robot through narrow doorways."""
    robot = task.robot.robot
    assert robot is not None, "a robot in a corridor"
    return {"robot_radius": robot.through_gaps, "obstacle_margin": 0.0}


def guards(options: DriveConfig, task: NavigationTask, **limits: float) -> list[NodeSpec]:
    """Return the nodes between a driver and its robot: the watchdog and, if wanted, the safety filter."""
    if not options.safety_filter:
        return [watchdog(options.speed, "", RAW, **limits)]
    return [safety_filter(task), watchdog(options.speed, "", SAFE, **limits)]


def watchdog(speed: float, namespace: str = "", hears: str = RAW, **limits: float) -> NodeSpec:
    """Return the watchdog between a driver and its robot; in slow simulations it waits longer for a command."""
    parameters = {"use_sim_time": True, "timeout": _timeout(speed), **limits}
    remappings = {RAW: hears} if hears != RAW else {}
    return NodeSpec("ctrl_rl_core", "watchdog", parameters, namespace=namespace, remappings=remappings)


def flight_guard(task: str) -> NodeSpec:
    """Return the guard between a pilot and its watchdog, for flights that end at the goal of a task.

    The simulator's odometry starts in the frame of the task.
    """
    parameters = {"use_sim_time": True, "task": task, "goal": True}
    remappings = {"rotor_thrusts": SAFE_THRUSTS}
    return NodeSpec("ctrl_rl_safety", "flight_guard", parameters, (SAFE_THRUSTS,), remappings=remappings)


def thrust_watchdog(speed: float, task: NavigationTask, hears: str = RAW_THRUSTS) -> NodeSpec:
    """Return the watchdog between a pilot and its quadrotor; it does not stop the rotors of a paused simulation.

    A pilot has the thrust limits of its task, the flight guard those of the rotors.
    """
    system = task.system.build()
    pilots, rotors = max(each.high for each in task.robot.commands.values()), float(system.control_bounds[1].max())
    parameters = {
        "use_sim_time": True,
        "timeout": _timeout(speed),
        "rest_thrust": 0.5 * system.parameters["m"] * system.parameters["g"],
        "hover_for": 0.0,
        "largest_thrust": pilots if hears == RAW_THRUSTS else rotors,
    }
    remappings = {RAW_THRUSTS: hears} if hears != RAW_THRUSTS else {}
    return NodeSpec("ctrl_rl_core", "thrust_watchdog", parameters, remappings=remappings)


def _timeout(speed: float) -> float:
    return min(_WATCHDOG_S / min(1.0, speed) if speed > 0.0 else _WATCHDOG_S, 60.0)


def value_nodes(options: DriveConfig, files: Mapping[str, Path]) -> list[NodeSpec]:
    """Return the nodes that serve the value functions `files`, see `prepare.value_files`.

    The simulator's odometry starts in the frame of the map.
    """
    nodes = []
    if "time_to_reach" in files:
        parameters = _served(files["time_to_reach"], task=options.task, corridor_width=float(options.width))
        nodes.append(NodeSpec("ttr_reward_node", "reward", parameters, ("reward", "time_to_reach")))
    if "oc_value" in files:
        parameters = _served(files["oc_value"], task=options.task)
        nodes.append(NodeSpec("oc_baseline_node", "baseline", parameters, ("oc_value",)))
    return nodes


def _served(file: Path, **more: Any) -> dict[str, Any]:
    return {"use_sim_time": True, "grid": str(file), **more}


def scripted_driver(seed: int) -> NodeSpec:
    """Return the driver of training drives."""
    parameters = {"use_sim_time": True, "seed": seed}
    return NodeSpec("koopman_lqr_controller", "scripted_driver", parameters, (RAW,), remappings={"cmd_vel": RAW})
