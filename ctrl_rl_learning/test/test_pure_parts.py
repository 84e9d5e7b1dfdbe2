"""Steps of a clock, the operator, and who commanded: the parts of the environment that need no robot."""

import math
from pathlib import Path

import numpy as np
import pytest
import torch
from ctrl_rl_learning.errors import LearningError
from ctrl_rl_learning.on_robot.environment.operator import JoyMapping, Operator, Tally
from ctrl_rl_learning.on_robot.environment.robot_env import StepClock
from ctrl_rl_learning.on_robot.learning.fine_tuner import FineTuner, TuneSettings
from ctrl_rl_learning.on_robot.learning.policy import read_policy
from ctrl_rl_learning.on_robot.learning.session import Session
from ctrl_rl_learning.torch.checkpoints import save_arrays, state_arrays
from ctrl_rl_learning.torch.replay_buffer import ReplayBuffer
from hypothesis import given
from hypothesis import strategies as st

from ctrl_rl_core import Actor, find_policy

LOW, HIGH = np.array((-0.1, -2.0)), np.array((0.2, 1.0))
JOY = JoyMapping(button=4, speed=1, turn=0)


@given(st.floats(0.05, 2.0), st.lists(st.floats(0.0, 5.0), min_size=1, max_size=30), st.floats(0.0, 1e6))
def test_no_time_is_lost_and_no_missed_step_is_hidden(period: float, delays: list[float], begin: float) -> None:
    clock, now, passed, missed = StepClock(period), begin, 0.0, 0
    clock.begin(begin)
    for delay in delays:
        due = clock.due
        now = max(now, due) + delay
        timing = clock.end(now)
        passed, missed = passed + timing.duration, missed + timing.missed
        assert timing.late == pytest.approx(now - due, abs=1e-6)
        assert timing.missed == pytest.approx(timing.late / period - 0.5, abs=0.5 + 1e-4)
        assert now < clock.due <= now + period + 1e-6
    assert passed == pytest.approx(now - begin, abs=1e-5)
    assert (len(delays) + missed) * period == pytest.approx(now - begin, abs=period * (len(delays) + 1))


def test_steps_on_time_do_not_drift_and_a_clock_that_goes_back_is_said() -> None:
    clock = StepClock(0.4)
    clock.begin(10.0)
    for count in range(1, 200):
        assert clock.due == pytest.approx(10.0 + 0.4 * count)
        assert clock.end(clock.due + 0.03).missed == 0
    with pytest.raises(LearningError, match="the clock went back"):
        clock.end(3.0)


@given(st.floats(allow_nan=True), st.floats(allow_nan=True), st.floats(0.0, 100.0))
def test_an_operator_s_command_is_finite_within_limits_and_fresh(speed: float, turn: float, age: float) -> None:
    operator = Operator(0.5, LOW, HIGH)
    assert operator.command(0.0) is None
    operator.on_command(speed, turn, 7.0)
    command = operator.command(7.0 + age)
    if not (math.isfinite(speed) and math.isfinite(turn)):
        assert command is None
        assert operator.refused == 1
    elif age > 0.5 + 1e-9:
        assert command is None
    elif age < 0.5 - 1e-9:
        assert command is not None
        assert ((command >= LOW) & (command <= HIGH)).all()


def test_the_joystick_drives_while_its_button_is_held() -> None:
    operator = Operator(0.5, LOW, HIGH)
    held, free = [0, 0, 0, 0, 1], [0, 0, 0, 0, 0]
    operator.on_joy([-1.0, 0.5], held, JOY, 1.0)
    assert operator.command(1.0) == pytest.approx((0.1, -2.0))
    operator.on_joy([-1.0, 0.5], free, JOY, 1.1)
    assert operator.command(1.1) is None
    for axes, buttons in (([0.0], held), ([0.0, 0.0], []), ([math.nan, 0.0], held)):
        operator.on_joy(axes, buttons, JOY, 2.0)
        assert operator.command(2.0) is None
    assert operator.refused == 3


