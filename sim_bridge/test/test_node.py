"""The bridge as a real process, over real ROS."""

import itertools
import math
import signal
import sys
import time

import numpy as np
import pytest
import rclpy
from ctrl_rl_core.ros import LATCHED, seconds
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped, Twist, TwistStamped
from nav_msgs.msg import OccupancyGrid, Odometry
from preloaded import Preloaded
from rclpy.duration import Duration
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState, LaserScan
from std_msgs.msg import String
from std_srvs.srv import SetBool
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import MarkerArray

from ctrl_rl_core import RESULT, SENSOR, OccupancyMap
from ctrl_rl_msgs.msg import EpisodeStatus, Movers, RotorThrusts, TaskOutcome
from ctrl_rl_msgs.srv import ResetWorld, StepWorld

PROGRAM = [
    sys.executable,
    "-c",
    "import sys; from sim_bridge.ros.bridge_node import main; sys.exit(main())",
    "--ros-args",
]
PATIENCE = 120.0


def arguments(**parameters):
    return [part for name, value in parameters.items() for part in ("-p", f"{name}:={value}")]


class Client:
    """Communicates with one bridge process and stores its messages."""

    def __init__(self, kind=TwistStamped, namespace="", **parameters):
        self.process = Preloaded([*PROGRAM, *arguments(**parameters)])
        self.node = rclpy.create_node("bridge_test")
        self.heard = {}
        topics = {"scan": LaserScan, "odom": Odometry, "ground_truth": Odometry, "episode": EpisodeStatus}
        for topic, message in topics.items():
            self.listen(
                message, f"{namespace}/{topic}" if namespace else topic, SENSOR if topic != "episode" else RESULT
            )
        self.listen(Clock, "/clock", 1)
        self.listen(DiagnosticArray, "diagnostics", 10)
        topic = "rotor_thrusts" if kind is RotorThrusts else "cmd_vel"
        self.commands = self.node.create_publisher(kind, f"{namespace}/{topic}" if namespace else topic, 1)
        self.services = {
            name: self.node.create_client(kind, f"sim_bridge/{name}")
            for name, kind in (("reset", ResetWorld), ("pause", SetBool), ("step", StepWorld))
        }
        for service in self.services.values():
            assert service.wait_for_service(PATIENCE)
        self.until(lambda: self.commands.get_subscription_count() == 1)

    def listen(self, kind, topic, qos):
        self.heard[topic] = []
        self.node.create_subscription(kind, topic, self.heard[topic].append, qos)

    def until(self, condition):
        end = time.monotonic() + PATIENCE
        while not condition():
            assert time.monotonic() < end, "waited in vain"
            rclpy.spin_once(self.node, timeout_sec=0.05)

    def call(self, name, **fields):
        service = self.services[name]
        future = service.call_async(service.srv_type.Request(**fields))
        rclpy.spin_until_future_complete(self.node, future, timeout_sec=PATIENCE)
        assert future.result() is not None
        return future.result()

    def speeds(self, v, omega):
        message = TwistStamped()
        message.twist.linear.x, message.twist.angular.z = v, omega
        self.commands.publish(message)
        assert self.commands.wait_for_all_acked(Duration(seconds=10))  # so that a step asked for next obeys it

    def diagnostics(self):
        """Return the key figures of the next report."""
        self.heard["diagnostics"].clear()
        self.until(lambda: self.heard["diagnostics"])
        return {value.key: value.value for value in self.heard["diagnostics"][-1].status[0].values}

    def close(self, number=signal.SIGINT):
        """Ask the bridge to stop and return its exit code."""
        self.process.send_signal(number)
        return self.process.wait(120.0)


@pytest.fixture
def start():
    """Return a function that starts a bridge and a client."""
    rclpy.init()
    clients = []

    def make(**parameters):
        clients.append(Client(**parameters))
        return clients[-1]

    yield make
    for client in clients:
        client.process.kill()
        client.process.wait()
        client.node.destroy_node()
    rclpy.try_shutdown()


