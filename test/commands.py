"""Commands of the suite, run to their end as `ros2 run` does."""

import os
import subprocess
from pathlib import Path

from ament_index_python.packages import get_package_prefix


def start(executable: str, *arguments: object, package: str = "ctrl_rl_bringup") -> subprocess.Popen[str]:
    """Start one; its output comes on pipes."""
    path = Path(get_package_prefix(package)) / "lib" / package / executable
    pipe = subprocess.PIPE
    return subprocess.Popen([path, *map(str, arguments)], stdout=pipe, stderr=pipe, text=True, env=os.environ)


def command(executable: str, *arguments: object, package: str = "ctrl_rl_bringup") -> subprocess.CompletedProcess[str]:
    """Run one and return what it said."""
    process = start(executable, *arguments, package=package)
    try:
        out, errors = process.communicate(timeout=280)
    finally:
        process.kill()
    return subprocess.CompletedProcess(process.args, process.returncode, out, errors)


def check_refused(words: str, executable: str, *arguments: object) -> None:
    """Check that a command says in one line what is wrong, and ends with 2."""
    answer = command(executable, *arguments)
    assert answer.returncode == 2, answer.stdout
    (line,) = answer.stderr.splitlines()
    assert line.startswith(f"{executable}: ")
    assert words in line
