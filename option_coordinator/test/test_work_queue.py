"""Tasks in a file: none is lost or done twice, and states only move along their table, with kills in between."""

import math
import shutil
import tempfile
from contextlib import suppress
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import hypothesis.strategies as st
import pytest
from hypothesis import HealthCheck, settings
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule
from option_coordinator.work import Task, TaskState, WorkQueue
from option_coordinator.work.task import OPEN, TRANSITIONS

from option_coordinator import OptionError

TASK = Task("t", "shelf", "desk")
ROBOTS = ("r0", "r1")
IDS = st.sampled_from(["a", "b", "c"])


@pytest.fixture
def queue(tmp_path):
    out = WorkQueue(tmp_path / "sub" / "work.sqlite", "team")
    yield out
    out.close()


def states(queue, task_id="t"):
    return [change.state.name for change in queue.history(task_id)]


def test_a_task_goes_its_way_and_its_history_tells(queue, tmp_path):
    queue.submit(TASK, "", 1.0)
    queue.move("t", TaskState.ASSIGNED, 2.0, "r0", base=4)
    queue.move("t", TaskState.ON_BOARD, 3.0)
    queue.move("t", TaskState.DONE, 4.0, reason="1 s late")
    assert states(queue) == ["SUBMITTED", "WAITING", "ASSIGNED", "ON_BOARD", "DONE"]
    last = WorkQueue(tmp_path / "sub" / "work.sqlite", "team").known("t")
    assert (last.number, last.at, last.robot, last.reason, last.base, last.submitted) == (
        5,
        4.0,
        "r0",
        "1 s late",
        4,
        1.0,
    )
    assert last.task == TASK
    assert WorkQueue(tmp_path / "sub" / "work.sqlite", "other").present("t") is None


def test_what_is_repeated_changes_nothing(queue):
    for _ in range(2):
        assert queue.submit(TASK, "", 1.0).state is TaskState.WAITING
    for state in (TaskState.ASSIGNED, TaskState.ON_BOARD, TaskState.DONE):
        for _ in range(2):
            assert queue.move("t", state, 2.0, "r0").state is state
    assert queue.submit(replace(TASK, priority=3), "", 5.0).state is TaskState.DONE
    assert len(queue.history("t")) == 5


def test_a_refused_task_may_be_submitted_again(queue):
    assert queue.submit(TASK, "no robot", 1.0).reason == "no robot"
    queue.submit(TASK, "no robot", 2.0)
    assert states(queue) == ["SUBMITTED", "REFUSED"]
    assert queue.submit(TASK, "", 3.0).state is TaskState.WAITING


def test_what_cannot_be_is_said(queue):
    queue.submit(TASK, "", 1.0)
    with pytest.raises(OptionError, match="'t' exists and is another one"):
        queue.submit(replace(TASK, destination="other"), "", 1.0)
    with pytest.raises(OptionError, match="there is no task 'u'"):
        queue.move("u", TaskState.CANCELLED, 1.0)
    with pytest.raises(OptionError, match="'t' is waiting: it cannot be done next"):
        queue.move("t", TaskState.DONE, 1.0)
    queue.move("t", TaskState.ASSIGNED, 1.0, "r0")
    with pytest.raises(OptionError, match="is not r1's but r0's"):
        queue.move("t", TaskState.ON_BOARD, 1.0, "r1")
    queue.submit(replace(TASK, id="u"), "", 1.0)
    with pytest.raises(OptionError, match="r0 has a task already"):
        queue.move("u", TaskState.ASSIGNED, 1.0, "r0")
    queue.move("t", TaskState.ON_BOARD, 2.0)
    with pytest.raises(OptionError, match="'t' is on board: it cannot be cancelled next"):
        queue.move("t", TaskState.CANCELLED, 3.0)
    queue.move("t", TaskState.DONE, 3.0)
    with pytest.raises(OptionError, match="'t' is done: it cannot be changed"):
        queue.adjust(replace(TASK, priority=1), 4.0)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"id": ""}, "needs an id"),
        ({"id": "x" * 256}, "its id has more than 255 bytes"),
        ({"skill": "x" * 256}, "its skill has more"),
        ({"priority": 1001}, "must be -1000 to 1000"),
        ({"earliest": math.inf}, "not finite"),
        ({"latest": math.nan}, "not finite"),
    ],
)
def test_a_task_out_of_range_is_refused(change, words):
    with pytest.raises(OptionError, match=words):
        replace(TASK, **change)


def test_a_block_is_written_whole_or_not_at_all(queue):
    queue.submit(TASK, "", 1.0)

    def interrupted():
        with queue.transaction():
            queue.move("t", TaskState.ASSIGNED, 1.0, "r0")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert states(queue) == ["SUBMITTED", "WAITING"]


def test_a_low_priority_waits_longer_but_not_for_ever(queue):
    queue.submit(replace(TASK, id="old"), "", 0.0)
    queue.submit(replace(TASK, id="urgent", priority=2), "", 60.0)
    queue.submit(replace(TASK, id="later", priority=2), "", 121.0)
    assert [change.task.id for change in queue.waiting()] == ["urgent", "old", "later"]
    queue.adjust(replace(TASK, id="old", priority=9), 200.0)
    assert [change.task.id for change in queue.waiting()] == ["old", "urgent", "later"]
    assert [change.task.id for change in queue.unfinished()] == ["old", "urgent", "later"]
    queue.submit(replace(TASK, id="due", latest=100.0, skill="cool"), "", 99.0)
    assert [change.task.id for change in queue.waiting(["", "cool"], 2)] == ["old", "due"]
    assert [change.task.id for change in queue.due(101.0)] == ["due"]
    assert queue.due(100.0) == []


