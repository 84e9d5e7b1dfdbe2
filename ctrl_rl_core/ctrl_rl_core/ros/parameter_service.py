"""Parameter services with validated requests, because rclpy raises on a value of unknown type."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from rcl_interfaces.msg import ParameterType, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.parameter_service import ParameterService

from ctrl_rl_core.errors import one_line

MOST_NAMES = 1000
"""Maximum number of parameters in one request."""
_LAST_TYPE = ParameterType.PARAMETER_STRING_ARRAY


class CheckedParameterService(ParameterService):
    """The six parameter services of a node; an invalid request is answered and counted, and never raises.

    Args:
        node: Node that owns the parameters.
        refused: Called with the reason for each invalid request.
    """

    def __init__(self, node: Node, refused: Callable[[str], None]) -> None:
        self._refused = refused
        super().__init__(node)

    def _set_parameters_callback(self, request: Any, response: Any) -> Any:
        for parameter in request.parameters[:MOST_NAMES]:
            response.results.append(self._set([parameter]))
        left = len(request.parameters) - MOST_NAMES
        if left > 0:
            response.results += [self._refusal(f"more than {MOST_NAMES} parameters in one request")] * left
        return response

    def _set_parameters_atomically_callback(self, request: Any, response: Any) -> Any:
        if len(request.parameters) > MOST_NAMES:
            response.result = self._refusal(f"more than {MOST_NAMES} parameters in one request")
        else:
            response.result = self._set(request.parameters)
        return response

    def _describe_parameters_callback(self, request: Any, response: Any) -> Any:
        return super()._describe_parameters_callback(self._bounded(request), response)

    def _get_parameters_callback(self, request: Any, response: Any) -> Any:
        return super()._get_parameters_callback(self._bounded(request), response)

    def _get_parameter_types_callback(self, request: Any, response: Any) -> Any:
        return super()._get_parameter_types_callback(self._bounded(request), response)

    def _list_parameters_callback(self, request: Any, response: Any) -> Any:
        if len(request.prefixes) > MOST_NAMES:
            self._refused(f"more than {MOST_NAMES} prefixes in one request")
            return response
        return super()._list_parameters_callback(request, response)

    def _bounded(self, request: Any) -> Any:
        """Remove the names of a request that has too many; ROS answers an invalid list of names with an empty one."""
        if len(request.names) > MOST_NAMES:
            self._refused(f"more than {MOST_NAMES} parameters in one request")
            request.names = []
        return request

    def _set(self, messages: Sequence[Any]) -> SetParametersResult:
        for message in messages:
            kind = message.value.type
            if kind > _LAST_TYPE:
                return self._refusal(f"parameter '{message.name[:100]}' has a value of unknown type {kind}")
        try:
            result = self._get_node().set_parameters_atomically([Parameter.from_parameter_msg(m) for m in messages])
        except Exception as error:  # rclpy raises several types for invalid names and values
            return self._refusal(one_line(error))
        return result

    def _refusal(self, reason: str) -> SetParametersResult:
        self._refused(reason)
        return SetParametersResult(successful=False, reason=reason)
