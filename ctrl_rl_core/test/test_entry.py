"""The common entry point: signals at any time, closed and full outputs, unexpected errors, cached help pages."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from ctrl_rl_core.processes.signals import STOP_SIGNALS

pytestmark = pytest.mark.fault
WORK = {
    "imports": "import time\nprint('ready', flush=True)\ntime.sleep(100)",
    "works": "def work():\n    import time\n    print('ready', flush=True)\n    time.sleep(100)",
    "turns_it_into_another_error": """def work():
    import time
    print('ready', flush=True)
    try:
        time.sleep(100)
    except KeyboardInterrupt:
        raise RuntimeError('Unable to convert call argument') from None""",
    "loses_it_in_a_finaliser": """import time
class Slow:
    def __del__(self):
        print('ready', flush=True)
        time.sleep(1000)
def work():
    slow = Slow()
    del slow
    time.sleep(1000)""",
    "ends_slowly": """import time
class Slow:
    def __init__(self):
        self.sleep, self.print = time.sleep, print
    def __del__(self):
        self.print('ready', flush=True)
        self.sleep(1.0)
slow = Slow()
def work():
    return 2""",
    "fails": "def work():\n    return {}['nothing']",
    "prints": "def work():\n    print('words', flush=False)\n    return 0",
    "prints_much": "def work():\n    for _ in range(100_000):\n        print('words')\n    return 0",
}


class Executables:
    """Executables in a folder, implemented in a package of their own."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.package = folder, folder / "ctrl_rl_tried"
        self.package.mkdir()
        (self.package / "__init__.py").touch()
        self.environment = os.environ | {"PYTHONPATH": f"{folder}:{os.environ.get('PYTHONPATH', '')}"}
        (folder / "cache").mkdir()
        self.environment |= {"XDG_CACHE_HOME": str(folder / "cache")}

    def make(self, name: str, code: str, door: str = "command", run_command: bool = True) -> Path:
        """Create an executable."""
        if run_command and "def work" in code:
            code += "\nfrom ctrl_rl_core.command import run_command\ndef run():\n    return run_command('try', work)\n"
        else:
            code = code.replace("def work", "def run")
        (self.package / f"{name}.py").write_text(code)
        file = self.folder / name
        file.write_text(
            f"import sys\nfrom ctrl_rl_core.entry import {door}\nsys.exit({door}.ctrl_rl_tried.{name}.run())"
        )
        return file

    def start(self, file: Path, *words: str, **options: object) -> "subprocess.Popen[str]":
        """Start an executable."""
        pipe = subprocess.PIPE
        given = {"stdout": pipe, "stderr": pipe, "env": self.environment} | options
        return subprocess.Popen([sys.executable, file, *words], text=True, **given)  # type: ignore[call-overload,no-any-return]


@pytest.fixture
def executables(tmp_path: Path) -> Executables:
    return Executables(tmp_path)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT, signal.SIGUSR1])
@pytest.mark.parametrize("moment", ["imports", "works", "turns_it_into_another_error", "loses_it_in_a_finaliser"])
def test_a_command_that_is_interrupted_ends_with_130_and_one_line(
    executables: Executables, moment: str, number: int
) -> None:
    process = executables.start(executables.make(moment, WORK[moment]))
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    process.send_signal(number)
    _, errors = process.communicate(timeout=120.0)
    assert process.returncode == 130, errors
    assert [line.partition(": ")[2] for line in errors.splitlines()] == ["interrupted"]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGHUP, STOP_SIGNALS[-1]])
def test_a_signal_during_the_interpreters_last_clean_up_changes_nothing(executables: Executables, number: int) -> None:
    process = executables.start(executables.make("ends_slowly", WORK["ends_slowly"]))
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    process.send_signal(number)
    _, errors = process.communicate(timeout=120.0)
    assert (process.returncode, errors) == (2, "")


def test_a_node_that_is_interrupted_while_it_imports_ends_in_good_order(executables: Executables) -> None:
    process = executables.start(executables.make("imports", WORK["imports"], "node"))
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    process.send_signal(signal.SIGTERM)
    _, errors = process.communicate(timeout=120.0)
    assert (process.returncode, errors) == (0, "")


def test_all_signals_that_end_processes_are_caught_from_the_first_import_on(executables: Executables) -> None:
    process = executables.start(executables.make("imports", WORK["imports"]))
    assert process.stdout is not None
    process.stdout.readline()
    lines = Path(f"/proc/{process.pid}/status").read_text().splitlines()
    caught = next(int(line.split()[1], 16) for line in lines if line.startswith("SigCgt"))
    process.kill()
    process.communicate()
    assert [number for number in STOP_SIGNALS if not caught >> (number - 1) & 1] == []


@pytest.mark.parametrize("output", ["closed", "full", "pipe"])
@pytest.mark.parametrize("name", ["prints", "prints_much"])
@pytest.mark.parametrize("run_command", [True, False])
def test_an_output_that_takes_nothing_is_no_traceback(
    executables: Executables, name: str, output: str, run_command: bool
) -> None:
    file = executables.make(name, WORK[name], run_command=run_command)
    way = {"closed": '"$@" >&-', "full": '"$@" >/dev/full', "pipe": '(sleep 1; "$@"; echo $? >code) | true'}[output]
    answer = subprocess.run(
        ["bash", "-c", way, "bash", sys.executable, file],
        env=executables.environment,
        cwd=executables.folder,
        capture_output=True,
        text=True,
        check=False,
    )
    code = int((executables.folder / "code").read_text()) if output == "pipe" else answer.returncode
    assert code == (1 if output == "full" else 0), answer.stderr
    assert len(answer.stderr.splitlines()) == (output == "full"), answer.stderr
    assert "No space left" in answer.stderr or output != "full"


def test_a_fault_of_the_program_is_one_line_and_a_traceback_where_it_is_wanted(executables: Executables) -> None:
    file = executables.make("fails", WORK["fails"])
    process = executables.start(file)
    _, errors = process.communicate(timeout=120.0)
    (line,) = errors.splitlines()
    assert process.returncode == 1
    assert line.startswith("fails: failed unexpectedly at fails.py:2: KeyError: 'nothing'")
    wanted = executables.start(file, env=executables.environment | {"PYTHONDEVMODE": "1"})
    assert "Traceback" in wanted.communicate(timeout=120.0)[1]


def test_a_page_of_help_is_kept_until_a_file_of_the_package_changes(executables: Executables) -> None:
    code = "def work():\n    print('usage: {}')\n    return 0\nimport sys\nsys.stderr.write('imported ')\n"
    file = executables.make("helps", code.format("old"))

    def said() -> tuple[str, str]:
        out, errors = executables.start(file, "--help").communicate(timeout=120.0)
        return out.strip(), errors.strip()

    assert said() == ("usage: old", "imported")
    assert said() == ("usage: old", "")
    time.sleep(0.05)
    # Of another length: Python takes a file of the same second and size for the one that it has compiled.
    executables.make("helps", code.format("newer"))
    assert said() == ("usage: newer", "imported")
    assert said() == ("usage: newer", "")
    for page in (executables.folder / "cache").rglob("*.json"):
        page.write_text("{")
    assert said() == ("usage: newer", "imported")
