"""Work that arrives: what is admitted, who gets which task, and robots that do all of it in the light world."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from option_coordinator.environments.tasks import make_simulation
from option_coordinator.environments.tasks.team_delivery import TeamDeliverySimulation
from option_coordinator.options.options import NONE
from option_coordinator.teams.delivery import Delivery
from option_coordinator.teams.team_file import FOLDER
from option_coordinator.work import Admission, Change, Dispatcher, FreeRobot, Task, TaskState, WorkQueue, assign
from option_coordinator.work.travel import TravelTimes

from option_coordinator import OptionEnvironment, OptionError, PolicyQuery, load_team

WAIT, SHELF, OTHER_SHELF, DESK, OTHER_DESK, HOME = range(6)
TASK = Task("t", "shelf_1", "desk_1")
HOMES = [(-0.9, -1.2), (0.0, -1.2), (0.9, -1.2)]
FREE, LOADED = [1, 1, 1, 0, 0, 1], [1, 0, 0, 1, 1, 0]


@pytest.fixture(scope="module")
def team(tmp_path_factory):
    text = (FOLDER / "delivery_team.yaml").read_text().replace("name: delivery_team", "name: couriers")
    text = text.replace("deliveries: 2", "deliveries: 0").replace('"(0.9, -1.2) m"', '"(0.9, -1.2) m", skills: [cool]')
    file = tmp_path_factory.mktemp("team") / "couriers.yaml"
    file.write_text(text)
    return load_team(str(file))


@pytest.fixture
def queue(tmp_path):
    out = WorkQueue(tmp_path / "work.sqlite", "couriers")
    yield out
    out.close()


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({}, ""),
        ({"skill": "cool"}, ""),
        ({"latest": 100.0}, ""),
        ({"kind": "mop"}, "its kind is 'mop': team 'couriers' knows 'delivery' alone"),
        ({"origin": "cellar"}, "its origin: there is no station 'cellar'; team 'couriers' fetches at shelf_1, shelf_2"),
        ({"destination": "shelf_2"}, "its destination: 'shelf_2' is an option to fetch; .* delivers at desk_1, desk_2"),
        ({"origin": "home"}, "its origin: 'home' is an option to rest"),
        ({"skill": "fly"}, "no robot has the skill 'fly': skills of team 'couriers' are cool"),
        ({"latest": 25.0}, "cannot be met: from 'shelf_1' to 'desk_1' takes at least 18 s, and 15 s are left"),
        ({"earliest": 90.0, "latest": 100.0}, "takes at least 18 s, and 10 s are left"),
        ({"latest": 5.0}, "and 0 s are left"),
    ],
)
def test_what_nobody_can_do_is_refused_with_the_reason(team, change, reason):
    found = Admission(team).refusal(replace(TASK, **change), 10.0)
    if not reason:
        assert found == ""
    else:
        with pytest.raises(OptionError, match=reason):
            raise OptionError(found)


def waiting(task_id, origin="shelf_1", submitted=0.0, **changes):
    return Change(
        1, submitted, replace(TASK, id=task_id, origin=origin, **changes), TaskState.WAITING, submitted=submitted
    )


def robot(name, place, skills=(), origins=("shelf_1", "shelf_2")):
    return FreeRobot(name, place, frozenset(skills), frozenset(origins))


NEAR, FAR = robot("near", (-1.6, 0.9)), robot("far", (1.6, 1.0), ["cool"])


@pytest.mark.parametrize(
    ("tasks", "robots", "expected"),
    [
        ([], [NEAR], {}),
        ([waiting("a")], [FAR, NEAR], {"a": "near"}),
        ([waiting("a", skill="cool")], [FAR, NEAR], {"a": "far"}),
        ([waiting("a", skill="fly")], [FAR, NEAR], {}),
        ([waiting("a"), waiting("b", "shelf_2")], [NEAR, FAR], {"a": "near", "b": "far"}),  # the least sum
        ([waiting("b"), waiting("a")], [NEAR], {"a": "near"}),  # the id decides
        ([waiting("a", submitted=50.0), waiting("b")], [NEAR], {"b": "near"}),  # the older
        ([waiting("a"), waiting("b", priority=1)], [NEAR], {"b": "near"}),
        ([waiting("a"), waiting("b", submitted=90.0, priority=1)], [NEAR], {"a": "near"}),  # it has waited for longer
        ([waiting("a"), waiting("b", latest=140.0)], [NEAR], {"b": "near"}),  # it would be late
        ([waiting("a", latest=117.0)], [NEAR], {}),  # nobody can be in time
        ([waiting("a", latest=125.0)], [FAR, NEAR], {"a": "near"}),
        ([waiting("a", earliest=110.0)], [NEAR], {}),
        ([waiting("a", earliest=110.0)], [NEAR, FAR], {"a": "far"}),  # it gets there in time
        ([waiting("a")], [robot("r", (0.0, 0.0), (), ["shelf_2"])], {}),
    ],
)
def test_who_gets_which_task(team, tasks, robots, expected):
    for each in (tasks, tasks[::-1]):
        pairs = assign(each, robots, TravelTimes(team), 100.0)
        assert {change.task.id: found.name for change, found in pairs} == expected


def test_a_station_that_others_head_for_costs_the_time_until_they_have_left(team):
    tasks = [waiting("a"), waiting("b", "shelf_2")]
    (pair,) = assign(tasks, [NEAR], TravelTimes(team), 100.0, {"shelf_1": 2})
    assert pair[0].task.id == "b"


@settings(deadline=None, max_examples=50)
@given(st.integers(0, 2**32 - 1))
def test_the_order_of_the_tasks_does_not_matter_and_nobody_idles(team, seed):
    random = np.random.default_rng(seed)
    tasks = [
        waiting(str(i), f"shelf_{random.integers(1, 3)}", priority=int(random.integers(3)))
        for i in range(random.integers(6))
    ]
    robots = [robot(str(i), tuple(random.integers(-1, 2, 2))) for i in range(random.integers(6))]
    travel, shuffled = TravelTimes(team), [tasks[i] for i in random.permutation(len(tasks))]
    pairs = assign(tasks, robots, travel, 0.0)
    assert pairs == assign(shuffled, robots, travel, 0.0)
    assert len(pairs) == min(len(tasks), len(robots))


class Robots:
    """Robots as the dispatcher sees them, and its decisions on them."""

    def __init__(self, team, queue):
        self.now = 0.0
        self.dispatcher = Dispatcher(team, queue, lambda: self.now)
        self.seen = np.array([(*home, 0.0, 0.0) for home in HOMES], np.float32)

    def decide(self, legal=FREE, of=0, carries=None, delivered=None):
        """Return the option that one robot gets while the others are absent."""
        self.now += 1.0
        if carries is not None:
            self.seen[of, 2] = carries
        if delivered is not None:
            self.seen[of, 3] = delivered
        choosing, mask = np.arange(3) == of, np.array([legal] * 3, bool)
        query = PolicyQuery(self.seen.ravel(), choosing, np.full(3, NONE), mask)
        return int(self.dispatcher(query)[0][of])

    def lose(self, name, seconds):
        """Tell the dispatcher that a robot, heard just now, is then lost for a time."""
        for lost in ([], [name]):
            self.dispatcher.supervise({}, lost)
        self.now += seconds
        self.dispatcher.supervise({}, [name])


@pytest.fixture
def robots(team, queue):
    return Robots(team, queue)


def test_a_task_is_followed_by_what_its_robot_reports(robots, queue):
    assert robots.decide() == WAIT
    queue.submit(TASK, "", 0.0)
    robots.seen[0, 3] = 4
    for _ in range(2):  # an answer that never left is given again
        assert robots.decide() == SHELF
    assert (queue.known("t").state, queue.known("t").base) == (TaskState.ASSIGNED, 4)
    for _ in range(2):
        assert robots.decide(LOADED, carries=1) == DESK
    assert queue.known("t").state is TaskState.ON_BOARD
    for _ in range(2):
        assert robots.decide(carries=0, delivered=5) == WAIT
    assert [change.state for change in queue.history("t")].count(TaskState.DONE) == 1


def test_an_idle_robot_that_may_not_wait_goes_home_where_it_is(robots):
    assert robots.decide([0, 1, 1, 0, 0, 1]) == HOME  # its last wait overran


def test_an_idle_robot_leaves_a_station_for_its_home(robots):
    robots.seen[0, :2] = (-1.65, 1.0)
    assert robots.decide() == HOME


def test_a_late_task_is_done_late(robots, queue):
    queue.submit(replace(TASK, latest=40.0), "", 0.0)
    robots.decide()
    robots.now = 50.0
    robots.decide(LOADED, carries=1)
    robots.decide(carries=0, delivered=1)
    assert (queue.known("t").state, queue.known("t").reason) == (TaskState.DONE, "12 s late")


def test_a_station_that_a_robot_does_not_reach_is_left_to_another(robots, queue):
    queue.submit(TASK, "", 0.0)
    robots.decide()
    assert robots.decide([1, 0, 1, 0, 0, 1]) == WAIT  # the option overran
    assert (queue.known("t").state, queue.known("t").robot) == (TaskState.WAITING, "robot_1")
    assert "robot_1 did not get to 'shelf_1' in time" in queue.known("t").reason
    assert robots.decide(of=1) == SHELF


def test_a_destination_that_is_barred_for_ever_fails_the_task(robots, queue):
    queue.submit(TASK, "", 0.0)
    robots.decide()
    robots.decide(LOADED, carries=1)
    barred = [1, 0, 0, 0, 1, 0]
    assert robots.decide(barred) == WAIT
    assert queue.known("t").state is TaskState.ON_BOARD
    assert robots.decide(barred) == OTHER_DESK  # out of the way
    assert queue.known("t").state is TaskState.FAILED


def test_a_robot_that_forgot_its_work(robots, queue):
    queue.submit(TASK, "", 0.0)
    robots.seen[0, 3] = 4
    robots.decide()
    assert robots.decide(delivered=0) == SHELF
    assert queue.known("t").base == 0
    robots.decide(LOADED, carries=1)
    robots.decide(carries=0)
    assert (queue.known("t").state, "does not know its work" in queue.known("t").reason) == (TaskState.FAILED, True)


def test_a_lost_robot_leaves_its_task_to_others_unless_it_has_the_parcel(robots, queue):
    queue.submit(TASK, "", 0.0)
    robots.decide()
    robots.lose("robot_1", 59.0)
    assert queue.known("t").state is TaskState.ASSIGNED
    robots.lose("robot_1", 61.0)
    assert queue.known("t").reason == "robot_1 is lost"
    assert robots.decide(LOADED, carries=1) == DESK  # it is back, with the parcel
    robots.lose("robot_1", 900.0)
    assert queue.known("t").state is TaskState.ON_BOARD
    robots.dispatcher.supervise({"robot_1": "it is given up"}, [])
    assert (queue.known("t").state, queue.known("t").reason) == (TaskState.FAILED, "it is given up")


def test_a_parcel_on_board_of_a_robot_that_was_lost_is_not_left_to_another_one(robots, queue):
    queue.submit(TASK, "", 0.0)
    robots.decide()
    robots.lose("robot_1", 61.0)
    assert robots.decide(of=1) == SHELF
    assert robots.decide(LOADED, carries=1) == DESK
    assert (queue.known("t").state, queue.known("t").robot) == (TaskState.ON_BOARD, "robot_1")
    running = {"robot_1": "desk_1", "robot_2": "shelf_1", "robot_3": "home"}
    assert robots.dispatcher.recalls(running) == {"robot_2": "its task was taken back"}


def test_idle_robots_are_called_once_for_each_task(robots, queue):
    running = {"robot_1": "home", "robot_3": "wait"}
    assert robots.dispatcher.recalls(running) == {}
    queue.submit(replace(TASK, skill="cool"), "", 0.0)
    assert robots.dispatcher.recalls(running) == {"robot_3": "there is work"}
    assert robots.dispatcher.recalls(running) == {}
    queue.submit(replace(TASK, id="u"), "", 0.0)
    assert robots.dispatcher.recalls(running) == {"robot_1": "there is work"}


def test_a_parcel_without_a_task_is_put_down_where_its_task_would_have_gone(robots, queue):
    assert robots.decide(LOADED, carries=1) == DESK  # nobody knows what this is
    queue.submit(replace(TASK, destination="desk_2"), "", 0.0)
    robots.decide(carries=0, delivered=1)
    queue.move("t", TaskState.CANCELLED, 9.0)
    assert robots.decide(LOADED, carries=1) == OTHER_DESK
    assert robots.decide(carries=0, delivered=2) == WAIT
    assert (robots.dispatcher.strays, queue.known("t").state) == (2, TaskState.CANCELLED)


def test_a_task_that_waited_too_long_has_failed(robots, queue):
    queue.submit(replace(TASK, skill="cool", latest=30.0), "", 0.0)
    assert robots.decide() == WAIT
    robots.now = 13.0
    robots.dispatcher.supervise({}, [])
    assert queue.known("t").state is TaskState.FAILED
    assert "latest time can no longer be met" in queue.known("t").reason


def test_robots_of_an_endless_team_fetch_or_go_home_after_any_number_of_deliveries(team):
    delivery = Delivery(team, "robot_1")
    delivery.resume("carries=0 delivered=123456")
    assert delivery.delivered == 123456
    assert np.flatnonzero(delivery.see(np.zeros(3)).legal).tolist() == [WAIT, SHELF, OTHER_SHELF, HOME]
    assert not delivery.over(HOME)
    with pytest.raises(OptionError, match="no number of deliveries to learn with"):
        make_simulation(team)


@pytest.mark.parametrize("seed", range(2))
def test_all_work_is_done_once_in_the_light_world_with_kills_at_every_decision(team, tmp_path, seed):
    """Kills between a decision's write and its grants, too: then the same decision is made anew from the file."""
    random, file, simulation = np.random.default_rng(seed), tmp_path / "work.sqlite", TeamDeliverySimulation(team)
    arrivals = np.cumsum(random.exponential(10.0, 12)).tolist()
    environment = OptionEnvironment(simulation, team.discount)
    decision, now, number = environment.reset(seed=seed), 0.0, 0
    queue = WorkQueue(file, "couriers")
    while not decision.over:
        for _ in range(1 + (random.random() < 0.5)):
            if random.random() < 0.5:
                queue.close()
                queue = WorkQueue(file, "couriers")
            while number < len(arrivals) and arrivals[number] <= now:
                task = Task(str(number), f"shelf_{random.integers(1, 3)}", f"desk_{random.integers(1, 3)}")
                queue.submit(replace(task, skill="cool" if number % 4 == 0 else ""), "", now)
                number += 1
            options, log_probability = Dispatcher(team, queue, lambda at=now: at)(decision)
        decision = environment.step(decision.named(options))
        now += decision.duration * team.time_step
    ends = {task: [change.state for change in queue.history(str(task))] for task in range(len(arrivals))}
    assert number == len(arrivals)
    assert log_probability == 0.0
    assert all(states[-1] is TaskState.DONE and states.count(TaskState.DONE) == 1 for states in ends.values()), ends
    assert simulation.figures()["deliveries"] == len(arrivals)
    assert all(queue.known(str(task)).robot == "robot_3" for task in range(0, len(arrivals), 4))
    assert math.isclose(sum(1 for states in ends.values() for state in states if state is TaskState.ON_BOARD), number)
