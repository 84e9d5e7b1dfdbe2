"""Each executable of the workspace answers --help without the libraries that only its work needs."""

import subprocess
import sys
from pathlib import Path

import pytest
from ament_index_python.packages import get_package_prefix

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts" / "reference"))
from workspace import Executable, executables

HEAVY = ("numpy", "numba", "scipy", "torch", "rclpy", "tyro", "matplotlib", "pybullet", "casadi")
LARGEST_MB = 60.0
MEASURE = """
import resource, subprocess, sys
subprocess.run([sys.argv[1], "--help"], stdout=subprocess.DEVNULL, check=True)
print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024.0)
"""
"""In a process of its own: a child begins with the memory of the process that forks it, and this one is large."""


@pytest.mark.parametrize("executable", list(executables()), ids=lambda each: f"{each.package}-{each.name}")
def test_help_is_quick_and_small(executable: Executable) -> None:
    """`make bench` measures the seconds; what would take them is counted here."""
    file = Path(get_package_prefix(executable.package)) / "lib" / executable.package / executable.name
    first = subprocess.run([file, "--help"], capture_output=True, text=True, check=True).stdout
    command = [sys.executable, "-X", "importtime", file, "--help"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        out, imports = process.communicate()
    assert (process.returncode, out) == (0, first)
    assert first.startswith("usage:")
    names = {line.rpartition("|")[2].strip().partition(".")[0] for line in imports.splitlines()}
    assert not names.intersection(HEAVY)
    measure = subprocess.run([sys.executable, "-c", MEASURE, file], capture_output=True, text=True, check=True)
    assert float(measure.stdout) < LARGEST_MB