def test_a_running_bridge_moves_the_robot_reports_and_stops_in_good_order(start):
    client = start(speed_factor=5.0, seed=1)
    client.until(lambda: client.heard["odom"] and client.heard["scan"] and client.heard["/clock"])
    begin = client.heard["odom"][0].pose.pose.position.x
    end = time.monotonic() + PATIENCE
    while client.heard["odom"][-1].pose.pose.position.x < begin + 0.05:
        assert time.monotonic() < end
        client.speeds(0.2, 0.0)
        rclpy.spin_once(client.node, timeout_sec=0.02)
    scan, odom, truth = client.heard["scan"][-1], client.heard["odom"][-1], client.heard["ground_truth"][-1]
    assert len(scan.ranges) == 360
    assert (scan.header.frame_id, odom.header.frame_id, odom.child_frame_id) == ("base_scan", "odom", "base_footprint")
    assert truth.header.frame_id == "map"
    assert scan.range_min == pytest.approx(0.12)
    assert scan.angle_increment == pytest.approx(math.tau / 360)
    values = client.diagnostics()
    assert values["episode"] == "0"
    assert (
        int(values["published./odom"])
        == int(values["published./ground_truth"])
        == int(values["published./episode"])
        > 0
    )
    assert int(values["published./scan"]) > 0
    assert int(values["published./clock"]) > 0
    assert client.close() == 0


def test_pause_step_and_reset(start):
    client = start(start_paused="true", seed=1)
    assert client.call("reset", seed=5).episode == 1
    client.until(lambda: client.heard["episode"] and client.heard["episode"][-1].seed == 5)
    stamp = seconds(client.call("step", duration=0.5).stamp)
    assert seconds(client.call("step", duration=1e-9).stamp) == pytest.approx(stamp + 1 / 240, abs=1e-6)
    for duration in (0.0, -1.0, math.nan, 1e9):
        answer = client.call("step", duration=duration)
        assert not answer.success
        assert "must be more than 0" in answer.message
    client.until(lambda: client.heard["episode"][-1].elapsed >= 0.49)
    status = client.heard["episode"][-1]
    assert (status.episode, status.seed, status.outcome.value) == (1, 5, TaskOutcome.RUNNING)
    assert status.clearance > 0.0
    assert client.call("pause", data=False).success
    assert "pause it first" in client.call("step", duration=0.1).message
    client.until(lambda: client.heard["episode"][-1].elapsed > 0.7)
    assert client.call("pause", data=True).success
    begin = client.call("step", duration=0.1).stamp
    assert seconds(client.call("step", duration=0.1).stamp) == pytest.approx(seconds(begin) + 0.1)
    answer = client.call("reset", seed=2**63)
    assert (answer.success, answer.episode) == (True, 2)
    client.until(lambda: client.heard["episode"][-1].seed == 2**63)
    stamps = [seconds(message.header.stamp) for message in client.heard["odom"]]
    assert all(later > earlier for earlier, later in itertools.pairwise(stamps))
    client.until(lambda: len(client.heard["/clock"]) > 1)
    assert client.close() == 0


def test_a_lidar_turns_as_often_as_it_is_asked_to(start):
    """The process is ended by SIGTERM."""
    client = start(start_paused="true", scan_rate=8.0)
    client.call("step", duration=1.0)
    client.until(lambda: len(client.heard["scan"]) > 5)
    stamps = [seconds(message.header.stamp) for message in client.heard["scan"]]
    assert np.diff(stamps) == pytest.approx(0.125)
    assert client.heard["scan"][-1].scan_time == pytest.approx(0.125)
    assert client.close(signal.SIGTERM) == 0


def stepped_drive(start, **parameters):
    """Return the messages of a stepped bridge for fixed commands, as bytes."""
    client = start(start_paused="true", odom_drift=0.05, scan_dropout=0.05, **parameters)
    assert client.call("reset", seed=11).success
    record = []
    for step in range(15):
        client.speeds(0.2, 0.6 * (-1) ** step)
        target = client.call("step", duration=0.2).stamp
        client.until(lambda stamp=target: client.heard["scan"] and client.heard["scan"][-1].header.stamp == stamp)
        client.until(lambda stamp=target: client.heard["odom"] and client.heard["odom"][-1].header.stamp == stamp)
        scan, pose = client.heard["scan"][-1], client.heard["odom"][-1].pose.pose
        record.append(np.frombuffer(scan.ranges, np.float32).tobytes())
        record.append(np.array((pose.position.x, pose.position.y, pose.orientation.z)).tobytes())
    moved = pose.position.x
    assert client.close() == 0
    return b"".join(record), moved


def test_stepped_runs_are_the_same_bit_by_bit(start):
    first, moved = stepped_drive(start, seed=1)
    second, _ = stepped_drive(start, seed=2)
    assert first == second
    assert moved > 0.5


