"""Base class of nodes that drive a robot: they stop it when they fail, are suspended, deactivated or end."""

from __future__ import annotations

from typing import Any

from ctrl_rl_core.driving.commander import Commander
from ctrl_rl_core.ros.managed_life import ManagedLife
from ctrl_rl_core.ros.node import Status, SuiteNode


class RobotNode(SuiteNode):
    """A node with one robot, which stops when the node fails, is suspended or ends.

    With the parameter `managed` a lifecycle manager holds the node, and the robot moves only while it is active.

    Attributes:
        robot: The robot; created in the subclass's constructor.
    """

    SHARED_MEMORY = False
    robot: Commander

    def __init__(self, name: str, **kwargs: Any) -> None:
        super().__init__(name, **kwargs)
        self._life = ManagedLife(self, lambda: self.robot.stop(), self.forget) if self.settings.get("managed") else None

    @property
    def is_active(self) -> bool:
        """Whether the robot may move."""
        return self._life is None or self._life.active

    def forget(self) -> None:
        """Drop what must not go on when an inactive node is activated again, such as a goal; override it."""

    def on_callback_error(self, _error: Exception) -> None:
        """Stop the robot until every failed callback has succeeded again."""
        self.robot.fail()

    def on_parameter_changed(self, name: str) -> None:
        """Apply a changed robot parameter."""
        self.robot.use_parameter(name)

    def status(self) -> Status:
        """Report whether commands are sent."""
        return self.robot.status()

    def stop(self) -> None:
        """Stop the robot."""
        self.robot.stop()

    def on_suspend(self) -> None:
        """Stop the robot, as in `stop`."""
        self.robot.stop()
