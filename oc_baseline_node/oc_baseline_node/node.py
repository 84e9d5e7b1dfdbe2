"""The baseline node: odometry in, optimal control value out."""

from __future__ import annotations

from pathlib import Path

from ctrl_rl_core.ros import run_node
from ctrl_rl_core.value_function import ValueFunction
from ctrl_rl_core.value_server import Valued, ValueServer

from oc_baseline_node.value_file import find_value, load_value


class OcBaselineNode(ValueServer):
    """Serves an optimal control value function V_oc (thesis Eq. 3.13), a baseline for policy gradients.

    Subscribes to odom; publishes oc_value for each message, ~/grid and ~/slice latched; answers ~/query and ~/reload.
    The file is a network that `oc fit` wrote, or a value grid; car_navigation, quad_navigation and quad_trap name the
    networks that come with the package.
    """

    TOPIC = "oc_value"
    KIND = "oc_value"

    def __init__(self) -> None:
        super().__init__("oc_baseline_node")

    def read(self, path: Path) -> ValueFunction:
        """Read a network or a value grid: a file, or by task one that comes with the package."""
        return load_value(find_value(path))

    def prepare(self, _function: ValueFunction) -> Valued:
        """Return what says nothing more: the StateValue tells all."""
        return lambda _message, _state, _value: None


def main() -> int:
    """Run the node."""
    return run_node(OcBaselineNode)
