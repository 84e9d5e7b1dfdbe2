"""Action servers whose goals a node pursues one at a time, in its own callbacks.

server = GoalServer(node, NavigateToPose, "navigate_to_pose", begin, cancel)

`begin` receives each new goal and returns at once; the node reports with `feedback` and ends the goal with `succeed`,
`abort` or `cancelled`, whenever it likes.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle

from ctrl_rl_core.errors import CtrlRlError, one_line

if TYPE_CHECKING:
    from ctrl_rl_core.ros.node import SuiteNode

_KEEP_S = 10
"""Time for which a result is kept for clients that ask for it later [s], as in Nav2."""
_LATE_S, _POLL_S = 0.2, 0.01
"""Time for which a node that ends answers requests for its last result, and the polling interval [s]."""
_MOST_GOALS = 256
"""Maximum number of goals whose results are kept; further ones are rejected."""


class GoalError(CtrlRlError):
    """A goal cannot be pursued.

    Attributes:
        code: Error code of the action's result.
    """

    def __init__(self, message: str, code: int = 0) -> None:
        super().__init__(message)
        self.code = code


class ActiveGoal:
    """A goal of a client; only the first of `succeed`, `abort` and `cancelled` counts.

    Attributes:
        request: Goal message.
        active: Whether the goal has not ended.
    """

    def __init__(self, server: _Server, handle: ServerGoalHandle) -> None:
        self.request = handle.request
        self.active = True
        self._server, self._handle = server, handle

    @property
    def kind(self) -> Any:
        """Type of the action."""
        return self._server.action_type

    def feedback(self, **fields: Any) -> None:
        """Send feedback to the client."""
        if self.active:
            self._handle.publish_feedback(self.kind.Feedback(**fields))

    def succeed(self, **fields: Any) -> None:
        """End with success."""
        self._end(self._handle.succeed, fields)

    def abort(self, message: str, code: int = 0, **fields: Any) -> None:
        """End without success, for a reason."""
        self._end(self._handle.abort, {"error_msg": message, "error_code": code, **fields})

    def cancelled(self, **fields: Any) -> None:
        """End because the client asked for it."""
        self._end(self._handle.canceled if self._handle.is_cancel_requested else self._handle.abort, fields)

    def _end(self, change: Callable[[], None], fields: dict[str, Any]) -> None:
        if self.active:
            self.active = False
            self._server.end(self._handle, change, self.kind.Result(**fields))


class _Server(ActionServer):
    """An action server that leaves the execution of its goals to the node.

    rclpy runs a goal inside a callback, which polls as long as the goal lasts. Here a goal ends when the node says so,
    and its result is sent at once, also while the node shuts down.
    """

    def notify_execute(self, goal_handle: ServerGoalHandle, execute_callback: Any) -> None:
        """Leave a goal to the node once its state is 'executing'."""

    def add_future(self, future: Any) -> None:
        """Let a result be sent as soon as it is known, instead of by the executor, which may have ended."""

    def remove_future(self, future: Any) -> None:
        """Forget a result."""

    def end(self, handle: ServerGoalHandle, change: Callable[[], None], result: Any) -> None:
        """Change the state of a goal and send its result."""

        def finish(_handle: ServerGoalHandle) -> Any:
            change()
            return result

        with suppress(StopIteration):
            self._execute_goal(finish, handle).send(None)

    def answer_late(self, seconds: float) -> None:
        """Answer requests for results for a while [s], without an executor: a new goal's client may ask only now."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            taken = self._handle.take_result_request(self.action_type.Impl.GetResultService.Request)
            if all(taken):
                with suppress(StopIteration):
                    self._execute_get_result_request(taken).send(None)
            else:
                time.sleep(_POLL_S)

    @property
    def is_full(self) -> bool:
        """Whether as many results are kept as may be."""
        return len(self._goal_handles) >= _MOST_GOALS


class GoalServer:
    """An action server of a node; no callback ends the node.

    Args:
        node: Node that pursues the goals.
        kind: Type of the action.
        name: Name of the action, relative to the node's namespace.
        begin: Called with each new goal; if it raises a CtrlRlError, the goal is aborted with that reason.
        cancel: Called with a goal whose client asks to cancel it; it must end the goal.
    """

    def __init__(
        self,
        node: SuiteNode,
        kind: type[Any],
        name: str,
        begin: Callable[[ActiveGoal], None],
        cancel: Callable[[ActiveGoal], None],
    ) -> None:
        self._node, self._name, self._begin, self._cancel = node, name, begin, cancel
        self._goals: dict[bytes, ActiveGoal] = {}
        self._server = _Server(
            node,
            kind,
            name,
            lambda _handle: None,
            goal_callback=self._on_request,
            handle_accepted_callback=self._on_accepted,
            cancel_callback=self._on_cancel,
            result_timeout=_KEEP_S,
        )
        node.goal_servers.append(self)

    def abort(self, reason: str) -> None:
        """Abort the goals that are left."""
        for goal in self._goals.values():
            goal.abort(reason)

    def destroy(self) -> None:
        """Abort the goals that are left, and take the server away; a node that ends does this after its `stop`."""
        had = any(goal.active for goal in self._goals.values())
        self.abort("the node ends")
        self._server.answer_late(_LATE_S if had else 0.0)
        self._server.destroy()

    def _on_request(self, _request: Any) -> GoalResponse:
        if not self._node.is_active:
            self._node.get_logger().warning(f"{self._name}: a goal is rejected: the node is inactive")
            return GoalResponse.REJECT
        if self._server.is_full:
            self._node.get_logger().warning(
                f"{self._name}: a goal is rejected: {_MOST_GOALS} came within {_KEEP_S} s", throttle_duration_sec=5.0
            )
            return GoalResponse.REJECT
        return GoalResponse.ACCEPT

    def _on_accepted(self, handle: ServerGoalHandle) -> None:
        handle.execute()
        self._goals = {each: goal for each, goal in self._goals.items() if goal.active}
        goal = self._goals[bytes(handle.goal_id.uuid)] = ActiveGoal(self._server, handle)
        try:
            self._begin(goal)
        except CtrlRlError as error:
            self._node.get_logger().error(f"{self._name}: the goal is aborted: {error}")
            goal.abort(str(error), error.code if isinstance(error, GoalError) else 0)
        except Exception as error:
            self._node.faults.note(f"goal ({self._name})", error)
            goal.abort(one_line(error))

    def _on_cancel(self, handle: ServerGoalHandle) -> CancelResponse:
        goal = self._goals.get(bytes(handle.goal_id.uuid))
        if goal is None or not goal.active:
            return CancelResponse.REJECT
        self._node.call_soon(lambda: self._cancel(goal))  # once the state is 'canceling'
        return CancelResponse.ACCEPT
