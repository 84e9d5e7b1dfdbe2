"""A thing that is run, and the digests of what it leaves."""

from __future__ import annotations

import os
import shlex
import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from ament_index_python.packages import get_package_prefix
from digests import Parts, array_parts, bag_parts, json_parts, printed_parts, tensor_parts

ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
_LIMIT_S = 1800.0
_TIMES = r"CPU|seconds| ms\b|this run"
"""Printed lines that depend on the machine."""


class BehaviourError(Exception):
    """A thing could not be run, or did not leave what it should."""


@dataclass(frozen=True)
class Case:
    """A thing that is run once.

    Attributes:
        name: Its name, with which its lines begin.
        command: A command line, as after `ros2 run`; empty where `work` is given.
        outputs: Files that it leaves (.safetensors, .json, .npz; a bag's folder with / at the end); * matches.
        after: Names of the cases whose outputs it needs.
        printed: Whether the numbers that it prints count.
        work: What is done in place of a command, in a folder; returns the parts of each line.
    """

    name: str
    command: str = ""
    outputs: tuple[str, ...] = ()
    after: tuple[str, ...] = ()
    printed: bool = False
    work: Callable[[Path], dict[str, Parts]] | None = None

    def run(self, folder: Path) -> dict[str, Parts]:
        """Run it in a folder and return the parts of each of its lines.

        Raises:
            BehaviourError: it failed, or did not leave what it should.
        """
        if self.work is not None:
            return {f"{self.name}{'.' * bool(line)}{line}": parts for line, parts in self.work(folder).items()}
        said = run_command(self.command, folder)
        lines: dict[str, Parts] = {self.name: printed_parts(said, _TIMES) if self.printed else {}}
        for pattern in self.outputs:
            for name, (measured, described) in _of_files(folder, pattern).items():
                lines[self.name] |= {f"{name}:{part}": digest for part, digest in measured.items()}
                header = lines.setdefault(f"{self.name}.header", {})
                header |= {f"{name}:{part}": digest for part, digest in described.items()}
        return {name: parts for name, parts in lines.items() if parts}


def run_command(command: str, folder: Path) -> str:
    """Run a command of the workspace in a folder, on one thread, and return what it prints.

    Raises:
        BehaviourError: it is not built, or it failed.
    """
    package, executable, *arguments = shlex.split(command)
    given = [found for argument in arguments for found in _expanded(folder, argument)]
    answer = subprocess.run(
        [executable_path(package, executable), *given],
        cwd=folder, env=os.environ | ONE_THREAD, capture_output=True, text=True, timeout=_LIMIT_S, check=False,
    )  # fmt: skip
    if answer.returncode != 0:
        raise BehaviourError(f"{command}: ended with {answer.returncode}: {answer.stderr.strip()[-500:]}")
    return answer.stdout


def executable_path(package: str, executable: str) -> Path:
    """Return the file that `ros2 run` starts.

    Raises:
        BehaviourError: it is not built.
    """
    path = Path(get_package_prefix(package)) / "lib" / package / executable
    if not path.is_file():
        raise BehaviourError(f"package {package} has no executable {executable}: build it, or adapt commands.py")
    return path


def _expanded(folder: Path, argument: str) -> list[str]:
    if "*" not in argument:
        return [argument]
    found = sorted(str(path.relative_to(folder)) for path in folder.glob(argument))
    if not found:
        raise BehaviourError(f"nothing matches {argument}: adapt commands.py")
    return found


def _of_files(folder: Path, pattern: str) -> dict[str, tuple[Parts, Parts]]:
    """Return (measured, described) of the files that match; several are told apart by their folder's name."""
    found = sorted(folder.glob(pattern.rstrip("/")))
    if not found:
        raise BehaviourError(f"no file {pattern} was left: adapt commands.py")
    several = len({path.parent for path in found}) > 1
    return {f"{path.parent.name}/{path.name}" if several else path.name: _of_file(path) for path in found}


def _of_file(path: Path) -> tuple[Parts, Parts]:
    if path.is_dir():
        return bag_parts(path)
    if path.suffix == ".npz":
        return array_parts(path), {}
    return tensor_parts(path) if path.suffix == ".safetensors" else json_parts(path)
