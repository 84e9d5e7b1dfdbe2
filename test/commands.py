"""Commands of the suite, run to their end as `ros2 run` does."""

import subprocess
import sys
from pathlib import Path

from ament_index_python.packages import get_package_prefix
from preloaded import Preloaded

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
    return Preloaded([path, *map(str, arguments)], stdout=pipe, stderr=pipe, text=True)


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
    pipe = subprocess.PIPE
    process = Preloaded([sys.executable, *arguments], cwd=folder, stdout=pipe, stderr=pipe, text=True)
    out, errors = process.communicate(timeout=280)
    assert process.returncode == 0, errors
    assert words in out
    for file in written:
        assert (folder / file).stat().st_size > 1000
