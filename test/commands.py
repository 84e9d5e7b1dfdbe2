"""Commands of the suite, run to their end as `ros2 run` does."""

import os
import subprocess
from pathlib import Path

from ament_index_python.packages import get_package_prefix


def command(executable: str, *arguments: object, package: str = "ctrl_rl_bringup") -> subprocess.CompletedProcess[str]:
    """Run one and return what it said."""
    path = Path(get_package_prefix(package)) / "lib" / package / executable
    return subprocess.run(
        [path, *map(str, arguments)], capture_output=True, text=True, env=os.environ, timeout=280, check=False
    )


def check_refused(words: str, executable: str, *arguments: object) -> None:
    """Check that a command says in one line what is wrong, and ends with 2."""
    answer = command(executable, *arguments)
    assert answer.returncode == 2, answer.stdout
    (line,) = answer.stderr.splitlines()
    assert line.startswith(f"{executable}: ")
    assert words in line
