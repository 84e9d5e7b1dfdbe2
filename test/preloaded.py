"""Processes that begin with their imports done: a server that has imported what a program needs forks it.

Importing ROS, NumPy and the suite takes a node a second of processor time, and the tests start hundreds. A forked
program is a process like any other: with its own arguments, environment, signals and exit code, and rclpy starts in it.
It ends with the process that asked for it. At its own end what was imported is not taken down: that takes long, too.
Where the start or the end of a process itself is tried, `subprocess.Popen` is right.
"""

import ast
import atexit
import ctypes
import gc
import json
import os
import re
import runpy
import signal
import socket
import subprocess
import sys
import threading
import time
import types
from collections.abc import Sequence
from contextlib import suppress
from functools import cache
from importlib import import_module
from importlib.metadata import distribution
from pathlib import Path
from typing import Any

_END_WITH_PARENT, _SUBREAPER = 1, 36  # PR_SET_PDEATHSIG and PR_SET_CHILD_SUBREAPER of prctl(2)
_LIBC = ctypes.CDLL(None)
_LONGEST = 1 << 17
_ASKS = threading.Lock()


class Preloaded(subprocess.Popen):
    """A Python program, forked: `python -c CODE`, `python SCRIPT.py` or an executable as `ros2 run` starts it."""

    sources: Sequence[Path] = ()
    """Files whose imports the server makes as well."""

    def _execute_child(self, args: Any, *rest: Any) -> None:
        program = [str(part) for part in args]
        if program[0] == sys.executable:
            del program[0]
        if program[0] != "-c" and not os.path.exists(program[0]):
            raise FileNotFoundError(program[0])
        folder, environment, pipes = rest[4], rest[5], rest[9:15]
        streams = [pipe if pipe >= 0 else number for number, pipe in enumerate((pipes[0], pipes[3], pipes[5]))]
        place, sources = os.path.abspath(folder or "."), [str(source) for source in self.sources]
        self.pid = _ask([program, dict(environment or os.environ), place, sources], streams)
        self._child_created = True
        self._close_pipe_fds(*pipes)


@cache
def _server() -> tuple[socket.socket, subprocess.Popen]:
    ours, its = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with its:
        command = [sys.executable, __file__, str(its.fileno())]
        null = subprocess.DEVNULL
        return ours, subprocess.Popen(command, pass_fds=[its.fileno()], stdin=null, stdout=null)


def _ask(request: list[Any], streams: list[int]) -> int:
    with _ASKS:
        door, _ = _server()
        # The server's child, left by its parent at once, becomes a child of ours: we may wait for it.
        _LIBC.prctl(_SUBREAPER, 1, 0, 0, 0)
        try:
            socket.send_fds(door, [json.dumps(request).encode()], streams)
            pid, left = door.recv(100), door.recv(100)
        finally:
            _LIBC.prctl(_SUBREAPER, 0, 0, 0, 0)
    if not left:
        raise RuntimeError("the server of preloaded processes has ended")
    return int(pid)


def _serve(door: socket.socket) -> list[str]:
    """Fork a process for each request; return in each its program."""
    tests = os.getppid()
    while True:
        request, streams, *_ = socket.recv_fds(door, _LONGEST, 3)
        if not request:
            os._exit(0)
        program, environment, folder, sources = json.loads(request)
        for source in sources:
            with suppress(Exception):  # pytest says what is wrong with it
                _preload(Path(source).read_text())
        with suppress(Exception):  # the program fails in the same way
            _preload(program[1] if program[0] == "-c" else Path(program[0]).read_text())
        gc.freeze()  # a collection would write to every page that the processes share
        tracing = _Tracing()
        middle = os.fork()
        if middle == 0:
            middle = os.getpid()
            if pid := os.fork():
                door.send(str(pid).encode())
                os._exit(0)
            tracing.call("after_fork_child")
            _end_with(tests, middle)
            break
        tracing.call("after_fork_parent")
        os.waitpid(middle, 0)
        door.send(b"its parent has left it")
        for stream in streams:
            os.close(stream)
    door.close()
    for number, stream in enumerate(streams):
        os.dup2(stream, number)
        os.close(stream)
    os.environ.clear()
    os.environ.update(environment)
    os.chdir(folder)
    return program


class _Tracing:
    """Fork hooks of LTTng's library, which ROS loads: its threads have to stand still and begin anew in the child."""

    def __init__(self) -> None:
        maps = Path("/proc/self/maps").read_text()
        self._libraries = [ctypes.CDLL(path) for path in set(re.findall(r"/\S*/liblttng-ust[-.]\S*", maps))]
        self._signals = ctypes.create_string_buffer(128)  # a sigset_t
        self.call("before_fork")

    def call(self, hook: str) -> None:
        for library in self._libraries:
            for name in (f"ust_{hook}", f"lttng_ust_{hook}"):  # before and since LTTng 2.13
                with suppress(AttributeError):
                    getattr(library, name)(self._signals)


def _end_with(parent: int, left_by: int) -> None:
    """Let this process be killed when the parent that it gets after `left_by` ends, however that ends."""
    while os.getppid() == left_by:
        time.sleep(0.001)
    _LIBC.prctl(_END_WITH_PARENT, signal.SIGKILL, 0, 0, 0)
    if os.getppid() != parent:
        os._exit(1)


@cache
def _preload(code: str) -> None:
    """Import what a program imports at its top."""
    if found := re.search(r"load_entry_point\('(.+)', '(.+)', '(.+)'\)", code):
        project, group, entry = found.groups()
        places = [each.attr.split(".") for each in distribution(project).entry_points.select(group=group, name=entry)]
        modules = [".".join(place[1:-1]) for place in places]  # behind the door of ctrl_rl_core.entry
    else:
        nodes = ast.parse(code).body
        modules = [alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names]
        modules += [str(node.module) for node in nodes if isinstance(node, ast.ImportFrom)]
    for module in modules:
        with suppress(ImportError):
            import_module(module)


def _run(program: list[str]) -> None:
    if program[0] == "-c":
        sys.argv = ["-c", *program[2:]]
        main = sys.modules["__main__"] = types.ModuleType("__main__")
        exec(compile(program[1], "<string>", "exec"), main.__dict__)
    else:
        sys.argv = program
        sys.path[0] = str(Path(program[0]).resolve().parent)
        runpy.run_path(program[0], run_name="__main__")


def _end(code: int) -> None:
    """End with an exit code, after the threads, what was registered for the end, and what the program has left."""
    threading._shutdown()  # type: ignore[attr-defined]
    atexit._run_exitfuncs()
    gc.collect()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code & 0xFF)


if __name__ == "__main__":
    try:
        _run(_serve(socket.socket(fileno=int(sys.argv[1]))))
    except SystemExit as error:
        if not isinstance(error.code, int | None):
            raise
        _end(error.code or 0)
    else:
        _end(0)
