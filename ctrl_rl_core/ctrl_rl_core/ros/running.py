"""Runs a node process: startup checks, executor, signals, and a clean shutdown."""

from __future__ import annotations

import faulthandler
import inspect
import os
import resource
import signal
import sys
import time
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import rclpy
from rclpy._rclpy_pybind11 import RCLError, UnknownROSArgsError
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.logging import LoggingSeverity, get_logger
from rclpy.signals import SignalHandlerOptions

from ctrl_rl_core.errors import CtrlRlError, one_line
from ctrl_rl_core.processes.children import end_with_ros2
from ctrl_rl_core.processes.signals import set_handlers
from ctrl_rl_core.ros.parameters import ParameterError, help_text

if TYPE_CHECKING:
    from ctrl_rl_core.ros.node import SuiteNode

try:
    from rclpy.experimental import EventsExecutor
except ImportError:  # rclpy before 7.1.4
    EventsExecutor = None

EXIT_FAILURE = 1
EXIT_USAGE = 2
_POLL_S = 0.1
_BREATH_S = 0.001
"""Pause after an error outside of all callbacks [s], so that a repeated error does not saturate the CPU."""
_FAREWELL_S = 10.0
"""Maximum time for the middleware to close a node [s]."""
_LEAST_FILES = 64
"""Minimum limit of open files and sockets; the middleware alone needs about 30."""


class _InterruptedError(BaseException):
    """A signal arrived during interruptible work."""


class _Stop:
    """Handles the signals that end a process: they request shutdown, and interrupt blocks that allow it.

    Attributes:
        asked: Whether shutdown was requested.
        suspended: Whether Ctrl-Z is pending.
    """

    def __init__(self) -> None:
        self.asked = self.suspended = False
        self._may_raise = False

    def suspend(self, _signal: int, _frame: object) -> None:
        """Record Ctrl-Z."""
        self.suspended = True

    def __call__(self, _signal: int, _frame: object) -> None:
        self.asked = True
        if self._may_raise:
            self._may_raise = False
            raise _InterruptedError

    @contextmanager
    def at_once(self) -> Iterator[None]:
        """Let a signal interrupt this block."""
        if self.asked:
            raise _InterruptedError
        before, self._may_raise = self._may_raise, True
        try:
            yield
        finally:
            self._may_raise = before


_stop = _Stop()
interruptible = _stop.at_once
"""Context for long work in a callback, such as reading a file: a signal may abort it anywhere and end the node."""


def run_node(kind: type[SuiteNode], arguments: list[str] | None = None) -> int:
    """Run one node until a stop signal or shutdown, and return the process's exit code.

    The node also ends with the `ros2 run` or `ros2 launch` that started it. Signals are caught here rather than by
    rclpy, which would close the publishers before `SuiteNode.stop` could send its zero velocity. Exit codes: 0 clean
    stop; 1 the work failed; 2 invalid parameter or argument.
    """
    arguments = sys.argv if arguments is None else arguments
    program = arguments[0].rsplit("/", 1)[-1]
    if "-h" in arguments[1:] or "--help" in arguments[1:]:
        _say(help_text(program, inspect.getdoc(kind) or "", kind.PARAMETERS), sys.stdout)
        return 0
    set_handlers(_stop)
    set_handlers(_stop.suspend, (signal.SIGTSTP,))
    end_with_ros2()
    node: SuiteNode | None = None
    try:
        with interruptible():
            if not kind.SHARED_MEMORY:
                _leave_out_shared_memory()
            extra = initialise(arguments)
            if extra:
                raise ParameterError(f"unknown argument '{extra[0]}': see --help")
            node = kind()  # type: ignore[call-arg]
        _spin(node)
    except (ExternalShutdownException, _InterruptedError):
        pass
    except CtrlRlError as error:
        _say(f"{program}: {error}", sys.stderr)
        return EXIT_USAGE if isinstance(error, ParameterError) else EXIT_FAILURE
    except Exception as error:
        if _stop.asked:  # reported by the interrupted block itself
            return 0
        _say(f"{program}: {'could not start' if node is None else 'failed'}: {one_line(error)}", sys.stderr)
        _explain(program)
        return EXIT_FAILURE
    finally:
        _close(node)
    return 0


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


def _executor(node: SuiteNode) -> Any:
    if node.QUICK and EventsExecutor is not None:
        return EventsExecutor()
    if node.QUICK:
        node.get_logger().info(
            "this rclpy has no EventsExecutor (7.1.4 has): the usual executor takes twice the time and processor"
        )
    return SingleThreadedExecutor()


def _spin(node: SuiteNode) -> None:
    """Run the node's callbacks until a signal or the middleware ends it."""
    executor = _executor(node)
    node.executor_name = type(executor).__name__
    executor.add_node(node)
    try:
        while not _stop.asked and rclpy.ok():
            try:
                executor.spin_once(timeout_sec=_POLL_S)
            except ExternalShutdownException:
                raise
            except Exception as error:  # an unreadable message, or an answer that cannot be sent
                if _stop.asked:
                    break
                node.faults.note("executor", error)
                time.sleep(_BREATH_S)
            if node.faults.ended_by is not None:
                raise node.faults.ended_by
            if _stop.suspended:
                _suspend(node)
    finally:
        executor.shutdown()  # before its context is destroyed, or its finaliser would complain


def _suspend(node: SuiteNode) -> None:
    """Suspend the process after stopping the robot, since a suspended process cannot stop it."""
    _stop.suspended = False
    node.on_suspend()
    os.kill(os.getpid(), signal.SIGSTOP)


def _close(node: SuiteNode | None) -> None:
    try:
        if node is not None and rclpy.ok():
            node.stop()
            for server in node.goal_servers:
                server.destroy()
    finally:
        with _soon():
            if node is not None:
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
