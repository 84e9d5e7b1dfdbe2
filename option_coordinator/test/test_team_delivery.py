"""Lightweight environment of a delivery team: episodes, agreement with the real robots, and learning."""

import numpy as np
import pytest
from option_coordinator.environments.tasks import make_simulation
from option_coordinator.environments.tasks.team_delivery import TeamDeliverySimulation
from option_coordinator.teams.team_file import FOLDER, TeamRewards
from option_coordinator.training.experiments.evaluation import summary

from ctrl_rl_core import TaskError, task_digest
from option_coordinator import (
    OptionEnvironment,
    OptionError,
    OptionPolicy,
    RandomPolicy,
    TeamFile,
    load_option_task,
    load_team,
    make_environment,
    play_episodes,
    scripted_policy,
    shipped_policies,
)

TEAM = load_team("delivery_team")
WAIT, SHELF, OTHER_SHELF, DESK, OTHER_DESK, HOME = range(6)
PARCELS = TEAM.deliveries * len(TEAM.robots)


def changed(**changes):
    return TeamFile.model_construct(**{name: getattr(TEAM, name) for name in TeamFile.model_fields} | changes)


def until_ended(simulation):
    while True:
        step = simulation.step()
        if step.ended[0]:
            return step


@pytest.mark.parametrize("scripted", [True, False])
def test_whatever_makes_sense_brings_every_parcel(scripted):
    environment = make_environment("delivery_team")
    chooser = scripted_policy(environment) if scripted else RandomPolicy(0)
    for episode in play_episodes(environment, chooser, range(3)):
        assert episode.terminated
        assert episode.figures["deliveries"] == PARCELS
        assert episode.figures["makespan"] == pytest.approx(episode.steps * TEAM.time_step)


def test_the_scripted_policy_is_a_baseline_worth_beating():
    """It is much quicker than random options, which going to any free station was not."""
    environment = make_environment("delivery_team")
    choosers = scripted_policy(environment), RandomPolicy(0)
    scripted, random = (summary(list(play_episodes(environment, each, range(5)))) for each in choosers)
    assert scripted["makespan"] < 0.95 * random["makespan"]
    assert scripted["return"] > random["return"] + 2.0


def test_robots_stay_in_the_room_and_out_of_the_obstacle():
    environment = OptionEnvironment(make_simulation(TEAM), film=True)
    list(play_episodes(environment, RandomPolicy(3), [3]))
    places = np.array([list(scene.robots.values()) for scene in environment.scenes])
    (left, right), (bottom, top) = environment.simulation.room
    assert (places > (left, bottom)).all()
    assert (places < (right, top)).all()
    assert not (np.abs(places - (0.0, 0.35)) < 0.15).all(axis=-1).any()
    moved = np.linalg.norm(np.diff(places, axis=0), axis=-1)
    assert moved.max() <= 0.2 * TEAM.time_step + 1e-9


def test_the_joint_reward_is_the_sum_of_what_each_robot_earns():
    """The rewards that robots report to a coordinator sum to the joint reward used for learning."""
    simulation = TeamDeliverySimulation(changed(rewards=TeamRewards(step=-0.5, delivery=7.0)))
    simulation.reset(np.random.default_rng(1))
    options = {0: [SHELF, DESK], 1: [OTHER_SHELF, OTHER_DESK], 2: [WAIT] * 5}
    expected = 0.0
    for agent, chosen in options.items():
        simulation.begin(agent, chosen.pop(0))
    for _ in range(1000):
        carrying = sum(work.option is not None for work in simulation._work)
        delivered = simulation.figures()["deliveries"]
        step = simulation.step()
        expected = -0.5 * carrying + 7.0 * (simulation.figures()["deliveries"] - delivered)
        assert step.reward == pytest.approx(expected)
        for agent in np.flatnonzero(step.ended):
            if options[int(agent)]:
                simulation.begin(int(agent), options[int(agent)].pop(0))
    assert simulation.figures()["deliveries"] == 2


def test_who_is_at_home_costs_nothing_and_has_no_other_option():
    simulation = TeamDeliverySimulation(changed(robots={"robot_1": TEAM.robots["robot_1"]}))
    simulation._work[0].delivered = TEAM.deliveries
    simulation.begin(0, HOME)
    step = until_ended(simulation)
    assert step.terminated
    assert np.flatnonzero(simulation.legal(0)).tolist() == [HOME]
    simulation.begin(0, HOME)
    assert simulation.step().reward == 0.0


def test_an_option_that_takes_too_long_is_over_and_brings_nothing():
    options = {name: o.model_copy(update={"longest": 2.0}) for name, o in TEAM.options.items()}
    simulation = TeamDeliverySimulation(changed(options=options))
    simulation.reset(np.random.default_rng(0))
    simulation.begin(0, SHELF)
    until_ended(simulation)
    assert simulation.figures()["makespan"] == pytest.approx(2.0)
    assert not simulation._work[0].carries


def test_a_team_is_a_task_by_name_or_by_file(tmp_path):
    assert load_option_task("delivery_team") == TEAM
    file = tmp_path / "mine.yaml"
    file.write_text((FOLDER / "delivery_team.yaml").read_text())
    with pytest.raises(OptionError, match="must be the file's name 'mine'"):
        load_option_task(str(file))
    file.write_text(file.read_text().replace("name: delivery_team", "name: mine"))
    assert task_digest(load_option_task(str(file))) == task_digest(changed(name="mine"))
    for how in ({"sight": "image"}, {"level": "thesis"}, {"level": "actions"}):
        with pytest.raises(OptionError, match="delivery_team"):
            make_simulation(TEAM, **how)


def test_a_room_too_small_for_the_team_is_refused():
    robots = {f"robot_{i}": TEAM.robots["robot_1"] for i in range(30)}
    with pytest.raises(TaskError, match="no room for 30 robots"):
        TeamDeliverySimulation(changed(robots=robots))


@pytest.mark.fault
def test_five_robots_find_room_in_every_episode():
    """A layout without space for the last robot is drawn again."""
    robots = {f"robot_{i}": TEAM.robots["robot_1"] for i in range(5)}
    simulation = TeamDeliverySimulation(changed(robots=robots))
    for seed in range(300):
        simulation.reset(np.random.default_rng(seed))
        places = simulation._poses[:, :2]
        distances = np.linalg.norm(places[:, None] - places[None], axis=-1)[np.triu_indices(5, 1)]
        assert distances.min() >= 2.0 * 0.123 + 0.1 - 1e-9


@pytest.mark.parametrize("name", shipped_policies())
def test_a_shipped_policy_is_of_its_team_and_beats_the_scripted_one(name):
    file = shipped_policies()[name]
    assert file.stat().st_size < 1_000_000
    team = load_team(name)
    policy = OptionPolicy.load_for(name, (robot.agent for robot in team.coordinated))
    assert policy.manifest["task_digest"] == task_digest(team)
    environment = make_environment(name)
    random = np.random.default_rng(0)
    learnt = summary(list(play_episodes(environment, lambda decision: policy.choose(decision, random), range(5))))
    scripted = summary(list(play_episodes(environment, scripted_policy(environment), range(5))))
    assert learnt["return"] > scripted["return"]
    assert learnt["makespan"] < scripted["makespan"]
