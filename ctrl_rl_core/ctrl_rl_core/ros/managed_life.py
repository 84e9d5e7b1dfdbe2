"""The life of a managed node, as a lifecycle manager such as Nav2's sees it."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from rclpy.lifecycle import LifecycleNodeMixin, LifecycleState, TransitionCallbackReturn

if TYPE_CHECKING:
    from ctrl_rl_core.ros.node import SuiteNode

_DONE = TransitionCallbackReturn.SUCCESS


class ManagedLife(LifecycleNodeMixin):
    """Serves a node's lifecycle services: unconfigured, inactive, active or finalized.

    The node checks its parameters and loads its files when it starts, so configuring it has nothing left to do.

    Args:
        node: Node that is being constructed.
        rest: Called before the node is deactivated, while it may still stop its robot.
        forget: Called afterwards, to drop what must not go on at the next activation.

    Attributes:
        active: Whether the node may act.
    """

    def __init__(self, node: SuiteNode, rest: Callable[[], None], forget: Callable[[], None]) -> None:
        self._node, self._rest, self._forget, self.active = node, rest, forget, False
        # The mixin is meant for a base class of the node; these are the parts of the node that it uses.
        self.handle, self.default_callback_group = node.handle, node.default_callback_group
        self._services: list[Any] = []
        super().__init__()
        node._services.extend(self._services)
        for service in self._services:
            service.callback = node.faults.guard_service(service.callback, service.srv_name)
        self._service_change_state.callback = self._guarded(self._service_change_state.callback)

    @property
    def state(self) -> str:
        """Name of the state."""
        return str(self._state_machine.current_state[1])

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:  # noqa: ARG002 - of rclpy
        """Become inactive."""
        return _DONE

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:  # noqa: ARG002
        """Become active."""
        self.active = True
        self._node.get_logger().info("active")
        return _DONE

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:  # noqa: ARG002
        """Stop the robot, and become inactive."""
        return self._end()

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:  # noqa: ARG002
        """Become unconfigured."""
        return _DONE

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:  # noqa: ARG002
        """Stop the robot if it may move, and become finalized."""
        return self._end()

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:  # noqa: ARG002
        """Stop the robot after a failed transition, and become unconfigured."""
        return self._end()

    def _end(self) -> TransitionCallbackReturn:
        if self.active:
            try:
                self._rest()
            finally:
                self.active = False
            for server in self._node.goal_servers:
                server.abort("the node is inactive")
            self._forget()
            self._node.get_logger().info("inactive")
        return _DONE

    def _guarded(self, change: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
        """Return a callback that answers an impossible transition with success = False."""

        def change_if_possible(request: Any, response: Any) -> Any:
            transition = request.transition
            possible = self._state_machine.available_transitions
            if not any(
                transition.label == each[1] if transition.label else transition.id == each[0] for each in possible
            ):
                name = transition.label or transition.id
                self._node.get_logger().warning(f"no transition '{name}' from state '{self.state}'")
                response.success = False
                return response
            return change(request, response)

        return change_if_possible
