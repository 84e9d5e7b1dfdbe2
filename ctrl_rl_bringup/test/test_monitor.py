"""A drive begins when every node has spoken, not when its publishers are there, in any namespace."""

import signal
import sys
from pathlib import Path

import pytest
from ctrl_rl_bringup.corridor.report import read_drive
from ctrl_rl_bringup.runner.monitor import Monitor, MonitorError
from ctrl_rl_bringup.runner.processes import ros

_FROZEN_SPINS = 40
pytestmark = pytest.mark.usefixtures("_no_shared_memory")  # some are killed or frozen
"""Calls of `check` at least 50 ms apart: longer than what the monitor lets matches settle."""


@pytest.mark.fault
def test_a_drive_waits_for_a_value_node_that_is_there_but_not_at_work(
    run_node, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    space = ("__ns:=/lab",)
    run_node("sim_bridge", "bridge", "task:=curved_corridor", "start_paused:=true", remap=space)
    recorder = run_node("ctrl_rl_bags", "recorder", f"output:={tmp_path / 'bag'}", remap=space)
    run_node("koopman_lqr_controller", "controller", "use_sim_time:=true", remap=space)
    baseline = run_node("oc_baseline_node", "baseline", "use_sim_time:=true", "grid:=curved_corridor", remap=space)
    baseline.wait_for("points")
    spins, frozen, thawed = 0, False, False

    def check() -> None:
        nonlocal spins, frozen, thawed
        publishes = monitor._node.count_publishers("oc_value") == 1
        if publishes and not frozen:
            baseline.process.send_signal(signal.SIGSTOP)
            frozen = True
        spins += frozen
        if spins == _FROZEN_SPINS:
            baseline.process.send_signal(signal.SIGCONT)
            thawed = True

    monkeypatch.setattr(sys, "argv", ["monitor", "--ros-args", "-r", space[0]])
    with ros():
        monitor = Monitor(check, ["oc_value"])
        try:
            with monitor.session():
                assert thawed
                monitor.run()
                while monitor._episode is None or monitor._episode.elapsed < 1.0:
                    monitor._spin()
        finally:
            baseline.process.send_signal(signal.SIGCONT)
    recorder.stop()
    drive = read_drive(tmp_path / "bag")
    assert drive.task == "curved_corridor"
    assert len(drive.odometry)
    assert len(drive.oc_values)


def test_who_is_not_ready_within_the_limit_is_named() -> None:
    words = r"not ready after 0\.2 s: nobody publishes scan; --ready-limit"
    with ros(), pytest.raises(MonitorError, match=words), Monitor(lambda: None, ready_limit=0.2).session():
        pass
