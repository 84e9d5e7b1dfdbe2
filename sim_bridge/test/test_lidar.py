import numpy as np
import pytest
from yards import yard

from ctrl_rl_core import find_robot, load_navigation_task


def room_ranges(origin, heading, bearings, largest):
    """Return hand-computed distances in the empty room from a point."""
    angles = heading + bearings
    with np.errstate(divide="ignore"):
        along_x = np.where(np.cos(angles) > 0, 2.0 - origin[0], -2.0 - origin[0]) / np.cos(angles)
        along_y = np.where(np.sin(angles) > 0, 1.5 - origin[1], -1.5 - origin[1]) / np.sin(angles)
    ranges = np.minimum(np.abs(along_x), np.abs(along_y))
    return np.where(ranges < largest, ranges, np.inf)


@pytest.mark.parametrize(("x", "theta"), [(0.0, 0.0), (0.8, 0.7), (-1.5, -2.2)])
def test_ranges_in_a_room_are_those_by_hand(simulate, make_room, x, theta):
    world = simulate(make_room(x, theta))
    origin = np.array((x, 0.0)) - 0.032 * np.array((np.cos(theta), np.sin(theta)))
    expected = room_ranges(origin, theta, world.lidar.bearings, 3.5)
    np.testing.assert_allclose(world.scan(0), expected, atol=2e-3)


def test_ranges_meet_the_surfaces_of_the_task_geometry(simulate):
    world = simulate("curved_corridor", seed=2, scan_noise=0.0)
    ranges, frame = world.scan(0), world._robots[0].body.sensor()
    hit = np.isfinite(ranges)
    assert hit.sum() > 300
    ends = (
        frame.origin[:2]
        + ranges[hit, None]
        * np.stack((np.cos(world.lidar.bearings[hit]), np.sin(world.lidar.bearings[hit])), axis=1)
        @ frame.axes[:, :2]
    )
    assert np.abs(world.geometry.signed_distance(ends)).max() < 2e-3


def test_discs_and_boxes_stand_where_the_task_says(simulate, make_room):
    obstacles = """
  - disc: {centre: "(1.0, 0.0) m", radius: 0.25 m}
  - box: {centre: "(-1.0, 0.0) m", size: "(0.4, 0.6) m"}"""
    world = simulate(make_room(obstacles=obstacles))
    ranges = world.scan(0)
    assert ranges[0] == pytest.approx(0.75 + 0.032, abs=1e-3)
    assert ranges[180] == pytest.approx(0.8 - 0.032, abs=1e-3)
    assert ranges[90] == pytest.approx(1.5, abs=1e-3)


def test_nothing_within_reach_is_plus_infinity_and_too_near_is_minus_infinity(simulate, make_room):
    obstacles = """
  - box: {centre: "(0.14, 0.0) m", size: "(0.1, 0.02) m"}"""
    world = simulate(make_room(x=0.0, obstacles=obstacles))
    assert world.scan(0)[0] == pytest.approx(0.122, abs=1e-3)
    world = simulate(make_room(x=0.007, obstacles=obstacles))
    assert world.scan(0)[0] == -np.inf  # 0.115 m, and 0.12 m is the least
    world = simulate(make_room(x=-1.8))
    assert world.scan(0)[0] == np.inf


def test_a_sensor_inside_an_obstacle_sees_all_of_it_too_near(simulate, make_room):
    obstacles = """
  - box: {centre: "(0.0, 0.0) m", size: "(1.0, 1.0) m"}"""
    world = simulate(make_room(obstacles=obstacles))
    assert (world.scan(0) == -np.inf).all()
    assert world.clearance(0) < 0.0


def test_noise_has_the_deviation_asked_for(simulate, make_room):
    task = make_room()
    clean = simulate(task)
    noisy = simulate(task, scan_noise=0.02)
    error = np.concatenate([noisy.scan(0) - clean.scan(0) for _ in range(20)])
    assert error.std() == pytest.approx(0.02, rel=0.05)
    assert abs(error.mean()) < 0.001


@pytest.mark.parametrize(("lost_beam", "test"), [("nan", np.isnan), ("inf", np.isposinf), ("zero", lambda r: r == 0.0)])
def test_lost_beams_read_as_asked(simulate, make_room, lost_beam, test):
    world = simulate(make_room(), scan_dropout=0.25, lost_beam=lost_beam)
    share = np.mean([test(world.scan(0)) for _ in range(20)])
    assert share == pytest.approx(0.25, abs=0.03)


