"""The burger's policies learn on a robot in a corridor: cloned from a Koopman policy, judged by the pose alone."""

from pathlib import Path

import numpy as np
import pytest
from ctrl_rl_learning.offline.data.values import solvable
from ctrl_rl_learning.on_robot.environment.rewards import StepReward
from ctrl_rl_learning.on_robot.environment.robot import Driven, StepEnd
from ctrl_rl_learning.on_robot.environment.robot_env import RobotEnv
from ctrl_rl_learning.on_robot.learning.fine_tuner import FineTuner, TuneSettings
from ctrl_rl_learning.on_robot.learning.policy import read_or_clone
from ctrl_rl_learning.on_robot.learning.session import Session

from ctrl_rl_core import Actor, FunctionDriver, NavigationTask, drive, load_navigation_task, load_policy
from sim_bridge import RobotSenses, SimulatedWorld, SimulationOptions
from ttr_reward_node import TimeToReach, load_value, problem_from_task, solve

TASK = load_navigation_task("curved_corridor")
RATE = 30
DRIVES = 3
"""Drives in each round of cloning, half as many as usual."""


class PlanarRobot:
    """The robot of a simulated world without its outcomes: as on a floor, the pose decides."""

    def __init__(self, task: NavigationTask) -> None:
        self.world = SimulatedWorld(task, options=SimulationOptions(engine="planar", rate=RATE))
        self._senses, self._command = RobotSenses(self.world), np.zeros(2)

    def now(self) -> float:
        return self.world.elapsed

    def begin(self, seed: int) -> StepEnd:
        self.world.reset(seed)
        self._senses, self._command = RobotSenses(self.world), np.zeros(2)
        return self.read()

    def drive(self, command: np.ndarray, until: float) -> Driven:
        self._command = command
        self.world.command(0, command)
        self.world.step(max(1, round((until - self.now()) * RATE)))
        return Driven(command, 0.0, 0.0)

    def read(self) -> StepEnd:
        return StepEnd(self._senses(self._command), None, 0)

    def stand(self) -> None:
        self._command = np.zeros(2)


@pytest.fixture(scope="module")
def reward(tmp_path_factory: pytest.TempPathFactory) -> StepReward:
    file = tmp_path_factory.mktemp("value") / "value.safetensors"
    solve(problem_from_task(solvable(TASK), counts=(55, 34, 36), inflation=TASK.robot.radius)).grid.save(file)
    return StepReward(TASK, TimeToReach(load_value(file)))


@pytest.fixture(scope="module")
def cloned(tmp_path_factory: pytest.TempPathFactory) -> tuple[Actor, Path, list[str]]:
    """Give the clone of the Koopman policy that ships, its folder, and what was said about it."""
    folder, told = tmp_path_factory.mktemp("clone"), list[str]()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("ctrl_rl_learning.on_robot.learning.clone.EPISODES", DRIVES)
        actor, _ = read_or_clone("curved_corridor_edmd", False, TASK, 0, folder, told.append)
    return actor, folder, told


def test_a_koopman_policy_becomes_a_network_that_does_the_same(cloned: tuple[Actor, Path, list[str]]) -> None:
    actor, folder, told = cloned
    assert len(told) == 1
    arrived = int(told[0].split("; ")[1].split()[0])
    assert arrived >= DRIVES - 1, told
    assert [part.source for part in actor.interface.observation] == ["odometry", "scan"]
    again = read_or_clone("curved_corridor_edmd", False, TASK, 0, folder, told.append)[0]
    assert len(told) == 1, "it is kept"
    assert all((one == other).all() for one, other in zip(actor.weights, again.weights, strict=True))
    policy = load_policy(folder / "cloned.safetensors")
    np.testing.assert_allclose(policy.limits, (actor.low, actor.high), atol=1e-6)


def test_the_goal_along_a_corridor_is_told_by_the_pose(cloned: tuple[Actor, Path, list[str]], reward) -> None:
    actor, _, _ = cloned
    robot = PlanarRobot(TASK)
    try:
        environment = RobotEnv(robot, TASK, actor.interface, reward)
        (episode,) = drive(
            environment,
            FunctionDriver(lambda seen: actor.scaled_action((seen - actor.middle) / actor.unit)),
            seeds=(7,),
        )
        assert episode.outcome == "GOAL"
        assert episode.total > TASK.rewards.goal, "the way brought something, too"
        assert robot.world.episode().outcome.name == "GOAL"
    finally:
        robot.world.close()


def test_an_episode_that_ran_out_of_steps_says_so(cloned: tuple[Actor, Path, list[str]], reward) -> None:
    short = TASK.model_copy(update={"episode": TASK.episode.model_copy(update={"steps": 3})})
    robot = PlanarRobot(short)
    try:
        environment = RobotEnv(robot, short, cloned[0].interface, reward)
        environment.reset(seed=0)
        ends = [environment.step(np.zeros(2, np.float32)) for _ in range(3)]
    finally:
        robot.world.close()
    assert [end[4]["outcome"] for end in ends] == ["RUNNING", "RUNNING", "TIMEOUT"]
    assert [end[2:4] for end in ends] == [(False, False), (False, False), (False, True)]


def test_it_learns_in_the_corridor(cloned: tuple[Actor, Path, list[str]], reward, tmp_path: Path) -> None:
    actor, _, _ = cloned
    robot = PlanarRobot(TASK)
    try:
        environment = RobotEnv(robot, TASK, actor.interface, reward)
        tuner = FineTuner(actor, TuneSettings(updates=1, first_steps=100, first_updates=20), 2000, 0)
        session = Session(environment, tuner, tmp_path, 0, {"policy": "curved_corridor_edmd"})
        session.learn(60.0, lambda _log: None)
        tested = session.test(2, lambda _log: None)
    finally:
        robot.world.close()
    assert session.seconds >= 60.0
    assert session.episodes[-1].losses
    assert all(each.outcome in ("GOAL", "TIMEOUT", "FENCE", "RUNNING") for each in tested)
    assert load_policy(tmp_path / "policy.safetensors").period == pytest.approx(0.2)
