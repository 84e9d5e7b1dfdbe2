"""The filter as a Gymnasium wrapper: no contact for any actions, and the information for a learner."""

from typing import Any

import numpy as np
import pytest

from ctrl_rl_core import load_navigation_task

pytest.importorskip("stable_baselines3")
from ctrl_rl_learning.sb3 import make_algorithm
from ctrl_rl_safety.training import ShieldOptions, ToldPPO, shielded_environment
from ctrl_rl_safety.training.runs import AttackRun, ShieldRun
from ctrl_rl_safety.trials.episodes import CAR
from stable_baselines3.common.callbacks import BaseCallback

TASK = load_navigation_task("car_navigation")
AHEAD = np.array((1.0, 0.0), np.float32)


def play(options: ShieldOptions, steps: int = 25) -> list[tuple[float, dict[str, Any]]]:
    """Drive straight ahead and return the reward and the info of each step."""
    environment = shielded_environment(TASK, CAR, options)
    environment.reset(seed=4)
    out = []
    for _ in range(steps):
        observation, reward, terminated, truncated, info = environment.step(AHEAD)
        assert observation.shape == environment.observation_space.shape == (3 + TASK.lidar.beams,)
        out.append((float(reward), info))
        if terminated or truncated:
            break
    environment.close()
    return out


def test_full_speed_ahead_collides_without_the_shield_and_not_with_it() -> None:
    assert play(ShieldOptions(active=False))[-1][1]["outcome"] == "COLLISION"
    steps = play(ShieldOptions())
    assert len(steps) == 25
    assert steps[0][1]["changed"] == 0.0
    assert max(info["changed"] for _, info in steps) == 1.0


def test_the_learner_is_told_what_the_options_say() -> None:
    raw, sent, penalty = (play(ShieldOptions(told=told)) for told in ("raw", "sent", "penalty"))
    assert all((info["told_action"] == AHEAD).all() for _, info in (*raw, *penalty))
    changed = [info["changed"] > 0.0 for _, info in sent]
    assert [bool((info["told_action"] != AHEAD).any()) for _, info in sent] == changed
    assert [reward < plain for (reward, _), (plain, _) in zip(penalty, raw, strict=True)] == changed


def test_ppo_remembers_the_actions_that_were_sent() -> None:
    run = ShieldRun("car_navigation", "sent", 0)
    model: Any = make_algorithm("ppo", run.environment, 0, 64, ToldPPO, n_steps=8, batch_size=64)
    seen: list[list[dict[str, Any]]] = []

    class Watch(BaseCallback):
        def _on_step(self) -> bool:
            seen.append(self.locals["infos"])
            return True

    model.learn(64, callback=Watch())
    model.env.close()
    told = np.array([[info["told_action"] for info in infos] for infos in seen])
    changed = np.array([[info["changed"] > 0.0 for info in infos] for infos in seen])
    assert changed.any()
    remembered = model.rollout_buffer.actions.reshape(told.shape[1], told.shape[0], 2).swapaxes(0, 1)
    np.testing.assert_array_equal(remembered[changed], told[changed])


def test_an_attacker_is_paid_for_coming_near() -> None:
    environment = AttackRun("turtlebot2", 0).environment()
    environment.reset(seed=1)
    rewards, clearances = [], []
    for _ in range(8):
        _, reward, _, _, info = environment.step(AHEAD)
        rewards.append(float(reward))
        clearances.append(info["clearance"])
    environment.close()
    np.testing.assert_allclose(rewards[1:], -100.0 * np.diff(clearances), atol=1e-6)


def test_an_attacker_without_the_filter_is_paid_for_a_contact_and_behind_it_has_none() -> None:
    ends = {}
    for bare in (True, False):
        environment = AttackRun("turtlebot2", 0, bare).environment()
        environment.reset(seed=1)
        for _ in range(25):
            _, reward, terminated, _, info = environment.step(AHEAD)
            if terminated:
                break
        environment.close()
        ends[bare] = info["avoidable"], float(reward) > 500.0
    assert ends == {True: (True, True), False: (False, False)}
