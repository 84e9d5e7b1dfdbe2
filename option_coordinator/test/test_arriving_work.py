"""Work that arrives at a real coordinator: by its services, on its topic, and through kills of its process."""

from pathlib import Path

import numpy as np
import pytest
from option_coordinator.nodes.messages import EXCHANGE
from option_coordinator.nodes.work_board import LAST_CHANGES
from option_coordinator.protocol.protocol_types import GrantStatus
from option_coordinator.teams.team_file import FOLDER

from ctrl_rl_msgs.msg import WorkState, WorkTask
from ctrl_rl_msgs.srv import ChangeWork, QueryWork, SubmitWork

pytestmark = [pytest.mark.fault, pytest.mark.timeout(900)]
ROBOT = str(Path(__file__).with_name("delivery_process.py"))
ROBOTS = ("robot_1", "robot_2", "robot_3")
TASK = {"origin": "shelf_1", "destination": "desk_1"}


class Work:
    """A team's coordinator and robots, and a user of its services."""

    def __init__(self, rig, folder):
        self.rig, self.folder, self.changes = rig, folder, []
        text = (FOLDER / "delivery_team.yaml").read_text().replace("name: delivery_team", "name: couriers")
        text = text.replace("deliveries: 2", "deliveries: 0").replace("lasts: 2.0 s", "lasts: 0.2 s")
        text = text.replace('0) m"}', '0) m", lasts: 0.1 s}').replace('2) m"}\n  desk', '2) m", lasts: 0.1 s}\n  desk')
        self.team = folder / "couriers.yaml"
        self.team.write_text(text)
        rig.node.create_subscription(WorkState, "work_states", self.changes.append, LAST_CHANGES)
        kinds = {"submit_work": SubmitWork, "change_work": ChangeWork, "query_work": QueryWork}
        self.clients = {name: rig.node.create_client(kind, f"coordinator/{name}") for name, kind in kinds.items()}

    def start(self):
        self.rig.coordinator(policy="spread", team=self.team, work=self.folder / "work.sqlite")

    def robots(self, *names, way=0.1):
        for name in names or ROBOTS:
            memory = self.folder / f"{name}.sqlite"
            self.rig.start(name, ROBOT, robot=name, team=self.team, memory=memory, way=way)

    def call(self, name, request):
        """Return the answer of a service, or None if the coordinator was killed before it answered."""
        client = self.clients[name]
        self.rig.until(client.service_is_ready, name)
        future = client.call_async(request)
        for _ in range(100):
            self.rig.let_pass(0.02)
            if future.done():
                return future.result()
        return None

    def submit(self, task_id, **changes):
        return self.call("submit_work", SubmitWork.Request(task=WorkTask(id=task_id, **TASK | changes)))

    def query(self, task_id=""):
        return self.rig.until(lambda: self.call("query_work", QueryWork.Request(id=task_id)), "an answer")

    def history(self, task_id):
        return [state.state for state in self.query(task_id).states]


@pytest.fixture
def work(rig, tmp_path):
    return Work(rig, tmp_path)