def test_robots_in_namespaces_see_each_other(start):
    client = start(namespace="second", robots="['first', 'second']", start_paused="true", scan_noise=0.0, seed=4)
    client.listen(LaserScan, "first/scan", SENSOR)
    client.listen(Odometry, "first/odom", SENSOR)
    client.call("step", duration=0.4)
    client.until(
        lambda: all(client.heard[f"{name}/{topic}"] for name in ("first", "second") for topic in ("scan", "odom"))
    )
    poses, lidars = {}, {}
    for name in ("first", "second"):
        pose = client.heard[f"{name}/odom"][-1].pose.pose
        theta = 2 * math.atan2(pose.orientation.z, pose.orientation.w)
        poses[name] = (pose.position.x, pose.position.y, theta)
        lidars[name] = (pose.position.x - 0.032 * math.cos(theta), pose.position.y - 0.032 * math.sin(theta))
        assert client.heard[f"{name}/scan"][-1].header.frame_id == f"{name}/base_scan"
    gap = math.dist(lidars["first"], lidars["second"])
    for name, other in (("first", "second"), ("second", "first")):
        bearing = math.atan2(lidars[other][1] - lidars[name][1], lidars[other][0] - lidars[name][0]) - poses[name][2]
        beam = round(math.degrees(bearing)) % 360
        assert client.heard[f"{name}/scan"][-1].ranges[beam] == pytest.approx(gap - 0.035, abs=0.01)
    client.speeds(0.2, 0.0)
    client.call("step", duration=1.0)
    client.until(lambda: client.heard["second/odom"][-1].header.stamp.sec >= 1)
    assert abs(client.heard["second/odom"][-1].pose.pose.position.x - poses["second"][0]) > 0.05
    assert client.heard["first/odom"][-1].twist.twist.linear.x == pytest.approx(0.0, abs=0.01)
    assert client.close() == 0


def test_commands_time_out_and_nonsense_is_refused_and_counted(start):
    client = start(kind=Twist, start_paused="true", enable_stamped_cmd_vel="false")
    message = Twist()
    message.linear.x = 0.2
    now = 0.0

    def step(duration):
        nonlocal now
        client.call("step", duration=duration)
        now += duration
        client.until(lambda: client.heard["odom"] and seconds(client.heard["odom"][-1].header.stamp) > now - 0.01)
        return client.heard["odom"][-1].twist.twist.linear.x

    def moves():  # a topic and a service have no order between them: the command may come after the step
        client.commands.publish(message)
        return step(0.1) == pytest.approx(0.2, rel=0.05)

    client.until(moves)
    message.linear.x = math.nan
    client.commands.publish(message)
    assert step(0.3) == pytest.approx(0.2, rel=0.05)
    assert step(1.0) == pytest.approx(0.0, abs=0.005)
    assert client.diagnostics()["refused_commands"] == "1"
    assert client.close() == 0


def test_a_quadrotor_flies_by_rotor_thrusts(start):
    client = start(kind=RotorThrusts, task="quad_ttr", start_paused="true")
    client.call("step", duration=0.1)
    client.until(lambda: client.heard["odom"])
    begin = client.heard["odom"][0].pose.pose.position
    client.commands.publish(RotorThrusts(t1=7.0, t2=7.0))
    client.call("step", duration=0.4)
    client.until(lambda: seconds(client.heard["odom"][-1].header.stamp) > 0.49)
    odom = client.heard["odom"][-1]
    assert odom.pose.pose.position.z > begin.z + 0.05
    assert odom.pose.pose.position.y == 0.0
    assert odom.child_frame_id == "base_link"
    assert len(client.heard["scan"][-1].ranges) == 8
    assert client.close() == 0


def planar(pose):
    """Return a message's pose or transform as x, y, heading."""
    place = getattr(pose, "position", None) or pose.translation
    turn = getattr(pose, "orientation", None) or pose.rotation
    return np.array((place.x, place.y, 2 * math.atan2(turn.z, turn.w)))


