"""The baseline node: receives odometry, publishes the optimal control value."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import ClassVar

from ctrl_rl_core.ros import Valued
from ctrl_rl_core.values import check_function

from ctrl_rl_core import (
    SERVER_PARAMETERS,
    Parameter,
    ValueFunction,
    ValueServer,
    load_navigation_task,
    run_node,
    task_names,
)
from oc_baseline_node.values.value_file import find_value, load_value, shipped_values


def _with_names(parameter: Parameter) -> Parameter:
    """Return the parameter, accepting for `grid` the names of shipped networks as well as files."""
    if parameter.name != "grid":
        return parameter
    names = ", ".join(shipped_values())
    return replace(parameter, description=f"{parameter.description} Or one that comes with the package: {names}.")


class OcBaselineNode(ValueServer):
    """Serves an optimal control value function V_oc (thesis Eq. 3.13), a baseline for policy gradients.

    Subscribes to odom; publishes oc_value for each message, ~/grid and ~/slice latched; answers ~/query and ~/reload.
    The file is a network written by `oc fit`, or a value grid; shipped networks are named by their task.
    """

    TOPIC = "oc_value"
    KIND = "oc_value"
    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (
        *map(_with_names, SERVER_PARAMETERS),
        Parameter(
            "task", "", "Name or .yaml file of the task; empty for the one that the grid was made for.", kind="path"
        ),
    )

    def __init__(self) -> None:
        super().__init__("oc_baseline_node")

    def read(self, path: Path) -> ValueFunction:
        """Load a network or a value grid from a file, or a shipped network by task."""
        return load_value(find_value(path))

    def prepare(self, function: ValueFunction) -> Valued:
        """Warn if a value was made for another version of its task; return a callback without further output.

        Raises:
            CtrlRlError: The task does not exist, or the function belongs to another one.
        """
        given = self.settings["task"]
        # A custom task is known only by its file.
        if given or function.task in task_names():
            task = load_navigation_task(given or function.task)
            if not check_function(function, task, self.KIND):
                self.get_logger().warning(
                    f"the grid was made for another version of task '{task.name}': make it with 'oc data' and 'oc fit'"
                )
        return lambda _message, _state, _value: None


def main() -> int:
    """Run the node."""
    return run_node(OcBaselineNode)
