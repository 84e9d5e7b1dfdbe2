"""Value data: Eq. 3.13 against its formula, and folders that survive a kill."""

import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from oc_baseline_node.problems.start_states import state_space
from oc_baseline_node.value_data.dataset import LOCK, chunk_file
from oc_baseline_node.values.returns import returns, rewards, step_discount
from preloaded import Preloaded

from ctrl_rl_core import LockError, exclusive_lock, load_navigation_task
from oc_baseline_node import (
    DataSettings,
    OcError,
    OptimalControlProblem,
    ValueData,
    draw_start,
    formulate,
    load_data,
    make_data,
)

MAKE = """
import sys
from pathlib import Path
from ctrl_rl_core import load_navigation_task
from oc_baseline_node import DataSettings, formulate, make_data
make_data(formulate(load_navigation_task("car_navigation")), DataSettings(5, chunk=1), Path(sys.argv[1]))
"""


@pytest.fixture(scope="module")
def car() -> OptimalControlProblem:
    return formulate(load_navigation_task("car_navigation"))


def same(one: ValueData, other: ValueData) -> bool:
    names = ("states", "controls", "time_steps", "unsolved", "doomed")
    return one.reasons == other.reasons and all(
        np.array_equal(getattr(one, name), getattr(other, name)) for name in names
    )


@given(st.lists(st.floats(-1000, 1000), min_size=1, max_size=30), st.floats(0.5, 1.0), st.integers(0, 40))
def test_values_are_the_discounted_sums_of_rewards(paid: list[float], discount: float, end: int) -> None:
    ended = np.arange(len(paid)) == end
    values = returns(paid, ended, discount)
    for m in range(len(paid)):
        last = end if m <= end < len(paid) else len(paid) - 1
        direct = sum(discount ** (i - m) * paid[i] for i in range(m, last + 1))
        assert values[m] == pytest.approx(direct, abs=1e-6)


def test_a_state_is_worth_the_goal_discounted_by_the_steps_to_it(car: OptimalControlProblem) -> None:
    y = np.linspace(0.0, 3.5, 8)
    states = np.column_stack((np.full(8, 3.5), y, np.zeros(8)))  # 0.5 m a step; the goal begins at y = 2.5
    data = ValueData(states[None], np.zeros((1, 7, 2)), np.array([0.05]), *(np.zeros(0) for _ in range(2)), (),
                     np.zeros(0, bool), np.zeros(0))  # fmt: skip
    steps = np.maximum(5 - np.arange(8), 0)
    # Eight steps of 0.05 s are one of the policy's 0.4 s.
    _, values, met = data.samples(car, 0.9)
    assert values[0] == pytest.approx(1000 * 0.9 ** (steps / 8))
    assert met[0].tolist() == [True] * 6 + [False] * 2  # up to the arrival
    _, (whole,), met = data.samples(car, 0.9, whole_horizon=True)
    assert met.all()
    assert whole[-1] == 1000
    assert whole[4] == pytest.approx(1000 * sum(0.9 ** (i / 8) for i in (1, 2, 3)))


def test_rewards_are_the_tasks() -> None:
    task = load_navigation_task("quad_trap")
    states = np.zeros((5, 6))
    states[:, [0, 2]] = ((4.0, 8.9), (-2.0, 0.8), (4.0, 6.0), (0.0, 4.0), (0.0, 4.0))
    states[:, 4] = (0.1, 0.0, 0.0, 0.0, 1.45)
    paid, ended = rewards(task, states)
    assert paid.tolist() == [1000.0, 100.0, -400.0, 0.0, -400.0]
    assert ended.tolist() == [True, True, True, False, True]
    tilted = rewards(load_navigation_task("quad_navigation"), states[-1:])[0]
    assert tilted.tolist() == [-800.0]


def test_a_discount_holds_for_the_policys_step() -> None:
    task = load_navigation_task("car_navigation")
    assert step_discount(task, 0.81, [0.4, 0.2, 0.8]) == pytest.approx([0.81, 0.9, 0.6561])


@pytest.mark.parametrize("name", ["car_navigation", "quad_trap"])
def test_starts_are_free_and_spread_over_the_state_space(name: str) -> None:
    problem = formulate(load_navigation_task(name))
    random = np.random.default_rng(0)
    starts = np.array([draw_start(problem, random) for _ in range(400)])
    low, high = state_space(problem)
    assert (problem.margin(starts) >= 0.0).all()
    share = (starts - low) / (high - low)
    assert share.min() >= 0.0
    assert share.max() <= 1.0
    assert np.abs(share.mean(axis=0) - 0.5).max() < 0.1
    assert np.abs(share.std(axis=0) - np.sqrt(1 / 12)).max() < 0.05


