"""The planar engine compared with PyBullet without contacts, and its geometry with brute force."""

import math

import numpy as np
import pytest
from sim_bridge.engines.engine import WheeledRobot
from sim_bridge.engines.planar_engine import PlanarEngine
from sim_bridge.engines.planar_parts import outline, wheeled_model

from ctrl_rl_core import Box, Disc, Outcome
from sim_bridge import NavigationEnv, SimulatedWorld, SimulationError, SimulationOptions


def episodes(task, seed, actions, **rates):
    """Return states, lidar ranges and clearances of the same actions in both engines, and both outcomes."""
    pytest.importorskip("pybullet")
    out = []
    for engine in ("pybullet", "planar"):
        environment = NavigationEnv(task, options=SimulationOptions(engine=engine, rate=rates[engine]))
        observation, info = environment.reset(seed=seed)
        trace, over = [], False
        for action in actions:
            observation, _, terminated, truncated, info = environment.step(action)
            over = terminated or truncated
            if over:
                break
            trace.append(np.concatenate((info["state"], [info["clearance"]], observation[len(info["state"]) :])))
        out.append((np.array(trace), info["outcome"]))
        environment.close()
    return out


@pytest.mark.parametrize(("task", "rate", "size"), [("car_ttr", 30, 3), ("quad_ttr", 120, 6)])
def test_a_robot_moves_and_sees_as_in_pybullet_until_it_touches_something(task, rate, size):
    random = np.random.default_rng(0)
    for seed in (1, 4):
        actions = np.clip(np.cumsum(random.normal(0.0, 0.4, (40, 2)), axis=0), -1.0, 1.0)
        (theirs, their_end), (ours, our_end) = episodes(task, seed, actions, pybullet=240, planar=rate)
        assert abs(len(theirs) - len(ours)) <= 1
        assert their_end == our_end
        both = min(len(theirs), len(ours))
        assert both > 3
        away = np.abs(theirs[:both] - ours[:both])
        assert away[:, :2].max() < 0.05  # open loop, for up to 16 s
        assert np.median(away[:, size]) < 0.02  # clearance
        assert np.median(away[:, size + 1 :]) < 0.02  # lidar


def test_a_burger_turns_as_in_pybullet(make_room):
    actions = np.tile((0.8, 0.3), (10, 1))
    (theirs, _), (ours, _) = episodes(make_room(), 0, actions, pybullet=240, planar=60)
    np.testing.assert_allclose(ours[:, :3], theirs[:, :3], atol=0.02)
    np.testing.assert_allclose(ours[:, 3], theirs[:, 3], atol=0.01)


def test_the_same_seed_draws_the_same_noise_and_drift_in_each_engine(make_room):
    pytest.importorskip("pybullet")
    task = make_room(obstacles='[{disc: {centre: "(1.0, 0.3) m", radius: 0.2 m}}]')
    options = {"scan_noise": 0.01, "scan_dropout": 0.1, "odom_drift": 0.1, "command_delay": 0.1}
    scans = []
    for engine in ("pybullet", "planar"):
        world = SimulatedWorld(task, seed=5, options=SimulationOptions(engine=engine, **options))
        world.command(0, (0.1, 0.0))
        world.step(120)
        scans.append((world.scan(0), world.odometry(0).pose))
        world.close()
    assert (np.isfinite(scans[0][0]) == np.isfinite(scans[1][0])).mean() > 0.99
    seen = np.isfinite(scans[0][0]) & np.isfinite(scans[1][0])
    assert np.median(np.abs(scans[0][0] - scans[1][0])[seen]) < 0.005
    np.testing.assert_allclose(scans[0][1], scans[1][1], atol=0.005)


def ready(shapes, *poses, urdf="turtlebot3_burger.urdf"):
    engine = PlanarEngine(60)
    engine.begin("xy", shapes)
    for pose in poses:
        engine.add_wheeled(WheeledRobot(urdf, np.array(pose, dtype=float), 1.0))
    engine.finish()
    return engine


