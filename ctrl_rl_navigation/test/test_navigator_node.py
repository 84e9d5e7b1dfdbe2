"""The navigator as a real node with the simulator: goals, cancelling, unreachable goals, and waiting for inputs."""

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import rclpy
from ctrl_rl_navigation.cli.simulation import TASK_NAME
from map_operator import Operator, write_room
from std_srvs.srv import Trigger

from ctrl_rl_msgs.msg import NavigatorStatus
from ctrl_rl_msgs.srv import QueryValues

pytestmark = pytest.mark.realtime

GOAL = (2.5, 0.5)


@pytest.fixture
def operator() -> Iterator[Operator]:
    rclpy.init()
    operator = Operator()
    yield operator
    operator.node.destroy_node()
    rclpy.try_shutdown()


@pytest.fixture
def room(tmp_path: Path) -> Path:
    """Write the map and the task of a room with a post at its centre."""
    return write_room(tmp_path).parent


def test_it_drives_to_goals_and_tells_what_it_does(run_node: Callable, operator: Operator, room: Path) -> None:
    run_node("sim_bridge", "bridge", f"task:={room}/{TASK_NAME}.yaml", "localisation:=none", "speed_factor:=4.0")
    run_node("ctrl_rl_navigation", "map_server", f"map:={room}/room.yaml", "topic:=floor")
    navigator = run_node("ctrl_rl_navigation", "navigator", "use_sim_time:=true", remap=("map:=floor",))
    operator.wait_for(NavigatorStatus.WAITING, "no transform from 'map' to 'base_footprint'")
    operator.localise()
    operator.wait_for(NavigatorStatus.WAITING, "waiting for a goal")

    operator.click(50.0, 0.0)
    refused = operator.wait_for(NavigatorStatus.UNREACHABLE)
    assert "off the map" in refused.message
    asked = operator.call(QueryValues, "navigator/query", QueryValues.Request(states=[0.5, 0.0]))
    assert not asked.success
    operator.click(1.0, 1.0, "nowhere")
    navigator.wait_for("the goal is refused: no transform from 'map' to 'nowhere'")

    operator.click(*GOAL)
    driving = operator.wait_for(NavigatorStatus.DRIVING)
    assert driving.header.frame_id == "map"
    assert (driving.goal.position.x, driving.goal.position.y) == GOAL
    operator.wait(lambda: any(each.remaining_distance > 1.0 for each in operator.status))
    assert operator.status[-1].remaining_time > 5.0
    operator.wait(lambda: bool(operator.paths and operator.slices))
    last = operator.paths[-1].poses[-1].pose.position
    assert np.hypot(last.x - GOAL[0], last.y - GOAL[1]) < 0.2
    assert max(operator.slices[-1].data) == 100
    asked = operator.call(QueryValues, "navigator/query", QueryValues.Request(states=[*GOAL, 0.5, 1.0]))
    assert asked.success
    assert asked.values[0] == pytest.approx(0.0, abs=0.5)
    assert asked.values[1] > 5.0
    assert operator.call(Trigger, "navigator/cancel", Trigger.Request()).success
    operator.wait_for(NavigatorStatus.CANCELLED)
    assert not operator.call(Trigger, "navigator/cancel", Trigger.Request()).success

    operator.click(*GOAL)
    reached = operator.wait_for(NavigatorStatus.REACHED)
    assert reached.remaining_time == 0.0
    assert navigator.stop()[0] == 0
    assert "Traceback" not in navigator.output


def test_it_drives_by_the_pose_of_a_localiser_and_refuses_goals_that_are_none(
    run_node: Callable, operator: Operator, room: Path
) -> None:
    task = f"task:={room}/{TASK_NAME}.yaml"
    run_node("sim_bridge", "bridge", task, "localisation:=noisy", "speed_factor:=4.0")
    words = (f"map:={room}/room.yaml", "pose:=amcl_pose", "use_sim_time:=true")
    navigator = run_node("ctrl_rl_navigation", "navigator", *words)
    operator.wait_for(NavigatorStatus.WAITING, "waiting for a goal")
    operator.click(float("nan"), 0.5)
    navigator.wait_for("the goal is refused: a translation of [nan, 0.5")
    operator.click(1e300, 0.5)
    navigator.wait_for("the goal is refused: a translation of [1e+300, 0.5")
    operator.click(1.0, 0.5)
    assert operator.wait_for(NavigatorStatus.REACHED).goal.position.x == 1.0