def test_a_file_that_is_none_is_refused_in_one_line(tmp_path):
    (tmp_path / "work.sqlite").write_text("no tables" * 1000)
    with pytest.raises(OptionError, match=r"work\.sqlite: tasks cannot be kept there: file is not a database"):
        WorkQueue(tmp_path / "work.sqlite", "team")
    with pytest.raises(OptionError, match="cannot be kept there"):
        WorkQueue(tmp_path, "team")


class Work(RuleBasedStateMachine):
    """Random submissions, changes and robots, and kills before and after what they write is complete."""

    @initialize()
    def begin(self):
        self.folder = Path(tempfile.mkdtemp())
        self.queue, self.now = self.open(), 0.0
        self.accepted, self.done, self.seen = set(), [], []

    def teardown(self):
        if hasattr(self, "folder"):
            self.queue.close()
            shutil.rmtree(self.folder)

    def open(self):
        return WorkQueue(self.folder / "work.sqlite", "team")

    def attempt(self, operation, *arguments, **options):
        """Carry out an operation, which the table may forbid; return the change if there is one."""
        self.now += 1.0
        before = self.queue.since(0)
        try:
            operation(*arguments, now=self.now, **options)
        except OptionError:
            assert self.queue.since(0) == before, "a refused operation has changed something"
        new = self.queue.since(0)[len(before) :]
        self.accepted |= {change.task.id for change in new if change.state is TaskState.WAITING}
        self.done += [change.task.id for change in new if change.state is TaskState.DONE]

    @rule(task_id=IDS, refusal=st.sampled_from(["", "no"]), priority=st.integers(-2, 2))
    def submit(self, task_id, refusal, priority):
        self.attempt(self.queue.submit, Task(task_id, "shelf", "desk", priority=priority), refusal)

    @rule(task_id=IDS, latest=st.sampled_from([9.0, math.inf]))
    def adjust(self, task_id, latest):
        self.attempt(self.queue.adjust, Task(task_id, "shelf", "desk", latest=latest))

    @rule(task_id=IDS, state=st.sampled_from(TaskState), robot=st.sampled_from(ROBOTS), twice=st.booleans())
    def move(self, task_id, state, robot, twice):
        for _ in range(1 + twice):
            self.attempt(self.queue.move, task_id, state, robot=robot)

    @rule(robot=st.sampled_from(ROBOTS), twice=st.booleans())
    def deliver(self, robot, twice):
        held = self.queue.held_by(robot)
        for _ in range(1 + twice):
            if held is not None:
                self.attempt(self.queue.move, held.task.id, TaskState.ON_BOARD, robot=robot)
                self.attempt(self.queue.move, held.task.id, TaskState.DONE, robot=robot)

    @rule(robot=st.sampled_from(ROBOTS))
    def assign(self, robot):
        for change in self.queue.waiting()[:1]:
            self.attempt(self.queue.move, change.task.id, TaskState.ASSIGNED, robot=robot, base=0)

    @rule()
    def kill_between_two_writes(self):
        self.queue = self.open()

    @rule(robot=st.sampled_from(ROBOTS))
    def kill_within_a_write(self, robot):
        before = self.queue.since(0)
        with suppress(OptionError), self.queue.transaction():  # it cannot be committed
            for change in self.queue.waiting()[:1]:
                if self.queue.held_by(robot) is None:
                    self.queue.move(change.task.id, TaskState.ASSIGNED, self.now, robot)
            self.queue.close()  # as the end of a process does
        self.queue = self.open()
        assert self.queue.since(0) == before

    @invariant()
    def nothing_is_lost_or_done_twice(self):
        if not hasattr(self, "folder"):
            return
        changes = self.queue.since(0)
        assert changes[: len(self.seen)] == self.seen, "the history was altered"
        self.seen = changes
        for task_id in {change.task.id for change in changes}:
            history = [change.state for change in changes if change.task.id == task_id]
            assert history[0] is TaskState.SUBMITTED
            for state, following in pairwise(history):
                assert following in TRANSITIONS[state] | ({state} & set(OPEN))
            assert history.count(TaskState.DONE) <= 1
            assert self.queue.known(task_id).state is history[-1]
        assert self.accepted <= {change.task.id for change in changes}
        assert sorted(self.done) == sorted(c.task.id for c in changes if c.state is TaskState.DONE)
        held = [change.robot for change in self.queue.held()]
        assert len(held) == len(set(held)), "a robot has two tasks"
        assert {c.task.id for c in self.queue.unfinished()} == {
            task_id for task_id in self.accepted if self.queue.known(task_id).state in OPEN
        }


TestWork = Work.TestCase
TestWork.settings = settings(
    max_examples=40, stateful_step_count=30, deadline=None, suppress_health_check=list(HealthCheck)
)
