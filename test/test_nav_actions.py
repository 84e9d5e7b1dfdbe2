"""The drives along paths: what is drawn, what a drive measures, and what the command refuses."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from nav_actions.command import Options, follow_paths, line, rows_of
from nav_actions.drivers import DRIVERS
from nav_actions.drives import PathDrive, distances, follow
from nav_actions.paths import draw_trial

from ctrl_rl_core import OccupancyMap, read_results


def test_every_second_path_has_a_box_beside_it_and_the_same_seed_the_same_path(tmp_path: Path) -> None:
    for seed in range(4):
        trial, again = draw_trial(seed, tmp_path), draw_trial(seed, tmp_path)
        assert np.array_equal(trial.path, again.path)
        assert trial.boxed == bool(seed % 2)
        known, world = OccupancyMap.load(trial.map_file), OccupancyMap.load(trial.world_file)
        assert known.is_same(world) != trial.boxed
        assert 2.5 <= np.linalg.norm(np.diff(trial.path, axis=0), axis=1).sum() <= 7.0


@pytest.mark.parametrize("name", ["navigator", "Koopman controller"])
def test_a_driver_arrives_beside_a_box(name: str, tmp_path: Path) -> None:
    trial = draw_trial(1, tmp_path)
    drive = follow(trial, DRIVERS[name](trial), 1)
    assert drive.arrived
    assert not drive.contact
    assert drive.error < 0.08
    assert drive.error <= drive.largest_error < 0.3
    assert 0.8 < drive.seconds < 2.0


def test_distances_are_those_from_the_lines() -> None:
    path = np.array(((0.0, 0.0), (2.0, 0.0), (2.0, 1.0)))
    places = np.array(((1.0, 0.5), (2.5, 0.5), (-3.0, 4.0), (2.0, 0.0)))
    assert distances(places, path) == pytest.approx([0.5, 0.5, 5.0, 0.0])


def test_it_writes_a_row_for_each_driver(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output = tmp_path / "nav_actions.json"
    follow_paths(Options(paths=1, drivers=("dynamic window",), output=output))
    assert "dynamic window" in capsys.readouterr().out
    (experiment,) = read_results(tmp_path)
    metrics = {row.metric for row in experiment.rows}
    assert {"arrived", "contacts", "path error", "time over that at full speed"} <= metrics


def test_lines_and_rows_have_all_figures() -> None:
    drives = [PathDrive(True, False, 1.1, 0.02, 0.1), PathDrive(False, True, 4.0, 0.05, 0.3)]
    assert line("navigator", drives).split()[1:] == ["2", "1", "1", "1.10", "0.035", "0.30"]
    assert [row.metric for row in rows_of("navigator", drives)][-2:] == ["path error", "largest path error"]


@pytest.mark.parametrize(
    "words", [("--drivers", "nobody"), ("--goals", "-1"), ("--speed", "0"), ("--speed", "nan"), ("--seed", "-1")]
)
def test_wrong_options_are_refused_in_a_line(words: tuple[str, ...]) -> None:
    command = [sys.executable, Path(__file__).parent / "nav_actions", *words]
    answer = subprocess.run(command, capture_output=True, text=True, check=False)
    assert answer.returncode == 2
    assert len(answer.stderr.splitlines()) == 1
