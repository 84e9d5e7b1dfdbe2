"""The coordinator's services and topic for work that arrives, and the topic of its states."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from builtin_interfaces.msg import Time
from ctrl_rl_core.ros import seconds, to_stamp
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import Header

from ctrl_rl_core import ParameterError, SuiteNode
from ctrl_rl_msgs.msg import WorkState, WorkTask
from ctrl_rl_msgs.srv import ChangeWork, QueryWork, SubmitWork
from option_coordinator.errors import OptionError
from option_coordinator.nodes.messages import EXCHANGE
from option_coordinator.nodes.option_agent import STEADY
from option_coordinator.protocol.coordination import Coordinator
from option_coordinator.protocol.ledger import State
from option_coordinator.teams.team_file import TeamFile
from option_coordinator.work.admission import Admission
from option_coordinator.work.dispatcher import Dispatcher
from option_coordinator.work.task import DELIVERY, Change, Task, TaskState
from option_coordinator.work.work_queue import MOST_ROWS, WorkQueue

LAST_CHANGES = QoSProfile(
    depth=MOST_ROWS, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
)
"""QoS of work_states: who listens late gets the last changes."""
_SAID_EVERY_S = 10.0
_TELLS_S, _SUPERVISES_S = 0.1, 1.0
"""Periods of publishing what became of tasks, and of supervising them [s]."""


class WorkBoard:
    """Takes tasks by the node's services and a topic, and publishes what becomes of them.

    Args:
        node: Node of the coordinator.
        team: The team.
        name: Name of the team, under which the file has its tasks.
        file: SQLite file of the tasks.
        now: Returns the time of the tasks [s]; 0 until the ROS clock has started.

    Raises:
        OptionError: The file cannot be used.

    Attributes:
        dispatcher: The team's policy.
    """

    def __init__(self, node: SuiteNode, team: TeamFile, name: str, file: Path, now: Callable[[], float]) -> None:
        self._node, self._now = node, now
        self._coordinator: Coordinator | None = None
        self._options = team.option_names
        self._queue, self._admission = WorkQueue(file, name), Admission(team)
        self.dispatcher = Dispatcher(team, self._queue, now)
        self._published = max(0, self._queue.newest() - MOST_ROWS)
        self._logged = self._queue.newest()
        self._states = node.create_publisher(WorkState, "work_states", LAST_CHANGES)
        node.create_subscription(WorkTask, "work_tasks", self._on_task, EXCHANGE)
        node.create_service(SubmitWork, "~/submit_work", self._on_submit)
        node.create_service(ChangeWork, "~/change_work", self._on_change)
        node.create_service(QueryWork, "~/query_work", self._on_query)

    @property
    def figures(self) -> dict[str, object]:
        """Numbers of unfinished tasks by state, and of parcels without a task, for diagnostics."""
        counts = {f"tasks {state.words}": count for state, count in self._queue.unfinished_counts().items()}
        return {**counts, "parcels without a task": self.dispatcher.strays}

    def follow(self, coordinator: Coordinator) -> None:
        """Publish changes, and supervise the robots' tasks, while this coordinator decides."""
        self._coordinator = coordinator
        self._node.create_timer(_TELLS_S, self._tend, clock=STEADY)
        self._node.create_timer(_SUPERVISES_S, self._supervise, clock=STEADY)

    def tell(self) -> None:
        """Publish the changes since the last call; after a restart, the last ones again."""
        if self._coordinator is None or not self._coordinator.epoch:
            return
        for change in self._queue.since(self._published):
            self._states.publish(state_message(change))
            self._published = change.number
            if change.number > self._logged:
                words = [f"task '{change.task.id}' is {change.state.words}", change.robot, change.reason]
                self._node.get_logger().info(", ".join(word for word in words if word))

    def _tend(self) -> None:
        """Publish changes, and call robots whose option serves no more."""
        self.tell()
        if self._coordinator is None or not self._coordinator.epoch:
            return
        robots = self._coordinator.ledger
        running = {name: self._options[e.option] for name, e in robots.items() if e.runs and not e.cancelled}
        for name, reason in self.dispatcher.recalls(running).items():
            robots[name].cancel(reason)

    def _supervise(self) -> None:
        """End or return the tasks of robots that cannot go on, and those that are too late."""
        if self._coordinator is None or not self._coordinator.epoch:
            return
        robots = self._coordinator.ledger.values()
        given_up = {entry.agent: entry.given_up for entry in robots if entry.given_up}
        lost = [entry.agent for entry in robots if entry.state in (State.LOST, State.UNKNOWN)]
        self.dispatcher.supervise(given_up, lost)

    def _on_submit(self, request: SubmitWork.Request, response: SubmitWork.Response) -> SubmitWork.Response:
        def submit(now: float) -> Change:
            task = task_of(request.task)
            return self._queue.submit(task, self._admission.refusal(task, now), now)

        return self._answer(response, submit)

    def _on_task(self, task: WorkTask) -> None:
        """Take a task from the topic, if this coordinator decides; what becomes of it is on work_states."""
        if self._coordinator is None or not self._coordinator.epoch:
            return
        answer = self._on_submit(SubmitWork.Request(task=task), SubmitWork.Response())
        if not answer.success:
            words = f"a task on 'work_tasks' is refused: {answer.message}"
            self._node.get_logger().warning(words, throttle_duration_sec=_SAID_EVERY_S)

    def _on_change(self, request: ChangeWork.Request, response: ChangeWork.Response) -> ChangeWork.Response:
        def change(now: float) -> Change:
            if request.cancel:
                return self._queue.move(request.id, TaskState.CANCELLED, now, reason="as requested")
            before, (earliest, latest) = self._queue.known(request.id), _times(request)
            task = replace(before.task, priority=request.priority, earliest=earliest, latest=latest)
            refusal = self._admission.refusal(task, now) if before.state is TaskState.WAITING else ""
            if refusal:
                raise OptionError(f"task {request.id!r} is not changed: {refusal}")
            return self._queue.adjust(task, now)

        return self._answer(response, change)

    def _on_query(self, request: QueryWork.Request, response: QueryWork.Response) -> QueryWork.Response:
        try:
            if request.id:
                self._queue.known(request.id)
            changes = self._queue.history(request.id) if request.id else self._queue.unfinished()
            response.success, response.states = True, [state_message(change) for change in changes]
        except OptionError as error:
            response.message = str(error)
        return response

    def _answer(self, response: Any, act: Callable[[float], Change]) -> Any:
        """Carry out a request in one transaction, and fill in its response."""
        try:
            now = self._now()
            if now <= 0.0:
                raise OptionError("the ROS clock has not started yet")
            with self._queue.transaction():
                change = act(now)
        except OptionError as error:
            response.message = str(error)
            return response
        response.success = change.state is not TaskState.REFUSED
        response.message, response.state = change.reason, state_message(change)
        self.tell()
        return response


