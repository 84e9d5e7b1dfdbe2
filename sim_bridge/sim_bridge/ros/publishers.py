"""Publishes the state of a world, counting messages by topic."""

from __future__ import annotations

import math

from ctrl_rl_core.ros import LATCHED, ODOM_PUBLISHER, SCAN_PUBLISHER, float32_array, to_stamp
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState, LaserScan
from std_msgs.msg import String

from ctrl_rl_core import RESULT
from ctrl_rl_msgs.msg import EpisodeStatus
from sim_bridge.ros.frames import WORLD_FRAME, CountedPublisher, Frames, TransformPublisher, odometry_transform
from sim_bridge.ros.localisation import LocalisationPublisher
from sim_bridge.ros.robot_model import RobotModel
from sim_bridge.simulation.odometry import OdometryReading
from sim_bridge.simulation.world import SimulatedWorld

_LATE_JOINER_S = 1.0


class RobotPublisher:
    """Scan, odometry, ground truth, episode status, transforms and model of one robot of a world.

    Attributes:
        publishers: Publishers, one per topic.
    """

    def __init__(
        self,
        node: Node,
        world: SimulatedWorld,
        robot: int,
        frames: Frames,
        transforms: TransformPublisher,
        model: RobotModel,
        localisation: LocalisationPublisher,
    ) -> None:
        self._world, self._robot, self._frames, self._transforms = world, robot, frames, transforms
        self._model, self._localisation = model, localisation
        self._scan = CountedPublisher(node, LaserScan, frames.topic("scan"), SCAN_PUBLISHER)
        self._odom = CountedPublisher(node, Odometry, frames.topic("odom"), ODOM_PUBLISHER)
        self._truth = CountedPublisher(node, Odometry, frames.topic("ground_truth"), ODOM_PUBLISHER)
        self._episode = CountedPublisher(node, EpisodeStatus, frames.topic("episode"), RESULT)
        self._joints = CountedPublisher(node, JointState, frames.topic("joint_states"), ODOM_PUBLISHER)
        self._description = CountedPublisher(node, String, frames.topic("robot_description"), LATCHED)
        self._description.publish(model.description)
        told = () if localisation.publisher is None else (localisation.publisher,)
        self.publishers = (self._scan, self._odom, self._truth, self._episode, self._joints, *told)
        # Messages are serialised on publication, so each object is created once and reused.
        self._scan_message = LaserScan(scan_time=1.0 / world.lidar.spec.rate)
        self._scan_message.header.frame_id = frames.scan
        self._odom_message = _empty_odometry(frames.odom, frames.base)
        self._truth_message = _empty_odometry(WORLD_FRAME, frames.base)
        self._episode_message = EpisodeStatus()
        self._episode_message.header.frame_id = WORLD_FRAME

    def begin_episode(self) -> None:
        """Start a new episode."""
        self._localisation.begin_episode()

    def publish_scan(self, time: int) -> None:
        """Publish the ranges at simulation time `time` [ns]."""
        message, scan = self._scan_message, self._world.laser_scan(self._robot)
        message.header.stamp = to_stamp(time)
        message.ranges = float32_array(scan.ranges)
        message.angle_min, message.angle_increment = scan.angle_min, scan.angle_increment
        message.angle_max = scan.angle_min + scan.angle_increment * (len(scan.ranges) - 1)
        message.range_min, message.range_max = scan.range_min, scan.range_max
        self._scan.publish(message)

    def publish_odometry(self, time: int) -> None:
        """Publish odometry, transforms, joint states and the ground truth at simulation time `time` [ns]."""
        reading = self._world.odometry(self._robot)
        fill_odometry(self._odom_message, self._frames.plane, time, reading)
        self._odom.publish(self._odom_message)
        transforms = [*self._localisation.update(time, reading.pose), odometry_transform(self._odom_message)]
        angles = self._world.wheel_angles(self._robot)
        if angles is not None:
            self._joints.publish(self._model.joint_state(to_stamp(time), angles))
            transforms += self._model.wheels(to_stamp(time), angles)
        self._transforms.publish(transforms)
        pose, velocity = self._world.pose(self._robot), self._world.velocity(self._robot)
        fill_odometry(self._truth_message, self._frames.plane, time, OdometryReading(pose, velocity))
        attitude = self._truth_message.pose.pose.orientation
        attitude.x, attitude.y, attitude.z, attitude.w = self._world.quaternion(self._robot)
        self._truth.publish(self._truth_message)

    def publish_episode(self, time: int, number: int) -> None:
        """Publish the state of episode `number` at simulation time `time` [ns]."""
        episode, message = self._world.episode(self._robot), self._episode_message
        message.header.stamp = to_stamp(time)
        message.episode, message.seed = number, self._world.seed
        message.elapsed = self._world.elapsed
        message.clearance, message.smallest_clearance = episode.clearance, episode.smallest_clearance
        message.progress = episode.progress
        message.outcome.value = int(episode.outcome)
        self._episode.publish(message)


class ClockPublisher:
    """Publishes /clock at a maximum rate in wall and simulation time, and once a second for late joiners."""

    def __init__(self, node: Node, rate: float) -> None:
        self.publisher = CountedPublisher(node, Clock, "/clock", 1)
        self._period = 1.0 / rate
        self._wall, self._time = -math.inf, -1

    def publish(self, now: float, time: int) -> None:
        """Publish simulation time `time` [ns] if due at steady wall time `now` [s]."""
        waited, moved = now - self._wall, 1e-9 * (time - self._time)
        if (waited >= self._period and (moved >= self._period or self._time < 0)) or waited >= _LATE_JOINER_S:
            self._wall, self._time = now, time
            self.publisher.publish(Clock(clock=to_stamp(time)))


def _empty_odometry(parent: str, child: str) -> Odometry:
    message = Odometry(child_frame_id=child)
    message.header.frame_id = parent
    return message


def fill_odometry(message: Odometry, plane: str, time: int, reading: OdometryReading) -> None:
    """Write pose and body velocity of a plane, "xy" or "xz", into a message stamped `time` [ns]."""
    message.header.stamp = to_stamp(time)
    first, second, angle = reading.pose.tolist()
    along, aside, turn = reading.velocity.tolist()
    position, attitude, twist = message.pose.pose.position, message.pose.pose.orientation, message.twist.twist
    position.x, twist.linear.x, attitude.w = first, along, math.cos(0.5 * angle)
    if plane == "xy":
        position.y, twist.linear.y, twist.angular.z, attitude.z = second, aside, turn, math.sin(0.5 * angle)
    else:
        position.z, twist.linear.z, twist.angular.y, attitude.y = second, aside, turn, math.sin(0.5 * angle)
