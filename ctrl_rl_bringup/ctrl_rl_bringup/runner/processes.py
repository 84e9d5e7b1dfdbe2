"""Starts nodes as processes and ends them in order, like `ros2 launch` but without it."""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType

import rclpy
import yaml
from ament_index_python.packages import PackageNotFoundError, get_package_prefix
from ctrl_rl_core.processes import end_with_ros2, handle_signals, interrupt_once, start_child
from ctrl_rl_core.ros import initialise

from ctrl_rl_bringup.runner.stack import NodeSpec
from ctrl_rl_core import CtrlRlError


@contextmanager
def ros(arguments: list[str] | None = None) -> Iterator[None]:
    """Initialise rclpy; the first signal raises KeyboardInterrupt, later ones wait for the end.

    Args:
        arguments: Command line with ROS arguments; by default the process's.

    Raises:
        ParameterError: A ROS argument is wrong, or ROS cannot run here.
    """
    end_with_ros2()
    with interrupt_once():
        # rclpy's own handlers would close the context under whoever is waiting in it.
        initialise(sys.argv if arguments is None else arguments)
        try:
            yield
        finally:
            rclpy.try_shutdown()


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Defer signals to the end of this block, within which they would be lost or leave work half done."""
    caught: list[int] = []
    with handle_signals(lambda number, _frame: caught.append(number)):
        yield
    if caught:
        signal.raise_signal(caught[0])


_STOP_S = 15.0
_FULL_BYTES = 1_000_000


class ProcessError(CtrlRlError):
    """A node cannot be started, or has ended by itself."""


def executable_path(spec: NodeSpec) -> Path:
    """Return the file that `ros2 run` would start.

    Raises:
        ProcessError: The package or executable is not built.
    """
    try:
        path = Path(get_package_prefix(spec.package)) / "lib" / spec.package / spec.executable
    except PackageNotFoundError:
        raise ProcessError(
            f"package '{spec.package}' is not built: run 'make build' and source the workspace"
        ) from None
    if not path.is_file():
        raise ProcessError(f"{path} is missing: run 'make build' again")
    return path


class Processes:
    """Running nodes; a context that ends them in the given order.

    They end with this process even if it is killed. Each node's output goes to `<folder>/<name>.log`.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._running: dict[str, subprocess.Popen[bytes]] = {}
        self._parameters = tempfile.TemporaryDirectory(prefix="ctrl_rl_")

    def start(self, specs: Iterable[NodeSpec]) -> None:
        """Start nodes.

        Raises:
            ProcessError: A node is not built.
        """
        for spec in specs:
            rules = [f"__ns:=/{spec.namespace}"] if spec.namespace else []
            rules += [f"{name}:={other}" for name, other in spec.remappings.items()]
            names = [part for rule in rules for part in ("-r", rule)]
            # An interruption between the start of a process and its entry here would leave it behind.
            with uninterrupted(), (self._folder / f"{spec.name}.log").open("ab") as log:
                self._running[spec.name] = start_child(
                    [executable_path(spec), "--ros-args", *names, "--params-file", self._parameter_file(spec)],
                    stdin=subprocess.DEVNULL,
                    stdout=log,
                    stderr=subprocess.STDOUT,
                    start_new_session=True,  # Ctrl-C in the terminal is ours to hand on, in order
                )

    def check(self) -> None:
        """Raise ProcessError, with its last log line, if a node has ended by itself."""
        for name, process in self._running.items():
            if process.poll() is not None:
                raise ProcessError(self._end_of(name, process.returncode))

    def stop(self, name: str) -> None:
        """Stop a node by SIGTERM and wait for it; kill it if it does not end.

        Raises:
            ProcessError: It had to be killed, or its exit code is not 0.
        """
        process = self._running.pop(name, None)
        if process is None:
            return
        process.terminate()
        try:
            code = process.wait(_STOP_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
            raise ProcessError(
                f"{name} did not stop within {_STOP_S:g} s and was killed: {self._last_words(name)}"
            ) from None
        if code != 0:
            raise ProcessError(self._end_of(name, code))

    def __enter__(self) -> Processes:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for process in self._running.values():
            process.terminate()
        for process in self._running.values():
            try:
                process.wait(_STOP_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        self._running.clear()
        self._parameters.cleanup()

    def _parameter_file(self, spec: NodeSpec) -> str:
        path = Path(self._parameters.name) / f"{spec.name}.yaml"
        path.write_text(yaml.safe_dump({"/**": {"ros__parameters": dict(spec.parameters)}}), encoding="utf-8")
        return str(path)

    def _end_of(self, name: str, code: int) -> str:
        if code < 0:
            return f"{name} was ended by {signal.Signals(-code).name}; see {self._folder / name}.log"
        return f"{name} ended with exit code {code}: {self._last_words(name)}"

    def _last_words(self, name: str) -> str:
        """Return the last error in a node's log, or its last line; on a full disk the log may lack both."""
        lines = (self._folder / f"{name}.log").read_text(errors="replace").strip().splitlines()
        own = f"{name.rpartition('.')[2]}: "  # what it ends for, before its publishers' last words
        errors = [line for line in lines if line.startswith(own) or "[ERROR]" in line or "[FATAL]" in line]
        words = (errors or lines or ["it said nothing"])[-1]
        if shutil.disk_usage(self._folder).free < _FULL_BYTES:
            return f"{words} (no space left on the disk of {self._folder})"
        return words