def test_tasks_are_submitted_changed_cancelled_and_asked_for(work):
    work.start()
    answer = work.submit("a")
    assert (answer.success, answer.state.state) == (True, WorkState.WAITING), answer.message
    assert work.submit("a").state.number == answer.state.number
    other = work.submit("a", destination="desk_2")
    assert (other.success, "is another one" in other.message) == (False, True)
    refused = work.submit("b", origin="cellar")
    assert (refused.success, "there is no station 'cellar'" in refused.message) == (False, True)
    assert not work.submit("").success
    changed = work.call("change_work", ChangeWork.Request(id="a", priority=3))
    assert (changed.success, changed.state.task.priority) == (True, 3)
    late = ChangeWork.Request(id="a")
    late.latest.sec = 1
    late = work.call("change_work", late)
    assert (late.success, "is not changed: its latest time" in late.message) == (False, True)
    assert [state.task.id for state in work.query().states] == ["a"]
    for _ in range(2):
        cancelled = work.call("change_work", ChangeWork.Request(id="a", cancel=True))
        assert (cancelled.success, cancelled.state.state) == (True, WorkState.CANCELLED)
    assert work.query().states == []
    waiting = WorkState.WAITING
    assert work.history("a") == [WorkState.SUBMITTED, waiting, waiting, WorkState.CANCELLED]
    assert "there is no task 'c'" in work.query("c").message
    work.rig.until(lambda: len(work.changes) >= 6, "all changes on the topic")
    assert [change.number for change in work.changes] == list(range(1, 7))


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow), pytest.param(2, marks=pytest.mark.slow)])
def test_no_task_is_lost_or_done_twice_though_the_coordinator_is_killed_five_times(work, seed):
    random, rig = np.random.default_rng(seed), work.rig
    work.start()
    work.robots()
    tasks = {f"task {i}": {"origin": f"shelf_{1 + i % 2}", "priority": i % 3} for i in range(20)}
    unanswered = list(tasks)
    for _ in range(5):
        for task_id in unanswered[:4]:
            if work.submit(task_id, **tasks[task_id]):
                unanswered.remove(task_id)
        rig.let_pass(random.uniform(0.0, 1.5))
        rig.kill("coordinator")
        work.start()
    for task_id in tasks:  # whoever does not know whether it was heard says it again
        rig.until(lambda task_id=task_id: work.submit(task_id, **tasks[task_id]), "an answer")
    rig.until(lambda: not work.query().states, "all tasks are finished")
    for task_id in tasks:
        history = work.history(task_id)
        assert history[-1] == WorkState.DONE
        assert history.count(WorkState.DONE) == history.count(WorkState.ON_BOARD) == 1
    delivered = {request.agent: int(request.observation[3]) for request in rig.requests}
    assert sum(delivered.values()) == len(tasks), delivered
    numbers = {change.number for change in work.changes}
    rig.until(lambda: numbers.update(change.number for change in work.changes) or len(numbers) == max(numbers), "all")
    assert rig.counted("parcels without a task") == 0


def test_tasks_come_by_topic_too(work):
    work.start()
    publisher = work.rig.node.create_publisher(WorkTask, "work_tasks", EXCHANGE)

    def told(task, state):
        publisher.publish(task)
        return [state, task.id] in [[change.state, change.task.id] for change in work.changes]

    work.rig.until(lambda: told(WorkTask(id="a", **TASK), WorkState.WAITING), "it is accepted")
    work.rig.until(lambda: told(WorkTask(id="b", origin="cellar"), WorkState.REFUSED), "it is refused")
    assert [change.state for change in work.changes if change.task.id == "a"] == [
        WorkState.SUBMITTED,
        WorkState.WAITING,
    ]
    assert "no station 'cellar'" in work.changes[-1].reason


def test_an_idle_robot_is_called_when_work_arrives(work):
    work.team.write_text(
        work.team.read_text().replace("longest: 5.0 s, lasts: 0.2 s", "longest: 900.0 s, lasts: 800.0 s")
    )
    work.start()
    work.robots("robot_1")
    work.rig.until(lambda: work.rig.running("robot_1"), "it waits")
    work.submit("a")
    work.rig.until(lambda: work.changes[-1].state == WorkState.DONE, "it is done")
    assert {grant.reason for grant in work.rig.given("robot_1", GrantStatus.CANCELLED)} == {"there is work"}


def test_a_robot_whose_task_is_cancelled_does_not_go_on_to_fetch_it(work):
    work.start()
    work.robots("robot_1", way=600.0)
    work.submit("a")
    work.rig.until(lambda: work.rig.given("robot_1") and work.history("a")[-1] == WorkState.ASSIGNED, "it is assigned")
    assert work.call("change_work", ChangeWork.Request(id="a", cancel=True)).success
    stopped = work.rig.until(lambda: work.rig.given("robot_1", GrantStatus.CANCELLED), "it stops")
    assert "its task was taken back" in {grant.reason for grant in stopped}


@pytest.mark.slow
def test_a_robot_that_dies_leaves_its_task_to_another(work):
    work.team.write_text(work.team.read_text().replace("fetch, longest: 60.0 s", "fetch, longest: 30.0 s"))
    work.start()
    work.robots("robot_1", way=600.0)
    work.submit("a")
    work.rig.until(lambda: WorkState.ASSIGNED in [change.state for change in work.changes], "it is assigned")
    work.rig.kill("robot_1")
    work.robots("robot_2")
    work.rig.until(lambda: work.changes[-1].state == WorkState.DONE, "it is done")
    assert work.changes[-1].robot == "robot_2"
    assert "robot_1 is lost" in [change.reason for change in work.changes]
