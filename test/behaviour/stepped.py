"""Drives in stepped time: real nodes as processes, each scan answered before the simulation goes on.

In which order a node hears odometry and scan would be chance. So the bridge's topics lie in the namespace `world`, and
what it says is passed on here message by message, each once the one before has been dealt with; so are the commands.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from case import BehaviourError, Case
from commands import AS_REAL, NODES
from digests import Parts, digest, message_text

_SCAN_PERIOD_S = 0.2
_SEED = 11
_ATTEMPTS = 3
_SENSORS = ("world/scan", "world/odom", "ground_truth", "episode")
_COMMANDS = ("cmd_vel", "cmd_vel_raw")
_VALUES = ("reward", "time_to_reach", "oc_value")
_STEP, _RESET = "sim_bridge/step", "sim_bridge/reset"


@dataclass(frozen=True)
class Drive:
    """A drive.

    Attributes:
        driver: Name of the node that answers scans; its ROS name too but for the controller.
        node: ROS name of that node.
        latent: Whether it publishes its latent state.
        values: Whether the nodes that serve value functions run as well.
        world: More parameters of the bridge.
        own: More parameters of the driver.
        scans: How many scans are answered.
    """

    driver: str = "controller"
    node: str = "koopman_lqr_controller"
    latent: bool = True
    values: bool = False
    world: str = ""
    own: str = ""
    scans: int = 100

    @property
    def answers(self) -> tuple[str, ...]:
        """The topics with an answer to each scan."""
        return (*_COMMANDS, f"{self.node}/latent") if self.latent else _COMMANDS

    @property
    def served(self) -> tuple[str, ...]:
        """The topics with an answer to each odometry message."""
        return _VALUES if self.values else ()

    @property
    def nodes(self) -> dict[str, str]:
        """The command line of each node."""
        names = ("bridge", "watchdog", self.driver, *(("reward", "baseline") if self.values else ()))
        more = {"bridge": self.world, self.driver: self.own}
        return {name: f"{NODES[name]} {more.get(name, '')}" for name in names}


def run(folder: Path, drive: Drive) -> dict[str, Parts]:
    """Drive in stepped time and return a part for each topic.

    Sensors are sent with best effort: where a busy machine loses one, nobody answers it, and the drive begins anew.
    """
    for _ in range(_ATTEMPTS - 1):
        with suppress(BehaviourError):
            return _once(folder, drive)
    return _once(folder, drive)


def _once(folder: Path, drive: Drive) -> dict[str, Parts]:
    from geometry_msgs.msg import TwistStamped  # other cases need no ROS
    from nav_msgs.msg import Odometry
    from rcl_interfaces.srv import GetParameters
    from rclpy.qos import qos_profile_sensor_data
    from rig import Rig
    from sensor_msgs.msg import LaserScan

    from ctrl_rl_msgs.srv import ResetWorld, StepWorld

    look = f"{drive.node}/get_parameters"
    services = {_STEP: StepWorld, _RESET: ResetWorld, look: GetParameters}
    with Rig(folder, drive.nodes, _topics(drive), services) as rig:
        odometry = rig.publisher(Odometry, "odom", 1 + 2 * drive.values)
        scans = rig.publisher(LaserScan, "scan", 1, qos_profile_sensor_data)
        commands = rig.publisher(TwistStamped, "world/cmd_vel", 1)
        rig.stamped(_SENSORS, rig.call(_STEP, duration=_SCAN_PERIOD_S).stamp)
        rig.forget()  # what was said before everyone listened
        rig.call(_RESET, seed=_SEED)
        passed, said = 0, {topic: [] for topic in drive.answers}
        for _ in range(drive.scans):
            stamp = rig.call(_STEP, duration=_SCAN_PERIOD_S).stamp
            scan = rig.stamped(_SENSORS, stamp)[0]
            for message in rig.heard["world/odom"][passed:]:
                odometry.publish(message)
                rig.stamped(drive.served, message.header.stamp)
                rig.call(look, names=["use_sim_time"])  # once it answers, the driver knows the odometry
                passed += 1
            scans.publish(scan)
            answers = rig.stamped(drive.answers, stamp)
            rig.publish(commands, answers[0])
            for topic, answer in zip(drive.answers, answers, strict=True):
                said[topic].append(answer)
        return {"": _parts(folder, rig.heard | said)}


def _parts(folder: Path, messages: dict[str, list[Any]]) -> Parts:
    """Return a digest for each topic, and leave the texts in the folder, to be compared by hand."""
    out = {}
    for topic, each in messages.items():
        text = "\n".join(map(message_text, each))
        (folder / f"heard-{topic.replace('/', '-')}.txt").write_text(text, encoding="utf-8")
        out[topic] = digest(text)
    return out


def _topics(drive: Drive) -> dict[str, Any]:
    """Return the message types of the topics that are heard."""
    from geometry_msgs.msg import TwistStamped
    from nav_msgs.msg import Odometry
    from sensor_msgs.msg import LaserScan

    from ctrl_rl_msgs.msg import EpisodeStatus, LatentState, StateValue, TaskReward

    return (
        dict(zip(_SENSORS, (LaserScan, Odometry, Odometry, EpisodeStatus), strict=True))
        | dict(zip(drive.answers, (TwistStamped, TwistStamped, LatentState), strict=False))
        | dict(zip(drive.served, (TaskReward, StateValue, StateValue), strict=False))
    )


_DRIVES = {
    "stepped_demo": Drive(values=True),
    "stepped_edmd": Drive(own="-p policy:=curved_corridor_edmd", world="-p corridor_width:=0.6"),
    "stepped_as_real": Drive(world=AS_REAL),
    "stepped_scripted": Drive("scripted_driver", "scripted_driver", latent=False),
}
STEPPED = tuple(
    Case(name, after=("solve_corridor",) if drive.values else (), work=partial(run, drive=drive))
    for name, drive in _DRIVES.items()
)