def test_robots_see_each_other_but_not_themselves(simulate):
    task = load_navigation_task("curved_corridor")
    alone, pair = (simulate(task, seed=5, robots=count, scan_noise=0.0) for count in (1, 2))
    np.testing.assert_array_equal(alone.pose(0), pair.pose(0))
    without, with_other = alone.scan(0), pair.scan(0)
    changed = without != with_other
    offset = pair._robots[1].body.sensor().origin - pair._robots[0].body.sensor().origin
    distance = np.hypot(*offset[:2])
    assert 1 <= changed.sum() <= 40
    assert with_other[changed].min() == pytest.approx(distance - 0.035, abs=0.002)
    bearing = np.arctan2(offset[1], offset[0]) - pair.pose(0)[2]
    assert np.abs(np.angle(np.exp(1j * (pair.lidar.bearings[changed] - bearing)))).max() < 0.15


def test_beams_of_the_quadrotor_turn_with_it_in_the_x_z_plane(simulate):
    world = simulate("quad_ttr", seed=4)
    ranges, pose = world.scan(0), world.pose(0)
    bearings = world.lidar.bearings[np.isfinite(ranges)]
    x_axis = np.array((np.cos(pose[2]), -np.sin(pose[2])))
    z_axis = np.array((np.sin(pose[2]), np.cos(pose[2])))
    ends = pose[:2] + ranges[np.isfinite(ranges), None] * (
        np.cos(bearings)[:, None] * x_axis + np.sin(bearings)[:, None] * z_axis
    )
    assert np.abs(world.geometry.signed_distance(ends)).max() < 2e-3
    up = np.argmin(np.abs(world.lidar.bearings - np.pi / 2))
    down = np.argmin(np.abs(world.lidar.bearings + np.pi / 2))
    assert ranges[down] == pytest.approx((pose[1] - 0.6) / np.cos(pose[2]), abs=2e-3)
    assert ranges[up] < 9.85 - pose[1]  # a box hangs above the start


def test_an_lds01_reads_zero_where_it_measures_nothing(simulate, make_room):
    world = simulate(make_room(x=-1.8), lidar="lds01", scan_dropout=0.1)
    scan = world.laser_scan(0)
    assert len(scan.ranges) == 360
    assert scan.ranges[0] == 0.0  # the wall ahead is 3.8 m away, beyond its reach
    assert np.isfinite(scan.ranges).all()
    assert 0.05 < np.mean(scan.ranges == 0.0) < 0.4


def test_an_lds02_varies_its_beams_claims_much_and_fills_with_nan(simulate, make_room):
    world = simulate(make_room(x=0.3, theta=0.4), lidar="lds02", scan_dropout=0.1, scan_noise=0.0)
    scans = [world.laser_scan(0) for _ in range(20)]
    counts = {len(scan.ranges) for scan in scans}
    assert len(counts) > 3
    assert counts <= set(range(268, 275))
    origin = np.array((0.3, 0.0)) - 0.032 * np.array((np.cos(0.4), np.sin(0.4)))
    for scan in scans:
        assert (scan.range_min, scan.range_max) == (0.0, 100.0)
        bearings = scan.angle_min + scan.angle_increment * np.arange(len(scan.ranges))
        assert bearings[-1] < 2 * np.pi <= bearings[-1] + scan.angle_increment + 1e-9
        seen = np.isfinite(scan.ranges)
        assert 0.8 < seen.mean() < 0.98
        assert np.isnan(scan.ranges[~seen]).all()
        np.testing.assert_allclose(scan.ranges[seen], room_ranges(origin, 0.4, bearings, 8.0)[seen], atol=2e-3)


ROBOTS = ["turtlebot3_burger", "turtlebot2", "turtlebot4", "jackal", "race_car", "road_car"]


@pytest.mark.parametrize("robot", ROBOTS)
def test_a_lidar_sees_no_part_of_its_own_robot(simulate, robot):
    """Wheels taller than the lidar are parts of a robot as well."""
    world = simulate(yard(robot, theta=0.3))
    reach = 2.0 * find_robot(robot).radius
    for command in ((0.0, 0.0), (0.3, 0.3)):  # wheels turn and are steered
        world.command(0, command)
        world.step(world.options.rate // 2)
        assert (world.scan(0) > reach).all()
