"""Training environments: equal seeds give equal episodes, and a policy's observations equal a robot's."""

import os
import re
from ctypes.util import find_library
from pathlib import Path

import numpy as np
import pytest
from koopman_lqr_controller.training.analysis.true_system import StraightCorridor
from koopman_lqr_controller.training.environments.benchmark_tasks import BENCHMARK_TASKS, find_task, task_of_manifest
from koopman_lqr_controller.training.environments.control_suite import FRAMES, ControlSuite
from koopman_lqr_controller.training.environments.corridor import Conditions, Corridor

from ctrl_rl_core import TaskError, task_file
from koopman_lqr_controller import KoopmanError

if find_library("EGL"):
    os.environ.setdefault("MUJOCO_GL", "egl")  # else MuJoCo comes without OpenGL where states are simulated first


def needs_egl() -> None:
    if os.environ.get("MUJOCO_GL") != "egl":
        pytest.skip("pictures need libegl1")


def episode(environment, seed: int, steps: int) -> list:
    random = np.random.default_rng(0)
    x, _ = environment.reset(seed=seed)
    record = [x]
    for _ in range(steps):
        x, reward, terminated, truncated, _ = environment.step(random.uniform(-1, 1, environment.action_space.shape))
        record += [x, reward, terminated, truncated]
        if terminated or truncated:
            break
    return record


def same(one: list, other: list) -> bool:
    return len(one) == len(other) and all(np.array_equal(a, b) for a, b in zip(one, other, strict=True))


@pytest.mark.parametrize("name", BENCHMARK_TASKS)
def test_the_same_seed_gives_the_same_episode_whatever_came_before(name: str) -> None:
    if BENCHMARK_TASKS[name].settings.crop:
        needs_egl()
    first, second = find_task(name).make(True), find_task(name).make(True)
    expected = episode(first, 3, 6)
    episode(second, 4, 4)
    assert same(episode(second, 3, 6), expected)
    assert not np.array_equal(episode(second, 5, 1)[0], expected[0])
    assert expected[0].shape == first.observation_space.shape
    assert expected[0].dtype == first.observation_space.dtype
    first.close()
    second.close()


def test_an_episode_of_the_suite_is_1000_of_its_steps_and_is_cut_not_ended() -> None:
    environment = ControlSuite("cartpole", "swingup", 8)
    record = episode(environment, 0, 1000)
    assert len(record) == 1 + 4 * 125
    assert record[-2:] == [False, True]
    assert sum(record[2::4]) <= 1000.0


def test_the_goal_of_the_cartpole_is_an_equilibrium_that_pays_all() -> None:
    environment = ControlSuite("cartpole", "swingup", 8)
    environment.reset(seed=0)
    physics = environment._suite.physics
    with physics.reset_context():
        physics.data.qpos[:] = physics.data.qvel[:] = 0.0
    x, reward, *_ = environment.step(np.zeros(1, np.float32))
    assert x == pytest.approx(BENCHMARK_TASKS["cartpole_swingup"].goal, abs=1e-6)
    assert reward == pytest.approx(8.0, abs=1e-6)


def test_pixels_are_the_last_pictures_oldest_first() -> None:
    needs_egl()
    environment = ControlSuite("cartpole", "swingup", 8, pixels=24)
    x, _ = environment.reset(seed=0)
    assert x.shape == (FRAMES, 24, 24)
    assert np.array_equal(x[0], x[2])
    after = environment.step(np.ones(1, np.float32))[0]
    assert np.array_equal(after[:2], x[1:])
    assert not np.array_equal(after[2], after[1])
    environment.close()


def test_the_corridor_pays_for_progress_and_the_firmware_truncates() -> None:
    corridor = Corridor(learning=False, conditions=Conditions())
    corridor.reset(seed=1)
    ahead = np.array([1.0, 0.0], np.float32)
    reward = [corridor.step(ahead)[1] for _ in range(5)]
    assert reward[-1] == pytest.approx(1.0, abs=0.35)  # heading is up to 20 deg off
    x = corridor.step(np.array([-0.05, 0.004], np.float32))[0]  # 0.1045 m/s and 0.006 rad/s: 0.10 and 0.0 come through
    x = corridor.step(np.array([-0.05, 0.004], np.float32))[0]
    assert x[-2] * 0.22 == pytest.approx(0.10, abs=2e-3)
    assert x[-1] * 1.5 == pytest.approx(0.0, abs=1e-3)
    corridor.close()


