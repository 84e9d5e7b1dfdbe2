"""Runs the process of one node or several: startup checks, signals, and a clean shutdown."""

from __future__ import annotations

import ctypes
import faulthandler
import inspect
import os
import resource
import signal
import sys
import traceback
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import rclpy
from rclpy._rclpy_pybind11 import RCLError, UnknownROSArgsError
from rclpy.executors import ExternalShutdownException
from rclpy.logging import LoggingSeverity, get_logger
from rclpy.signals import SignalHandlerOptions

from ctrl_rl_core.errors import CtrlRlError, one_line
from ctrl_rl_core.processes.children import end_with_ros2
from ctrl_rl_core.processes.signals import set_handlers
from ctrl_rl_core.ros.parameters import ParameterError, help_text
from ctrl_rl_core.ros.spinning import finish, spin
from ctrl_rl_core.ros.stop_request import InterruptedWorkError, interruptible, stop_request

if TYPE_CHECKING:
    from ctrl_rl_core.ros.node import SuiteNode

EXIT_FAILURE = 1
EXIT_USAGE = 2
_FAREWELL_S = 10.0
"""Maximum time for the middleware to close a node [s]."""
_HEAPS = -8
"""M_ARENA_MAX of mallopt(3)."""
_LEAST_FILES = 64
"""Minimum limit of open files and sockets; the middleware alone needs about 30."""


def run_node(kind: type[SuiteNode], arguments: list[str] | None = None) -> int:
    """Run one node until a stop signal or shutdown, and return the process's exit code, as `run_nodes` does."""
    arguments = sys.argv if arguments is None else arguments
    if "-h" in arguments[1:] or "--help" in arguments[1:]:
        _say(help_text(_program(arguments), inspect.getdoc(kind) or "", kind.PARAMETERS), sys.stdout)
        return 0
    return run_nodes([kind], arguments)


def run_nodes(kinds: Sequence[type[SuiteNode]], arguments: list[str]) -> int:
    """Run nodes in this process until a stop signal or shutdown, and return the process's exit code.

    The nodes also end with the `ros2 run` or `ros2 launch` that started them. Signals are caught here rather than by
    rclpy, which would close the publishers before `SuiteNode.stop` could send its zero velocity. Exit codes: 0 clean
    stop; 1 the work failed; 2 invalid parameter or argument.
    """
    program = _program(arguments)
    set_handlers(stop_request)
    set_handlers(stop_request.suspend, (signal.SIGTSTP,))
    end_with_ros2()
    if len(kinds) > 1:
        _share_one_heap()
    nodes: list[SuiteNode] = []
    try:
        with interruptible():
            if not all(kind.SHARED_MEMORY for kind in kinds):
                _leave_out_shared_memory()
            extra = initialise(arguments)
            if extra:
                raise ParameterError(f"unknown argument '{extra[0]}': see --help")
            for kind in kinds:  # one at a time: those made before one that fails are closed
                nodes.append(kind())  # type: ignore[call-arg]  # noqa: PERF401
        spin(nodes)
    except (ExternalShutdownException, InterruptedWorkError):
        pass
    except CtrlRlError as error:
        _say(f"{program}: {error}", sys.stderr)
        return EXIT_USAGE if isinstance(error, ParameterError) else EXIT_FAILURE
    except Exception as error:
        if stop_request.asked:  # reported by the interrupted block itself
            return 0
        started = len(nodes) == len(kinds)
        _say(f"{program}: {'failed' if started else 'could not start'}: {one_line(error)}", sys.stderr)
        _explain(program)
        return EXIT_FAILURE
    finally:
        _close(nodes)
    return 0


def _program(arguments: list[str]) -> str:
    return arguments[0].rsplit("/", 1)[-1]


