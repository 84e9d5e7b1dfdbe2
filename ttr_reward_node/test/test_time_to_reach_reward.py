"""Time to reach as the reward of user-defined environments: the rewards, and training with them."""

import math
import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from ttr_reward_node.rewards.progress import PER_SECOND, ProgressEvaluator

from ctrl_rl_core import (
    SYSTEM_MODELS,
    Box,
    CtrlRlError,
    Quantity,
    SystemModel,
    load_navigation_task,
    make_system,
)
from ttr_reward_node import (
    RewardEvaluator,
    TimeToReach,
    TimeToReachError,
    TimeToReachReward,
    TimeToReachVectorReward,
    solve_value,
)

HALF, SPEED, STEP, LONGEST = 2.0, 1.0, 0.2, 40
WALL = Box((0.0, -0.7), (0.3, 2.6))
"""Wall from the lower side up to y = 0.6."""


def particle(_math, _parameters):
    """Return the equations of a point whose velocity is the control."""
    return lambda _, u, d: (u[0] + d[0], u[1] + d[1])


@pytest.fixture(scope="module")
def value():
    SYSTEM_MODELS["particle"] = SystemModel(
        states=(Quantity("x", "m"), Quantity("y", "m")),
        controls=(Quantity("v_x", "m/s", -SPEED, SPEED), Quantity("v_y", "m/s", -SPEED, SPEED)),
        parameters=(),
        equations=particle,
    )
    try:
        side = (-HALF, HALF, 41)
        target = {"x": (1.0, 1.6), "y": (-1.6, -1.0)}
        return solve_value(make_system("particle"), {"x": side, "y": side}, target, obstacles=[WALL])
    finally:
        del SYSTEM_MODELS["particle"]


class Yard(gymnasium.Env):
    """Particle that has to go round a wall; it is paid 1 at the goal and slides along walls."""

    def __init__(self, told=True):
        self.observation_space = spaces.Box(-HALF, HALF, (2,), np.float32)
        self.action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)
        self.told = told

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.steps = 0
        self.at = np.array((options or {}).get("at", self.np_random.uniform((-1.7, -1.7), (-0.5, -0.5))), float)
        return self.at.astype(np.float32), self.info()

    def info(self):
        return {"place": self.at.copy()} if self.told else {}

    def step(self, action):
        self.steps += 1
        for side in np.diag(STEP * SPEED * np.clip(action, -1.0, 1.0)):  # a blocked component does not stop the other
            there = np.clip(self.at + side, -HALF, HALF)
            if WALL.signed_distance(there[None])[0] > 0.0:
                self.at = there
        arrived = bool((np.abs(self.at - (1.3, -1.3)) <= 0.3).all())
        return self.at.astype(np.float32), float(arrived), arrived, self.steps >= LONGEST, self.info()


def drive(environment, actions, at=(-1.5, -1.5)):
    """Return the rewards and infos of actions from a start position."""
    _, info = environment.reset(seed=0, options={"at": at})
    rewards, infos = [], [info]
    for action in actions:
        _, reward, terminated, _, info = environment.step(np.array(action, np.float32))
        rewards.append(reward)
        infos.append(info)
        if terminated:
            break
    return rewards, infos


UP, DOWN, EAST, WEST = (0.0, 1.0), (0.0, -1.0), (1.0, 0.0), (-1.0, 0.0)
ROUND = [UP] * 15 + [EAST] * 14 + [DOWN] * 14


def test_best_progress_pays_the_time_to_reach_of_the_start_once(value):
    environment = TimeToReachReward(Yard(), value, "place")
    rewards, infos = drive(environment, ROUND)
    start = infos[0]["time_to_reach"]
    assert infos[-1]["time_to_reach"] == 0.0
    assert sum(rewards) == pytest.approx(1.0 + start)  # the environment's own 1, and 1 per second of progress
    to_and_fro, _ = drive(environment, [UP, DOWN] * 6 + ROUND)
    assert sum(to_and_fro) == pytest.approx(sum(rewards))
    assert min(to_and_fro) >= 0.0
    taken_back, _ = drive(TimeToReachReward(Yard(), value, "place", kind="progress"), [UP, DOWN])
    assert sum(taken_back) == pytest.approx(0.0, abs=1e-6)
    assert taken_back[1] < 0.0


