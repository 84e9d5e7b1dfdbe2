import subprocess
import sys

import numpy as np
import pytest
from ctrl_rl_core.tasks import PathCoordinates

from ctrl_rl_core import TaskError, load_navigation_task


def drive(world, steps=25):
    """Return all sensor readings on a fixed drive that ends at a wall."""
    low, high = world._robots[0].body.bounds.T
    record = []
    for step in range(steps):
        for robot in range(len(world)):
            share = 0.5 + 0.5 * np.sin(np.array((0.3, 0.7)) * step + robot)
            world.command(robot, low + share * (high - low))
        world.step(48)
        for robot in range(len(world)):
            reading = world.odometry(robot)
            record += [world.scan(robot), reading.pose, reading.velocity, world.state(robot), world.clearance(robot)]
    return b"".join(np.asarray(part).tobytes() for part in record)


@pytest.mark.parametrize("name", ["curved_corridor", "car_ttr", "quad_trap"])
def test_the_same_seed_gives_the_same_bits_after_a_reset_and_in_a_new_world(simulate, name):
    options = {"odom_drift": 0.05, "scan_noise": 0.01, "scan_dropout": 0.05}
    worlds = [simulate(name, seed=7, robots=1, **options) for _ in range(2)]
    first = drive(worlds[0])
    assert drive(worlds[0]) != first
    worlds[0].reset(8)
    assert drive(worlds[0]) != first
    worlds[0].reset(7)
    assert drive(worlds[0]) == first
    assert drive(worlds[1]) == first


def test_the_same_seed_gives_the_same_bits_in_two_processes(engine, tmp_path):
    script = tmp_path / "drive.py"
    script.write_text(
        """
import hashlib, sys
from ctrl_rl_core import load_navigation_task
from sim_bridge.simulation.options import SimulationOptions
from sim_bridge.simulation.world import SimulatedWorld
options = SimulationOptions(engine=sys.argv[1], odom_drift=0.05, scan_dropout=0.05, randomise_width=True)
world = SimulatedWorld(load_navigation_task("curved_corridor"), seed=3, robots=2, options=options)
digest = hashlib.sha256()
for step in range(60):
    for robot in range(2):
        world.command(robot, (0.2, 0.8 if step % 3 else -1.5))
    world.step(24)
    for robot in range(2):
        digest.update(world.scan(robot).tobytes() + world.odometry(robot).pose.tobytes())
print("digest", digest.hexdigest())
"""
    )
    command = [sys.executable, script, engine]
    runs = [subprocess.run(command, capture_output=True, text=True, check=True) for _ in range(2)]
    digests = [line for run in runs for line in run.stdout.splitlines() if line.startswith("digest")]
    assert len(digests) == 2
    assert digests[0] == digests[1]


def test_noise_of_one_robot_does_not_depend_on_how_often_another_is_read(simulate):
    task = load_navigation_task("curved_corridor")
    first, second = (simulate(task, seed=1, robots=2) for _ in range(2))
    for _ in range(5):
        first.scan(0)
    np.testing.assert_array_equal(first.scan(1), second.scan(1))


def test_clearance_is_that_of_the_body_and_a_bump_is_a_collision(simulate, make_room):
    world = simulate(make_room(x=1.5))
    assert world.clearance(0) == pytest.approx(0.5 - 0.037, abs=2e-3)  # its front is 0.037 m ahead of the wheels' axis
    world.command(0, (0.2, 0.0))
    while world.episode(0).outcome.name == "RUNNING":
        world.step(8)
        assert world.elapsed < 5.0
    assert world.episode(0).outcome.name == "COLLISION"
    assert world.pose(0)[0] == pytest.approx(2.0 - 0.037, abs=3e-3)
    world.command(0, (-0.2, 0.0))
    world.step(480)
    episode = world.episode(0)
    assert episode.outcome.name == "COLLISION"  # latched
    assert episode.clearance > 0.2
    assert episode.smallest_clearance <= 0.0


@pytest.mark.parametrize("name", ["car_ttr", "car_navigation"])
def test_clearance_of_a_round_robot_is_its_distance_to_the_geometry(simulate, name):
    world = simulate(name)
    for seed in range(5):
        world.reset(seed)
        expected = float(world.geometry.signed_distance(world.pose(0)[:2])) - 0.177
        assert world.clearance(0) == pytest.approx(expected, abs=2e-3)


