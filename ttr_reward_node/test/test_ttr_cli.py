"""The commands `solve`, `check` and `slices`: files, figures, and one-line error messages."""

from dataclasses import replace

import pytest
from ttr_reward_node.cli.values import check, slices, solve_value

from ctrl_rl_core import ValueGrid, task_file
from ttr_reward_node import DecomposedValue, load_value

COARSE = ["--count", "x=21", "y=21", "theta=16"]
COARSE_QUADROTOR = ["--count", "x=21", "z=21", "v_x=11", "v_z=11", "psi=16", "omega=5"]


def test_a_car_is_solved_and_drawn(tmp_path, capsys):
    file = tmp_path / "car.safetensors"
    assert solve_value(["--task", "car_ttr", *COARSE, "--robot-size", "--output", str(file)]) == 0
    function = load_value(file)
    assert isinstance(function, ValueGrid)
    assert function.values.shape == (21, 21, 16)
    said = capsys.readouterr().out
    assert "dubins_car, 21 x 21 x 16 nodes, at most" in said
    assert "converged after" in said
    assert slices([str(file), "--at", "theta=0,1.57"]) == 0
    assert (tmp_path / "car.png").stat().st_size > 10_000


@pytest.mark.parametrize(("kind", "more"), [("avoid", []), ("reach_avoid", ["--horizon", "4"])])
def test_safe_states_are_solved_and_drawn(kind, more, tmp_path, capsys):
    file = tmp_path / "safe.safetensors"
    arguments = ["--task", "car_ttr", *COARSE, "--robot-size", "--kind", kind, *more, "--output", str(file)]
    assert solve_value(arguments) == 0
    function = load_value(file)
    assert (function.kind, function.unit) == (kind, "m")
    goal, wall, far = function.value([[4.0, 4.0, 0.75], [4.75, 0.0, 0.0], [-4.0, -4.0, 0.75]])
    assert wall < 0.0
    assert (far > 0.0) == (kind == "avoid")
    assert kind == "avoid" or goal > -0.05  # the goal lies in a corner in which a car cannot stay
    assert "% of the nodes" in capsys.readouterr().out
    assert slices([str(file), "--at", "theta=0,1.57"]) == 0
    assert (tmp_path / "safe.png").stat().st_size > 10_000


def test_a_quadrotor_is_solved_in_parts(tmp_path):
    file = tmp_path / "quad.safetensors"
    arguments = ["--task", "quad_ttr", *COARSE_QUADROTOR, "--decomposition", "4d+4d", "--output", str(file)]
    assert solve_value(arguments) == 0
    function = load_value(file)
    assert isinstance(function, DecomposedValue)
    assert [grid.values.ndim for grid in function.grids] == [4, 4]


def test_what_has_not_converged_says_so(tmp_path, capsys):
    file = tmp_path / "car.safetensors"
    assert solve_value(["--task", "car_ttr", *COARSE, "--max-sweeps", "2", "--output", str(file)]) == 1
    assert "NOT converged (allow more with --max-sweeps)" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--task", "nowhere"], "no task 'nowhere'"),
        (["--task", "tool_delivery"], "a navigation task is needed here"),
        (["--task", "car_ttr", "--decomposition", "4d+4d"], "dubins_car has no decomposition '4d+4d'; there is none"),
        (
            ["--task", "car_ttr", "--robot-size", "--inflation", "0.1"],
            "--inflation and --robot-size exclude",
        ),
        (["--task", "car_ttr", "--disturbance", "d_q=0:1"], "disturbance 'd_q' in [0, 1]: choose from"),
        (["--task", "car_ttr", "--output", "no/such/folder/x.safetensors"], "there is no folder no/such/folder"),
        (["--task", "quad_ttr"], "split the system (decomposition)"),
        (["--task", "car_ttr", "--horizon", "3"], "--horizon is for --kind avoid"),
        (["--task", "car_ttr", "--kind", "avoid", "--method", "lax_friedrichs"], "leave them out of avoid"),
        (["--task", "car_ttr", *COARSE, "--kind", "avoid", "--inflation", "6"], "no state of the grid can avoid"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(arguments, words, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert solve_value(arguments) == 1
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--task", "car_ttr", "--count", "x=many"], "--count 'many' is not a whole number"),
        (["--task", "car_ttr", "--count", "x"], "--count 'x' must be NAME=VALUE"),
        (["--task", "car_ttr", "--disturbance", "d_x=1"], "--disturbance '1' must be LOW:HIGH"),
        (["--task", "car_ttr", "--tolerance", "nan"], "--tolerance 'nan' is not a finite number"),
        (["--task", "car_ttr", "--max-sweeps", "0"], "--max-sweeps must be a whole number of at least 1"),
        (["--task", "car_ttr", "--method", "magic"], "--method magic: choose from semi_lagrangian, lax_friedrichs"),
        ([], "missing --task"),
    ],
)
def test_wrong_usage_is_said_in_one_line(arguments, words, capsys):
    with pytest.raises(SystemExit) as ended:
        solve_value(arguments)
    assert ended.value.code == 2
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1


