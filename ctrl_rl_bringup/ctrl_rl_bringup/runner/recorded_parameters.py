"""The parameters that nodes had while a bag was recorded."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ctrl_rl_core.io.checked_json import parse_json

from ctrl_rl_core import CtrlRlError


def recorded_parameters(custom_data: Mapping[str, str], node: str) -> dict[str, Any]:
    """Return a node's parameters, whatever its namespace; none where the bag does not say them, or they are damaged."""
    keys = (key for key in custom_data if key.startswith("parameters.") and key.endswith(f"/{node}"))
    try:
        content = parse_json(custom_data.get(min(keys, default=""), "{}"))
    except CtrlRlError:
        return {}
    return content if isinstance(content, dict) else {}