def initialise(arguments: list[str]) -> list[str]:
    """Start rclpy without changing the signal handlers, and return the non-ROS arguments.

    Raises:
        ParameterError: A ROS argument is invalid, the limit of open files is too low, or there is no log folder.
    """
    _check_open_files()
    _check_log_folder()
    try:
        rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
        return list(rclpy.utilities.remove_ros_args(arguments))[1:]
    except UnknownROSArgsError as error:
        raise ParameterError(f"unknown ROS argument {error}: see --help") from None
    except RCLError as error:
        raise ParameterError(f"wrong ROS arguments ({str(error).split(', at ')[0]}): see --help") from None


def _share_one_heap() -> None:
    """Have all threads allocate from one heap; glibc has no environment variable that takes effect after the start.

    By default each of the middleware's threads fills a heap of its own, a quarter of the memory of a process that holds
    three nodes. A single node would gain nothing, and lose a tenth of its speed to the lock.
    """
    change = getattr(ctypes.CDLL(None), "mallopt", None)
    if change is not None:
        change(_HEAPS, 1)


def _leave_out_shared_memory() -> None:
    """Restrict Fast DDS to UDP unless the user chose a transport; environment variables are its only interface."""
    chosen = ("FASTDDS_BUILTIN_TRANSPORTS", "FASTDDS_DEFAULT_PROFILES_FILE", "FASTRTPS_DEFAULT_PROFILES_FILE")
    if not any(os.environ.get(name) for name in chosen):
        os.environ["FASTDDS_BUILTIN_TRANSPORTS"] = "UDPv4"


def _check_open_files() -> None:
    """Raise the limit of open files to its maximum if it is too low for a node.

    Raises:
        ParameterError: The maximum is still too low; the middleware would fail unpredictably, or serve half of its
            topics.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft >= _LEAST_FILES or soft == resource.RLIM_INFINITY:
        return
    if hard != resource.RLIM_INFINITY and hard < _LEAST_FILES:
        raise ParameterError(
            f"only {hard} files may be open at once: a node needs {_LEAST_FILES}, raise it with ulimit -n"
        )
    resource.setrlimit(resource.RLIMIT_NOFILE, (_LEAST_FILES, hard))


def _check_log_folder() -> None:
    """Check that ROS can write its log, before it reports the problem in many lines.

    Raises:
        ParameterError: ROS cannot write its log.
    """
    given, home = os.environ.get("ROS_LOG_DIR"), os.environ.get("HOME")
    ros_home = os.environ.get("ROS_HOME") or (f"{home}/.ros" if home else "")
    folder = given or (f"{ros_home}/log" if ros_home else "")
    if not folder:
        raise ParameterError("HOME is not set, and ROS writes its log there: set HOME or ROS_LOG_DIR")
    path = Path(folder).expanduser()
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ParameterError(f"ROS cannot write its log to {path} ({error.strerror}): set ROS_LOG_DIR") from None
    if not os.access(path, os.W_OK | os.X_OK):
        raise ParameterError(f"ROS may not write its log to {path}: set ROS_LOG_DIR")


def _close(nodes: list[SuiteNode]) -> None:
    try:
        for node in nodes:
            if rclpy.ok():
                finish(node)
    finally:
        with _soon():
            for node in nodes:
                node.destroy_node()
            rclpy.try_shutdown()


@contextmanager
def _soon() -> Iterator[None]:
    """End the process with code 1 if the block hangs; the node has finished its work by then.

    Fast DDS 2.14 was seen to wait forever for one of its own threads while holding Python's lock: then no Python thread
    or signal handler runs, but faulthandler's thread does.
    """
    with open(os.devnull, "w") as nowhere:
        faulthandler.dump_traceback_later(_FAREWELL_S, exit=True, file=nowhere)
        try:
            yield
        finally:
            faulthandler.cancel_dump_traceback_later()


def _explain(program: str) -> None:
    """Print the traceback of the current error if the log level is debug."""
    if rclpy.ok() and get_logger(program).is_enabled_for(LoggingSeverity.DEBUG):
        _say(traceback.format_exc(), sys.stderr)


def _say(text: str, stream: Any) -> None:
    print(text, file=stream)