def test_the_command_of_a_step_is_the_mean_by_time() -> None:
    tally = Tally(1.0, np.zeros(2))
    tally.sent(1.0, np.array((0.2, 0.0)), by_operator=False)
    tally.sent(1.3, np.array((0.0, 1.0)), by_operator=True)
    for changed in (False, True, False, False):
        tally.answered(changed)
    driven = tally.end(1.4)
    assert driven.command == pytest.approx((0.15, 0.25))
    assert (driven.operator, driven.changed) == pytest.approx((0.25, 0.25))
    assert Tally(1.0, HIGH).end(1.0).command == pytest.approx(HIGH)


def test_a_replay_keeps_the_newest_steps_through_a_checkpoint() -> None:
    replay, again = ReplayBuffer(4), ReplayBuffer(4)
    for number in range(6):
        replay.add({"rewards": np.array([number]), "following": np.full((1, 3), number + 1)})
    again.add(replay.in_order())
    assert again.in_order()["rewards"].tolist() == [2, 3, 4, 5]
    batch = again.draw(50, np.random.default_rng(0))
    assert (batch["following"][:, 0] == batch["rewards"] + 1).all()


def test_a_tuner_goes_on_where_it_was_and_refuses_what_is_damaged(tmp_path: Path) -> None:
    actor, interface = read_policy("car_ttr", motion=True)
    assert interface.size == len(actor.middle) == 15
    plain = Actor.load(find_policy("car_ttr"))
    seen = np.random.default_rng(0).normal(size=(50, 15)).astype(np.float32)
    assert actor.command(seen) == pytest.approx(plain.command(seen[:, :11])), "until it learns, it is the same policy"

    settings = TuneSettings(updates=1, first_updates=4, first_steps=20, batch=8, hidden=8)
    made = [FineTuner(actor, settings, 100, seed) for seed in (0, 1)]
    for row in seen:
        made[0].add(row, np.zeros(2, np.float32), float(row[0]), row, 0.9, by_operator=row[1] > 0.0)
    made[0].learn(6, np.random.default_rng(0))
    made[1].restore(made[0].arrays())
    for tuner in made:
        torch.manual_seed(0)
        tuner.learn(10, np.random.default_rng(1))
    assert (made[0].act(seen[0]) == made[1].act(seen[0])).all()
    assert (made[0].act(seen[0]) != FineTuner(actor, settings, 100, 0).act(seen[0])).any()

    (tmp_path / "checkpoint.safetensors").write_bytes(b"nothing of the kind")
    with pytest.raises(LearningError, match="delete it to start over"):
        Session(None, made[0], tmp_path, 0, {})
    save_arrays(tmp_path / "checkpoint.safetensors", made[0].arrays(), {"terms": {"seed": 0}, "episodes": []})
    Session(None, made[1], tmp_path, 0, {"seed": 0})
    with pytest.raises(LearningError, match="belongs to different settings"):
        Session(None, made[1], tmp_path, 0, {"seed": 1})


def test_the_policy_comes_to_do_what_the_operator_did() -> None:
    actor, _ = read_policy("car_ttr", motion=False)
    settings = TuneSettings(updates=300, first_updates=10, first_steps=20, batch=32, hidden=16, hold=100.0)
    tuner = FineTuner(actor, settings, 200, 0)
    wanted, random = np.array((-0.5, 0.5), np.float32), np.random.default_rng(0)
    seen = actor.middle + actor.unit * random.normal(size=(100, 11)).astype(np.float32)
    before = np.abs(np.array([tuner.act(row) for row in seen]) - wanted).mean()
    for row in seen:
        tuner.add(row, wanted, 0.0, row, 0.0, by_operator=True)
    tuner.learn(1, random)
    assert np.abs(np.array([tuner.act(row) for row in seen]) - wanted).mean() < 0.5 * before


def test_weights_that_are_not_finite_are_told_and_not_kept() -> None:
    layer = torch.nn.Linear(2, 1)
    assert set(state_arrays({"actor": layer}, {})) == {"actor.weight", "actor.bias"}
    with torch.no_grad():
        layer.bias.fill_(float("nan"))
    with pytest.raises(LearningError, match=r"diverged: weights actor\.bias are not finite"):
        state_arrays({"actor": layer}, {})
