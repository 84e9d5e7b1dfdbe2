"""What tests share: nodes in a domain of their own that end with the test, runs that are cut off, a real drive."""

import json
import os
import pickle
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

sys.path.insert(0, str(Path(__file__).parent / "test"))  # parts that tests of all packages use lie there

import durations
from forked_workers import pytest_xdist_setupnodes as pytest_xdist_setupnodes
from preloaded import Preloaded

ROOT = Path(__file__).parent

# Property tests draw the same examples each time; `make attack` has others (--hypothesis-profile anew).
settings.register_profile("same", derandomize=True, database=None)
settings.register_profile("anew", database=None)
settings.load_profile("same")

# Before any test imports rclpy. Domains up to 101 are safe on every system; one per test process keeps them apart.
os.environ["ROS_DOMAIN_ID"] = str(1 + os.getpid() % 100)
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
# Before any test imports NumPy or torch. Test processes run side by side: more threads get into each other's way.
os.environ.setdefault("OMP_NUM_THREADS", "1")
# A shell that starts the tests in the background lets SIGINT be ignored, and whatever they start inherits that.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

_GOODBYE_S = 0.1
"""Until a test's own node has heard that the others are gone: the middleware may crash where it is to end meanwhile."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option that keeps what files take."""
    parser.addoption("--record-durations", action="store_true", help="keep what files take, to order later runs")


def pytest_configure(config: pytest.Config) -> None:
    """Record durations where asked to, but not in each of the processes that run tests side by side."""
    if config.getoption("--record-durations") and not hasattr(config, "workerinput"):
        config.pluginmanager.register(durations.Recorder())


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Bring the longest files first; processes take whole files, in this order."""
    durations.longest_first(items)


class NodeProcess:
    """A node: the executable that `ros2 run` starts, in a process that has its imports, or in one that begins anew."""

    def __init__(self, package: str, executable: str, arguments: tuple[str, ...], log: Path, anew: bool) -> None:
        from ament_index_python.packages import get_package_prefix

        self._log = log
        path = Path(get_package_prefix(package)) / "lib" / package / executable
        with log.open("wb") as stream:
            start = subprocess.Popen if anew else Preloaded
            self.process = start([path, *arguments], stdout=stream, stderr=subprocess.STDOUT)

    @property
    def output(self) -> str:
        """What it has said so far, the middleware's own complaints left out."""
        return self._log.read_text(errors="replace")

    def wait_for(self, words: str, timeout: float = 120.0) -> None:
        """Return once it has said `words`."""
        deadline = time.monotonic() + timeout
        while words not in self.output:
            assert self.process.poll() is None, f"ended with {self.process.returncode}: {self.output}"
            assert time.monotonic() < deadline, f"never said '{words}': {self.output}"
            time.sleep(0.02)

    def stop(self, number: int = signal.SIGINT, timeout: float = 120.0) -> tuple[int, float]:
        """Send a signal and return exit code and how long it took to end [s]."""
        begin = time.monotonic()
        self.process.send_signal(number)
        code = self.process.wait(timeout)
        return code, time.monotonic() - begin

    def end(self) -> None:
        """See to it that it has ended, in good order where it still can."""
        if self.process.poll() is None:
            try:
                self.stop()
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()


def _nodes(folder: Path) -> Iterator[Callable[..., NodeProcess]]:
    started: list[NodeProcess] = []

    def run(
        package: str,
        executable: str,
        *parameters: str,
        remap: tuple[str, ...] = (),
        params_file: Path | None = None,
        anew: bool = False,
        words: tuple[str, ...] = (),
    ) -> NodeProcess:
        options = [part for parameter in parameters for part in ("-p", parameter)]
        options += [part for rule in remap for part in ("-r", rule)]
        options += ["--params-file", str(params_file)] if params_file else []
        arguments = (*words, *(("--ros-args", *options) if options else ()))
        node = NodeProcess(package, executable, arguments, folder / f"{len(started)}-{executable}.log", anew)
        started.append(node)
        return node

    yield run
    for node in started:
        node.end()
    time.sleep(_GOODBYE_S)


@pytest.fixture(scope="module")
def _no_shared_memory() -> Iterator[None]:
    """Let nodes speak UDP over the loopback interface: who shares memory with a killed process may be deaf afterwards.

    With the range LOCALHOST rmw_fastrtps shares memory whatever it is told.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")
        patch.setenv("FASTRTPS_DEFAULT_PROFILES_FILE", str(ROOT / "test" / "loopback_udp.xml"))
        yield


@pytest.fixture
def run_node(tmp_path: Path) -> Iterator[Callable[..., NodeProcess]]:
    """Give a function that starts a node of a package by executable, parameters ("speed:=1.0") and remappings."""
    yield from _nodes(tmp_path)


@pytest.fixture(scope="module")
def run_shared_node(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[..., NodeProcess]]:
    """Give the same for nodes that the tests of a module share."""
    yield from _nodes(tmp_path_factory.mktemp("nodes"))


@pytest.fixture
def start() -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Give a function that starts Python with some arguments; the processes that are left end with the test."""
    processes: list[subprocess.Popen[str]] = []

    def run(*arguments: object) -> subprocess.Popen[str]:
        pipe = subprocess.PIPE
        command = [sys.executable, *map(str, arguments)]
        processes.append(subprocess.Popen(command, text=True, stdin=pipe, stdout=pipe, stderr=pipe))
        return processes[-1]

    yield run
    for process in processes:
        process.kill()
        process.communicate()


