"""Nodes as processes: started, watched, ended in order."""

import shutil
import time
from dataclasses import replace
from pathlib import Path

import pytest
from ctrl_rl_bringup.runner.processes import ProcessError, Processes, executable_path
from ctrl_rl_bringup.runner.stack import NodeSpec, controller, recorder, scripted_driver

from ctrl_rl_bringup import DriveConfig
from ctrl_rl_core import task_file


def wait_until(said: Path, words: str) -> None:
    deadline = time.monotonic() + 120.0
    while words not in said.read_text():
        assert time.monotonic() < deadline, said.read_text()
        time.sleep(0.05)


def test_a_node_gets_its_parameters_and_ends_when_told(tmp_path: Path) -> None:
    with Processes(tmp_path) as processes:
        processes.start([controller(DriveConfig(tmp_path))])
        wait_until(tmp_path / "controller.log", "policy curved_corridor.safetensors")
        processes.check()
        processes.stop("controller")
        processes.stop("controller")  # it is gone already: nothing to do


def test_a_node_that_ends_by_itself_is_found_with_its_last_words(tmp_path: Path) -> None:
    with Processes(tmp_path) as processes:
        processes.start([NodeSpec("koopman_lqr_controller", "controller", {"policy": "nowhere"})])
        wait_until(tmp_path / "controller.log", "no policy 'nowhere'")
        processes._running["controller"].wait(120.0)
        with pytest.raises(ProcessError, match=r"controller ended with exit code 1: .*no policy 'nowhere'"):
            processes.check()


@pytest.mark.fault
def test_a_full_disk_is_the_reason_that_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The recorder stops while there is space for the end of its bag; its last line is not its reason."""
    spec = recorder(DriveConfig(tmp_path), {"task": task_file("curved_corridor")})
    spec = replace(spec, parameters={**spec.parameters, "min_free_mb": 1_000_000})

    def run() -> None:
        with Processes(tmp_path) as processes:
            processes.start([spec])
            deadline = time.monotonic() + 120.0
            while time.monotonic() < deadline:
                processes.check()
                time.sleep(0.05)

    with pytest.raises(ProcessError, match=r"recorder ended with exit code 1: .*left on the disk"):
        run()
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr(shutil, "disk_usage", lambda _folder: usage._replace(free=4096))
    with pytest.raises(ProcessError, match=f"no space left on the disk of {tmp_path}"):
        run()


def test_leaves_none_behind_when_the_work_fails(tmp_path: Path) -> None:
    running = []

    def work() -> None:
        with Processes(tmp_path) as processes:
            processes.start([scripted_driver(0), controller(DriveConfig(tmp_path))])
            running.extend(processes._running.values())
            raise RuntimeError("on purpose")

    with pytest.raises(RuntimeError, match="on purpose"):
        work()
    assert len(running) == 2
    assert all(process.poll() is not None for process in running)


def test_says_what_is_not_built() -> None:
    with pytest.raises(ProcessError, match="package 'nowhere' is not built: run 'make build'"):
        executable_path(NodeSpec("nowhere", "node"))
    with pytest.raises(ProcessError, match="is missing: run 'make build' again"):
        executable_path(NodeSpec("sim_bridge", "nothing"))
