"""Policies in both engines, by the command `transfer`."""

import pytest
from ctrl_rl_bringup.transfer.in_process import play_episode
from ctrl_rl_bringup.transfer.table import SHIFTS, Cell, drive_cells, transfer_ratios

from ctrl_rl_core import Outcome, find_policy, load_navigation_task, load_policy
from sim_bridge import SimulationOptions

TASK = load_navigation_task("curved_corridor")
POLICY = load_policy(find_policy("curved_corridor_edmd"))


@pytest.mark.parametrize("engine", ["pybullet", "mujoco"])
def test_a_corridor_policy_reaches_the_goal_in_both_engines(engine):
    pytest.importorskip(engine)
    episode = play_episode(POLICY, TASK, 3, SimulationOptions(engine=engine))
    assert episode.outcome is Outcome.GOAL
    assert episode.smallest_clearance > 0.02


def test_each_shift_changes_options_of_the_simulation():
    shifted = [SimulationOptions(**shift) for shift in SHIFTS.values()]
    assert SimulationOptions() in shifted
    assert len(set(shifted)) == len(SHIFTS)


def test_a_cell_says_how_its_drives_ended():
    (cell,) = drive_cells({"edmd": (POLICY, TASK)}, ["mujoco"], ["nominal"], [5])
    assert (cell.reached, cell.collided) == ((True,), (False,))
    assert cell.text() == f"{'edmd':<24} {'nominal':<26} {'mujoco':<9}   1 of 1 reach the goal, 0 collide"
    assert [row.method for row in cell.results()] == ["edmd, mujoco, nominal"] * 2


def test_ratios_compare_with_the_engine_of_learning():
    cells = [
        Cell("a", "pybullet", "nominal", (True, True, True, False), (False,) * 4),
        Cell("a", "mujoco", "nominal", (True, True, False, False), (False,) * 4),
        Cell("a", "mujoco", "wheels 5 % smaller", (False,) * 4, (True,) * 4),
    ]
    assert transfer_ratios(cells, "pybullet") == {"a, mujoco": pytest.approx(2 / 3)}