IN_TURN = """
import importlib, json, os, sys, tempfile
module, cases = sys.argv[1], json.loads(sys.argv[2])
main, ends = importlib.import_module(module).main, []
for case in cases:
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        sys.argv, kept = [module, *case], [os.dup(1), os.dup(2)]
        for stream, number in ((out, 1), (err, 2)):
            os.dup2(stream.fileno(), number)
        try:
            code = main()
        except SystemExit as error:
            code = error.code
        finally:
            sys.stdout.flush()
            sys.stderr.flush()
            for old, number in zip(kept, (1, 2)):
                os.dup2(old, number)
                os.close(old)
        said = []
        for stream in (err, out):
            stream.seek(0)
            said.append(stream.read().decode())
        ends.append((code, *said))
print(json.dumps(ends))
"""


def call_in_turn(module: str, cases: list[list[str]], memory: int | None = None) -> list[tuple[int, str, str]]:
    """Call a command's `main` with one list of arguments after the other, in one process that starts once.

    Args:
        module: Module of the command.
        cases: Arguments of each call.
        memory: Address space that the process may have [bytes]; None for any.

    Returns:
        Exit code, errors and output of each call.
    """
    limit = (lambda: resource.setrlimit(resource.RLIMIT_AS, (memory, memory))) if memory else None
    command = [sys.executable, "-c", IN_TURN, module, json.dumps(cases)]
    answer = subprocess.run(command, capture_output=True, text=True, check=False, timeout=600, preexec_fn=limit)
    assert answer.returncode == 0, answer.stderr
    return [(code, errors, output) for code, errors, output in json.loads(answer.stdout.splitlines()[-1])]


@pytest.fixture(scope="session")
def in_turn() -> Callable[..., list[tuple[int, str, str]]]:
    """Give `call_in_turn`."""
    return call_in_turn


class CutOffError(Exception):
    """Stands for a kill between two iterations."""


@pytest.fixture
def cut_off() -> Callable[[Callable[..., Any], Any, Any], None]:
    """Give a function that lets `train(run, options, report)` learn one iteration and no more."""

    def killed(*_: object) -> None:
        raise CutOffError

    def learn(train: Callable[..., Any], run: Any, options: Any) -> None:
        with pytest.raises(CutOffError):
            train(run, options, killed)
        assert not (options.folder / run.name / "result.json").exists()

    return learn


@pytest.fixture(scope="module")
def runs_here() -> Iterator[None]:
    """Let commands train in this process; that runs get through to others is shown by ctrl_rl_learning's tests."""
    from ctrl_rl_learning.study import train

    def train_all(todo: list[Any], options: Any, *_: object) -> None:
        for run in todo:
            train(pickle.loads(pickle.dumps(run)), options)  # noqa: S301 as a worker gets it

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("ctrl_rl_learning.study.matrix._in_processes", train_all)
        yield


@pytest.fixture
def update_every(monkeypatch: pytest.MonkeyPatch) -> Callable[[int], None]:
    """Give a function that lets PPO and TRPO update after some samples instead of thousands."""
    return lambda samples: monkeypatch.setattr("ctrl_rl_learning.sb3.algorithms.ROLL_OUT", samples)


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> dict[str, list[str]]:
    """Give the faults of each picture that is written while the test runs, by its title."""
    from matplotlib.figure import Figure
    from picture_faults import faults_of

    found: dict[str, list[str]] = {}
    write = Figure.savefig

    def savefig(figure: Figure, file: Any, **options: Any) -> None:
        write(figure, file, **options)
        found[f"{len(found)}: {figure.get_suptitle()}"] = faults_of(figure)

    monkeypatch.setattr(Figure, "savefig", savefig)
    return found


@pytest.fixture
def check_resuming(tmp_path: Path) -> Callable[..., Path]:
    """Give a function that checks that a run ends alike from what a kill after an iteration leaves, and where."""
    from ctrl_rl_core.io import read_json

    def learnt(folder: Path) -> tuple[Any, bytes]:
        result = read_json(folder / "result.json")  # without its digest, which is of the times too
        for measured in (result, *result["curve"]):
            for name in ("seconds", "cpu_seconds"):
                measured.pop(name, None)
        return result, (folder / "policy.safetensors").read_bytes()

    def check(train: Callable[..., Any], run: Any, options: Callable[[Path], Any]) -> Path:
        resumed, whole = tmp_path / "resumed", tmp_path / "whole"

        def keep(*_: object) -> None:
            if not resumed.exists():
                assert any((whole / run.name).glob("checkpoint*"))
                shutil.copytree(whole, resumed)

        train(run, options(whole), keep)
        assert not (resumed / run.name / "result.json").exists()
        train(run, options(resumed))
        assert learnt(resumed / run.name) == learnt(whole / run.name)
        return resumed / run.name

    return check


@pytest.fixture(scope="session")
def real_drive() -> Path:
    """Give a recording of a real TurtleBot 4, which lies beside the repository on some machines only."""
    folder = ROOT.parent / "shared" / "data" / "tb4_office"
    if not folder.is_dir():
        pytest.skip("the recording is not on this machine")
    return folder