def test_every_frame_hangs_on_the_map_which_shows_the_walls(start):
    client = start(
        engine="mujoco", start_paused="true", odom_drift=0.1, localisation="noisy", localisation_rate=2.0, seed=3
    )
    client.listen(TFMessage, "/tf", 100)
    for kind, topic in ((TFMessage, "/tf_static"), (OccupancyGrid, "map"), (MarkerArray, "walls")):
        client.listen(kind, topic, LATCHED)
    client.listen(String, "robot_description", LATCHED)
    client.listen(PoseWithCovarianceStamped, "amcl_pose", LATCHED)
    client.listen(JointState, "joint_states", 10)
    for _ in range(4):
        client.speeds(0.2, 0.1)
        client.call("step", duration=0.5)
    heard = client.heard
    client.until(
        lambda: heard["odom"] and seconds(heard["odom"][-1].header.stamp) >= 1.99 and len(heard["amcl_pose"]) > 3
    )
    client.until(lambda: all(heard[topic] for topic in ("/tf_static", "map", "walls", "robot_description")))
    client.until(lambda: heard["/tf"][-1].transforms[0].header.stamp == heard["odom"][-1].header.stamp)
    moving = {each.child_frame_id: each for each in heard["/tf"][-1].transforms}
    parents = {name: each.header.frame_id for name, each in moving.items()}
    parents |= {each.child_frame_id: each.header.frame_id for each in heard["/tf_static"][-1].transforms}
    for frame in ("odom", "base_scan", "wheel_left_link", "wheel_right_link"):
        while frame in parents:
            frame = parents[frame]
        assert frame == "map"
    x, y, turn = planar(moving["odom"].transform)
    base, truth = planar(moving["base_footprint"].transform), planar(heard["ground_truth"][-1].pose.pose)
    told = np.array((x, y)) + np.array(((np.cos(turn), -np.sin(turn)), (np.sin(turn), np.cos(turn)))) @ base[:2]
    assert 0.0 < np.hypot(*(told - truth[:2])) < 0.3
    assert abs(turn + base[2] - truth[2]) < 0.3
    assert heard["amcl_pose"][-1].pose.covariance[0] == pytest.approx(0.05**2)
    assert np.diff([seconds(each.header.stamp) for each in heard["amcl_pose"]]) == pytest.approx(0.5)
    assert heard["joint_states"][-1].position[0] == pytest.approx(0.2 * 2.0 / 0.033, rel=0.15)
    assert 'robot name="turtlebot3_burger"' in heard["robot_description"][-1].data
    drawn = OccupancyMap.from_message(heard["map"][-1])
    assert drawn.at(truth[:2]) == 0
    assert all(drawn.at((m.pose.position.x, m.pose.position.y)) == 100 for m in heard["walls"][-1].markers[1:])
    assert client.close() == 0


REFUSALS = (
    ({"task": "nowhere"}, "no task 'nowhere'"),
    ({"task": "water_filling"}, "a navigation task is needed"),
    ({"speed_factor": "-1.0"}, "'speed_factor' is out of range"),
    ({"physics_rate": "fast"}, "'physics_rate' is"),
    ({"corridor_width": "3.0"}, "width 3 m"),
    ({"corridor_width": "0.7", "randomise_width": "true"}, "contradict"),
    ({"robots": "['a', 'a']"}, "each namespace"),
    ({"engine": "ode"}, "'engine' is 'ode'"),
    ({"localisation_rate": "0.0"}, "'localisation_rate' is out of range"),
    ({"robots": "['a b']"}, "no namespace"),
    ({"task": "car_ttr", "robots": str([f"r{i}" for i in range(20)])}, "no room for 20 robots"),
)


def test_movers_are_told_with_each_odometry(start):
    client = start(start_paused=True, task="walkers", seed=2)
    client.listen(Movers, "movers", SENSOR)
    client.listen(MarkerArray, "mover_markers", SENSOR)
    client.until(lambda: client.node.count_publishers("movers") and client.node.count_publishers("mover_markers"))
    while not (client.heard["movers"] and client.heard["mover_markers"]):
        assert client.call("step", duration=0.1).success
        rclpy.spin_once(client.node, timeout_sec=0.05)
    message, markers = client.heard["movers"][-1], client.heard["mover_markers"][-1].markers
    assert message.header.frame_id == "map"
    assert [mover.id for mover in message.movers] == [0, 1, 2]
    assert all(mover.radius == pytest.approx(0.15) for mover in message.movers)
    assert all(0.1 <= math.hypot(mover.velocity.x, mover.velocity.y) <= 0.3 for mover in message.movers)
    assert len(markers) == 3


def test_a_bad_parameter_ends_with_one_message(in_turn):
    ends = in_turn("sim_bridge.ros.bridge_node", [["--ros-args", *arguments(**given)] for given, _ in REFUSALS])
    for (code, errors, _), (_, complaint) in zip(ends, REFUSALS, strict=True):
        assert code in (1, 2)
        assert complaint in errors
        assert "Traceback" not in errors
        assert len([line for line in errors.splitlines() if line.strip()]) == 1
