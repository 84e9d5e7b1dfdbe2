import math

import numpy as np
import pytest
from ctrl_rl_core.geometry.motion import catmull_rom, polyline
from ctrl_rl_core.tasks.task import FOLDER

from ctrl_rl_core import TaskError, draw_movers, load_navigation_task, task_digest

NAMES = ("corridor_crossing", "corridor_cutting_in", "corridor_head_on", "corridor_sudden", "walkers")


def places(motion, count=400):
    return np.array([motion.position(time) for time in np.linspace(0.0, 1.5 * motion.duration, count)])


def test_a_polyline_has_one_speed_and_ends_as_it_is_told():
    corners = [(0.0, 0.0), (3.0, 0.0), (3.0, 0.0), (3.0, 4.0)]
    once, loop, back = (polyline(corners, 0.5, repeat) for repeat in ("once", "loop", "back_and_forth"))
    assert [each.duration for each in (once, loop, back)] == pytest.approx([14.0, 24.0, 28.0])
    assert once.position(100.0) == (3.0, 4.0)
    assert once.velocity(100.0) == (0.0, 0.0)
    assert loop.position(19.0) == pytest.approx((1.5, 2.0))
    assert back.position(28.0 + 10.0) == back.position(28.0 - 10.0) == pytest.approx((3.0, 2.0))
    assert back.velocity(28.0 - 10.0) == pytest.approx((0.0, -0.5))
    assert once.top_speed == pytest.approx(0.5)
    assert [each.closed for each in (once, loop, back)] == [False, True, True]
    with pytest.raises(ValueError, match="two different points"):
        polyline([(1.0, 1.0)] * 3, 0.5, "once")


def test_a_spline_goes_through_its_frames_with_the_slopes_of_catmull_and_rom():
    times, points = [0.0, 1.0, 3.0, 4.0], np.array([(0.0, 0.0), (1.0, 0.5), (2.0, -1.0), (0.0, 0.0)])
    motion = catmull_rom(times, points, True)
    for time, point in zip(times[:-1], points, strict=False):
        assert motion.position(time) == pytest.approx(tuple(point))
    # Half way between frames 1 and 2: the mean of both, and an eighth of the difference of their slopes.
    slopes = 0.5 * (points[2] - points[0]), 0.5 * (points[3] - points[1])
    assert motion.position(2.0) == pytest.approx(tuple(0.5 * (points[1] + points[2]) + (slopes[0] - slopes[1]) / 8))
    step = 1e-6
    for time in (0.3, 1.7, 3.4):
        ahead, behind = np.array(motion.position(time + step)), np.array(motion.position(time - step))
        assert motion.velocity(time) == pytest.approx(tuple((ahead - behind) / (2 * step)), abs=1e-6)
    speeds = [math.hypot(*motion.velocity(time)) for time in np.linspace(0.0, 4.0, 500)]
    assert max(speeds) <= motion.top_speed * 1.001


@pytest.mark.parametrize("name", NAMES)
def test_a_seed_draws_one_set_of_ways_that_keep_clear_of_walls(name):
    task = load_navigation_task(name)
    world = task.build_world()
    first, same, other = (draw_movers(task, world, np.random.default_rng(seed)) for seed in (1, 1, 2))
    assert first == same != other
    for plan in first:
        assert world.signed_distance(places(plan.motion)).min() > plan.radius - 0.01


def changed(tmp_path, old, new, name="corridor_crossing"):
    text = (FOLDER / f"{name}.yaml").read_text()
    assert old in text
    file = tmp_path / f"{name}.yaml"
    file.write_text(text.replace(old, new))
    return load_navigation_task(file)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("speed: 0.1 .. 0.3 m/s", "speed: 0.0 .. 0.3 m/s", r"movers.0.track.speed: 0: must be at least"),
        ("delay: 0.0 .. 5.0 s", "delay: -1.0 .. 5.0 s", r"movers.0.delay: -1: must be at least 0"),
        ('"(3.0, -0.28) m"', '"(3.0, 0.28) m"', "are all the same"),
        ("track: {", "way: {", "movers"),
        ("delay: 0.0 .. 5.0 s", "wander: {speed: 1 m/s}", "needs either 'track', 'wander' or 'keyframes'"),
        (
            "delay: 0.0 .. 5.0 s",
            'keyframes: {frames: [{time: 0 s, point: "(0, 0) m"}, {time: 0 s, point: "(0, 1) m"}]}',
            "0 s follows 0 s: times must rise",
        ),
    ],
)
def test_a_wrong_mover_is_refused_with_file_and_key(tmp_path, old, new, message):
    with pytest.raises(TaskError, match=message):
        changed(tmp_path, old, new)


def test_a_mover_without_room_is_named(tmp_path):
    task = changed(tmp_path, "radius: 0.1 m\n", "radius: 0.2 m\n")
    with pytest.raises(TaskError, match=r"movers.0 finds no way that is clear of walls .* smaller than 0.2 m"):
        draw_movers(task, task.build_world(), np.random.default_rng(0))


def test_movers_are_part_of_the_digest_and_tasks_without_keep_theirs(tmp_path):
    task = load_navigation_task("corridor_crossing")
    assert task_digest(changed(tmp_path, "radius: 0.1 m\n", "radius: 0.09 m\n")) != task_digest(task)
    assert task_digest(task.model_copy(update={"movers": ()})) != task_digest(task)