def test_an_existing_file_stays_unless_told(tmp_path, capsys):
    file = tmp_path / "car.safetensors"
    file.write_text("mine", encoding="ascii")
    assert solve_value(["--task", "car_ttr", *COARSE, "--output", str(file)]) == 1
    assert "add --overwrite" in capsys.readouterr().err
    assert file.read_text(encoding="ascii") == "mine"
    assert solve_value(["--task", "car_ttr", *COARSE, "--output", str(file), "--overwrite"]) == 0
    assert load_value(file).task == "car_ttr"


def test_a_function_is_checked_in_its_own_task(tmp_path, capsys):
    task, file = tmp_path / "narrow.yaml", tmp_path / "narrow.safetensors"
    task.write_text(task_file("curved_corridor").read_text().replace("curved_corridor", "narrow"), encoding="utf-8")
    assert solve_value(["--task", str(task), "--robot-size", "--width", "0.65", "--output", str(file)]) == 0
    capsys.readouterr()
    driven = [str(file), "--task", str(task), "--width", "0.65", "--starts", "100"]
    assert check([*driven, "--at-least", "0.9"]) == 0
    said = capsys.readouterr().out
    assert said.startswith("reached ")
    assert "executed/predicted median 1.0" in said
    assert check([*driven, "--at-least", "1.01"]) == 1
    capsys.readouterr()
    for arguments, words in (
        ([str(file), "--task", "car_ttr"], "belongs to task 'narrow', not 'car_ttr'"),
        ([str(file)], "no task 'narrow'"),
    ):
        assert check(arguments) == 1
        error = capsys.readouterr().err
        assert words in error
        assert error.count("\n") == 1


def test_check_names_the_cause_of_collisions(tmp_path, capsys):
    graze, wide = tmp_path / "graze.safetensors", tmp_path / "wide.safetensors"
    finer = ["--count", "x=51", "y=51", "theta=36"]
    assert solve_value(["--task", "car_ttr", *finer, "--output", str(graze)]) == 0
    assert solve_value(["--task", "car_ttr", *finer, "--robot-size", "--output", str(wide)]) == 0
    capsys.readouterr()
    assert check([str(graze), "--starts", "200"]) == 0
    said = capsys.readouterr().out
    assert "obstacles were widened by 0 m, so the shortest paths graze them" in said
    assert "solve again with --robot-size (0.177 m), or with --inflation 0.1 or more" in said
    assert check([str(wide), "--starts", "200"]) == 0
    assert "--robot-size" not in capsys.readouterr().out


def test_a_steady_current_is_kept_in_the_file_and_driven_in(tmp_path, capsys):
    file = str(tmp_path / "car.safetensors")
    fine = ["--count", "x=51", "y=51", "theta=36"]
    current = ["--disturbance", "d_x=0.3:0.3"]
    assert solve_value(["--task", "car_ttr", *fine, *current, "--robot-size", "--strict", "--output", file]) == 0
    assert load_value(file).notes["disturbances"] == "{'d_x': (0.3, 0.3)}"
    assert check([file, "--starts", "100", "--at-least", "0.8"]) == 0
    assert "executed/predicted median 1.0" in capsys.readouterr().out


@pytest.mark.fault
@pytest.mark.parametrize("note", ["{'d_x': 1}", "{'d_x': (0.3,", "__import__('os')", "{'d_q': (0.0, 1.0)}", "(" * 999])
def test_a_note_on_disturbances_that_is_none_is_refused(note, tmp_path, capsys):
    file = tmp_path / "car.safetensors"
    assert solve_value(["--task", "car_ttr", *COARSE, "--robot-size", "--output", str(file)]) == 0
    value = ValueGrid.load(file)
    replace(value, notes={**value.notes, "disturbances": note}).save(file, overwrite=True)
    capsys.readouterr()
    assert check([str(file), "--starts", "5"]) == 1
    assert capsys.readouterr().err.count("\n") == 1
