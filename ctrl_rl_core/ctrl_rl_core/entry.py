"""Common entry point of all executables: handles signals, closed outputs and unexpected errors.

`scripts/package_setup.py` rewrites the entry point "demo = ctrl_rl_bringup.cli.drive:demo" to
"demo = ctrl_rl_core.entry:command.ctrl_rl_bringup.cli.drive.demo". This module imports little, so signal handlers are
in place before the executable's own modules are imported.
"""

from __future__ import annotations

import atexit
import os
import signal
import sys
import traceback
from collections.abc import Callable
from importlib import import_module
from types import FrameType
from typing import NoReturn

from ctrl_rl_core.errors import CtrlRlError, one_line
from ctrl_rl_core.help_pages import help_page
from ctrl_rl_core.processes.signals import interrupt_once, set_handlers

EXIT_FAILURE = 1
EXIT_INTERRUPTED = 130
"""Exit code that shells report for SIGINT."""
_MOVED, MOVED_TO = "ctrl_rl_core.moved", "ctrl_rl_bags"
"""Modules of commands that have moved, and their new package."""
_NOT_ON_A_ROBOT = ("sim_bridge", "ctrl_rl_learning")
"""Packages of this workspace that only learning needs."""


class Door:
    """A function given by its dotted name and imported when called: `command.package.module.function()`.

    Args:
        interrupted: Exit code after a signal during the imports.
        target: Dotted name so far.
    """

    def __init__(self, interrupted: int, target: str = "") -> None:
        self._interrupted, self._target = interrupted, target

    def __getattr__(self, name: str) -> Door:
        if name.startswith("__"):
            raise AttributeError(name)
        return Door(self._interrupted, f"{self._target}.{name}" if self._target else name)

    def __call__(self) -> int:
        """Run the function as this process's executable, and return its exit code."""
        program = os.path.basename(sys.argv[0])
        _open_standard_streams()
        set_handlers(self._end)
        # The interpreter restores the default handlers before its last clean-up, but leaves ignored signals alone. The
        # first function registered runs last.
        atexit.register(set_handlers, signal.SIG_IGN)
        module, _, function = self._target.rpartition(".")
        if module == _MOVED:  # printed here, because a cached help page does not mention it
            _say(f"{program}: this command is now `ros2 run {MOVED_TO} {program}`")

        def work() -> int:
            return int(getattr(import_module(module), function)() or 0)

        try:
            return guarded(program, lambda: help_page(work))
        except Exception as error:
            return _confess(program, error)

    def _end(self, _number: int, _frame: FrameType | None) -> NoReturn:
        """Exit immediately: nothing has started that would need cleaning up."""
        if self._interrupted:
            _say(f"{os.path.basename(sys.argv[0])}: interrupted")
        os._exit(self._interrupted)


command, node = Door(EXIT_INTERRUPTED), Door(0)
"""Entry points of commands, and of nodes; a signal shuts nodes down cleanly."""


def run_command(program: str, work: Callable[[], int], failure: int = EXIT_FAILURE) -> int:
    """Run a command and return its exit code; the first signal that would end the process raises KeyboardInterrupt.

    Output is line-buffered, into pipes and files too.

    Args:
        program: Prefix of its error messages.
        work: Returns the exit code.
        failure: Exit code for a `CtrlRlError`.
    """
    reconfigure = getattr(sys.stdout, "reconfigure", None)
    if reconfigure is not None:
        reconfigure(line_buffering=True)
    with interrupt_once() as interruption:
        return guarded(program, work, failure, lambda: interruption.came)


def guarded(
    program: str, work: Callable[[], int], failure: int = EXIT_FAILURE, interrupted: Callable[[], bool] = lambda: False
) -> int:
    """Run work and return its exit code; an interruption or a user error prints one line.

    Args:
        program: Prefix of the line.
        work: Returns the exit code.
        failure: Exit code for a `CtrlRlError`.
        interrupted: Returns whether a signal has arrived. If so, any error is treated as its consequence: native code
            turns the KeyboardInterrupt of a callback into an error of its own ("Unable to convert call argument").

    Raises:
        Exception: Any other exception, which indicates a bug.
    """
    try:
        try:
            return work()
        finally:
            if sys.stdout is not None:
                sys.stdout.flush()
    except KeyboardInterrupt:
        return _interrupted(program)
    except Exception as error:
        if interrupted():
            return _interrupted(program)
        return _explain(program, error, failure)


def _interrupted(program: str) -> int:
    _discard_output()
    _say(f"{program}: interrupted")
    return EXIT_INTERRUPTED


def _explain(program: str, error: Exception, failure: int) -> int:
    """Print an error in one line and return its exit code."""
    _discard_output()
    match error:
        case BrokenPipeError():  # the reader of a pipe (head, less) has closed it
            return 0
        case CtrlRlError():
            _say(f"{program}: {error}")
        case ModuleNotFoundError():
            _say(f"{program}: {what_to_install(str(error.name))}")
        case OSError():
            _say(f"{program}: {_named(error)}{os.strerror(error.errno) if error.errno else one_line(error)}")
        case MemoryError():
            _say(f"{program}: not enough memory{f' ({error})' if str(error) else ''}")
        case _:
            raise error
    return failure


def _confess(program: str, error: Exception) -> int:
    """Print an unexpected error in one line and return its exit code."""
    if sys.flags.dev_mode:
        traceback.print_exception(error)
    place = traceback.extract_tb(error.__traceback__)[-1]
    where = f"{os.path.basename(place.filename)}:{place.lineno}"
    _say(f"{program}: failed unexpectedly at {where}: {one_line(error)}; PYTHONDEVMODE=1 shows the way there")
    return EXIT_FAILURE


def _named(error: OSError) -> str:
    return f"{error.filename}: " if error.filename is not None else ""


def what_to_install(module: str) -> str:
    """Return instructions for installing a missing module."""
    package = module.partition(".")[0]
    if package in _NOT_ON_A_ROBOT:
        packages = " and ".join(_NOT_ON_A_ROBOT)
        return (
            f"needs the package '{package}', which is not installed: build {packages} with colcon, "
            "and python -m pip install -r requirements/training.txt"
        )
    return f"needs '{module}': python -m pip install -r requirements/training.txt"


def _open_standard_streams() -> None:
    """Open standard streams that were closed (`>&-`), or the next opened file gets number 1 and receives C output."""
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # uses the lowest free descriptor
            if getattr(sys, name) is None:
                setattr(sys, name, os.fdopen(number, "r" if number == 0 else "w"))


def _discard_output() -> None:
    """Redirect output that can no longer be written to /dev/null, so the interpreter does not complain at exit."""
    if sys.stdout is None:
        return
    try:
        sys.stdout.flush()
    except (OSError, ValueError):
        with open(os.devnull, "wb") as nowhere:
            os.dup2(nowhere.fileno(), 1)


def _say(text: str) -> None:
    try:
        sys.stderr.write(f"{text}\n")
        sys.stderr.flush()
    except OSError:
        with open(os.devnull, "wb") as nowhere:
            os.dup2(nowhere.fileno(), 2)