def open_board(node: SuiteNode, team: TeamFile | None, name: str, now: Callable[[], float]) -> WorkBoard | None:
    """Return the board of a coordinator with the parameter `work`; None for a team with a fixed number of deliveries.

    Args:
        node: Node of the coordinator.
        team: The team; None for one without a file.
        name: Name of the team.
        now: Returns the time of the tasks [s].

    Raises:
        ParameterError: The team's work arrives and there is no file for it, or the reverse.
        OptionError: The file cannot be used.
    """
    file, endless = node.settings["work"], team is not None and team.deliveries == 0
    if file and not endless:
        raise ParameterError("parameter 'work' needs a 'team' whose work arrives: its file has 'deliveries: 0'")
    if endless and not file:
        raise ParameterError("parameter 'work' is missing: the work of this team arrives, its file has 'deliveries: 0'")
    return WorkBoard(node, team, name, Path(file), now) if file and team is not None else None


def task_of(message: WorkTask) -> Task:
    """Return the task of a message.

    Raises:
        OptionError: A value lies outside the range given in the message file.
    """
    earliest, latest = _times(message)
    return Task(
        id=message.id,
        origin=message.origin,
        destination=message.destination,
        kind=message.kind or DELIVERY,
        priority=message.priority,
        earliest=earliest,
        latest=latest,
        skill=message.skill,
    )


def state_message(change: Change) -> WorkState:
    """Return the message of a change."""
    task = change.task
    return WorkState(
        header=Header(stamp=_stamp(change.at)),
        number=change.number,
        task=WorkTask(
            id=task.id,
            kind=task.kind,
            origin=task.origin,
            destination=task.destination,
            priority=task.priority,
            earliest=_stamp(task.earliest),
            latest=_stamp(task.latest if math.isfinite(task.latest) else 0.0),
            skill=task.skill,
        ),
        state=int(change.state),
        robot=change.robot,
        reason=change.reason,
    )


def _times(message: WorkTask | ChangeWork.Request) -> tuple[float, float]:
    """Return earliest and latest time [s]; a latest time of 0 stands for none."""
    return seconds(message.earliest), seconds(message.latest) or math.inf


def _stamp(time: float) -> Time:
    return to_stamp(round(1e9 * time))
