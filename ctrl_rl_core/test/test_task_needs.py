"""Requirements of commands on a task, and the default grid of tasks."""

import pytest
from ctrl_rl_core.tasks import can, require, with_grid

from ctrl_rl_core import TaskError, load_navigation_task, load_task


def test_a_command_refuses_by_the_first_need_that_is_not_met() -> None:
    assert can("ctrl_rl_learning teach", load_task("curved_corridor")) == ""
    with pytest.raises(TaskError, match="task 'car_ttr' has no corridor: there are "):
        require("ctrl_rl_learning teach", load_task("car_ttr"))
    with pytest.raises(TaskError, match="task 'quad_navigation' has no value grid: add 'grid' with an axis"):
        require("ttr_reward_node solve", load_task("quad_navigation"))
    with pytest.raises(TaskError, match="task 'tool_delivery' is of kind 'tool_delivery': a navigation task is needed"):
        require("ctrl_rl_bringup demo", load_task("tool_delivery"))
    with pytest.raises(TaskError, match="task 'quad_ttr' is steered by T_1 and T_2: v and omega are needed here"):
        require("koopman_lqr_controller edmd", load_task("quad_ttr"))
    for name, part in (("walkers", "movers"), ("car_ttr_randomised", "randomisation")):
        assert can("ttr_reward_node train", load_task(name)) == ""
        with pytest.raises(TaskError, match=f"has {part}, which no fleet simulates: learn it with `ros2"):
            require("ctrl_rl_trials train", load_task(name))


def test_an_arena_without_a_grid_gets_one_of_10_cm_and_5_degrees() -> None:
    task = load_navigation_task("car_navigation")
    grid = with_grid(task).grid
    assert not task.grid
    assert {name: axis.count for name, axis in grid.items()} == {"x": 101, "y": 101, "theta": 72}
    assert (grid["x"].interval, grid["theta"].interval) == ("-5.0 .. 5.0 m", "-180.0 .. 180.0 deg")


@pytest.mark.parametrize("name", ["car_ttr", "curved_corridor", "corridor_doorways", "quad_navigation"])
def test_other_tasks_stay_as_they_are(name: str) -> None:
    task = load_navigation_task(name)
    assert with_grid(task) is task
