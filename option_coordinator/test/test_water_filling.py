"""Water Filling: published constants, and invariants for any choices."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from option_coordinator.environments.tasks.water_filling import WaterFillingSimulation
from option_coordinator.scripted.task_policies import GreedyFiller, JarCycle

from ctrl_rl_core import CtrlRlError
from option_coordinator import OptionEnvironment, RandomPolicy, load_option_task, make_environment

TASK = load_option_task("water_filling")


def mean_reward(environment, chooser, seed):
    decision = environment.reset(seed)
    while not decision.over:
        decision = environment.step(chooser(decision))
    return environment.figures()["mean_reward"]


def test_options_are_the_published_and_the_thesis_ones():
    assert [len(agent.options) for agent in WaterFillingSimulation(TASK).agents] == [7, 7]
    vehicle, drone = WaterFillingSimulation(TASK, "thesis").agents
    assert len(vehicle.options) == 13  # four moves; Fill, NavTo, NavToFill of each jar
    assert drone.options == ("Up", "Down", "Left", "Right", "NavTo:bottle", "NavTo:cup", "NavTo:mug")


def test_speeds_and_reach():
    """The drone is four times as fast; both stop within a metre."""
    environment = make_environment("water_filling")
    environment.reset(0)
    mug = environment.agents[0].options.index("NavToFill:mug")
    steps = {}
    decision = environment.step({"vehicle": mug, "drone": environment.agents[1].options.index("NavTo:mug")})
    steps["drone"] = environment.steps
    while "vehicle" not in decision.ready:
        decision = environment.step({"drone": environment.agents[1].options.index("NavTo:mug")})
    steps["vehicle"] = environment.steps
    assert steps == {"drone": 2, "vehicle": 7}
    places = environment.simulation.scene().robots
    way = np.linalg.norm(np.subtract(places["vehicle"], environment.simulation.landmarks["mug"]))
    assert way <= 1.0
    assert environment.simulation.levels[2] == 1.0


def test_who_runs_on_sees_what_is_known_now():
    """Level readings are shared, so every robot observes the most recent ones."""
    environment = make_environment("water_filling")
    decision = environment.reset(0)
    for _ in range(30):
        decision = environment.step(dict.fromkeys(decision.ready, 0))
        for index, agent in enumerate(environment.agents):
            assert np.array_equal(decision.observations[agent.name], environment.simulation.observe(index))


def test_the_reward_is_eq_5_6():
    environment = make_environment("water_filling")
    environment.reset(0)
    decision = environment.step({"vehicle": 3, "drone": 3})
    levels = environment.simulation.levels
    assert decision.rewards[-1] == pytest.approx(sum(1.0 - 1.0 / (level + 0.001) for level in levels))


def test_levels_fall_as_published():
    """Intervals average 9.5 steps; drops follow a folded normal distribution."""
    simulation = WaterFillingSimulation(TASK)
    simulation.reset(np.random.default_rng(0))
    waits, drops = [], []
    for _ in range(4000):
        simulation._draw(0)
        waits.append(simulation._wait[0])
        drops.append(simulation._drop[0])
    assert np.mean(waits) == pytest.approx(9.5, rel=0.05)
    assert np.mean(drops) == pytest.approx(0.2 * np.sqrt(2.0 / np.pi), rel=0.05)
    assert min(drops) >= 0.0


def test_knowing_more_is_better():
    environment = make_environment("water_filling")
    scores = {
        name: np.mean([mean_reward(environment, make(seed), seed) for seed in range(3)])
        for name, make in {
            "random": RandomPolicy,
            "cycle": lambda _: JarCycle(),
            "greedy": lambda _: GreedyFiller(environment.simulation),
        }.items()
    }
    assert scores["random"] < scores["cycle"] < scores["greedy"] < 0.0


@pytest.mark.parametrize("options", ["published", "thesis", "actions"])
@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=8, deadline=None)
def test_what_holds_for_any_choices(options, seed):
    simulation = WaterFillingSimulation(TASK, options)
    environment = OptionEnvironment(simulation)
    chooser = RandomPolicy(seed)
    decision = environment.reset(seed)
    for _ in range(80):
        decision = environment.step(chooser(decision))
        assert np.all((simulation.levels >= 0.0) & (simulation.levels <= 1.0))
        assert np.all(np.isfinite(decision.observation))
        assert np.all((decision.observation[:2] >= 0.0) & (decision.observation[:2] <= 1.0))
        assert all(mask.any() for mask in decision.masks.values())
        if options == "actions":
            assert decision.duration == 1


def test_the_same_seed_gives_the_same_episode():
    scores = {mean_reward(make_environment("water_filling"), JarCycle(), 7) for _ in range(2)}
    assert len(scores) == 1
    assert scores != {mean_reward(make_environment("water_filling"), JarCycle(), 8)}


def test_images_show_the_robots_and_the_jars():
    simulation = WaterFillingSimulation(TASK, sight="image")
    size = simulation.agents[0].observation_size
    image = simulation.observe(0)[:-6].reshape(3, 31, 19)
    assert size == len(simulation.observe(1)) == 3 * 31 * 19 + 6
    assert image[0].sum() == image[1].sum() == 1.0
    assert image[2].sum() == 1.5  # three jars, none in reach


def test_illegal_moves_are_refused():
    environment = OptionEnvironment(WaterFillingSimulation(TASK, "actions"))
    environment.reset(0)
    with pytest.raises(CtrlRlError, match="'Fill' is not legal"):
        environment.step({"vehicle": 4, "drone": 0})