def test_own_rewards_are_weighed_and_seconds_have_their_price(value):
    rewards, infos = drive(TimeToReachReward(Yard(), value, "place", per_second=10.0, own=0.0), ROUND)
    assert sum(rewards) == pytest.approx(10.0 * infos[0]["time_to_reach"])


def test_shaping_takes_its_potential_back_where_an_episode_is_terminated_and_not_where_it_is_cut(value):
    gamma = 0.95
    environment = TimeToReachReward(Yard(), value, "place", kind="shaping", discount=gamma, own=0.0)
    rewards, infos = drive(environment, ROUND)
    longest = float(np.max(value.values[np.isfinite(value.values)]))
    potential = [longest - info["time_to_reach"] for info in infos]
    worth = sum(gamma**index * reward for index, reward in enumerate(rewards))
    assert worth == pytest.approx(-potential[0], abs=1e-3)
    cut, infos = drive(environment, [UP] * LONGEST)
    potential = [longest - info["time_to_reach"] for info in infos]
    assert cut[-1] == pytest.approx(gamma * potential[-1] - potential[-2], abs=1e-3)


def test_the_state_is_a_key_of_info_or_a_function_of_what_is_seen(value):
    expected, _ = drive(TimeToReachReward(Yard(), value, "place"), ROUND)
    for state in (lambda seen: seen, lambda seen, info: info["place"] + 0.0 * seen, np.asarray):
        assert drive(TimeToReachReward(Yard(), value, state), ROUND)[0] == pytest.approx(expected, abs=1e-5)


def test_states_off_the_grid_and_without_a_way_are_no_progress(value):
    def paid(*places):
        read = iter(places)
        environment = TimeToReachReward(Yard(), value, lambda _: next(read), own=0.0)
        environment.reset(seed=0)
        return [environment.step(np.zeros(2, np.float32))[1] for _ in places[1:]]

    longest = float(np.max(value.values[np.isfinite(value.values)]))
    (off,) = paid((-1.5, -1.5), (-1.5, -9.0))  # same as at (-1.5, -2), farther from the goal
    assert off == 0.0
    inside, out, back = (0.0, -1.0), (-1.0, -1.0), (0.0, -1.0)  # a position inside the wall cannot reach the goal
    entered, left = paid(inside, out, back)
    assert entered == pytest.approx(longest - float(value.value([out])[0]))
    assert left == 0.0


def test_a_reset_within_an_episode_begins_anew(value):
    environment = TimeToReachReward(Yard(), value, "place")
    first, _ = drive(environment, ROUND[:20])
    assert drive(environment, ROUND[:20])[0] == first


def test_where_info_says_that_the_goal_is_reached_no_time_is_left(value):
    class Sure(Yard):
        def info(self):
            return {**super().info(), "is_success": self.steps > 0}

    (reward,), infos = drive(TimeToReachReward(Sure(), value, "place"), [UP])
    assert reward == pytest.approx(infos[0]["time_to_reach"])