def corners(row, pose, count=200):
    """Return points on the boundary of a rounded part of an outline at a pose (n, 2)."""
    turn = np.linspace(0.0, 2.0 * np.pi, count)
    x, y, a, b, radius = row[:5]
    square = np.stack((np.cos(turn), np.sin(turn)), axis=1)
    square /= np.abs(square).max(axis=1, keepdims=True)
    flat = square * (a, b) + radius * np.stack((np.cos(turn), np.sin(turn)), axis=1) + (x, y)
    c, s = math.cos(pose[2]), math.sin(pose[2])
    return flat @ np.array(((c, s), (-s, c))) + pose[:2]


def test_distances_are_those_of_points_on_the_outline():
    random = np.random.default_rng(1)
    shapes = (Box((1.0, 0.5), (0.7, 0.3), 0.6), Box((-1.0, -1.0), (0.2, 2.0)), Disc((0.0, 1.2), 0.3))
    for _ in range(20):
        pose = random.uniform((-2.0, -2.0, -3.0), (2.0, 2.0, 3.0))
        points = np.concatenate([corners(row, pose) for row in outline("turtlebot3_burger.urdf", "xy").parts])
        brute = min(float(shape.signed_distance(points).min()) for shape in shapes)
        found = ready(shapes, pose).distance(0, 1.0)
        if brute > 0.0:
            assert found == pytest.approx(brute, abs=0.005)
        else:
            assert found <= 0.001


def test_robots_keep_a_distance_to_and_see_each_other():
    engine = ready((), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0))
    behind = 0.032 + 0.5 * 0.138
    for height, front in ((0.1, behind), (0.182, 0.032 + 0.035), (0.3, -2.0)):  # hull, lidar, nothing
        origin, ends = np.array((0.0, 0.0, height)), np.array(((3.0, 0.0, height), (-3.0, 0.0, height)))
        free = engine.cast(origin, ends, 0)
        assert 3.0 * free[0] == pytest.approx(1.0 - front, abs=1e-6)
        assert free[1] == 1.0
    assert engine.distance(0, 1.0) == pytest.approx(1.0 - behind - 0.037, abs=1e-3)


def test_movers_go_their_way_and_are_met_and_seen():
    engine = PlanarEngine(60)
    engine.begin("xy", ())
    engine.add_wheeled(WheeledRobot("turtlebot2.urdf", np.zeros(3), 1.0))
    mover = engine.add_mover(0.3, (2.0, 0.0))
    engine.finish()
    mover.move((2.0, 0.0), (-1.0, 0.0))
    for _ in range(30):
        engine.step()
    assert engine.distance(0, 1.0) == pytest.approx(1.5 - 0.3 - 0.177)
    assert engine.mover_distance(0, 0, 5.0) == pytest.approx(1.5 - 0.3 - 0.177)
    free = engine.cast(np.array((0.0, 0.0, 0.3)), np.array(((4.0, 0.0, 0.3),)), 0)
    assert 4.0 * free[0] == pytest.approx(1.2)


def test_a_robot_that_is_alone_is_near_nothing():
    assert ready((), (0.0, 0.0, 0.0)).distance(0, 1.0) == math.inf


def test_the_outline_of_a_round_robot_is_one_disc():
    parts, outer = outline("turtlebot2.urdf", "xy")
    assert outer == 1
    assert parts[0, :5].tolist() == [0.0, 0.0, 0.0, 0.0, 0.177]
    assert outline("planar_quadrotor.urdf", "xz").parts[:, 2:5].tolist() == [[0.4, 0.125, 0.0]]
    assert wheeled_model("turtlebot2.urdf").wheel_separation == pytest.approx(0.23)


def test_a_collision_ends_an_episode_and_a_window_is_refused(make_room):
    world = SimulatedWorld(make_room(x=1.5), options=SimulationOptions(engine="planar", rate=60))
    world.command(0, (0.22, 0.0))
    world.step(60 * 4)
    assert world.episode(0).outcome is Outcome.COLLISION
    with pytest.raises(SimulationError, match="has no window here"):
        SimulatedWorld(make_room(), options=SimulationOptions(engine="planar", gui=True))