def test_a_touch_between_two_looks_is_not_missed(simulate, make_room):
    world = simulate(make_room(x=1.9))
    world.command(0, (0.22, 0.0))
    world.step(90)
    world.command(0, (-0.22, 0.0))
    world.step(240)
    assert world.clearance(0) > 0.1
    assert world.episode(0).outcome.name == "COLLISION"


def test_driving_along_the_path_reaches_the_goal_with_full_progress(simulate):
    world = simulate("curved_corridor", seed=0, scan_noise=0.0)
    path = world.geometry.path
    coordinates, last = PathCoordinates(path), 0.0
    while world.episode(0).outcome.name == "RUNNING":
        x, y, theta = world.state(0)
        s, lateral = coordinates((x, y, theta))[:2].tolist()
        heading = float(path.pose(s + 0.15)[2])
        error = np.angle(np.exp(1j * (theta - heading)))
        world.command(0, (0.22, -3.0 * error - 4.0 * lateral))
        world.step(24)
        progress = world.episode(0).progress
        assert progress >= last - 0.01
        last = progress
    assert world.episode(0).outcome.name == "GOAL"
    assert world.episode(0).progress == pytest.approx(1.0, abs=0.01)
    assert 25.0 < world.elapsed < 45.0


def test_quadrotor_that_tilts_too_far_has_crashed(simulate):
    world = simulate("quad_ttr", seed=0)
    world.command(0, (12.0, 0.0))
    world.step(60)
    episode = world.episode(0)
    assert episode.outcome.name == "COLLISION"
    assert episode.tilted
    assert episode.clearance > 0.0


def test_doing_nothing_times_out(simulate):
    task = load_navigation_task("car_ttr")
    world = simulate(task, seed=0)
    world.step(round(240 * task.episode.steps * task.episode.time_step) - 1)
    assert world.episode(0).outcome.name == "RUNNING"
    world.step(1)
    assert world.episode(0).outcome.name == "TIMEOUT"


def test_odometry_is_true_without_drift_and_drifts_with_it(simulate):
    task = load_navigation_task("curved_corridor")
    for drift, largest in ((0.0, 1e-12), (0.05, 0.1)):
        world = simulate(task, seed=1, odom_drift=drift)
        np.testing.assert_allclose(world.odometry(0).pose, world.pose(0))
        world.command(0, (0.2, 0.2))
        for _ in range(90):
            world.step(8)
            reading = world.odometry(0)
        error = np.abs(reading.pose - world.pose(0)).max()
        assert error <= largest
        assert (error > 1e-3) == (drift > 0.0)
        np.testing.assert_allclose(world.measured_state(0)[:2], reading.pose[:2])


def test_width_is_the_one_asked_for_or_drawn_from_the_task(simulate):
    task = load_navigation_task("curved_corridor")
    world = simulate(task, width=0.65)
    assert world.geometry.width == 0.65
    world = simulate(task, randomise_width=True)
    widths = set()
    for seed in range(4):
        world.reset(seed)
        widths.add(world.geometry.width)
        assert world.geometry.width in task.corridor.width_range
    assert len(widths) == 4
    with pytest.raises(TaskError, match="width"):
        simulate(task, width=3.0)


def test_starts_keep_robots_apart_and_too_many_are_refused(simulate):
    for name, count in (("curved_corridor", 6), ("car_ttr", 2)):
        world = simulate(name, seed=2, robots=count)
        assert min(world.clearance(robot) for robot in range(count)) > 0.02
    with pytest.raises(TaskError, match="no room for 20 robots"):
        simulate("car_ttr", robots=20)


def test_a_start_lies_in_the_start_set(simulate):
    for name in ("car_ttr", "quad_ttr", "car_navigation", "quad_trap"):
        task = load_navigation_task(name)
        world = simulate(task)
        for seed in range(5):
            world.reset(seed)
            assert task.start.region.contains(world.system.state_names, world.state(0))
            assert world.episode(0).outcome.name == "RUNNING"