def test_data_depend_on_the_seed_alone_and_not_on_the_processes(car: OptimalControlProblem, tmp_path: Path) -> None:
    settings = DataSettings(2, chunk=1)
    alone, wall, cpu = make_data(car, settings, tmp_path / "alone", progress=False)
    assert alone.states.shape == (2, 141, 3)
    assert alone.controls.shape == (2, 140, 2)
    assert 0.0 < cpu < wall * 2 + 1.0
    together, *_ = make_data(car, settings, tmp_path / "together", workers=2, progress=False)
    assert same(alone, together)
    other, *_ = make_data(car, DataSettings(2, chunk=1, seed=1), tmp_path / "other", progress=False)
    assert not same(alone, other)


def test_after_a_kill_the_rest_is_made_and_all_is_the_same(car: OptimalControlProblem, tmp_path: Path) -> None:
    process = Preloaded([sys.executable, "-c", MAKE, tmp_path / "killed"], stderr=subprocess.DEVNULL)
    deadline = time.monotonic() + 120.0
    while not chunk_file(tmp_path / "killed", 1).exists():
        assert process.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.005)
    process.send_signal(signal.SIGKILL)
    process.wait()
    settings = DataSettings(5, chunk=1)
    with pytest.raises(OcError, match=r"lacks \d of 5 chunks"):
        load_data(tmp_path / "killed", car)
    before = chunk_file(tmp_path / "killed", 1).stat().st_mtime_ns
    resumed, *_ = make_data(car, settings, tmp_path / "killed", progress=False)
    assert chunk_file(tmp_path / "killed", 1).stat().st_mtime_ns == before, "what was done is not done again"
    whole, *_ = make_data(car, settings, tmp_path / "whole", progress=False)
    assert same(resumed, whole)


def test_a_quadrotors_doomed_starts_are_told_from_the_rest(tmp_path: Path) -> None:
    problem = formulate(load_navigation_task("quad_navigation"))
    data, *_ = make_data(problem, DataSettings(2, chunk=2), tmp_path / "quad", progress=False)
    assert len(data.states) == 2
    assert len(data.unsolved) == len(data.reasons) == len(data.doomed) > 0
    assert data.success_rate < data.success_rate_of_viable <= 1.0
    assert all(reason.startswith("ipopt: ") for reason in data.reasons)
    assert (rewards(problem.task, data.states[:, -1])[0] == 1000.0).all()
    _, values, _ = data.samples(problem)
    assert values.min() >= 1000 * problem.discount**140
    assert values.max() <= 1000.0


def test_one_call_at_a_time_works_in_a_folder(car: OptimalControlProblem, tmp_path: Path) -> None:
    with exclusive_lock(tmp_path / LOCK), pytest.raises(LockError, match="another process is using this folder"):
        make_data(car, DataSettings(1, chunk=1), tmp_path, progress=False)
    assert [file.name for file in tmp_path.iterdir()] == [LOCK]


def test_what_a_killed_call_left_behind_does_not_count(car: OptimalControlProblem, tmp_path: Path) -> None:
    left = [tmp_path / name for name in (".settings.json.77.tmp", ".chunk-0000.npz.78.tmp", LOCK)]
    for file in left:
        file.write_text("half")
    data, *_ = make_data(car, DataSettings(1, chunk=1), tmp_path, progress=False)
    assert len(data.states) == 1
    assert {file.name for file in tmp_path.iterdir()} == {LOCK, "settings.json", "chunk-0000.npz"}


def test_a_folder_of_something_else_is_left_as_it_is(car: OptimalControlProblem, tmp_path: Path) -> None:
    mine = {tmp_path / name for name in (".profile", ".profile.12.tmp")}
    for file in mine:
        file.write_text("mine")
    with pytest.raises(OcError, match=r"holds \.profile, which is no value data: give another folder"):
        make_data(car, DataSettings(1, chunk=1), tmp_path, progress=False)
    assert set(tmp_path.iterdir()) == mine


def test_a_folder_of_other_data_is_left_alone(car: OptimalControlProblem, tmp_path: Path) -> None:
    make_data(car, DataSettings(1, chunk=1), tmp_path, progress=False)
    with pytest.raises(OcError, match="seed = 0, not 1"):
        make_data(car, DataSettings(1, chunk=1, seed=1), tmp_path, progress=False)
    with pytest.raises(OcError, match="holds data with task = car_navigation"):
        load_data(tmp_path, formulate(load_navigation_task("quad_trap")))
    whole = chunk_file(tmp_path, 0).read_bytes()
    flag = whole.index(b"PK\x01\x02") + 8
    encrypted = whole[:flag] + b"\x01" + whole[flag + 1 :]
    for damaged in (b"", b"not an archive", whole[: len(whole) // 2], encrypted):
        chunk_file(tmp_path, 0).write_bytes(damaged)
        with pytest.raises(OcError, match=r"chunk-0000\.npz: is not a whole \.npz file"):
            load_data(tmp_path, car)
    (tmp_path / "settings.json").unlink()
    with pytest.raises(OcError, match="which is no value data"):
        make_data(car, DataSettings(1, chunk=1), tmp_path, progress=False)
    with pytest.raises(OcError, match="has no value data"):
        load_data(tmp_path, car)
