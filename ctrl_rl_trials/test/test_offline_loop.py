"""The closed loop of drives and bags, and whether estimates agree with what is then driven."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from ctrl_rl_learning.offline import OC_VALUE, solvable
from ctrl_rl_trials.offline.closed_loop import LoopSettings, run_loop
from ctrl_rl_trials.offline.correlation import CANDIDATES, CorrelationSettings, agreements, candidates_for

from ctrl_rl_core import load_navigation_task, task_digest
from ctrl_rl_learning import LearningError
from ttr_reward_node import problem_from_task, solve

TASK = load_navigation_task("car_navigation")


def test_agreement_counts_order_and_what_the_choice_loses() -> None:
    driven = [{"return": earned} for earned in (0.0, 1.0, 2.0, 4.0)]
    predicted = [[{"fitted_q": guess} for guess in guesses] for guesses in ((0.0, 1.0, 4.0, 2.0), (0.0, 2.0, 4.0, 8.0))]
    (agreement,) = agreements({"driven": driven, "predicted": predicted}).values()
    np.testing.assert_allclose(agreement.ranks, (0.8, 1.0))
    np.testing.assert_allclose(agreement.regret, (0.5, 0.0))
    assert agreement.correlation[1] == pytest.approx(1.0)
    low, high = agreement.interval
    assert low < agreement.correlation.mean() <= high <= 1.0 + 1e-9


def test_a_quick_trial_compares_each_policy_once() -> None:
    assert candidates_for(TASK, CorrelationSettings.updates) == CANDIDATES
    quick = candidates_for(TASK, 5)
    assert len({each.name for each in quick}) == len(quick) < len(CANDIDATES)
    assert {each.method for each in quick} == {each.method for each in CANDIDATES}
    # A task of the user's own has no optimal control value.
    own = candidates_for(TASK.model_copy(update={"name": "hall"}), 5)
    assert set(quick) - set(own) == {each for each in quick if each.value == OC_VALUE}


def test_the_loop_goes_round_and_goes_on_where_it_was(tmp_path: Path) -> None:
    (tmp_path / "values").mkdir()
    problem = problem_from_task(solvable(TASK), counts=(31, 31, 18), inflation=TASK.robot.radius)
    solve(problem).grid.save(tmp_path / "values" / f"car_navigation-{task_digest(TASK)[:12]}.safetensors")
    settings = LoopSettings("value_weight", rounds=1, episodes=12, tests=3, updates=30, fit_updates=20, clearance=0.0)
    said: list[str] = []
    first = run_loop(TASK, tmp_path / "run", settings, tmp_path / "values", said.append)
    assert [each["round"] for each in first] == [0, 1]
    assert len(first[1]["success"]) == len(first[1]["returns"]) == 3
    assert first[1]["predicted"]["low"] <= first[1]["predicted"]["mean"] <= first[1]["predicted"]["high"]
    assert "scripted driver" in said[0]
    # What is there is not made again; what a call that was cut off left is.
    (tmp_path / "run" / "round_1" / "result.json").unlink()
    policy = (tmp_path / "run" / "round_1" / "policy.safetensors").stat()
    assert run_loop(TASK, tmp_path / "run", settings, tmp_path / "values", said.append) == first
    assert (tmp_path / "run" / "round_1" / "policy.safetensors").stat() == policy
    # Rounds of other settings are not taken for those of this call.
    with pytest.raises(LearningError, match="run: was made with tests 3, now it is 4: use another folder"):
        run_loop(TASK, tmp_path / "run", replace(settings, tests=4), tmp_path / "values", said.append)
