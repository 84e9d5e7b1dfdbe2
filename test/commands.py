"""Commands of the suite, run to their end as `ros2 run` does."""

import os
import subprocess
import sys
from pathlib import Path

from ament_index_python.packages import get_package_prefix

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
EXAMPLES_OF_A_BAG = {
    "align_bag": ("sequence 0:",),
    "koopman_policy_from_bag": ("slowest poles", "policy.safetensors"),
}
"""Words that it prints and file that it writes, by the script that reads a bag."""


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


def check_example(name: str, folder: Path, words: str, *written: str, bag: Path | None = None) -> None:
    """Run a script of examples/ in `folder`; check that it prints `words` and writes the files `written`."""
    arguments = [EXAMPLES / f"{name}.py", *([bag] if bag else []), *written]
    answer = subprocess.run([sys.executable, *arguments], cwd=folder, capture_output=True, text=True, check=False)
    assert answer.returncode == 0, answer.stderr
    assert words in answer.stdout
    for file in written:
        assert (folder / file).stat().st_size > 1000
