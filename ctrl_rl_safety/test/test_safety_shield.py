"""The shield around an independent simulator: no contact with any driver, while the same driver crashes without it."""

import math
from dataclasses import replace

import gymnasium
import numpy as np
import pytest
from ctrl_rl_safety.training import SafetyShield
from gymnasium import spaces
from gymnasium.utils.env_checker import check_env

from ctrl_rl_safety import SafetyError, find_model

ROBOT = replace(find_model("turtlebot3_burger"), delay=0.0, lag=0.0)
BEARINGS = np.linspace(-np.pi, np.pi, 180, endpoint=False)
HALF, STEP, SUBSTEPS = 1.5, 0.1, 10
BOUNDS = np.array(((-0.22, 0.22), (-2.84, 2.84)))


class Room(gymnasium.Env):
    """Unicycle among discs in a square room, in plain NumPy; actions in [-1, 1]."""

    def __init__(self):
        self.observation_space = spaces.Box(-10.0, 10.0, (5 + len(BEARINGS),), np.float32)
        self.action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)

    def reset(self, *, seed=None, options=None):  # noqa: ARG002 - gymnasium's own form
        super().reset(seed=seed)
        self.discs = self.np_random.uniform(-1.4, 1.4, (12, 2))
        self.discs = self.discs[np.hypot(*self.discs.T) > 0.6]
        self.state = np.array((0.0, 0.0, self.np_random.uniform(-np.pi, np.pi), 0.0, 0.0))
        return self._observe(), {}

    def step(self, action):
        v, omega = BOUNDS[:, 0] + 0.5 * (np.clip(action, -1.0, 1.0) + 1.0) * (BOUNDS[:, 1] - BOUNDS[:, 0])
        crashed = False
        for _ in range(SUBSTEPS):
            dt, s = STEP / SUBSTEPS, self.state
            s[3] += np.clip(v - s[3], -ROBOT.braking * dt, ROBOT.braking * dt)
            s[4] += np.clip(omega - s[4], -ROBOT.turn_acceleration * dt, ROBOT.turn_acceleration * dt)
            s[2] = math.remainder(s[2] + dt * s[4], 2.0 * np.pi)
            s[:2] += dt * s[3] * np.array((np.cos(s[2]), np.sin(s[2])))
            crashed |= self._clearance() <= 0.0
        return self._observe(), float(self.state[3]), bool(crashed), False, {}

    def _clearance(self):
        free = HALF - np.abs(self.state[:2]).max()
        gaps = np.hypot(*(self.discs - self.state[:2]).T) - 0.1
        return min(free, gaps.min(initial=np.inf)) - ROBOT.radius

    def _observe(self):
        x, y, theta = self.state[:3]
        c, s = np.cos(theta + BEARINGS), np.sin(theta + BEARINGS)
        with np.errstate(divide="ignore"):
            ranges = np.minimum((HALF * np.sign(c) - x) / c, (HALF * np.sign(s) - y) / s)
        for dx, dy in self.discs - (x, y):
            along = dx * c + dy * s
            half = 0.1**2 - (dx**2 + dy**2 - along**2)
            hit = (half > 0.0) & (along > 0.0)
            ranges[hit] = np.minimum(ranges[hit], along[hit] - np.sqrt(half[hit]))
        return np.concatenate((self.state, ranges)).astype(np.float32)


def shielded(**changes):
    settings = {"step": STEP, "state": lambda seen: seen[:5], "scan": lambda seen: seen[5:], "bearings": BEARINGS}
    return SafetyShield(Room(), ROBOT, **{**settings, "commands": BOUNDS, **changes})


def contacts(environment, seeds, steps=150):
    """Return the number of episodes with a contact for a careless driver, which holds random commands for 1 s."""
    count = 0
    for seed in seeds:
        random = np.random.default_rng(seed)
        environment.reset(seed=seed)
        for step in range(steps):
            if step % 10 == 0:
                action = np.array((1.0, random.uniform(-0.5, 0.5)), np.float32)
            if environment.step(action)[2]:
                count += 1
                break
    return count


@pytest.mark.parametrize("episodes", [6, pytest.param(20, marks=pytest.mark.slow)])
def test_a_careless_driver_never_collides_behind_the_shield_and_mostly_without_it(episodes):
    assert contacts(Room(), range(episodes)) >= 0.75 * episodes
    assert contacts(shielded(), range(episodes)) == 0
    assert contacts(shielded(recoverable_set=True), range(episodes // 6)) == 0


def test_info_tells_what_was_sent_and_free_actions_pass_as_they_are():
    environment = shielded()
    environment.reset(seed=1)
    ahead = np.array((1.0, 0.0), np.float32)
    told = [environment.step(ahead)[-1] for _ in range(120)]
    assert told[0]["changed"] == 0.0
    assert told[0]["told_action"].tolist() == ahead.tolist()
    assert told[0]["filter_mode"] == "PASSED"
    changed = [info for info in told if info["changed"]]
    assert changed
    assert all(info["told_action"].dtype == np.float32 for info in changed)
    assert all(environment.action_space.contains(info["told_action"]) for info in changed)
    assert any(info["told_action"][0] < 1.0 for info in changed)


def test_gymnasium_finds_nothing_wrong_with_it():
    with pytest.warns(UserWarning, match="different from the unwrapped version"):
        check_env(shielded(), skip_render_check=True)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"step": 0.0}, "step 0.0 s: must be more than 0"),
        ({"commands": ((1.0, 0.0), (0.0, 1.0))}, "must be \\(\\(least v, largest v\\)"),
        ({"state": "state"}, "info\\['state'\\]: no 'state'; info has nothing"),
        ({"state": lambda seen: seen[:3]}, "has the shape \\(3,\\): must be \\(5,\\), x \\[m\\]"),
        ({"bearings": BEARINGS[:9]}, "must have a range for each of the bearings, \\(9,\\)"),
        ({"bearings": None}, "give bearings for ranges"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(changes, message):
    with pytest.raises(SafetyError, match=message):
        shielded(**changes).reset(seed=0)


def test_a_step_before_a_reset_and_other_actions_are_refused():
    environment = shielded()
    with pytest.raises(SafetyError, match="reset the environment"):
        environment.step(np.zeros(2, np.float32))
    environment.reset(seed=0)
    with pytest.raises(SafetyError, match="two finite numbers"):
        environment.step(np.array((np.nan, 0.0), np.float32))
    with pytest.raises(SafetyError, match="must be a box of two numbers"):
        SafetyShield(gymnasium.make("CartPole-v1"), ROBOT, step=0.02, state="state", scan="scan")
