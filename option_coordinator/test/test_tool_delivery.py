"""Tool Delivery as specified: trajectories of the published environment, rules, and invariants for any choices."""

import json
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from option_coordinator.environments.tasks import make_simulation

from ctrl_rl_core import CtrlRlError
from option_coordinator import OptionEnvironment, RandomPolicy, load_option_task, make_environment, scripted_policy

TASK = load_option_task("tool_delivery")
GO_TO_WS, GO_TO_TR, GET_TOOL = range(3)


def play(environment, chooser, seed=0):
    """Play an episode and return its decisions; the first contains no choice."""
    decisions = [environment.reset(seed)]
    while not decisions[-1].over:
        decisions.append(environment.step(chooser(decisions[-1])))
    return decisions


def total(decisions):
    return sum(sum(decision.rewards) for decision in decisions)


def choose(t0=None, t1=None, fetch=None):
    named = {"turtlebot_0": t0, "turtlebot_1": t1, "fetchbot": fetch}
    return {name: option for name, option in named.items() if option is not None}


def test_the_script_reaches_the_optimum():
    environment = make_environment("tool_delivery", discount=1.0)
    decisions = play(environment, scripted_policy(environment))
    assert total(decisions) == 260.0
    assert environment.figures() == {"steps": 40, "deliveries": 3, "failed_passes": 0}
    assert decisions[-1].terminated
    assert not decisions[-1].truncated
    spans = {(s.agent, s.option, s.begin, s.end, s.finished) for s in environment.trace.spans}
    assert {
        ("fetchbot", "SearchTool0", 0, 6, True),
        ("fetchbot", "PassTo1", 6, 10, True),
        ("turtlebot_1", "GetTool", 0, 10, True),
        ("turtlebot_1", "GoToWS", 10, 19, True),
        ("turtlebot_0", "GetTool", 0, 15, True),  # patience ends: 5 steps of driving, the last of them waiting, 10 more
        ("turtlebot_0", "GetTool", 15, 20, True),
        ("fetchbot", "PassTo1", 27, 31, True),
        ("turtlebot_1", "GoToWS", 31, 40, True),
    } <= spans


def test_the_first_observations_of_the_script():
    environment = make_environment("tool_delivery")
    decisions = play(environment, scripted_policy(environment))

    def bits(decision, name):
        return "".join(str(int(bit)) for bit in decision.observations[name])

    assert bits(decisions[0], "turtlebot_0") == "0001000000000"  # nowhere, empty, nothing staged
    assert bits(decisions[0], "fetchbot") == "0000"
    assert decisions[1].duration == 6
    assert bits(decisions[1], "fetchbot") == "1011"  # one staged, both wait
    assert bits(decisions[1], "turtlebot_0") == "0001000000000"  # still runs: not refreshed
    assert decisions[2].ready == ("turtlebot_1", "fetchbot")
    assert bits(decisions[2], "turtlebot_1") == "0010000010000"  # at the table, tool 0 in the basket
    assert decisions[2].running_options == {"turtlebot_0": GET_TOOL}
    at_workshop = next(d for d in decisions if d.observations["turtlebot_1"][0] == 1.0)
    assert sum(d.duration for d in decisions[: decisions.index(at_workshop) + 1]) == 19
    assert bits(at_workshop, "turtlebot_1") == "1000010000000"  # delivered in step 19: the human is at stage 1


PUBLISHED = json.loads((Path(__file__).parent / "tool_delivery_published.json").read_text(encoding="utf-8"))


def test_it_goes_as_the_published_environment_step_for_step():
    """Observations, rewards and ends of 120 recorded episodes of the published environment: record_published.py."""
    environment, steps, deliveries = make_environment("tool_delivery"), 0, []
    for episode in PUBLISHED:
        decision = environment.reset(0)
        for options, duration, rewards, ready, seen in episode:
            assert not decision.over
            chosen = {a.name: int(o) for a, o in zip(environment.agents, options, strict=True) if o != "-"}
            decision = environment.step(chosen)
            expected = [-1.0] * duration
            for step, reward in rewards:
                expected[step] = reward
            assert decision.rewards == tuple(expected)
            if not decision.over:
                assert "".join(str(int(chooses)) for chooses in decision.choosing) == ready
                bits = f"{int(seen, 16):030b}"
                assert "".join(str(int(bit)) for bit in decision.observation) == bits
        assert decision.over
        steps += environment.steps
        deliveries.append(environment.simulation.deliveries)
    assert (len(PUBLISHED), steps) == (120, 10_491)
    assert set(deliveries) == {0, 1, 2, 3}


def test_a_reward_is_discounted_over_its_option():
    environment = make_environment("tool_delivery", discount=0.9)
    environment.reset()
    decision = environment.step(choose(GO_TO_TR, GO_TO_WS, 3))
    assert decision.duration == 4  # turtlebot 0 is nearest
    assert decision.reward == pytest.approx(-(1.0 + 0.9 + 0.81 + 0.729))
    assert decision.discount == pytest.approx(0.9**4)


def test_passing_to_nobody_costs_ten():
    environment = make_environment("tool_delivery")
    environment.reset()
    decision = environment.step(choose(GO_TO_WS, GO_TO_WS, 1))
    assert decision.rewards == (-1.0, -1.0, -1.0, -11.0)
    assert environment.figures()["failed_passes"] == 1