def test_hard_turns_cost() -> None:
    paid = []
    for turn in (0.0, 0.5, -1.0):
        corridor = Corridor(learning=False, conditions=Conditions(delay=0.2))  # nothing moves yet
        corridor.reset(seed=1)
        paid.append(corridor.step(np.array([-1.0, turn], np.float32))[1])
        corridor.close()
    assert paid[0] - np.array(paid) == pytest.approx([0.0, 0.05, 0.2], abs=1e-3)


def test_a_collision_costs_and_ends_the_episode() -> None:
    corridor = Corridor()
    corridor.reset(seed=0)
    for _ in range(100):
        _, reward, terminated, _, info = corridor.step(np.array([1.0, 0.2], np.float32))
        if terminated:
            break
    assert info["outcome"] == "COLLISION"
    assert reward < -19.0
    assert info["clearance"] <= 0.0
    corridor.close()


@pytest.mark.parametrize("lidar", ["task", "lds01", "lds02"])
def test_all_lidars_look_alike_to_the_policy(lidar: str) -> None:
    views = []
    for kind in ("task", lidar):
        corridor = Corridor(learning=False, conditions=Conditions(kind, 0.1 if kind == lidar else 0.0))
        views.append(corridor.reset(seed=5)[0])
        corridor.close()
    difference = np.abs(views[0] - views[1])
    assert np.median(difference) < 0.03
    assert np.quantile(difference, 0.8) < 0.2


def test_an_episode_of_learning_may_be_as_long_as_the_thesis_says() -> None:
    """Several corridors in a row take nearly the 700 steps of an episode at full speed."""
    learning, task = Corridor(), Corridor(learning=False)
    geometry, alone = learning._world.geometry, task._world.geometry
    assert geometry.path.length == pytest.approx(4 * alone.path.length)
    goal, end = learning.task.goal.intervals["s"], task.task.goal.intervals["s"]
    assert (goal.low - end.low, goal.high - goal.low) == pytest.approx((3 * alone.path.length, end.high - end.low))
    assert 500 < goal.low / (0.22 * learning.dt) < learning.task.episode.steps == 700
    for environment in (learning, task):
        environment.close()


def test_a_corridor_of_ones_own_is_learnt_without_meeting_itself(tmp_path: Path) -> None:
    """Three left corners in a row would return to the start."""
    file = tmp_path / "corner.yaml"
    pieces = "  pieces:\n    - {straight: 1.5 m}\n    - {turn: 90.0 deg, radius: 0.6 m}\n    - {straight: 1.0 m}\n"
    text = task_file("curved_corridor").read_text(encoding="utf-8")
    text = re.sub(r"  pieces:\n(    - .*\n)+", pieces, text).replace("curved_corridor", "corner")
    text = re.sub(r"\ngoal: .*", "\ngoal: {s: 3.1 .. 3.4 m}", text)
    file.write_text(text, encoding="utf-8")
    problem = find_task(str(file))
    assert problem.digest != BENCHMARK_TASKS["curved_corridor"].digest
    learning, task = problem.make(True), problem.make(False)
    alone = task._world.geometry.path.length
    assert round(learning._world.geometry.path.length / alone, 6) == 3, "the fourth would meet the first"
    assert learning.task.goal.intervals["s"].low == pytest.approx(3.1 + 2 * alone)
    for environment in (learning, task):
        environment.reset(seed=0)
        environment.step(np.zeros(2, np.float32))
        environment.close()


