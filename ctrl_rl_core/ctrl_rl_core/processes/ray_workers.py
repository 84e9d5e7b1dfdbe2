"""Runs jobs with their files on a Ray cluster; a job that loses its worker continues on another.

for answer in map_in_ray("auto", work, items, Job(folder, name)): ...

Every machine of the cluster needs the same packages: call `ray start` in a shell with the sourced workspace.
"""

from __future__ import annotations

import os
import socket
import sys
import threading
import uuid
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from queue import SimpleQueue
from tempfile import TemporaryDirectory
from typing import Any, TypeVar

from ctrl_rl_core.io.atomic_write import atomic_write
from ctrl_rl_core.io.file_checks import one_line
from ctrl_rl_core.processes.workers import WorkersError

Item = TypeVar("Item")
Answer = TypeVar("Answer")
Tell = Callable[[Any], None]
Files = dict[str, bytes | None]
"""Contents by path within a job's folder; None for a deleted file."""
_TICK = 1.0
_CONNECT_S = 10.0
_LOSSES = 5
"""Consecutive worker losses without a report after which the job itself is considered the cause."""


def map_in_ray(
    address: str,
    work: Callable[[Item, Path, Tell], Answer],
    items: Sequence[Item],
    folder: Path,
    name: Callable[[Item], str] = str,
    workers: int = 0,
    tell: Tell = lambda _: None,
    shared: bool | None = None,
) -> Iterator[Answer]:
    """Yield answers as they arrive, not in the order of the items.

    A job keeps its files in its own subfolder of the given folder. After each report the files are also on this
    machine; a job whose worker is lost restarts from them.

    Args:
        address: Address of the cluster, or "auto" for the one running on this machine.
        work: Function of an item, a folder and a report callback; workers import it by name.
        items: Jobs in the order in which they start.
        folder: Folder of all jobs on this machine.
        name: Returns the name of a job and of its folder.
        workers: Maximum number of concurrent jobs; 0 for one per processor of the cluster.
        tell: Receives the reports on this machine.
        shared: Whether workers see `folder` itself; detected by default. If not, files are transferred.

    Raises:
        WorkersError: Ray is missing, the cluster does not answer, or a job repeatedly lost its worker.
        Exception: Any exception of `work`; the other jobs are then dropped.
    """
    with _connected(address) as ray, _token(folder, shared) as token:
        job = ray.remote(_job)
        names = ("WorkerCrashedError", "NodeDiedError", "RaySystemError", "ObjectLostError", "OutOfMemoryError")
        lost = tuple(getattr(ray.exceptions, each) for each in names)
        waiting, losses = deque(items), dict.fromkeys(map(name, items), 0)
        running: dict[Any, Item] = {}
        while waiting or running:
            while waiting and (not workers or len(running) < workers):
                item = waiting.popleft()
                own = folder.resolve() / name(item)
                sent = None if shared else _contents(own)
                there = (str(folder.resolve()), token, name(item), sent, os.getcwd())
                how = {"num_cpus": 1, "max_retries": 0, "num_returns": "streaming", "name": name(item)}
                running[job.options(**how).remote(work, item, *there)] = item
            ready, _ = ray.wait(list(running), timeout=_TICK)
            for stream in ready:
                item = running[stream]
                try:
                    kind, said, files = ray.get(next(stream))
                except lost as error:
                    del running[stream]
                    losses[name(item)] += 1
                    if losses[name(item)] == _LOSSES:
                        raise WorkersError(f"{name(item)}: lost {_LOSSES} Ray workers in a row: {error}") from None
                    sys.stderr.write(f"{name(item)}: its Ray worker is lost, it continues on another one\n")
                    waiting.appendleft(item)
                    continue
                except ray.exceptions.RayTaskError as error:
                    raise _cause(error) from None
                _apply(folder / name(item), files)
                losses[name(item)] = 0
                if kind == "answer":
                    del running[stream]
                    yield said
                else:
                    tell(said)


def require_ray() -> Any:
    """Return the `ray` module.

    Raises:
        WorkersError: Ray is missing.
    """
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")  # keeps Ray from changing CUDA_VISIBLE_DEVICES
    try:
        import ray
    except ModuleNotFoundError:
        raise WorkersError(
            "--ray needs Ray: python -m pip install -r requirements/ray.txt, here and on workers"
        ) from None
    return ray


