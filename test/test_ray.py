"""Runs on a Ray cluster end as in local processes, even when a worker is killed; without Ray one line says so."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ctrl_rl_core.processes import map_in_ray
from ctrl_rl_learning.study import RunOptions, run_experiments
from option_coordinator.training import OptionRun, option_runs

from ctrl_rl_core import WorkersError, load_navigation_task
from oc_baseline_node import DataSettings, formulate, make_data

RUNS = option_runs("tool_delivery", ["async", "mac_dqn"], 4)
LIMIT = 200.0
needs_ray = pytest.mark.skipif(find_spec("ray") is None, reason="Ray is not installed")


@pytest.fixture(scope="module")
def cluster() -> Iterator[str]:
    """Give the address of a cluster of two machines, as far as Ray can tell, of one processor each."""
    from ray.cluster_utils import Cluster

    memory = 100 * 2**20
    paths = {"env_vars": {"PYTHONPATH": os.pathsep.join(filter(None, sys.path)), "OMP_NUM_THREADS": "1"}}
    os.environ |= paths["env_vars"]
    made = Cluster(True, head_node_args={"num_cpus": 1, "object_store_memory": memory, "include_dashboard": False})
    try:
        made.add_node(num_cpus=1, object_store_memory=memory)
        yield made.address
    finally:
        made.shutdown()


@pytest.fixture(scope="module")
def local(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give the folder of the runs as processes of this machine learn them."""
    folder = tmp_path_factory.mktemp("local")
    run_experiments(RUNS, how(folder), 2)
    return folder


def how(folder: Path) -> RunOptions:
    return RunOptions(folder, 4, 400, final_evaluations=1)


def learnt(folder: Path, run: OptionRun) -> tuple[Any, bytes]:
    result = json.loads((folder / run.name / "result.json").read_text())
    result.pop("sha256", None)
    for measured in (result, *result["curve"]):
        measured.pop("seconds", None)
        measured.pop("cpu_seconds", None)
    return result, (folder / run.name / "policy.safetensors").read_bytes()


def workers_of(name: str) -> list[int]:
    """Return the processes in which Ray works on a run; Ray names them by it."""
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        try:
            title = (process / "cmdline").read_bytes()
        except OSError:
            continue
        if title.startswith(b"ray::") and name.encode() in title:
            found.append(int(process.name))
    return found


@needs_ray
@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("shared", [True, False])
def test_eight_runs_end_alike_though_a_worker_is_killed(
    cluster: str, local: Path, tmp_path: Path, shared: bool
) -> None:
    program = (
        "import sys, functools; from pathlib import Path\n"
        "from ctrl_rl_learning.study import RunOptions, run_experiments\n"
        "from option_coordinator.training import option_runs\n"
        "matrix = sys.modules[run_experiments.__module__]\n"
        "matrix.map_in_ray = functools.partial(matrix.map_in_ray, shared=sys.argv[3] == 'True')\n"
        "runs = option_runs('tool_delivery', ['async', 'mac_dqn'], 4)\n"
        "run_experiments(runs, RunOptions(Path(sys.argv[1]), 4, 400, 0, 1), ray=sys.argv[2])\n"
    )
    begun = subprocess.Popen(
        [sys.executable, "-c", program, str(tmp_path), cluster, str(shared)], stderr=subprocess.PIPE, text=True
    )
    deadline, victim = time.monotonic() + LIMIT, None
    while victim is None:
        assert begun.poll() is None, begun.communicate()[1]
        assert time.monotonic() < deadline, "no run ever had a checkpoint"
        for run in RUNS:
            own = tmp_path / run.name
            if (own / "checkpoint.safetensors").exists() and (found := workers_of(run.name)):
                os.kill(found[0], signal.SIGKILL)
                victim = run
                break
        time.sleep(0.01)
    _, said = begun.communicate(timeout=LIMIT)
    assert begun.returncode == 0, said
    assert f"{victim.name}: its Ray worker is lost" in said
    for run in RUNS:
        assert learnt(tmp_path, run) == learnt(local, run)
    assert not list(tmp_path.glob(".ray-*"))


@needs_ray
@pytest.mark.slow
def test_value_data_are_those_of_local_processes(cluster: str, tmp_path: Path) -> None:
    problem, settings = formulate(load_navigation_task("car_navigation")), DataSettings(4, chunk=2)
    spread, *_ = make_data(problem, settings, tmp_path / "spread", progress=False, ray=cluster)
    here, *_ = make_data(problem, settings, tmp_path / "here", progress=False)
    assert np.array_equal(spread.states, here.states)
    assert np.array_equal(spread.controls, here.controls)
    assert not list((tmp_path / "spread").glob(".ray-*"))


def refuse(item: int, *_: object) -> int:
    raise ValueError(f"{item} is refused")


@needs_ray
@pytest.mark.slow
def test_what_a_job_raises_is_raised_here(cluster: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="3 is refused"):
        list(map_in_ray(cluster, refuse, [3], tmp_path))


@needs_ray
@pytest.mark.slow
def test_a_cluster_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(WorkersError, match=r"--ray 127\.0\.0\.1:1: no cluster answers"):
        list(map_in_ray("127.0.0.1:1", refuse, [3], tmp_path))


def test_without_ray_one_line_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(WorkersError, match=r"--ray needs Ray: python -m pip install -r requirements/ray\.txt"):
        list(map_in_ray("auto", refuse, [3], tmp_path))
