"""Learning from bags alone, and what bags say about policies that have not driven."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from ctrl_rl_learning.cli.evaluate_offline import evaluate_offline
from ctrl_rl_learning.cli.learn_offline import learn_offline
from ctrl_rl_learning.errors import LearningError
from ctrl_rl_learning.offline.data.motion import displacements, fit_motion
from ctrl_rl_learning.offline.data.transitions import Transitions, load_transitions, sensed_interface
from ctrl_rl_learning.offline.data.values import StateValues, load_values, solvable
from ctrl_rl_learning.offline.driving.drivers import NoisyPolicy, ScriptedDriver
from ctrl_rl_learning.offline.driving.driving import drive
from ctrl_rl_learning.offline.evaluation.dynamics import fit_dynamics
from ctrl_rl_learning.offline.evaluation.estimators import (
    PolicyValues,
    actions_of,
    episode_estimates,
    fit_values,
    step_ratios,
)
from ctrl_rl_learning.offline.evaluation.recorded import look_at
from ctrl_rl_learning.offline.evaluation.replay import replay
from ctrl_rl_learning.offline.evaluation.roll_outs import LearntWorld, at_rest, can_model, rest_of, roll_out
from ctrl_rl_learning.offline.evaluation.surroundings import Surroundings
from ctrl_rl_learning.offline.learners.learning import improved_actions, learn
from ctrl_rl_learning.offline.learners.settings import METHODS, NEEDS_REWARD, NEEDS_VALUE, LearningSettings
from ctrl_rl_learning.sb3.environment import DEPLOYED_RATE

from ctrl_rl_core import Actor, load_navigation_task, load_policy
from sim_bridge import NavigationEnv, SimulationOptions
from ttr_reward_node import RewardEvaluator, load_value, problem_from_task, relabel, solve

TASK = load_navigation_task("car_navigation")


@pytest.fixture(scope="module")
def value(tmp_path_factory) -> Path:
    problem = problem_from_task(solvable(TASK), counts=(31, 31, 18), inflation=TASK.robot.radius)
    file = tmp_path_factory.mktemp("values") / "car_navigation.safetensors"
    solve(problem).grid.save(file)
    return file


@pytest.fixture(scope="module")
def bag(tmp_path_factory, value: Path) -> Path:
    folder = tmp_path_factory.mktemp("drives")
    drives = drive(TASK, ScriptedDriver(TASK), 30, 0, folder / "plain")
    assert {1, 2} <= set(drives.outcomes.tolist())
    function = load_value(value)
    relabel(folder / "plain", folder / "bag", function, RewardEvaluator(TASK, function))
    return folder


@pytest.fixture(scope="module")
def transitions(bag: Path) -> Transitions:
    return load_transitions([bag], TASK)


def test_a_bag_gives_what_was_driven(bag: Path, transitions: Transitions) -> None:
    again = drive(TASK, ScriptedDriver(TASK), 30, 0)
    ends = np.append(np.flatnonzero(transitions.first)[1:] - 1, len(transitions) - 1)
    assert transitions.episode_count == 30
    np.testing.assert_array_equal(transitions.outcomes[ends], again.outcomes)
    np.testing.assert_array_equal(np.diff(np.append(np.flatnonzero(transitions.first), len(transitions))), again.steps)
    np.testing.assert_allclose(transitions.returns(0.99), again.returns(0.99))
    # Rewards are the relabelled ones, the task's at the end; without relabelling none is known before the end.
    assert set(transitions.rewards[ends].tolist()) == {1000.0, -400.0}
    running = transitions.outcomes == 0
    assert (transitions.rewards[running] < 0.0).all()
    plain = load_transitions([bag / "plain"], TASK)
    assert np.isnan(plain.rewards[running]).all()
    np.testing.assert_array_equal(plain.observations, transitions.observations)


def test_observations_are_those_of_the_environment(transitions: Transitions) -> None:
    environment = NavigationEnv(TASK, options=SimulationOptions(engine="planar", rate=30))
    try:
        seen, _ = environment.reset(seed=0)
        np.testing.assert_allclose(transitions.observations[0], seen, atol=1e-5)
        for step in range(3):
            seen, *_ = environment.step(transitions.actions[step])
            np.testing.assert_allclose(transitions.next_observations[step], seen, atol=1e-4)
    finally:
        environment.close()
    assert DEPLOYED_RATE == 240


@pytest.mark.parametrize("method", METHODS)
def test_every_method_leaves_a_policy_that_a_node_runs(
    method: str, transitions: Transitions, value: Path, tmp_path: Path
) -> None:
    values = load_values(str(value), TASK, tmp_path) if method in NEEDS_VALUE else None
    settings = LearningSettings(method, updates=30, hidden=16)
    actor = learn(transitions, TASK, settings, values)
    actor.save(tmp_path / "policy.safetensors")
    again = learn(transitions, TASK, settings, values)
    assert all((one == other).all() for one, other in zip(actor.weights, again.weights, strict=True))
    policy = load_policy(tmp_path / "policy.safetensors")
    assert (policy.robot, policy.period, policy.needs) == ("differential_drive", 0.4, {"pose"})
    assert actor.manifest["method"] == method
    assert len(drive(TASK, NoisyPolicy(policy, 0.3), 1, 0).outcomes) == 1


def test_the_value_function_prefers_what_saves_time(transitions: Transitions, value: Path, tmp_path: Path) -> None:
    values = load_values(str(value), TASK, tmp_path)
    advantage = values.advantages(transitions)
    ends = transitions.outcomes
    assert advantage[ends == 2].max() < np.median(advantage[ends == 0]) < 0.2
    # Cloning by it comes closer to the best recorded commands than plain cloning does.
    best = np.argsort(advantage)[-len(advantage) // 4 :]
    errors = []
    for method in ("bc", "value_weight"):
        actor = learn(transitions, TASK, LearningSettings(method, updates=300, hidden=32, temperature=0.5), values)
        own = actions_of(actor, transitions.observations[best])
        errors.append(float(((own - transitions.actions[best]) ** 2).mean()))
    assert errors[1] < errors[0]


def test_a_model_from_the_bags_and_the_value_function_find_better_commands(
    transitions: Transitions, value: Path, tmp_path: Path
) -> None:
    model = fit_motion(transitions)
    assert model.explained.min() > 0.8
    # Seen from the body, a step goes as far in each direction; along x it goes ahead.
    ahead, turned = np.array([[1.0, 0.0]]), np.array([[0.0, 0.0, 0.0], [1.0, -2.0, 0.5 * np.pi]])
    moved = model(turned, np.repeat(ahead, 2, axis=0)) - turned
    assert moved[0, 0] == pytest.approx(moved[1, 1])
    assert moved[0, 0] > 0.3
    values = load_values(str(value), TASK, tmp_path)
    better, known = improved_actions(transitions.states, model, values, 0.2)
    assert known.mean() > 0.9
    assert (np.abs(better) <= 1.0).all()

    def gained(actions: np.ndarray) -> float:
        ends = model(transitions.states[known], actions[known])
        return float(np.mean(values(ends) - values(transitions.states[known])))

    assert gained(better) > gained(transitions.actions) + 0.1
    actor = learn(transitions, TASK, LearningSettings("value_model", updates=300, hidden=32), values)
    assert np.abs(actions_of(actor, transitions.observations) - better)[known].mean() < 0.3


def test_a_model_of_motion_is_refused_where_bags_do_not_show_it(transitions: Transitions) -> None:
    with pytest.raises(LearningError, match="are too few for a model of motion"):
        fit_motion(transitions.rows(np.arange(50)))
    random = np.random.default_rng(0)
    shuffled = dataclasses.replace(transitions, actions=random.permutation(transitions.actions))
    with pytest.raises(LearningError, match="is the robot late or held back"):
        fit_motion(shuffled)


def test_a_learnt_world_looks_as_the_bags_do(transitions: Transitions) -> None:
    random = np.random.default_rng(0)
    around = Surroundings(TASK, [TASK.build_world()])
    world = LearntWorld(TASK, fit_dynamics(transitions, rest_of(TASK)), around, random)
    world.drive(transitions.states[:1], at_rest(world, 1), 1, lambda *_: np.zeros((1, 2), np.float32))
    all_in_one = np.zeros(len(transitions), dtype=np.intp)
    seen = world.observe(all_in_one, transitions.states, displacements(transitions))
    near = np.isclose(seen, transitions.observations, atol=2e-3)
    assert near.mean() > 0.999  # a ray may pass a corner on either side
    # With the step before, a step is known better than by its command alone.
    spread = displacements(transitions)[transitions.outcomes == 0].var(axis=0)
    explained = 1.0 - fit_dynamics(transitions, rest_of(TASK)).errors.var(axis=0) / spread
    assert (explained[[0, 2]] > fit_motion(transitions).explained).all()


def test_roll_outs_in_a_learnt_world_tell_what_a_policy_earns(
    transitions: Transitions, value: Path, tmp_path: Path
) -> None:
    inputs = transitions.observations.shape[1]
    blind = dataclasses.replace(always(0.0, inputs), biases=(np.zeros(4, np.float32), np.array((1.0, 0.0), np.float32)))
    values = load_values(str(value), TASK, tmp_path)
    seeing = learn(transitions, TASK, LearningSettings("value_model", updates=300, hidden=32), values)
    bags = look_at(transitions, TASK, 0)
    returns = [roll_out(bags, actor, 0.99, 2, 0).returns for actor in (blind, seeing)]
    assert [each.shape for each in returns] == [(4, 30), (4, 30)]
    assert returns[0].mean() < -100.0  # full speed ahead, into a wall
    assert returns[1].mean() > returns[0].mean() + 300.0
    assert all((each >= TASK.rewards.collision).all() and (each <= TASK.rewards.goal).all() for each in returns)


def test_a_model_is_believed_where_it_replays_the_bags(transitions: Transitions) -> None:
    found = replay(look_at(transitions, TASK, 0), 0)
    assert found.agreement > 0.6
    assert found.attainable == pytest.approx(found.agreement, abs=0.2)
    random = np.random.default_rng(0)
    shuffled = dataclasses.replace(transitions, actions=random.permutation(transitions.actions))
    assert replay(look_at(shuffled, TASK, 0), 0).agreement < 0.5


def test_robots_on_wheels_are_modelled() -> None:
    for name in ("car_navigation", "curved_corridor", "corridor_doorways", "corridor_sudden"):
        assert can_model(load_navigation_task(name)), name
    assert not can_model(load_navigation_task("quad_navigation"))


def test_in_a_corridor_a_policy_does_not_observe_its_pose() -> None:
    sources = [part.source for part in sensed_interface(load_navigation_task("curved_corridor")).observation]
    assert sources == ["odometry", "scan"]


def test_in_a_corridor_nobody_is_taught_to_drive_back(tmp_path: Path) -> None:
    task = load_navigation_task("curved_corridor")
    assert 0.0 in drive(task, ScriptedDriver(task), 6, 0, tmp_path / "bag").success  # some turned around
    solve(problem_from_task(solvable(task), counts=(55, 34, 36), inflation=task.robot.radius)).grid.save(
        tmp_path / "value.safetensors"
    )
    values = load_values(str(tmp_path / "value.safetensors"), task, tmp_path)
    recorded = load_transitions([tmp_path / "bag"], task)
    best, _ = improved_actions(recorded.states, fit_motion(recorded), values, 0.2)
    assert (best[:, 0] < 0.0).mean() > 0.05
    actor = learn(recorded, task, LearningSettings("value_model", updates=200, hidden=32), values)
    assert (actions_of(actor, recorded.observations)[:, 0] < 0.0).mean() < 0.01


def line_of(length: int, episodes: int) -> Transitions:
    """Return episodes of a made-up task: an action of 1 at the end reaches the goal, one of -1 collides."""
    random = np.random.default_rng(0)
    count = length * episodes
    step = np.tile(np.arange(length), episodes)
    actions = random.choice((-1.0, 1.0), size=(count, 2)).astype(np.float32)
    seen = np.stack((step / length, random.normal(size=count)), axis=1).astype(np.float32)
    last = step == length - 1
    paid = np.where(last, np.where(actions[:, 0] > 0.0, 1000.0, -400.0), 0.0)
    outcomes = np.where(last, np.where(actions[:, 0] > 0.0, 1, 2), 0)
    empty = np.zeros((count, 3))
    number = np.repeat(np.arange(episodes), length)
    return Transitions(
        seen, actions, paid, paid, np.roll(seen, -1, axis=0), last, empty, empty, number, outcomes, step == 0
    )


def always(action: float, inputs: int = 2) -> Actor:
    weights = (np.zeros((4, inputs), np.float32), np.zeros((2, 4), np.float32))
    biases = (np.zeros(4, np.float32), np.full(2, action, np.float32))
    bounds = {"low": np.full(2, -1.0, np.float32), "high": np.ones(2, np.float32)}
    scales = {"middle": np.zeros(inputs, np.float32), "unit": np.ones(inputs, np.float32)}
    return Actor(weights, biases, "relu", squashed=False, **scales, **bounds)


def test_estimates_find_the_return_of_policies_that_never_drove() -> None:
    recorded, discount = line_of(2, 200), 0.9
    found = {}
    for action in (-1.0, 1.0):
        values = fit_values(recorded, always(action), discount, 150, 0, (-400.0, 1000.0))
        own = actions_of(always(action), recorded.observations)
        ratios = step_ratios(recorded, np.zeros_like(own), own)
        robust, effective = episode_estimates(recorded, values, ratios, discount)
        found[action] = values.before[recorded.first].mean(), robust.mean()
        assert 1.0 < effective <= 200.0
    for method in range(2):
        assert found[1.0][method] == pytest.approx(1000.0 * discount, abs=60.0)
        assert found[-1.0][method] == pytest.approx(-400.0 * discount, abs=60.0)


def test_the_correction_mends_a_wrong_fit() -> None:
    recorded = line_of(1, 400)
    wrong = PolicyValues(*(np.full(400, each) for each in (0.0, 0.0, 0.0)))
    own = np.ones_like(recorded.actions)
    estimates, _ = episode_estimates(recorded, wrong, step_ratios(recorded, np.zeros_like(own), own), 0.9)
    assert estimates.mean() == pytest.approx(1000.0, abs=60.0)  # commands of the driver near 0 count a little


def test_the_commands_learn_judge_and_refuse(bag: Path, value: Path, tmp_path: Path, capsys) -> None:
    policy = tmp_path / "policy.safetensors"
    common = [str(bag), "--task", "car_navigation"]
    assert learn_offline([*common, "--method", "bc", "--updates", "50", "--output", str(policy)]) == 0
    assert "30 episodes" in capsys.readouterr().out
    # What hardly learnt anything is not called better, and what learnt nothing about the task neither.
    judged = ["--policy", str(policy), "--updates", "100", "--fits", "2", "--value", str(value)]
    assert evaluate_offline([*common, *judged, "--results", str(tmp_path / "told.json")]) == 1
    said = capsys.readouterr()
    assert "not show a gain" in said.err
    assert "doubly robust" in said.out
    assert "the model replays the bags with a correlation of" in said.out
    assert learn_offline([*common, "--output", str(policy)]) == 1
    assert "exists" in capsys.readouterr().err
    plain = [
        str(bag / "plain"),
        "--task",
        "car_navigation",
        "--method",
        "iql",
        "--output",
        str(tmp_path / "p.safetensors"),
    ]
    assert learn_offline(plain) == 1
    assert "relabel them first" in capsys.readouterr().err
    assert learn_offline(["nowhere", "--task", "car_navigation", "--output", str(tmp_path / "p.safetensors")]) == 1
    assert "no such bag" in capsys.readouterr().err


def test_a_driver_without_a_goal_keeps_to_the_corridor() -> None:
    corridor = load_navigation_task("curved_corridor")
    assert drive(corridor, ScriptedDriver(corridor), 1, 0).steps[0] > 20


def test_a_value_of_another_task_is_refused() -> None:
    class Other:
        kind, state_names, grids = "time_to_reach", ("x", "z"), ()

    with pytest.raises(LearningError, match="the value function's states are x, z"):
        StateValues(Other(), TASK)
    assert set(METHODS) >= NEEDS_REWARD | NEEDS_VALUE
