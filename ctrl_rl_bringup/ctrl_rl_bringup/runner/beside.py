"""The page beside a run on this machine."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager

from ctrl_rl_core.processes import end_child, start_child

from ctrl_rl_bringup.runner.processes import executable_path
from ctrl_rl_bringup.runner.stack import NodeSpec

_STOP_S = 10.0


@contextmanager
def page_beside(robot: str) -> Iterator[None]:
    """Run the command `view` within the block; it prints its address, and in one line why there is no page.

    Args:
        robot: Robot of the run.
    """
    file = executable_path(NodeSpec("ctrl_rl_bringup", "view"))
    process = start_child([file, "--robot", robot], stdin=subprocess.DEVNULL, start_new_session=True)
    try:
        yield
    finally:
        end_child(process, _STOP_S)
