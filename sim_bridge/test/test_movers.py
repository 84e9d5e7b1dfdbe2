import math

import numpy as np
import pytest

from ctrl_rl_core import Outcome, TaskError

ACROSS = '{radius: 0.2 m, track: {points: ["(1.0, -1.0) m", "(1.0, 1.0) m"], speed: 0.5 m/s}}'
TOWARDS = '{radius: 0.2 m, track: {points: ["(1.0, 0.0) m", "(-1.5, 0.0) m"], speed: 0.5 m/s}}'


def test_a_mover_keeps_to_its_way_and_the_lidar_sees_it(simulate, make_room):
    world = simulate(make_room(movers=f"[{ACROSS}]"))
    for _ in range(20):
        world.step(24)
        states, time = world.movers(), world.elapsed
        gone = (0.5 * time) % 4.0
        assert states.positions[0] == pytest.approx((1.0, -1.0 + min(gone, 4.0 - gone)), abs=1e-9)
        assert states.velocities[0] == pytest.approx((0.0, 0.5 if gone < 2.0 else -0.5), abs=1e-9)
        bearing = math.atan2(states.positions[0][1], 1.0 + 0.032)  # from the lidar, 0.032 m behind the middle
        expected = math.hypot(states.positions[0][1], 1.0 + 0.032) - 0.2
        assert world.scan()[round(math.degrees(bearing)) % 360] == pytest.approx(expected, abs=0.005)
    assert world.episode().outcome is Outcome.RUNNING


def test_a_mover_that_meets_a_standing_robot_ends_the_episode_and_pushes_it_at_its_own_speed(simulate, make_room):
    world = simulate(make_room(movers=f"[{TOWARDS}]"))
    while world.episode().outcome is Outcome.RUNNING:
        world.step(8)
    episode = world.episode()
    assert episode.outcome is Outcome.COLLISION
    assert episode.contact.mover == 0
    assert episode.contact.speed < 0.01
    # The burger's front, by its shape 0.037 m ahead of its middle, and the wheels' housing beside it.
    assert world.elapsed == pytest.approx((1.0 - 0.2 - 0.037) / 0.5, abs=0.05)
    world.step(120)
    assert world.velocity()[0] == pytest.approx(-0.5, abs=0.05)
    assert world.movers().positions[0][0] == pytest.approx(1.0 - 0.5 * world.elapsed, abs=1e-9)


def test_a_contact_says_how_fast_the_robot_was_and_what_it_met(simulate, make_room):
    world = simulate(
        make_room(movers="[{radius: 0.2 m, delay: 60 s, wander: {speed: 0.1 m/s}}]", theta=math.pi, x=-1.7)
    )
    while world.episode().outcome is Outcome.RUNNING:
        world.command(0, (0.22, 0.0))
        world.step(8)
    assert world.episode().contact.mover is None
    assert world.episode().contact.speed == pytest.approx(0.22, rel=0.05)
    assert world.episode().contact.words == "at 0.22 m/s"


def test_movers_wait_for_a_robot_to_come_near_and_for_one_in_their_way(simulate, make_room):
    near = TOWARDS.replace("track:", "near: 0.9 m, yields: 0.1 m, track:")
    world = simulate(make_room(movers=f"[{near}]"))
    world.step(240)
    assert world.movers().positions[0] == pytest.approx((1.0, 0.0))
    while world.pose()[0] < 0.12:
        world.command(0, (0.22, 0.0))
        world.step(24)
    world.command(0, (0.0, 0.0))
    world.step(480)
    assert world.episode().outcome is Outcome.RUNNING
    gap = np.linalg.norm(world.movers().positions[0] - world.pose()[:2])
    assert gap == pytest.approx(0.2 + 0.123 + 0.1, abs=0.005)
    assert (world.movers().velocities == 0.0).all()


def test_key_frames_repeat_and_may_jump_through_walls(simulate, make_room):
    frames = (
        '[{time: 0 s, point: "(1.0, 0.5) m"}, {time: 1 s, point: "(1.5, 0.5) m"}, {time: 2 s, point: "(3.0, 0.5) m"}]'
    )
    world = simulate(make_room(movers=f"[{{radius: 0.2 m, keyframes: {{frames: {frames}}}}}]"))
    world.step(240)
    assert world.movers().positions[0] == pytest.approx((1.5, 0.5))
    world.step(240 + 24)
    assert world.movers().positions[0][0] < 1.1
    assert np.linalg.norm(world.movers().velocities[0]) < 2.0
    world.step(1)
    assert world.scan()[round(math.degrees(math.atan2(0.5, 1.05)))] < 1.1


def test_no_robot_starts_in_a_mover(simulate, make_room):
    with pytest.raises(TaskError, match="no room for a robot at its start"):
        simulate(make_room(movers='[{radius: 0.3 m, track: {points: ["(0.0, 0.2) m", "(0.0, 1.0) m"], speed: 1 m/s}}]'))


@pytest.mark.parametrize("name", ["walkers", "corridor_sudden"])
def test_the_same_seed_gives_the_same_bits(simulate, name):
    def drive(world):
        record = []
        for step in range(20):
            world.command(0, (0.2, 0.5 * math.sin(step)))
            world.step(48)
            record += [world.scan(), world.pose(), world.movers().positions, world.clearance()]
        return b"".join(np.asarray(part).tobytes() for part in record)

    world = simulate(name, seed=3)
    first = drive(world)
    world.reset(4)
    assert drive(world) != first
    world.reset(3)
    assert drive(world) == first
    assert drive(simulate(name, seed=3)) == first
