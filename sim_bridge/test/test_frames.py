import math

import pytest

pytest.importorskip("rclpy")

from sim_bridge.ros.frames import Frames, fixed_transforms

from ctrl_rl_core import load_navigation_task


def test_topics_and_frames_carry_the_namespace():
    assert Frames("", "xy").topic("scan") == "scan"
    frames = Frames("robot1", "xy")
    assert (frames.topic("scan"), frames.odom, frames.base) == ("robot1/scan", "robot1/odom", "robot1/base_footprint")


def test_the_lidar_of_the_burger_is_where_it_is_built_in():
    base, scan = fixed_transforms(Frames("", "xy"), load_navigation_task("curved_corridor"))
    assert (base.header.frame_id, base.child_frame_id) == ("base_footprint", "base_link")
    assert base.transform.translation.z == pytest.approx(0.010)
    assert (scan.header.frame_id, scan.child_frame_id) == ("base_link", "base_scan")
    place = scan.transform.translation
    assert (place.x, place.y, place.z) == pytest.approx((-0.032, 0.0, 0.172))


def test_bearings_of_the_quadrotor_run_from_x_to_z():
    (scan,) = fixed_transforms(Frames("", "xz"), load_navigation_task("quad_ttr"))
    q = scan.transform.rotation
    # The second axis of a frame turned by (x, w) about x: (0, w^2 - x^2, 2 x w).
    assert (q.w**2 - q.x**2, 2 * q.x * q.w) == pytest.approx((0.0, 1.0))
    assert math.hypot(q.y, q.z) == 0.0
