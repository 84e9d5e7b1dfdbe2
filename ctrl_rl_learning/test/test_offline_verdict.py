"""Nothing that is worse than the driver is called better, whatever the bags hold; and what a verdict rests on is said.

Bags are drives of the planar simulator, from which episodes are chosen; policies drive there to show what they are.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from ctrl_rl_learning.cli.evaluate_offline import evaluate_offline as command
from ctrl_rl_learning.cli.learn_offline import learn_offline
from ctrl_rl_learning.offline import (
    TIME_TO_REACH,
    LearningSettings,
    NoisyPolicy,
    OfflineReport,
    ScriptedDriver,
    Transitions,
    drive,
    evaluate_offline,
    learn,
    load_transitions,
    load_values,
    what_few_show,
)
from ctrl_rl_learning.offline.data.digests import episode_digests, fitted_to
from ctrl_rl_learning.offline.data.motion import displacements
from ctrl_rl_learning.offline.evaluation.dynamics import fit_dynamics, recorded_inputs
from ctrl_rl_learning.offline.evaluation.roll_outs import rest_of
from ctrl_rl_learning.offline.evaluation.verdict import believed, difference_of_shares, wilson
from ctrl_rl_learning.study import Estimate
from verdicts.policies import FULL, STRAIGHT, always, blind, mirrored, random_network

from ctrl_rl_core import Actor, NavigationTask, Outcome, load_navigation_task, load_policy, task_file

EPISODES, TESTS = 40, 20
IN_CORRIDORS = 16, 8
"""Episodes and tests in corridors, whose episodes are ten times as long."""
BAD = ("straight", "full speed and turn", "mirrored", "blind", "random")
KINDS = ("all", "successes alone", "failures alone", "never turns left", "five")
QUICK = [("car_navigation", kind) for kind in ("all", "never turns left", "five")]
SLOW = ("car_ttr", "corridor_sudden", "curved_corridor", "corridor_head_on", "corridor_doorways")


def numbers(task: NavigationTask) -> tuple[int, int]:
    """Return how many episodes are recorded and how many are driven as a test."""
    return (EPISODES, TESTS) if task.corridor is None else IN_CORRIDORS


@cache
def recorded(name: str) -> tuple[NavigationTask, Transitions]:
    task = load_navigation_task(name)
    with TemporaryDirectory() as folder:
        drive(task, ScriptedDriver(task), numbers(task)[0], 0, Path(folder) / "bag")
        return task, load_transitions([Path(folder) / "bag"], task)


def chosen(transitions: Transitions, kind: str) -> Transitions:
    """Return the episodes of a kind; a driver that never turns left is recorded up to where he would."""
    starts = np.append(np.flatnonzero(transitions.first), len(transitions))
    reached = transitions.outcomes[starts[1:] - 1] == Outcome.GOAL
    number = np.cumsum(transitions.first) - 1
    if kind == "never turns left":
        left = np.where(transitions.actions[:, 1] > 0.05, 1, 0)
        so_far = np.cumsum(left) - (np.cumsum(left) - left)[starts[:-1]][number]
        return transitions.rows(np.flatnonzero((so_far == 0) | transitions.first))
    wanted = {"successes alone": reached, "failures alone": ~reached, "five": np.arange(len(reached)) < 5}
    return transitions.rows(np.flatnonzero(wanted.get(kind, np.ones(len(reached), dtype=bool))[number]))


def bad(name: str, clone: Actor) -> Actor:
    made = {"mirrored": mirrored, "blind": blind, "random": random_network}
    if name in made:
        return made[name](clone)
    return always(clone, {"straight": STRAIGHT, "full speed and turn": FULL}[name])


@cache
def clone_of(name: str) -> Actor:
    task, transitions = recorded(name)
    return learn(transitions, task, LearningSettings("bc", 400, hidden=32))


@cache
def driven(task_name: str, policy: str) -> tuple[float, float]:
    """Return return and success of a bad policy as it drives, or of the driver."""
    task, _ = recorded(task_name)
    driver = ScriptedDriver(task)
    if policy:
        with TemporaryDirectory() as folder:
            bad(policy, clone_of(task_name)).save(Path(folder) / "policy.safetensors")
            driver = NoisyPolicy(load_policy(Path(folder) / "policy.safetensors"))
    drives = drive(task, driver, numbers(task)[1], 900)
    return float(drives.returns(0.99).mean()), float(drives.success.mean())


def judged(task_name: str, transitions: Transitions, actor: Actor) -> OfflineReport:
    return evaluate_offline(transitions, load_navigation_task(task_name), actor, updates=60, fits=2)


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        pytest.param(name, kind, marks=[] if (name, kind) in QUICK else [pytest.mark.slow])
        for name in ("car_navigation", *SLOW)
        for kind in KINDS
    ],
)
def test_nothing_worse_than_the_driver_is_called_better(name: str, kind: str) -> None:
    _, transitions = recorded(name)
    bag, driver = chosen(transitions, kind), driven(name, "")
    if not len(bag):
        pytest.skip("the driver has no such episodes")
    for policy in BAD:
        found = judged(name, bag, bad(policy, clone_of(name)))
        told = driven(name, policy)
        is_better = told[0] > driver[0] and told[1] >= driver[1]
        assert is_better or not found.better, f"{policy}: earns {told}, the driver {driver}"
        if found.better:
            continue
        assert all(objection.reason and objection.record for objection in found.objections)
        assert found.verdict in ("not shown", "worse")


def test_a_policy_that_is_better_and_faster_than_anything_recorded_is_called_so(tmp_path: Path) -> None:
    task, transitions = recorded("car_navigation")
    values = load_values(TIME_TO_REACH, task, tmp_path, 0.5 * task.robot.radius)
    actor = learn(transitions, task, LearningSettings("value_model", 1000, hidden=64), values)
    found = judged("car_navigation", transitions, actor)
    assert found.by_model
    assert found.support is not None
    assert found.support.beyond > 0.3
    assert found.support.scans_off < 0.001
    assert found.objections == []
    actor.save(tmp_path / "policy.safetensors")
    drives = drive(task, NoisyPolicy(load_policy(tmp_path / "policy.safetensors")), TESTS, 900)
    assert found.recommended.low < drives.returns(0.99).mean() < found.recommended.high
    assert found.success.low <= drives.success.mean()


def test_walls_that_are_not_the_files_forbid_roll_outs(tmp_path: Path) -> None:
    task, transitions = recorded("car_navigation")
    written = task_file("car_navigation").read_text()
    for box in ("(0.0, 0.0) m", "(2.0, 1.0) m"):
        x, y = (float(part) for part in box.strip("() m").split(","))
        written = written.replace(f'centre: "{box}", size', f'centre: "({x + 0.3}, {y}) m", size')
    (tmp_path / "car_navigation.yaml").write_text(written)
    other = load_navigation_task(tmp_path / "car_navigation.yaml")
    assert other.obstacles != task.obstacles
    found = evaluate_offline(transitions, other, clone_of("car_navigation"), updates=60, fits=1)
    assert not found.by_model
    assert any("the recorded ranges are not those" in objection.reason for objection in found.objections)


@pytest.mark.parametrize(
    ("agreement", "attainable", "is_believed"),
    [(0.95, 0.95, True), (0.76, 0.75, True), (0.75, 0.95, False), (0.46, 0.72, False), (0.3, 0.3, False)],
)
def test_a_model_is_believed_as_far_as_two_replays_agree(
    agreement: float, attainable: float, *, is_believed: bool
) -> None:
    _, transitions = recorded("car_navigation")
    found = judged("car_navigation", transitions, clone_of("car_navigation"))
    assert found.support is not None
    assert believed(replace(found.support, agreement=agreement, attainable=attainable)) == is_believed


def test_a_way_that_few_drove_asks_for_drives_of_the_policy() -> None:
    _, transitions = recorded("car_navigation")
    found = judged("car_navigation", transitions, clone_of("car_navigation"))
    assert found.support is not None
    few = replace(found, support=replace(found.support, effective=4.0, outside=0.0, outside_at=None))
    assert "10 episodes of the policy itself, under the watchdog" in [each.record for each in few.objections]


def test_motion_beyond_the_bags_goes_on_or_stays() -> None:
    task, transitions = recorded("car_navigation")
    dynamics = replace(fit_dynamics(transitions, rest_of(task)), errors=np.zeros((1, 3)))
    inputs, random = recorded_inputs(transitions, rest_of(task)), np.random.default_rng(0)
    fast = np.concatenate((np.tile((1.0, 0.0), (50, 1)), np.zeros((50, 3)), np.tile((1.0, 0.0), (50, 1))), axis=1)
    reached = []
    for capped in (False, True):
        model, steps = replace(dynamics, capped=capped), fast.copy()
        for _ in range(20):
            _, moved = model(np.zeros((50, 3)), steps, random)
            steps[:, 2:5] = moved
        reached.append(float(moved[:, 0].mean()))
    fastest = float(np.quantile(displacements(transitions)[:, 0], 0.99))
    full = task.robot.commands["v"].high * task.episode.time_step
    assert reached[0] == pytest.approx(full, rel=0.15)
    assert 0.7 * fastest < reached[1] < 1.2 * fastest < reached[0]
    assert (dynamics.distance(inputs) > 0.0).mean() < 0.15


def test_a_policy_says_which_episodes_it_was_fitted_to() -> None:
    task, transitions = recorded("car_navigation")
    five, actor = chosen(transitions, "five"), clone_of("car_navigation")
    assert len(set(episode_digests(transitions))) == EPISODES
    assert fitted_to(actor.manifest, five).all()
    assert fitted_to(learn(five, task, LearningSettings("bc", 5)).manifest, transitions).sum() == 5
    assert fitted_to({"bags": ["bag"]}, five) is None
    assert judged("car_navigation", transitions, actor).held_out == 0


def test_shares_of_few_episodes_are_wide() -> None:
    assert wilson(1.0, 5)[0] == pytest.approx(0.566, abs=0.001)
    assert wilson(0.5, 100) == pytest.approx((0.404, 0.596), abs=0.001)
    same = difference_of_shares(Estimate(1.0, 1.0, 1.0), 1.0, 20)
    assert same.mean == 0.0
    assert same.low == pytest.approx(-0.161, abs=0.001)
    assert difference_of_shares(Estimate(0.9, 0.9, 0.9), 0.4, 60).low > 0.3
    assert "45%" in what_few_show(5)
    assert what_few_show(10) == ""


def test_the_commands_say_what_few_episodes_show(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    task, _ = recorded("car_navigation")
    drive(task, ScriptedDriver(task), 5, 0, tmp_path / "bag")
    words = [str(tmp_path / "bag"), "--task", "car_navigation"]
    policy = str(tmp_path / "policy.safetensors")
    assert learn_offline([*words, "--method", "bc", "--updates", "20", "--output", policy]) == 0
    assert "5 episodes show little" in capsys.readouterr().err
    assert command([*words, "--policy", policy, "--updates", "20", "--fits", "1"]) == 1
    said = capsys.readouterr()
    assert "5 episodes show little" in said.err
    assert "verdict    not shown to be better than the driver of the bags, success" in said.out
    assert "record     5 more episodes at least" in said.out
    assert "held out   episodes that the policy was not fitted to: 0 of 5" in said.out
