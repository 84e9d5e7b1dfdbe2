"""The time-to-reach solver beside the referee's random systems, and the referee beside wrong solutions and others.

Forty systems take about a minute of one core, all two hundred several: these are slow. `make attack` goes on with
new ones.
"""

from __future__ import annotations

import numpy as np
import pytest
from referee.command import describe, judged, main, seeds_of, table
from referee.families import FAMILIES, draw, family_of
from referee.judge import draw_states, judge
from referee.plain import plain_times

COUNT = 40
ALL = 200
PLAIN_LIMIT = 0.05
"""Median error of plain value iteration on cells half as wide as the grid's."""


@pytest.mark.parametrize("family", FAMILIES)
def test_wrong_solutions_are_caught(family: str) -> None:
    seed = next(seeds_of(family, 0))
    case = draw(seed)
    exact = case.reference

    assert not judge(case, exact, seed).wrong
    assert judge(case, lambda x: 1.05 * exact(x), seed).median == pytest.approx(0.05)
    assert judge(case, lambda x: 1.05 * exact(x), seed).wrong
    holes = judge(case, lambda x: np.where(np.arange(len(x)) % 50 == 7, np.inf, exact(x)), seed)
    assert holes.wrong
    assert holes.lost > 0
    filled = judge(case, lambda x: np.where(np.isfinite(exact(x)), exact(x), 1.0), seed)
    assert filled.gained > 0.25 * (filled.states - filled.reachable) or filled.states == filled.reachable
    nowhere = judge(case, lambda x: np.full(len(x), np.inf), seed)
    assert nowhere.lost > 0.25 * nowhere.reachable


@pytest.mark.parametrize("family", FAMILIES)
def test_a_seed_draws_the_same_system_again(family: str) -> None:
    seed = next(seeds_of(family, 1000))
    one, other = draw(seed), draw(seed)
    assert one.words == other.words
    assert one.problem.content_digest == other.problem.content_digest
    states = draw_states(one.problem, np.random.default_rng(0), 20)
    np.testing.assert_array_equal(one.reference(states), other.reference(states))


@pytest.mark.parametrize("family", ["line", "lag", "nonlinear"])
def test_closed_forms_of_one_state_are_those_of_plain_value_iteration(family: str) -> None:
    seeds = seeds_of(family, 0)
    for seed in (next(seeds) for _ in range(12)):
        case = draw(seed)
        verdict = judge(case, plain_times(case.problem, samples=41 if family == "nonlinear" else 2), seed)
        assert not verdict.wrong, describe(verdict)


@pytest.mark.slow
@pytest.mark.parametrize("family", ["boat", "zermelo", "cart", "spring", "motor"])
def test_times_of_two_states_are_those_of_plain_value_iteration(family: str) -> None:
    seed = next(s for s in seeds_of(family, 0) if len(draw(s).problem.axes) == 2)
    case = draw(seed)
    verdict = judge(case, plain_times(case.problem, 2, 24 if family == "zermelo" else 3), seed)
    assert verdict.median <= PLAIN_LIMIT, describe(verdict)
    assert verdict.lost + verdict.gained <= 0.01 * verdict.states, describe(verdict)


@pytest.mark.parametrize("family", ["turning", "stream"])
def test_what_drifts_arrives_when_it_should(family: str) -> None:
    """Follow the states of a system without a control by small steps, which needs no grid."""
    seeds = seeds_of(family, 0)
    for seed in (next(seeds) for _ in range(6)):
        case = draw(seed)
        states = draw_states(case.problem, np.random.default_rng(seed), 400)
        exact = case.reference(states)
        arrived = follow(case.problem, states, float(np.nanmax(np.where(np.isfinite(exact), exact, 0.0))) * 1.1)
        known = ~np.isnan(exact)
        both = known & np.isfinite(exact) & np.isfinite(arrived)
        assert (np.isfinite(exact) != np.isfinite(arrived))[known].mean() <= 0.01  # some graze a corner
        np.testing.assert_allclose(arrived[both], exact[both], rtol=0.01, atol=arrived[both].max() / 1000.0)


def follow(problem, states, horizon, steps=4000):  # type: ignore[no-untyped-def]
    """Return when each state (N,) without a control first is in the target [s]; +inf where it leaves, or after that."""
    dt, arrived = horizon / steps, np.full(len(states), np.inf)
    lost = np.zeros(len(states), dtype=bool)
    u = np.zeros(len(problem.system.controls))
    for k in range(steps):
        inside = problem.target.contains(problem.system.state_names, states) & ~lost
        arrived = np.where(inside, np.minimum(arrived, k * dt), arrived)
        states = problem.system.wrap(problem.system.step(states, np.broadcast_to(u, (len(states), len(u))), dt=dt))
        for i, axis in enumerate(problem.axes):
            lost |= (states[:, i] < axis.lower) | (states[:, i] > axis.upper)
    return arrived


def test_command_prints_a_table_and_writes_results(tmp_path, capsys, monkeypatch) -> None:  # type: ignore[no-untyped-def]
    output = tmp_path / "results.json"
    monkeypatch.setattr("sys.argv", ["referee", "--family", "line", "--count", "2", "--output", str(output)])
    code = main()
    said = capsys.readouterr().out
    assert said.splitlines()[1].startswith("line")
    assert code == int("--only" in said)
    assert "median error" in output.read_text()


@pytest.mark.parametrize("words", [["--family", "dance"], ["--count", "0"]])
def test_command_refuses(words, capsys, monkeypatch) -> None:  # type: ignore[no-untyped-def]
    monkeypatch.setattr("sys.argv", ["referee", *words])
    assert main() == 2
    assert capsys.readouterr().err.startswith("referee: ")


def test_solver_holds_on_forty_systems() -> None:
    verdicts = list(judged(range(COUNT), 1))
    assert {family_of(v.seed) for v in verdicts} == set(FAMILIES)
    assert not any(v.wrong for v in verdicts), table(verdicts)


@pytest.mark.slow
def test_solver_holds_on_two_hundred_systems() -> None:
    verdicts = list(judged(range(COUNT, ALL), 1))
    assert not any(v.wrong for v in verdicts), table(verdicts)
