"""The navigator goes round doors that are closed in the world, and says so where every way is closed."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from closed_doors.best import plan
from closed_doors.command import main, run
from closed_doors.drives import drive, most_passes
from closed_doors.worlds import Door, World
from ctrl_rl_navigation.driving import NavigatorState

from ctrl_rl_core import read_results

NEAR, FAR = Door(slice(38, 40), slice(20, 30), True), Door(slice(38, 40), slice(122, 134), False)


def halved_room(*doors: Door) -> World:
    """Return a room of 7 m by 4 m, halved by a wall with doors."""
    cells = np.zeros((80, 140), np.int8)
    cells[:2], cells[-2:], cells[:, :2], cells[:, -2:], cells[38:40] = (100,) * 5
    for door in doors:
        cells[door.rows, door.columns] = 0
    return World(cells, doors, (1.25, 1.2, math.pi / 2.0), (1.25, 2.9))


def test_it_goes_round_a_closed_door_and_does_not_come_back() -> None:
    world = halved_room(NEAR, FAR)
    outcome = drive(world, 1, 120.0)
    assert (outcome.state, outcome.collided, outcome.passes) == (NavigatorState.REACHED, False, 1)
    assert outcome.seconds < 1.5 * world.best().seconds
    assert "after a detour of" in outcome.message


def test_it_goes_round_a_gate_of_bars_that_beams_pass() -> None:
    bars = [Door(NEAR.rows, slice(column, column + 1), True) for column in range(22, 30, 3)]
    gate = halved_room(NEAR._replace(closed=False), FAR, *bars)
    outcome = drive(gate, 1, 120.0)
    assert (outcome.state, outcome.collided) == (NavigatorState.REACHED, False)
    assert outcome.passes <= 2


def test_where_every_door_is_closed_it_says_so_and_stands() -> None:
    world = halved_room(NEAR, FAR._replace(closed=True))
    outcome = drive(world, 1, 200.0)
    assert (outcome.state, outcome.collided) == (NavigatorState.BLOCKED, False)
    assert outcome.passes <= 2
    assert outcome.seconds < 150.0


@pytest.mark.parametrize(("method", "seed"), [("a way round", 7), ("a way round", 101), ("every way closed", 100)])
def test_drives_on_drawn_floors_are_good(method: str, seed: int) -> None:
    trial = run(method, seed)
    assert trial.is_good, trial


def test_the_best_learns_a_door_when_it_sees_it() -> None:
    world = halved_room(NEAR, FAR)
    straight = plan(world.known, [], (1.25, 1.2), (1.25, 2.9), 0.05)
    assert straight.seconds == pytest.approx(1.55 / 0.22, rel=0.05)
    best = world.best()
    assert best.learnt == 1
    assert best.seconds == pytest.approx((2.0 * math.hypot(5.0, 0.85) - 0.15) / 0.22, rel=0.05)
    shut = halved_room(NEAR, FAR._replace(closed=True)).best()
    assert shut.learnt == 2
    assert math.isinf(shut.seconds)
    assert shut.until < best.seconds


def test_passes_are_counted_by_direction() -> None:
    there = np.column_stack((np.linspace(0.0, 4.0, 100), np.zeros(100)))
    assert most_passes(there) == 1
    assert most_passes(np.concatenate((there, there[::-1]))) == 1
    assert most_passes(np.concatenate((there, there[::-1], there))) == 2


def test_it_writes_what_became_of_the_drives(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "closed_doors.json"
    words = ["closed_doors", "--worlds", "1", "--shut", "0", "--seed", "102", "--output", str(output)]
    monkeypatch.setattr("sys.argv", words)
    assert main() == 0
    (experiment,) = read_results(tmp_path)
    values = {(row.method, row.metric): row.values for row in experiment.rows}
    assert values["a way round", "arrived"] == [1.0]
    assert 0.5 < values["a way round", "time over best"][0] <= 1.5
    assert "a way round: arrived 1.000" in capsys.readouterr().out


def test_no_floors_are_one_line(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr("sys.argv", ["closed_doors", "--worlds", "0", "--shut", "0"])
    assert main() == 2
    assert capsys.readouterr().err.startswith("closed_doors: ")
