"""The life of a node's process: checks at the start, executor, signals, and a clean end."""

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
"""Pause after a failure outside of all callbacks [s], so that a repeated one leaves the processor to others."""
_FAREWELL_S = 10.0
"""Time that the middleware has to close a node [s]."""
_LEAST_FILES = 64
"""Files and sockets that a node may have open; the middleware alone takes some 30."""


class _InterruptedError(BaseException):
    """A signal came while work was under way that may be cut off anywhere."""


class _Stop:
    """Handling of the signals that end a process: they request the end, and interrupt blocks that allow it.

    Attributes:
        asked: Whether one has come.
        suspended: Whether Ctrl-Z has come since the last time that it was obeyed.
    """

    def __init__(self) -> None:
        self.asked = self.suspended = False
        self._may_raise = False

    def suspend(self, _signal: int, _frame: object) -> None:
        """Note Ctrl-Z."""
        self.suspended = True

    def __call__(self, _signal: int, _frame: object) -> None:
        self.asked = True
        if self._may_raise:
            self._may_raise = False
            raise _InterruptedError

    @contextmanager
    def at_once(self) -> Iterator[None]:
        """Let a signal cut this block off."""
        if self.asked:
            raise _InterruptedError
        before, self._may_raise = self._may_raise, True
        try:
            yield
        finally:
            self._may_raise = before


_stop = _Stop()
interruptible = _stop.at_once
"""Context of long work in a callback, as reading a file, that a signal may cut off anywhere: the node then ends."""


def run_node(kind: type[SuiteNode], arguments: list[str] | None = None) -> int:
    """Run one node until a signal that ends processes, or shutdown, and return the process's exit code.

    It ends with the `ros2 run` or `ros2 launch` that started it, too. The signals are caught here rather than by rclpy,
    which would close the publishers before `SuiteNode.stop` could send its zero velocity. 0: stopped in good order; 1:
    the work failed; 2: a wrong parameter or argument.
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
        if _stop.asked:  # an interrupted block reports that itself
            return 0
        _say(f"{program}: {'could not start' if node is None else 'failed'}: {one_line(error)}", sys.stderr)
        _explain(program)
        return EXIT_FAILURE
    finally:
        _close(node)
    return 0


def initialise(arguments: list[str]) -> list[str]:
    """Start rclpy with the process's signals left alone and return the arguments that are not ROS's.

    Raises:
        ParameterError: A ROS argument is wrong, or the process has too few files or no folder for its log.
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
    """Let Fast DDS use UDP alone, unless the user has chosen; its own variables are its only door."""
    chosen = ("FASTDDS_BUILTIN_TRANSPORTS", "FASTDDS_DEFAULT_PROFILES_FILE", "FASTRTPS_DEFAULT_PROFILES_FILE")
    if not any(os.environ.get(name) for name in chosen):
        os.environ["FASTDDS_BUILTIN_TRANSPORTS"] = "UDPv4"


def _check_open_files() -> None:
    """Raise the limit of open files as far as it may be where it is too low for a node.

    Raises:
        ParameterError: It may not be raised that far; the middleware would fail anywhere, or serve half of its topics.
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
    """Check whether ROS can write its log, before it complains in many lines.

    Raises:
        ParameterError: It cannot.
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
    """Serve the node's callbacks until a signal or the middleware ends it."""
    executor = _executor(node)
    node.executor_name = type(executor).__name__
    executor.add_node(node)
    try:
        while not _stop.asked and rclpy.ok():
            try:
                executor.spin_once(timeout_sec=_POLL_S)
            except ExternalShutdownException:
                raise
            except Exception as error:  # a message that cannot be taken, an answer that cannot be sent
                if _stop.asked:
                    break
                node.faults.note("executor", error)
                time.sleep(_BREATH_S)
            if node.faults.ended_by is not None:
                raise node.faults.ended_by
            if _stop.suspended:
                _suspend(node)
    finally:
        executor.shutdown()  # while its context lives: its finaliser would complain afterwards


def _suspend(node: SuiteNode) -> None:
    """Obey Ctrl-Z once the robot has been told to stand: a process that is suspended cannot do that any more."""
    _stop.suspended = False
    node.on_suspend()
    os.kill(os.getpid(), signal.SIGSTOP)


def _close(node: SuiteNode | None) -> None:
    try:
        if node is not None and rclpy.ok():
            node.stop()
    finally:
        with _soon():
            if node is not None:
                node.destroy_node()
            rclpy.try_shutdown()


@contextmanager
def _soon() -> Iterator[None]:
    """End the process, with 1, if the block hangs: the node has finished its work by then.

    Fast DDS 2.14 was seen to wait for one of its own threads for ever, with Python's lock held: no Python thread or
    signal handler gets through, but faulthandler's thread does.
    """
    with open(os.devnull, "w") as nowhere:
        faulthandler.dump_traceback_later(_FAREWELL_S, exit=True, file=nowhere)
        try:
            yield
        finally:
            faulthandler.cancel_dump_traceback_later()


def _explain(program: str) -> None:
    """Print the traceback of the error at hand where the log level is debug."""
    if rclpy.ok() and get_logger(program).is_enabled_for(LoggingSeverity.DEBUG):
        _say(traceback.format_exc(), sys.stderr)


def _say(text: str, stream: Any) -> None:
    print(text, file=stream)