@contextmanager
def _connected(address: str) -> Iterator[Any]:
    """Connect to a cluster; on exit, all jobs of this process end there."""
    ray = require_ray()
    if ray.is_initialized():
        yield ray
        return
    try:
        host, _, port = address.rpartition(":")
        if host and port.isdigit() and "/" not in host:  # Ray itself would retry for minutes
            socket.create_connection((host.strip("[]"), int(port)), _CONNECT_S).close()
        ray.init(address=address, log_to_driver=False, logging_level="ERROR", configure_logging=True)
    except (ConnectionError, ValueError, RuntimeError, ImportError, OSError, OverflowError) as error:
        raise WorkersError(
            f"--ray {address}: no cluster answers ({one_line(error)}): start one with `ray start --head`"
        ) from None
    try:
        yield ray
    finally:
        ray.shutdown()


@contextmanager
def _token(folder: Path, shared: bool | None) -> Iterator[str | None]:
    """Place a marker file in a folder while jobs run, if needed to detect whether workers share that folder."""
    if shared is not None:
        yield None
        return
    folder.mkdir(parents=True, exist_ok=True)
    token = folder / f".ray-{uuid.uuid4().hex}.{os.getpid()}.tmp"
    token.touch()
    try:
        yield token.name
    finally:
        token.unlink(missing_ok=True)


def _cause(error: Any) -> Exception:
    cause = getattr(error, "cause", None)
    if isinstance(cause, ModuleNotFoundError):
        return WorkersError(f"a Ray worker lacks {cause.name}: run `ray start` in a shell with the sourced workspace")
    return cause if isinstance(cause, Exception) else WorkersError(str(error).strip().splitlines()[-1])


def _job(
    work: Callable[[Any, Path, Tell], Any],
    item: Any,
    folder: str,
    token: str | None,
    name: str,
    files: Files | None,
    working_folder: str,
) -> Iterator[tuple[str, Any, Files]]:
    """Run a job on a worker; yield its reports and finally its answer, each with the files changed before it."""
    if Path(working_folder).is_dir():
        os.chdir(working_folder)
    if files is None or (token is not None and (Path(folder) / token).exists()):
        yield from _said(work, item, Path(folder), dict)
        return
    with TemporaryDirectory(prefix="ctrl_rl-") as temporary:
        own = Path(temporary) / name
        _apply(own, files)
        yield from _said(work, item, Path(temporary), _Changes(own))


def _said(
    work: Callable[[Any, Path, Tell], Any], item: Any, folder: Path, changes: Callable[[], Files]
) -> Iterator[tuple[str, Any, Files]]:
    """Yield a job's reports while it works in its own thread."""
    heard: SimpleQueue[tuple[str, Any, Files]] = SimpleQueue()

    def run() -> None:
        try:
            answer = work(item, folder, lambda report: heard.put(("report", report, changes())))
            heard.put(("answer", answer, changes()))
        except BaseException as error:  # raised again by the receiver
            heard.put(("error", error, {}))

    threading.Thread(target=run, daemon=True).start()
    while True:
        kind, said, files = heard.get()
        if kind == "error":
            raise said
        yield kind, said, files
        if kind == "answer":
            return


class _Changes:
    """Tracks the files of a folder that have changed since the last call."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._known = self._stamps()

    def _stamps(self) -> dict[str, tuple[int, int]]:
        stats = {path: path.stat() for path in _files(self._folder)}
        return {str(path.relative_to(self._folder)): (each.st_mtime_ns, each.st_ino) for path, each in stats.items()}

    def __call__(self) -> Files:
        before, self._known = self._known, self._stamps()
        out: Files = {path: None for path in before if path not in self._known}
        changed = [path for path, stamp in self._known.items() if before.get(path) != stamp]
        return out | {path: (self._folder / path).read_bytes() for path in changed}


def _files(folder: Path) -> list[Path]:
    return [path for path in sorted(folder.rglob("*")) if path.is_file()]


def _contents(folder: Path) -> Files:
    return {str(path.relative_to(folder)): path.read_bytes() for path in _files(folder)}


def _apply(folder: Path, files: Files) -> None:
    """Make a folder match another one; progress files are written after the files they refer to."""
    last = ("checkpoint.safetensors", "result.json")
    for path, content in sorted(files.items(), key=lambda each: (each[1] is None, each[0] in last, each[0])):
        if content is None:
            (folder / path).unlink(missing_ok=True)
        else:
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            atomic_write(folder / path, content)
