"""Team files of one name but other content: no robot begins another option than its coordinator granted."""

import math

import numpy as np
import pytest
from nav_msgs.msg import Odometry
from option_coordinator.protocol.protocol_types import AgentState, GrantStatus
from option_coordinator.teams.team_file import FOLDER
from rcl_interfaces.msg import Log
from sensor_msgs.msg import LaserScan
from team import AGENTS, TIMES, uniform
from test_coordination import START, OneClock, request

from option_coordinator import Status, TeamId, load_team

pytestmark = [pytest.mark.fault, pytest.mark.timeout(900)]
AGENT = "option_coordinator.nodes.navigation_agent"
NAMES = ("wait", "shelf_1", "shelf_2", "desk_1", "desk_2", "home")


def other_order(folder):
    """Write the delivery team with its options in another order, under the same name."""
    text = (FOLDER / "delivery_team.yaml").read_text()
    head, options = text.split("options:\n")
    lines, tail = options.split("safe_option:")
    ordered = sorted(lines.splitlines(), key=lambda line: ("desk" not in line, line))
    file = folder / "delivery_team.yaml"
    file.write_text(f"{head}options:\n" + "\n".join(ordered) + f"\nsafe_option:{tail}")
    return file


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("shelf_1:", "rack_1:"),
        ("(-1.65, 1.0) m", "(-1.65, 0.9) m"),
        ("robot_2:", "robot_4:"),
        ("(0.0, -1.2) m", "(0.1, -1.2) m"),
    ],
)
def test_the_digest_is_of_names_stations_and_homes(tmp_path, old, new):
    shipped = load_team("delivery_team")
    text = (FOLDER / "delivery_team.yaml").read_text()
    (tmp_path / "delivery_team.yaml").write_text(text.replace("about: Three", "about: Some"))
    assert load_team(str(tmp_path / "delivery_team.yaml")).digest == shipped.digest
    assert len(shipped.digest) == 64
    (tmp_path / "delivery_team.yaml").write_text(text.replace(old, new))
    assert load_team(str(tmp_path / "delivery_team.yaml")).digest != shipped.digest
    assert load_team(str(other_order(tmp_path))).digest != shipped.digest


def test_an_option_of_another_team_file_is_not_adopted():
    team = OneClock(AGENTS, uniform(0), "digest", 0.0, TIMES, 0, team=TeamId("t", "mine"))
    team.tick(START)
    told = {"coordinator_epoch": 1, "request_id": 3, "grant_id": 2, "option": 1, "team": "t"}
    team.on_status(Status("r0", 7, AgentState.RUNNING, team_digest="other", **told), START)
    assert not team.ledger["r0"].runs
    (grant,) = team.on_request(request("r0", 3, START, team="t", team_digest="other"), START).grants
    assert (grant.status, grant.team_digest) == (GrantStatus.REFUSED, "mine")
    assert "digest other, the coordinator's mine): give both the same file" in grant.reason
    team.on_status(Status("r1", 7, AgentState.RUNNING, **told), START)  # of another make, without a digest
    assert team.ledger["r1"].runs


class World:
    """Odometry and scans of a robot that stands in the open."""

    def __init__(self, rig):
        self.rig = rig
        self.odometry = rig.node.create_publisher(Odometry, "odom", 10)
        self.scans = rig.node.create_publisher(LaserScan, "scan", 10)
        rig.node.create_timer(0.1, self.publish)

    def publish(self):
        stamp = self.rig.node.get_clock().now().to_msg()
        odometry = Odometry(child_frame_id="base_link")
        odometry.header.stamp, odometry.header.frame_id = stamp, "odom"
        odometry.pose.pose.orientation.w = 1.0
        scan = LaserScan(angle_min=0.0, angle_max=2 * math.pi * 359 / 360, angle_increment=2 * math.pi / 360)
        scan.header.stamp, scan.header.frame_id = stamp, "base_scan"
        scan.range_min, scan.range_max = 0.12, 3.5
        scan.ranges = np.full(360, 3.0, np.float32)
        self.odometry.publish(odometry)
        self.scans.publish(scan)


def test_a_coordinator_restarted_with_the_options_in_another_order_grants_nothing(rig, tmp_path):
    world, said = World(rig), []
    rig.node.create_subscription(Log, "/rosout", said.append, 100)
    rig.log_level = "warn"
    rig.coordinator(team="delivery_team", policy="spread")
    rig.start("robot_1", AGENT, team="delivery_team", robot="robot_1", team_namespace=rig.namespace)
    first = rig.granted("robot_1")
    assert first.option_name == NAMES[first.option]
    assert first.team_digest == load_team("delivery_team").digest
    rig.until(lambda: rig.running("robot_1"), "it drives")
    rig.kill("coordinator")
    rig.kill("robot_1")
    rig.start("robot_1", AGENT, team="delivery_team", robot="robot_1", team_namespace=rig.namespace)
    rig.coordinator(team=other_order(tmp_path), policy="spread")
    refused = rig.until(lambda: rig.given("robot_1", GrantStatus.REFUSED), "a refusal")
    assert "the robot's team file differs" in refused[0].reason
    rig.until(lambda: "team file differs" in getattr(rig.status("robot_1"), "message", ""), "its diagnostics say so")
    rig.until(lambda: any("refused: the robot's team file differs" in m.msg for m in said), "its log says so")
    rig.until(lambda: rig.counted("messages with another team file") > 0, "the coordinator says so")
    later = [status for status in rig.statuses if status.incarnation != first.incarnation]
    assert later
    assert all(status.state != AgentState.RUNNING for status in later)
    assert rig.given("robot_1") == [first]
    assert world
