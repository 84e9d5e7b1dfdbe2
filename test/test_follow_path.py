"""Nav2's follow_path by drivers that know no path: a learnt policy and the Koopman controller."""

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import rclpy
import yaml
from ctrl_rl_navigation.cli import TASK_NAME, task_content
from nav2_client import ABORTED, CANCELED, SUCCEEDED, Nav2Client, path_through
from nav_msgs.msg import Odometry

from ctrl_rl_core import OccupancyMap

pytestmark = pytest.mark.realtime

CORNERS = ((1.0, 1.0), (4.0, 1.0), (5.0, 2.0), (5.0, 3.5), (4.2, 4.2), (2.0, 4.2), (1.2, 3.0), (2.5, 2.2), (4.0, 2.2))


@pytest.fixture
def hall(run_node: Callable, tmp_path: Path) -> Iterator[Nav2Client]:
    """Run the simulator in an empty hall, and give an application that records where the robot is."""
    cells = np.zeros((100, 120), np.int8)
    cells[:2], cells[-2:], cells[:, :2], cells[:, -2:] = (100,) * 4
    OccupancyMap(cells, 0.05).save(tmp_path / "hall.yaml")
    task = task_content(tmp_path / "hall.yaml", np.array((1.0, 1.0, 2.5)))
    (tmp_path / f"{TASK_NAME}.yaml").write_text(yaml.safe_dump(task, sort_keys=False))
    run_node("sim_bridge", "bridge", f"task:={tmp_path}/{TASK_NAME}.yaml", "localisation:=noisy", "speed_factor:=4.0")
    rclpy.init()
    client = Nav2Client()
    client.places = []
    client.create_subscription(
        Odometry,
        "ground_truth",
        lambda message: client.places.append((message.pose.pose.position.x, message.pose.pose.position.y)),
        10,
    )
    yield client
    client.destroy_node()
    rclpy.try_shutdown()


def errors(places: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Return the distances of places (n, 2) from a path (m, 2) [m]."""
    starts, ways = corners[:-1], np.diff(corners, axis=0)
    t = np.clip(((places[:, None] - starts) * ways).sum(2) / (ways**2).sum(1), 0.0, 1.0)
    return np.linalg.norm(places[:, None] - starts - t[..., None] * ways, axis=2).min(axis=1)


@pytest.mark.parametrize(
    ("package", "executable", "words"),
    [
        ("ctrl_rl_core", "policy", ("policy:=corridor_doorways",)),
        ("koopman_lqr_controller", "controller", ()),
    ],
)
def test_a_lidar_driver_follows_a_path_that_crosses_itself(
    hall: Nav2Client, run_node: Callable, package: str, executable: str, words: tuple[str, ...]
) -> None:
    given = ("follow_path:=true", "pose:=tf", "use_sim_time:=true", "path_patience:=10.0")
    in_a_hall = ("largest_gap:=6.3", "min_echo_share:=0.1")
    node = run_node(package, executable, *given, *in_a_hall, *words)
    node.wait_for("waiting for a path")
    assert hall.followPath(path_through((1.0, 1.0), (2.0, 1.0), frame="nowhere"))
    hall.wait()
    assert hall.getResult()[1].error_code == 102
    assert "nowhere" in hall.getResult()[1].error_msg

    assert hall.followPath(path_through(*CORNERS))
    hall.wait(lambda: bool(hall.feedback and hall.feedback.distance_to_goal < 12.0))
    hall.cancelTask()
    hall.wait()
    assert hall.getResult()[0] == CANCELED, hall.getResult()
    stood = hall.places[-1]

    assert hall.followPath(path_through(stood, *CORNERS[1:]))
    hall.wait()
    status, result = hall.getResult()
    assert (status, result.error_code) == (SUCCEEDED, 0), result
    assert np.hypot(hall.places[-1][0] - 4.0, hall.places[-1][1] - 2.2) < 0.4
    away = errors(np.array(hall.places), np.array(CORNERS))
    assert away.mean() < 0.15
    assert away.max() < 0.45
    assert hall.heard[0].distance_to_goal > 10.0
    assert max(each.speed for each in hall.heard) > 0.15

    assert hall.followPath(path_through((4.0, 2.2), (4.0, -8.0)))  # through the wall
    hall.wait()
    status, result = hall.getResult()
    assert (status, result.error_code) == (ABORTED, 105)
    assert "no progress" in result.error_msg
    assert node.stop()[0] == 0
    assert "Traceback" not in node.output
