"""Worlds from a map, and randomised conditions."""

import numpy as np
import pytest
from ctrl_rl_core.tasks import MapSpec

from ctrl_rl_core import OccupancyMap


@pytest.fixture
def mapped(make_room, tmp_path):
    """The room with 1,500 loose cells as a map; the robot is in the middle of a free square."""
    cells = np.zeros((300, 400), np.int8)
    random = np.random.default_rng(0)
    cells[random.integers(300, size=1500), random.integers(400, size=1500)] = 100
    cells[145:155, 195:210] = 0
    OccupancyMap(cells, 0.05, (-10.0, -7.5, 0.0)).save(tmp_path / "hall.yaml")
    spec = MapSpec.model_validate({"file": str(tmp_path / "hall.yaml")})
    return make_room().model_copy(update={"arena": None, "map": spec})


def test_a_world_of_a_thousand_boxes_is_seen_and_touched_as_it_is(simulate, mapped):
    world = simulate(mapped, seed=1)
    assert len(world.geometry.walls) > 1300
    ranges, sensor = world.scan(0), world._robots[0].body.sensor()
    hit = np.isfinite(ranges)
    assert hit.sum() > 100
    bearings = world.lidar.bearings[hit]
    ends = sensor.origin[:2] + ranges[hit, None] * np.stack((np.cos(bearings), np.sin(bearings)), axis=1)
    assert np.abs(world.geometry.signed_distance(ends)).max() < 2e-3
    near = float(world.geometry.signed_distance(world.pose(0)[:2]))
    assert near - 0.123 <= world.clearance(0) <= near
    world.command(0, (0.22, 0.3))
    while world.episode(0).outcome.name == "RUNNING":
        world.step(24)
        assert world.elapsed < 60.0
    assert world.episode(0).outcome.name == "COLLISION"
    assert world.geometry.signed_distance(world.pose(0)[:2]) < 0.125


def test_only_near_bodies_are_searched_and_the_distance_is_the_same(simulate, mapped, engine):
    if engine != "pybullet":
        pytest.skip("of one engine")
    world = simulate(mapped, seed=1)
    quick = world._engine.distance(0, 1.0)
    world._engine._gaps = lambda _robot: None
    assert world._engine.distance(0, 1.0) == quick


def speed(world, seconds=1.0):
    world.command(0, (0.2, 0.0))
    world.step(round(240 * seconds))
    return world.velocity(0)[0]


def test_smaller_wheels_drive_slower_than_odometry_says(simulate, make_room):
    world = simulate(make_room(), wheel_radius=0.9)
    assert speed(world) == pytest.approx(0.18, rel=0.01)
    assert world.odometry(0).velocity[0] == pytest.approx(0.2, rel=0.01)
    assert world.odometry(0).pose[0] == pytest.approx(world.pose(0)[0] / 0.9, rel=0.01)


def test_slow_motors_take_longer(simulate, make_room):
    world = simulate(make_room(), motor_lag=0.5)
    assert speed(world, 0.5) == pytest.approx(0.2 * (1 - np.exp(-1.0)), rel=0.05)


def test_wheels_slip_on_a_smooth_floor(simulate, make_room):
    worlds = [simulate(make_room(), friction=friction) for friction in (1.0, 0.02)]
    rough, smooth = (speed(world, 0.2) for world in worlds)
    assert smooth < 0.6 * rough


def test_each_episode_draws_its_conditions_from_the_ranges_of_the_task(simulate, make_room):
    ranges = {"wheel_radius": (0.8, 1.2), "scan_noise": (0.0, 0.05), "command_delay": (0.0, 0.3)}
    task = make_room().model_copy(update={"randomisation": ranges})
    world, seen = simulate(task), []
    for seed in (0, 1, 2, 0):
        world.reset(seed)
        drawn = world.conditions
        seen.append((drawn.wheel_radius, drawn.scan_noise, drawn.command_delay))
        assert all(low <= value <= high for value, (low, high) in zip(seen[-1], ranges.values(), strict=True))
        assert world.lidar.noise == drawn.scan_noise
    assert seen[0] == seen[3]
    assert len(set(seen)) == 3
    still = simulate(task, randomise=False)
    assert still.conditions == still.options