def test_an_empty_pass_ends_the_wait_and_costs_nothing():
    environment = make_environment("tool_delivery")
    environment.reset()
    rewards = []
    decision = environment.step(choose(GET_TOOL, GET_TOOL, 0))
    while "turtlebot_0" not in decision.ready:
        there = decision.observations["fetchbot"][2]
        decision = environment.step(choose(fetch=1 if there else 0))
        rewards += decision.rewards
    assert set(rewards) == {-1.0}
    assert not decision.observations["turtlebot_0"][8:11].any()


def test_a_search_finds_one_copy_and_the_table_holds_two():
    environment = make_environment("tool_delivery")
    environment.reset()
    fetchbot = environment.simulation.fetchbot
    decision = environment.step(choose(GO_TO_WS, GO_TO_WS, 3))
    for tool in (0, 2, 1):
        while "fetchbot" not in decision.ready:
            decision = environment.step(dict.fromkeys(decision.ready, GO_TO_WS))
        robots = {name: GO_TO_WS for name in decision.ready if name != "fetchbot"}
        decision = environment.step({**robots, "fetchbot": 3 + tool})
    while "fetchbot" not in decision.ready:
        decision = environment.step(dict.fromkeys(decision.ready, GO_TO_WS))
    assert fetchbot.staged == [0, 2]
    assert fetchbot.found == {0, 2}
    assert decision.observations["fetchbot"].tolist() == [0.0, 1.0, 0.0, 0.0]


@pytest.mark.parametrize("synchronisation", ["async", "wait", "cut"])
@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=25, deadline=None)
def test_what_holds_for_any_choices(synchronisation, seed):
    environment = OptionEnvironment(make_simulation(TASK), 0.99, synchronisation)
    decisions = play(environment, RandomPolicy(seed))
    for before, after in pairwise(decisions):
        assert after.duration >= 1
        assert after.discount == pytest.approx(0.99**after.duration)
        assert after.reward == pytest.approx(sum(r * 0.99**i for i, r in enumerate(after.rewards)))
        assert np.array_equal(after.running == -1, after.choosing) or after.over
        if synchronisation == "async":
            for i, name in enumerate(a.name for a in after.agents):
                if not after.choosing[i] and not after.over:
                    same = np.array_equal(before.observations[name], after.observations[name])
                    assert same, "who runs on sees nothing new"
        elif not after.over:
            assert after.choosing.all()
    assert all(decision.choosing.any() for decision in decisions[:-1])
    steps = sum(decision.duration for decision in decisions)
    assert steps == environment.steps <= TASK.horizon
    for name in (agent.name for agent in environment.agents):
        spans = sorted(span[2:4] for span in environment.trace.spans if span.agent == name)
        assert spans[0][0] == 0
        assert all(a[1] <= b[0] for a, b in pairwise(spans))
        assert synchronisation == "wait" or all(a[1] == b[0] for a, b in pairwise(spans))
        assert all(span.finished for span in environment.trace.spans if synchronisation == "wait" and span.end < steps)


@pytest.mark.parametrize("synchronisation", ["wait", "cut"])
def test_when_a_synchronous_team_is_cut_off_nobody_runs_on(synchronisation):
    """Values are learnt only at steps where all agents choose, so the time limit must produce such a step."""
    environment = OptionEnvironment(make_simulation(TASK), 0.99, synchronisation)
    for seed in range(4):
        *_, last = play(environment, RandomPolicy(seed), seed)
        if last.truncated:
            break
    assert last.truncated
    assert not last.choosing.any()
    assert np.all(last.running == -1)
    for index, agent in enumerate(environment.agents):
        assert np.array_equal(last.observations[agent.name], environment.simulation.observe(index))
    assert max(span.end for span in environment.trace.spans) == TASK.horizon


def test_without_options_the_fetchbot_knows_its_own_work():
    """The observation two steps into a search differs between searches, since only one of them finds tool 1."""
    environment = OptionEnvironment(make_simulation(TASK, "actions"), 1.0)
    seen = []
    for work in (3, 4):
        environment.reset()
        for _ in range(2):
            decision = environment.step(choose(4, 4, work))
        seen.append(decision.observations["fetchbot"])
    assert not np.array_equal(*seen)
    assert seen[0][4:].tolist() == pytest.approx([0, 0, 0, 1, 0, 0, 2 / 6])


def test_low_level_actions_can_deliver_too():
    """Manual low-level control through the delivery of the first tool."""
    environment = OptionEnvironment(make_simulation(TASK, "actions"), 1.0)
    environment.reset()
    left, right, up, _, stay = range(5)
    t1 = [up] + [left] * 3 + [stay] * 6 + [right] * 8 + [stay]
    fetch = [3] * 6 + [2] * 4 + [0] * 9
    decisions = [environment.step(choose(stay, a, b)) for a, b in zip(t1, fetch, strict=False)]
    assert all(decision.duration == 1 and decision.choosing.all() for decision in decisions)
    assert environment.simulation.deliveries == 1
    assert total(decisions) == 100.0 - len(decisions)


@pytest.mark.parametrize(
    ("choices", "words"),
    [
        (choose(0, 0), "ready are"),
        (choose(0, 0, 6), "no option 6"),
        ({**choose(0, 0, 0), "nobody": 0}, "nobody"),
    ],
)
def test_wrong_choices_are_refused(choices, words):
    environment = make_environment("tool_delivery")
    with pytest.raises(CtrlRlError, match="reset"):
        environment.step(choices)
    environment.reset()
    with pytest.raises(CtrlRlError, match=words):
        environment.step(choices)


def test_only_tasks_with_options_are_taken():
    with pytest.raises(CtrlRlError, match="navigation"):
        load_option_task("car_ttr")
    with pytest.raises(CtrlRlError, match="no images"):
        make_simulation(TASK, sight="image")
