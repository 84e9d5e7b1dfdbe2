"""Runs a solver in its own process, which the kernel terminates at a CPU time limit.

An interior-point solver may loop in its own code without calling back, as fatrop does if a derivative is NaN; Python
signal handlers then never run.
"""

from __future__ import annotations

import os
import signal
import time
import warnings
import weakref
from dataclasses import dataclass
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
_WAIT = 10.0
"""Maximum wall time per second of CPU time on a busy machine; beyond it the process is terminated too."""
_seconds_elsewhere = 0.0


@dataclass(frozen=True)
class Answer:
    """A solver's answer.

    Attributes:
        variables: Final variables.
        multipliers: Final multipliers of the constraints.
        success: Whether the solver reports success.
        status: The solver's status.
        iterations: Number of iterations.
        seconds: CPU time [s].
    """

    variables: Array
    multipliers: Array
    success: bool
    status: str
    iterations: int
    seconds: float


class LimitedSolver:
    """Runs a CasADi solver in a process that is forked on the first call and ends with this object.

    Args:
        solver: Solver; its output is discarded.
    """

    def __init__(self, solver: Any) -> None:
        self._solver = solver
        self._connection: Connection | None = None
        self._end: weakref.finalize[Any, Any] | None = None
        self._owner = 0

    def __call__(self, arguments: dict[str, Array], limit: float) -> Answer | None:
        """Return the answer; None if it took more than `limit` seconds of CPU time.

        Args:
            arguments: Arguments of the solver by name.
            limit: Maximum CPU time [s].
        """
        global _seconds_elsewhere
        if self._connection is None or self._owner != os.getpid():  # a forked process needs its own
            self._begin()
        assert self._connection is not None
        answer: Answer | None = None
        try:
            self._connection.send((arguments, limit))
            if self._connection.poll(_WAIT * limit):
                answer = self._connection.recv()
        except (EOFError, OSError):  # terminated by the kernel
            pass
        except BaseException:  # interrupted: its answer must not be mistaken for that of the next call
            self._close()
            raise
        if answer is None:
            self._close()
        _seconds_elsewhere += limit if answer is None else answer.seconds
        return answer

    def _begin(self) -> None:
        self._close()
        ours, theirs = Pipe()
        with warnings.catch_warnings():  # the child only runs the solver, so locks of other threads do not matter
            warnings.simplefilter("ignore", DeprecationWarning)
            process = os.fork()
        if process == 0:
            ours.close()
            _serve(self._solver, theirs)
        theirs.close()
        self._connection, self._owner = ours, os.getpid()
        self._end = weakref.finalize(self, _end, process, ours, os.getpid())

    def _close(self) -> None:
        if self._end is not None:
            self._end()
        self._connection = self._end = None


def seconds_elsewhere() -> float:
    """Return the total CPU time of the solver processes of this process [s]."""
    return _seconds_elsewhere


def _end(process: int, connection: Connection, owner: int) -> None:
    connection.close()
    if owner == os.getpid():
        os.kill(process, signal.SIGKILL)
        os.waitpid(process, 0)


def _serve(solver: Any, connection: Connection) -> NoReturn:
    """Answer calls until the other end of the pipe closes."""
    try:
        # Nothing else of the parent is kept open, because a lock on a file would last as long as this process.
        mine, most = connection.fileno(), os.sysconf("SC_OPEN_MAX")
        os.closerange(3, mine)
        os.closerange(mine + 1, most)
        nowhere = os.open(os.devnull, os.O_RDWR)
        for stream in (1, 2):  # solvers print pages of numbers for a NaN
            os.dup2(nowhere, stream)
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is handled by the parent, which ends this process
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        signal.signal(signal.SIGPROF, signal.SIG_DFL)
        while True:
            arguments, limit = connection.recv()
            signal.setitimer(signal.ITIMER_PROF, limit)
            answer = _ask(solver, arguments)
            signal.setitimer(signal.ITIMER_PROF, 0.0)
            connection.send(answer)
    except BaseException:  # after a fork, neither exit handlers nor the parent's code may run
        pass
    finally:
        os._exit(0)


def _ask(solver: Any, arguments: dict[str, Array]) -> Answer:
    begin = time.process_time()
    try:
        found = solver(**arguments)
        variables, multipliers = (np.asarray(found[name], dtype=float).ravel() for name in ("x", "lam_g"))
        failed = ""
    except RuntimeError:  # CasADi's only error type
        variables, multipliers, failed = np.full(len(arguments["x0"]), np.nan), np.empty(0), "Error_In_Solver"
    stats = solver.stats()
    status = failed or str(stats["return_status"])
    if not failed and status.lstrip("-").isdigit():  # fatrop only has numbers, so CasADi's general status is used
        status = str(stats.get("unified_return_status", status)).removeprefix("SOLVER_RET_")
    iterations = int(stats.get("iter_count", 0))
    success = bool(stats.get("success", False)) and not failed
    return Answer(variables, multipliers, success, status, iterations, time.process_time() - begin)
