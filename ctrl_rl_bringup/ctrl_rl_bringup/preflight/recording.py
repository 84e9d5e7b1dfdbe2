"""What a pre-flight heard: messages as plain data, and the endpoints of topics."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from ctrl_rl_core.sensing import echoes
from numpy.typing import NDArray

from ctrl_rl_bringup.preflight.frames import FrameTree
from ctrl_rl_core import OccupancyMap, ScanGeometry

_MOST = 50_000
"""Number of messages kept per topic: ten minutes at 80 Hz."""
Points = NDArray[np.float64]


class Times(NamedTuple):
    """When a message arrived, and when it was stamped.

    Attributes:
        arrival: Steady time of this computer on arrival [s].
        age: Time of this computer, or of the simulation, on arrival minus the message's stamp [s].
        stamp: Stamp of the message [s].
    """

    arrival: float
    age: float
    stamp: float


@dataclass(frozen=True)
class ScanSample:
    """One sensor_msgs/LaserScan.

    Attributes:
        times: Arrival and stamp.
        frame: Frame of the lidar.
        ranges: Ranges (beams,) [m].
        geometry: Bearings and limits of its beams in the lidar's frame.
    """

    times: Times
    frame: str
    ranges: NDArray[np.float32]
    geometry: ScanGeometry

    def points(self, lidar_x: float, lidar_yaw: float) -> Points:
        """Return its echoes in the robot's frame (n, 2) [m], given the lidar's position [m] and direction [rad]."""
        return echoes(self.ranges, self.geometry.turned(lidar_yaw), math.inf, lidar_x)


@dataclass(frozen=True)
class OdometrySample:
    """One nav_msgs/Odometry.

    Attributes:
        times: Arrival and stamp.
        frame: Frame that the pose is given in.
        child: Frame that it places.
        pose: x, y, yaw [m, m, rad].
        twist: Speed [m/s] and turn rate [rad/s].
        fault: Reason why it is unusable, with NaN for its numbers; empty if it is usable.
    """

    times: Times
    frame: str
    child: str
    pose: tuple[float, float, float]
    twist: tuple[float, float]
    fault: str = ""


class Battery(NamedTuple):
    """Charge, 0 to 1, and voltage [V] of a sensor_msgs/BatteryState; NaN if the driver does not report them."""

    charge: float
    voltage: float


class Endpoint(NamedTuple):
    """A publisher or subscriber of a topic: full name of its node, message type, and quality of service."""

    node: str
    kind: str
    qos: Any


@dataclass(frozen=True)
class Topic:
    """Endpoints of a topic.

    Attributes:
        name: Full name of the topic.
        publishers: Publishers, without this program's.
        subscribers: Subscribers, without this program's.
    """

    name: str
    publishers: tuple[Endpoint, ...] = ()
    subscribers: tuple[Endpoint, ...] = ()


@dataclass
class Recording:
    """What was heard in a span of time.

    Attributes:
        begin: Steady time at which the time began [s].
        end: Steady time at which it ended [s].
        simulated: Whether a /clock gave the time.
        scans: Scans, in order of arrival.
        odometry: Odometry, in order of arrival.
        battery: Last state of the battery, or None.
        frames: Frames of /tf and /tf_static; None if tf2_msgs is not installed.
        map: Map and its frame, or None.
        map_fault: Reason why the map is unusable, or empty.
        map_pose: Frame, and x, y, yaw [m, m, rad] in it, of the last amcl_pose, or None.
        topics: Endpoints of each topic, by this program's names.
        unstamped: Whether commands will be Twist instead of TwistStamped.
        command_topic: Topic that commands will be sent on, a key of `topics`.
    """

    begin: float = 0.0
    end: float = 0.0
    simulated: bool = False
    scans: deque[ScanSample] = field(default_factory=partial(deque, maxlen=_MOST))
    odometry: deque[OdometrySample] = field(default_factory=partial(deque, maxlen=_MOST))
    battery: Battery | None = None
    frames: FrameTree | None = None
    map: tuple[str, OccupancyMap] | None = None
    map_fault: str = ""
    map_pose: tuple[str, tuple[float, float, float]] | None = None
    topics: dict[str, Topic] = field(default_factory=dict)
    unstamped: bool = False
    command_topic: str = "cmd_vel"

    def topic(self, name: str) -> Topic:
        """Return a topic's endpoints, by this program's name for it."""
        return self.topics.get(name, Topic(name))
