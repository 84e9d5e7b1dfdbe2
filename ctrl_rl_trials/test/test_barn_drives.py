"""Controllers drive through a small world of BARN's format, and the command keeps the drives."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from barn_files import write_checkout
from ctrl_rl_trials.barn.controllers import CONTROLLERS, JACKAL, safety_check
from ctrl_rl_trials.barn.drive import BarnDrive, drive
from ctrl_rl_trials.barn.dynamic_window import DynamicWindow
from ctrl_rl_trials.barn.scenarios import Scenario, load_scenario
from ctrl_rl_trials.cli.barn import barn

from ctrl_rl_core import Sensors, exclusive_lock
from sim_bridge import SimulationOptions

PLANAR = SimulationOptions(engine="planar", odom_drift=0.01)
NONE = np.empty((0, 2))


@pytest.fixture(scope="module")
def checkout(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_checkout(tmp_path_factory.mktemp("checkout"))


@pytest.fixture(scope="module")
def scenario(checkout: Path) -> Scenario:
    return load_scenario(checkout, 0)


class Straight:
    """Drives straight on at one speed."""

    def __init__(self, speed: float) -> None:
        self._speed = speed

    def command(self, sensors: Sensors) -> np.ndarray:
        assert sensors.age == 0.0
        return np.array((self._speed, 0.0))


@pytest.mark.parametrize("name", ["explorer", "navigator"])
def test_it_drives_round_the_posts(scenario: Scenario, name: str) -> None:
    trace: list[np.ndarray] = []
    end = drive(scenario, CONTROLLERS[name](scenario, JACKAL), None, 0, PLANAR, trace)
    assert (end.end, end.score()) == ("goal", 0.5)
    assert end.distance < 1.0
    assert len(trace) * 0.05 == pytest.approx(end.seconds, abs=1.0)


def test_the_filter_stops_who_drives_into_the_posts(scenario: Scenario, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ctrl_rl_trials.barn.drive._PATIENCE", 1.5)
    crash = drive(scenario, Straight(1.0), None, 0, PLANAR)
    assert (crash.end, crash.score()) == ("collision", 0.0)
    assert crash.seconds == pytest.approx(2.6, abs=0.3)
    safe = drive(scenario, Straight(1.0), safety_check(0.0), 0, PLANAR)
    assert safe.end == "time-out"
    assert 7.0 < safe.distance < 8.0


def test_who_is_late_scores_less() -> None:
    one = BarnDrive(0, "goal", 12.0, 10.0, 0.9)
    assert one.score() == pytest.approx(5.0 / 12.0)
    assert BarnDrive(0, "time-out", 100.0, 10.0, 5.0).score() == 0.0


def test_the_dynamic_window_brakes_before_a_wall_and_turns_to_the_goal() -> None:
    window = DynamicWindow(JACKAL)
    assert window.choose(np.array((5.0, 0.0)), np.zeros(2), NONE)[0] > 0.2
    assert window.choose(np.array((0.0, 5.0)), np.zeros(2), NONE)[1] > 0.5
    wall = np.column_stack((np.full(81, 0.55), np.linspace(-2.0, 2.0, 81)))
    assert window.choose(np.array((5.0, 0.0)), np.array((1.4, 0.0)), wall)[0] < 1.4
    box = np.concatenate([0.3 * np.array([(math.cos(a), math.sin(a))]) for a in np.linspace(0.0, 6.2, 60)])
    assert window.choose(np.array((5.0, 0.0)), np.zeros(2), box)[0] == pytest.approx(0.0, abs=1e-6)


def run(monkeypatch: pytest.MonkeyPatch, *words: str) -> int:
    monkeypatch.setattr("sys.argv", ["barn", *words])
    return barn()


def test_the_command_keeps_drives_and_goes_on(
    checkout: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    results = tmp_path / "barn.json"
    words = [str(checkout), "--worlds", "0", "--controllers", "dynamic_window", "--results", str(results)]
    assert run(monkeypatch, *words) == 0
    assert "dynamic_window, BARN" in capsys.readouterr().out
    drives = json.loads(results.read_text())["figures"]["drives"]
    assert [each[0] for each in drives["dynamic_window"]] == [0]
    before = results.read_bytes()
    assert run(monkeypatch, *words) == 0
    assert "already has 1 of 1 drives" in capsys.readouterr().out
    assert results.read_bytes() == before
    assert run(monkeypatch, *words, "--seed", "1") == 1
    assert "give another file" in capsys.readouterr().err
    with exclusive_lock(tmp_path / ".barn.json.lock"):  # two writers would lose each other's drives
        assert run(monkeypatch, *words) == 1
    assert "another process is using" in capsys.readouterr().err


def test_drives_are_the_same_by_one_worker_and_by_two(
    checkout: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drives = []
    for workers in "12":
        results = tmp_path / f"{workers}.json"
        words = ["--worlds", "0", "300", "--controllers", "dynamic_window", "--workers", workers]
        assert run(monkeypatch, str(checkout), *words, "--results", str(results)) == 0
        drives.append(json.loads(results.read_text())["figures"]["drives"])
    assert drives[0] == drives[1]
    assert {method: [each[0] for each in ends] for method, ends in drives[0].items()} == {"dynamic_window": [0, 300]}


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--worlds", "360"], "give numbers from 0 to 359"),
        (["--worlds", "5-3"], "give numbers from 0 to 359"),
        (["--worlds", "0", "--controllers", "pilot"], "there are explorer, navigator"),
        (["--worlds", "0", "--drift", "2"], "must be 0 to 0.5"),
        (["--worlds", "7"], "world_7.world"),
    ],
)
def test_wrong_words_are_refused_in_one_line(
    checkout: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], words: list[str], said: str
) -> None:
    assert run(monkeypatch, str(checkout), *words) == 1
    error = capsys.readouterr().err
    assert said in error
    assert len(error.strip().splitlines()) == 1


def test_worlds_are_written_as_task_files(checkout: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert run(monkeypatch, str(checkout), "--worlds", "300", "--tasks", str(tmp_path)) == 0
    assert "keyframes" in (tmp_path / "barn_300.yaml").read_text()