def test_an_evaluator_pays_progress_at_the_end_too_and_begins_anew_after_it():
    task, value = load_navigation_task("car_ttr"), solve_value("car_ttr", counts=(41, 41, 24), inflation=0.0)
    evaluate = ProgressEvaluator(RewardEvaluator(task, value), TimeToReach(value))
    far, near, goal, outside = (-4.0, -4.0, 1.0), (0.0, -3.0, 1.0), (4.0, 4.0, 0.75), (7.0, 0.0, 0.0)
    times = value.value([far, near])
    gained = PER_SECOND * (times[0] - times[1])

    def paid(*states):
        return [evaluate(np.array(state), float(value.value([state])[0])).reward for state in states]

    assert paid(far, near, far, near) == pytest.approx([0.0, gained, 0.0, 0.0])
    assert paid(goal, far, near) == pytest.approx([1000.0 + PER_SECOND * times[1], 0.0, gained])
    evaluate.begin()
    assert paid(far, near) == pytest.approx([0.0, gained])
    assert not math.isnan(paid(outside)[0])


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_many_at_a_time_are_paid_as_one_at_a_time(value, mode):
    random = np.random.default_rng(1)
    actions = random.uniform(-1.0, 1.0, (130, 3, 2)).astype(np.float32)
    together = TimeToReachVectorReward(SyncVectorEnv([Yard] * 3, autoreset_mode=mode), value, "place")
    alone = [TimeToReachReward(Yard(), value, "place") for _ in range(3)]
    together.reset(seed=[5, 6, 7])
    for row, environment in enumerate(alone):
        environment.reset(seed=5 + row)
    over = np.zeros(3, dtype=bool)
    for each in actions:
        _, paid, terminated, truncated, _ = together.step(each)
        for row, environment in enumerate(alone):
            if over[row] and mode is AutoresetMode.NEXT_STEP:
                environment.reset()
                assert paid[row] == 0.0
                continue
            _, expected, *ended, _ = environment.step(each[row])
            assert (paid[row], [terminated[row], truncated[row]]) == (pytest.approx(expected, abs=1e-5), ended)
        over = terminated | truncated
        if mode is AutoresetMode.SAME_STEP:
            for row in np.flatnonzero(over):
                alone[row].reset()
        if mode is AutoresetMode.DISABLED and over.any():
            together.reset(options={"reset_mask": over})
            for row in np.flatnonzero(over):
                alone[row].reset()
    together.close()


def test_gymnasium_finds_nothing_wrong_with_it(value):
    with pytest.warns(UserWarning, match="different from the unwrapped version"):
        check_env(TimeToReachReward(Yard(), value, "place"), skip_render_check=True)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"state": "pose"}, "info\\['pose'\\]: no 'pose'; info has place: name another key, or give a function"),
        ({"state": lambda seen: seen[:1]}, "has the shape \\(1,\\): must be \\(2,\\), x, y"),
        ({"state": lambda _: (math.nan, 0.0)}, "every number must be finite"),
        ({"kind": "best"}, "no kind of pay 'best': there are best_progress, progress, shaping"),
        ({"per_second": math.inf}, "per_second inf"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(value, changes, message):
    with pytest.raises(CtrlRlError, match=message):
        TimeToReachReward(Yard(), value, **{"state": "place", **changes}).reset()


def test_a_step_before_a_reset_is_refused(value):
    with pytest.raises(TimeToReachError, match="reset the environment before its first step"):
        TimeToReachReward(Yard(), value, "place").step(np.zeros(2))


def success_after_learning(make, samples):
    """Return the success rate in 20 episodes after training PPO with `samples` samples."""
    from stable_baselines3 import PPO
    from stable_baselines3.common.env_util import make_vec_env

    vector = make_vec_env(make, 4, seed=0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        model = PPO("MlpPolicy", vector, n_steps=256, batch_size=128, learning_rate=1e-3, seed=0, device="cpu")
        model.learn(samples)
    arrived = 0
    for seed in range(20):
        environment = Yard()
        observation, _ = environment.reset(seed=1000 + seed)
        over = False
        while not over:
            observation, _, terminated, truncated, _ = environment.step(
                model.predict(observation, deterministic=True)[0]
            )
            over = terminated or truncated
        arrived += terminated
    return arrived / 20


def test_a_robot_learns_its_way_by_it_where_the_goal_alone_teaches_nothing(value):
    pytest.importorskip("stable_baselines3")
    samples = 20_480
    assert success_after_learning(Yard, samples) <= 0.1

    def make():
        return TimeToReachReward(Yard(told=False), value, lambda seen: seen, own=5.0)

    assert success_after_learning(make, samples) >= 0.9


def test_a_fleet_of_the_suite_is_paid_for_progress() -> None:
    value = solve_value("car_ttr", counts=(31, 31, 16))
    fleet = gymnasium.make_vec("sim_bridge.environments:ctrl_rl/car_ttr-v0", num_envs=3)
    environments = TimeToReachVectorReward(fleet, value, own=0.0)
    environments.reset(seed=0)
    paid = [environments.step(np.tile((1.0, 0.0), (3, 1)).astype(np.float32))[1] for _ in range(5)]
    assert np.shape(paid) == (5, 3)
    assert np.max(paid) > 0.0
