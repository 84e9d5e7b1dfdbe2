"""Work outlives processes: neither a robot's restart nor a SIGKILL of the coordinator loses it or does it twice."""

import sqlite3
from itertools import pairwise

import numpy as np
import pytest
from option_coordinator.protocol.protocol_types import GrantStatus
from option_coordinator.protocol.work_memory import WorkMemory
from option_coordinator.teams.delivery import Delivery

from option_coordinator import OptionError, load_team

pytestmark = [pytest.mark.fault, pytest.mark.timeout(900)]
TEAM = load_team("delivery_team")


def test_a_file_holds_the_last_work_of_each_robot_of_each_team(tmp_path):
    file = tmp_path / "sub" / "work.sqlite"
    memory = WorkMemory(file, "team")
    assert memory.of("r0") == ""
    assert memory.keep("r0", "first")
    assert memory.keep("r0", "second")
    assert WorkMemory(file, "other").of("r0") == ""
    standby = WorkMemory(file, "team")
    assert standby.of("r0") == "second"
    standby.forget("r0")
    assert WorkMemory(file, "team").of("r0") == ""


def test_a_file_that_is_none_is_refused_in_one_line(tmp_path):
    file = tmp_path / "work.sqlite"
    file.write_text("these are no tables, however long the text is" * 100)
    with pytest.raises(
        OptionError, match=r"work\.sqlite: the robots' work cannot be kept there: file is not a database"
    ):
        WorkMemory(file, "team")
    with pytest.raises(OptionError, match="cannot be kept there"):
        WorkMemory(tmp_path, "team")


def test_what_a_locked_file_misses_is_written_later(tmp_path):
    memory, other = WorkMemory(tmp_path / "w", "team"), sqlite3.connect(tmp_path / "w", isolation_level=None)
    other.execute("BEGIN IMMEDIATE")
    assert not memory.keep("r0", "a parcel")
    assert memory.of("r0") == "a parcel"
    other.execute("ROLLBACK")
    assert memory.keep("r0", "a parcel")
    assert WorkMemory(tmp_path / "w", "team").of("r0") == "a parcel"


def test_a_delivery_robot_goes_on_with_its_parcel():
    old, new = Delivery(TEAM, "robot_1"), Delivery(TEAM, "robot_1")
    old.carries, old.delivered = True, 1
    new.resume(old.see(np.zeros(3)).work)
    assert (new.carries, new.delivered) == (True, 1)
    with pytest.raises(OptionError, match="is not the work of a robot"):
        new.resume("nonsense")


def done(rig, agent="r0"):
    """Numbers of finished options that a robot has reported, in order of its requests."""
    return [int(r.work.removeprefix("done=")) for r in rig.requests if r.agent == agent and r.work]


def at_work(rig, count=3):
    """Return the number that a robot has reported, once it runs the option after its report."""

    def runs():
        status = rig.running("r0")
        return len(done(rig)) >= count and status and status.request_id == rig.requests[-1].request_id

    rig.until(runs, "it works")
    return done(rig)[-1]


def goes_on(rig, before):
    """Check that the number goes on from where it was; the watcher may miss the first requests of a new process."""
    rig.until(lambda: max(done(rig)) >= before + 2, "it goes on")
    assert all(one <= other for one, other in pairwise(done(rig))), [(r.incarnation, r.work) for r in rig.requests]


def test_a_restarted_robot_goes_on_where_it_was(rig):
    rig.coordinator()
    rig.robot("r0", lasts=0.5, keeps=True)
    before = at_work(rig)
    rig.kill("r0")
    rig.robot("r0", lasts=0.5, keeps=True)
    goes_on(rig, before)
    assert any(g.work >= f"done={before}" for g in rig.given("r0", GrantStatus.REFUSED))


def test_a_kill_of_the_coordinator_and_then_of_the_robot_loses_nothing(rig):
    """The robot tells a coordinator without a file what it has done."""
    rig.coordinator()
    rig.robot("r0", lasts=0.5, keeps=True)
    at_work(rig)
    rig.kill("coordinator")
    rig.coordinator()
    before = at_work(rig, len(done(rig)) + 2)
    rig.kill("r0")
    rig.robot("r0", lasts=0.5, keeps=True)
    goes_on(rig, before)


def test_a_kill_of_both_loses_nothing_that_was_reported_with_a_file(rig, tmp_path):
    memory = tmp_path / "work.sqlite"
    rig.coordinator(memory=memory)
    rig.robot("r0", lasts=0.5, keeps=True)
    before = at_work(rig)
    rig.kill("r0")
    rig.kill("coordinator")
    rig.coordinator(memory=memory)
    rig.robot("r0", lasts=0.5, keeps=True)
    goes_on(rig, before)


def test_what_a_robot_finished_without_a_coordinator_is_in_its_own_file(rig, tmp_path):
    memory = tmp_path / "robot.sqlite"
    rig.coordinator()
    rig.robot("r0", lasts=0.5, keeps=True, memory=memory)
    before = at_work(rig)
    rig.kill("coordinator")
    rig.until(lambda: done(rig)[-1] > before, "it ends its option")
    before = done(rig)[-1]
    rig.kill("r0")
    rig.coordinator()
    rig.robot("r0", lasts=0.5, keeps=True, memory=memory)
    goes_on(rig, before)
