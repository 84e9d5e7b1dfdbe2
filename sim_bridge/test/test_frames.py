import math

import pytest

pytest.importorskip("rclpy")

from builtin_interfaces.msg import Time
from sim_bridge.ros.frames import Frames
from sim_bridge.ros.robot_model import RobotModel

from ctrl_rl_core import load_navigation_task


def test_topics_and_frames_carry_the_namespace():
    assert Frames("", "xy").topic("scan") == "scan"
    frames = Frames("robot1", "xy")
    assert (frames.topic("scan"), frames.odom, frames.base) == ("robot1/scan", "robot1/odom", "robot1/base_footprint")


def place_of(transform):
    place = transform.transform.translation
    return place.x, place.y, place.z


def test_the_parts_of_the_burger_are_where_they_are_built_in():
    model = RobotModel(Frames("", "xy"), load_navigation_task("curved_corridor"))
    fixed = {each.child_frame_id: each for each in model.fixed}
    assert set(fixed) == {"base_link", "caster_back_link", "base_scan"}
    assert fixed["base_link"].header.frame_id == "base_footprint"
    assert place_of(fixed["base_link"]) == pytest.approx((0.0, 0.0, 0.010))
    assert fixed["base_scan"].header.frame_id == "base_link"
    assert place_of(fixed["base_scan"]) == pytest.approx((-0.032, 0.0, 0.172))
    left, right = model.wheels(Time(sec=3), (0.5 * math.pi, 0.0))
    assert (left.header.frame_id, left.child_frame_id, left.header.stamp.sec) == ("base_link", "wheel_left_link", 3)
    assert place_of(left) == pytest.approx((0.0, 0.080, 0.023))
    assert (left.transform.rotation.y, left.transform.rotation.w) == pytest.approx((math.sqrt(0.5), math.sqrt(0.5)))
    assert right.transform.rotation.w == 1.0


@pytest.mark.parametrize("body", ["car_ttr", "curved_corridor"])
def test_a_model_has_one_tree_of_frames(body):
    model = RobotModel(Frames("robot1", "xy"), load_navigation_task(body))
    links = [*model.fixed, *model.wheels(Time(), (0.0, 0.0))]
    children = [each.child_frame_id for each in links]
    assert len(set(children)) == len(children)
    assert {each.header.frame_id for each in links} <= {"robot1/base_footprint", *children}
    assert all(f'link name="{name.removeprefix("robot1/")}"' in model.description.data for name in children)


def test_bearings_of_the_quadrotor_run_from_x_to_z():
    (scan,) = RobotModel(Frames("", "xz"), load_navigation_task("quad_ttr")).fixed
    q = scan.transform.rotation
    # The second axis of a frame turned by (x, w) about x: (0, w^2 - x^2, 2 x w).
    assert (q.w**2 - q.x**2, 2 * q.x * q.w) == pytest.approx((0.0, 1.0))
    assert math.hypot(q.y, q.z) == 0.0
