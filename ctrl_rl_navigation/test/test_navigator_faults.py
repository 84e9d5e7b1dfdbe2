"""The navigator's inputs stop, die, jump or are replaced during a drive: it stops, reports why, and resumes."""

import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import rclpy
from ctrl_rl_core.ros import SCAN_PUBLISHER
from ctrl_rl_navigation.cli.simulation import TASK_NAME
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TransformStamped, TwistStamped
from map_operator import Operator, write_room
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from sensor_msgs.msg import LaserScan
from tf2_msgs.msg import TFMessage

from ctrl_rl_core import COMMAND, SENSOR
from ctrl_rl_msgs.msg import NavigatorStatus

pytestmark = [pytest.mark.realtime, pytest.mark.usefixtures("_no_shared_memory")]  # some are killed or frozen

FAR, BACK = (2.7, 1.7), (0.5, 0.5)
DRIVING, WAITING, REACHED = NavigatorStatus.DRIVING, NavigatorStatus.WAITING, NavigatorStatus.REACHED


class Saboteur(Operator):
    """Operator that relays scans and the localiser's transform until told to drop them.

    Attributes:
        sees: Whether scans are relayed.
        shift: Error of the localiser along x [m]; None while it is silent.
    """

    def __init__(self) -> None:
        super().__init__()
        self.sees = True
        self.shift: float | None = 0.0
        self.command = (0.0, 0.0)
        self.diagnosed = ""
        self._scan = self.node.create_publisher(LaserScan, "scan", SCAN_PUBLISHER)
        self._moving = self.node.create_publisher(TFMessage, "/tf", 10)
        self.node.create_subscription(LaserScan, "scan_raw", self._on_scan, SENSOR)
        self.node.create_subscription(TwistStamped, "cmd_vel", self._on_command, COMMAND)
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)
        self.node.create_timer(0.05, self._locate)

    def _on_scan(self, message: LaserScan) -> None:
        if self.sees:
            self._scan.publish(message)

    def _on_command(self, message: TwistStamped) -> None:
        self.command = (message.twist.linear.x, message.twist.angular.z)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        self.diagnosed = next((each.message for each in message.status if "navigator" in each.name), self.diagnosed)

    def _locate(self) -> None:
        if self.shift is not None:
            message = TransformStamped(child_frame_id="odom")
            message.header.frame_id, message.transform.rotation.w = "map", 1.0
            message.transform.translation.x = self.shift
            self._moving.publish(TFMessage(transforms=[message]))

    def wait_until_it_stands(self, why: str) -> None:
        """Return once status and diagnostics report why the robot stopped, and its last command is zero."""
        self.wait_for(WAITING, why)
        self.wait(lambda: why in self.diagnosed and self.command == (0.0, 0.0))

    def wait_until_it_drives(self) -> None:
        """Return once the robot drives."""
        self.wait_for(DRIVING)
        self.wait(lambda: self.command != (0.0, 0.0))

    def serve(self, file: Path) -> None:
        """Make the map server publish another map."""
        value = ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=str(file))
        request = SetParameters.Request(parameters=[Parameter(name="map", value=value)])
        assert self.call(SetParameters, "map_server/set_parameters", request).results[0].successful


@pytest.fixture
def saboteur() -> Iterator[Saboteur]:
    rclpy.init()
    saboteur = Saboteur()
    yield saboteur
    saboteur.node.destroy_node()
    rclpy.try_shutdown()


def test_whatever_is_missing_it_stands_says_why_and_goes_on(
    run_node: Callable, saboteur: Saboteur, tmp_path: Path
) -> None:
    """One drive goes through all faults, since starting the processes takes longer than the faults."""
    room = write_room(tmp_path)
    post = write_room(tmp_path, "post", (slice(30, 34), slice(40, 44)))
    closed = write_room(tmp_path, "closed", (slice(0, 44), slice(44, 48)))
    task = f"task:={tmp_path}/{TASK_NAME}.yaml"
    bridge = run_node(
        "sim_bridge", "bridge", task, "localisation:=none", "speed_factor:=2.0", remap=("scan:=scan_raw",)
    )
    server = run_node("ctrl_rl_navigation", "map_server", f"map:={room}", "topic:=floor")
    words = ("use_sim_time:=true", "pose_timeout:=0.5")
    navigator = run_node("ctrl_rl_navigation", "navigator", *words, remap=("map:=floor",))
    saboteur.wait_for(WAITING, "waiting for a goal")
    saboteur.click(*FAR)
    saboteur.wait_until_it_drives()

    saboteur.sees = False
    saboteur.wait_until_it_stands("no recent scan")
    saboteur.sees = True
    saboteur.wait_until_it_drives()

    saboteur.shift = None
    saboteur.wait_until_it_stands("the transform from 'map' to 'base_footprint' is")
    saboteur.shift = 50.0
    saboteur.wait_until_it_stands("off the map: is the pose right?")
    saboteur.shift = 0.0
    saboteur.wait_until_it_drives()

    saboteur.serve(post)
    saboteur.wait(lambda: navigator.output.count("a map of 3.2 x 2.2 m") == 2)
    saboteur.wait_until_it_drives()
    saboteur.serve(closed)
    saboteur.wait_for(NavigatorStatus.UNREACHABLE, "no way leads from")
    saboteur.wait(lambda: saboteur.command == (0.0, 0.0))
    saboteur.serve(room)
    saboteur.click(*BACK)
    saboteur.wait_until_it_drives()

    server.stop(signal.SIGKILL)
    saboteur.wait_for(REACHED)
    saboteur.click(*FAR)
    saboteur.wait_until_it_drives()
    bridge.stop(signal.SIGKILL)  # and with it the clock
    saboteur.wait_until_it_stands("no recent")
    assert navigator.stop()[0] == 0
    assert "Traceback" not in navigator.output
