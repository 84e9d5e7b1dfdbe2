"""Policies in both engines, by the command `transfer`."""

from dataclasses import replace
from shutil import copy

import pytest
from ctrl_rl_bringup.cli.transfer import transfer
from ctrl_rl_bringup.transfer.table import SHIFTS, Cell, Entry, drive_cells, plan_cells, play_episode, transfer_ratios
from ctrl_rl_core.io import read_experiment

from ctrl_rl_core import Actor, Outcome, find_policy, load_navigation_task, load_policy
from sim_bridge import SimulationOptions

TASK = load_navigation_task("curved_corridor")
POLICY = load_policy(find_policy("curved_corridor_edmd"))


@pytest.fixture
def run(monkeypatch, capsys):
    """Runs the command and returns its exit code, and what it said on both streams."""

    def call(*words):
        monkeypatch.setattr("sys.argv", ["transfer", *map(str, words)])
        code = transfer()
        return code, *capsys.readouterr()

    return call


@pytest.mark.parametrize("engine", ["pybullet", "mujoco"])
def test_a_corridor_policy_reaches_the_goal_in_both_engines(engine):
    pytest.importorskip(engine)
    episode = play_episode(POLICY, TASK, 3, SimulationOptions(engine=engine))
    assert episode.outcome == Outcome.GOAL.name
    assert episode.info["smallest_clearance"] > 0.02


def test_the_policy_that_was_taught_passes_four_doorways_of_another_robot():
    task = load_navigation_task("corridor_doorways")
    policy = load_policy(find_policy("corridor_doorways"))
    assert play_episode(policy, task, 0, SimulationOptions(randomise_width=True)).outcome == Outcome.GOAL.name


def test_each_shift_changes_options_of_the_simulation():
    shifted = [SimulationOptions(**shift) for shift in SHIFTS.values()]
    assert SimulationOptions() in shifted
    assert len(set(shifted)) == len(SHIFTS)


def test_cells_are_driven_once_for_each_engine_and_shift_that_suits():
    entry = Entry("edmd", TASK, {"digest": POLICY})
    ((_, planned),) = cells = plan_cells([entry], ["mujoco"], ["nominal"], [5])
    (cell,) = drive_cells(cells, [5])
    assert (cell.reached, cell.collided, cell.digest) == ((1.0,), (0.0,), planned.digest)
    assert cell.method == "edmd, mujoco, nominal"
    assert cell.text() == f"{cell.method:<64} 100% reach the goal,   0% collide"
    ((_, other),) = plan_cells([entry], ["mujoco"], ["nominal"], [6])
    assert other.digest != planned.digest
    flight = Entry("quad", load_navigation_task("quad_navigation"), {})
    assert "commands 0.2 s late" in flight.shifts(SHIFTS)
    assert not {"floor half as rough", "motors four times slower", "as on a TurtleBot3"} & set(flight.shifts(SHIFTS))


def test_policies_of_several_runs_are_one_method(tmp_path, run):
    files = [tmp_path / "runs" / name / "policy.safetensors" for name in "ab"]
    for file in files:
        file.parent.mkdir(parents=True)
        copy(find_policy("car_ttr"), file)
    actor = Actor.load(files[1])
    replace(actor, unit=10.0 * actor.unit).save(files[1])
    results = tmp_path / "transfer.json"
    words = ("--policies", f"two={tmp_path / 'runs'}", "--task", "car_ttr_randomised", "--engines", "mujoco")
    words += ("--shifts", "nominal", "--seeds", "2", "--results", results)
    assert run(*words)[0] == 0
    before = read_experiment(results)
    assert [(row.method, row.values) for row in before.rows if row.metric == "success"] == [
        ("two, mujoco, nominal, randomised", [1.0, 0.0])
    ]
    code, said, _ = run(*words)
    assert code == 0
    assert said.startswith("1 of 1 cells are in")
    assert read_experiment(results) == before


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--policies", "none=/nowhere.safetensors", "--task", "car_ttr"), "there is no such file"),
        (("--policies", "mine=/nowhere.safetensors"), "does not begin with the name of a task: give --task"),
        (("--policies", "car_ttr", "--task", "quad_ttr"), "is for a differential_drive, task 'quad_ttr' has a"),
        (("--shifts", "on ice"), "--shifts 'on ice': there are nominal"),
    ],
)
def test_what_cannot_be_driven_is_refused_in_one_line(run, words, message):
    code, _, errors = run(*words)
    assert code == 2
    (line,) = errors.splitlines()
    assert line.startswith("transfer: ")
    assert message in line


def test_ratios_compare_with_the_engine_of_learning():
    cells = [
        Cell("a", "pybullet", "nominal", (True, True, True, False), (False,) * 4),
        Cell("a", "mujoco", "nominal", (True, True, False, False), (False,) * 4),
        Cell("a", "mujoco", "wheels 5 % smaller", (False,) * 4, (True,) * 4),
    ]
    assert transfer_ratios(cells, "pybullet") == {"a, mujoco": pytest.approx(2 / 3)}