def test_a_corridor_is_driven_with_the_commands_that_its_task_allows(tmp_path: Path) -> None:
    text = task_file("curved_corridor").read_text(encoding="utf-8")

    def limits(v: str, omega: str) -> tuple[list[float], list[float]]:
        file = tmp_path / "own.yaml"
        body = "  body: turtlebot3_burger\n"
        own = text.replace(body, f"{body}  commands: {{v: {v} m/s, omega: {omega} rad/s}}\n")
        file.write_text(own.replace("curved_corridor", "own"), encoding="utf-8")
        corridor = find_task(str(file)).make(False)
        corridor.close()
        return corridor.robot_interface.u_low.tolist(), corridor.robot_interface.u_high.tolist()

    assert limits("0.0 .. 0.22", "-2.84 .. 2.84") == ([0.0, -1.5], [0.22, 1.5])
    assert limits("0.05 .. 0.1", "-0.9 .. 0.8") == ([0.05, -0.8], [0.1, 0.8])
    with pytest.raises(
        KoopmanError, match=r"task 'own' allows 0 \.\. 0\.1 m/s, 0 \.\. 0\.8 rad/s: a policy drives forwards"
    ):
        limits("0.0 .. 0.1", "0.0 .. 0.8")


def test_each_episode_has_another_robot_and_the_same_seed_the_same() -> None:
    corridor = Corridor()
    seen = {}
    for seed in (1, 2, 3, 1):
        x = corridor.reset(seed=seed)[0]
        options = corridor._world.options
        assert options.lidar in {"lds01", "lds02"}
        assert 0.0 <= options.scan_dropout <= 0.1 >= options.command_delay >= 0.0
        assert np.array_equal(seen.setdefault((seed, options), x), x)
    assert len(seen) == 3
    corridor.close()


def test_the_mirrored_corridor_is_one() -> None:
    """The mirrored corridor has the observation of a robot on the other side that turns the other way."""
    corridor, straight = Corridor(conditions=Conditions("task")), StraightCorridor(0.7, 0.2)
    order, sign, control_sign = corridor.mirror
    limits = corridor.robot_interface.command(np.array([[0.3, 0.8], [0.3, -0.8]]))
    state, swapped = np.array([0.1, 0.2, 0.15, 0.3]), np.array([1.0, -1.0])
    there = state * [-1.0, -1.0, 1.0, -1.0]

    def seen(state: np.ndarray) -> np.ndarray:
        return corridor.robot_interface.observation.observe(straight.scan(state), straight.geometry, *state[2:])

    assert limits[1] == pytest.approx(limits[0] * swapped), "mirrored actions are mirrored commands"
    assert control_sign == pytest.approx(swapped)
    for _ in range(5):
        assert seen(there) == pytest.approx(seen(state)[order] * sign, abs=1e-5)
        assert np.abs(seen(there) - seen(state)).max() > 0.1
        state, there = straight.step(state, limits[0]), straight.step(there, limits[1])
    corridor.close()


def test_what_is_not_there_is_named() -> None:
    with pytest.raises(KoopmanError, match="no task 'walker': there are cartpole_swingup, "):
        find_task("walker")
    with pytest.raises(TaskError, match="task 'car_ttr' has no corridor"):
        find_task(str(task_file("car_ttr")))
    same = {"task": "cheetah_run", "task_digest": find_task("cheetah_run").digest}
    assert task_of_manifest(same) == find_task("cheetah_run")
    with pytest.raises(KoopmanError, match="task cheetah_run has changed since the policy was made"):
        task_of_manifest({**same, "task_digest": "of yesterday"})
    with pytest.raises(KoopmanError, match="no setting latnt: there are latent, "):
        find_task("cheetah_run").with_settings(latnt=3)
    with pytest.raises(KoopmanError, match="batch is 0: must be positive"):
        find_task("cheetah_run").with_settings(batch=0)


def test_an_episode_that_stands_still_is_cut_off() -> None:
    environment = Corridor(learning=False)
    environment.reset(seed=0)
    steps, over = 0, False
    while not over:
        _, _, terminated, over, info = environment.step(np.array([-1.0, 0.0], np.float32))
        steps += 1
        assert not terminated
    assert info["outcome"] == "TIMEOUT"
    assert 10.0 < steps * environment.dt < 11.0
    environment.close()
