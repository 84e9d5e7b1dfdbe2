"""Trajectories from bags: a simulated team's record, written like a coordinator's, is read back unchanged."""

import shutil
from dataclasses import fields

import numpy as np
import pytest
import torch
from option_coordinator.data.bag_trajectory import TeamLayout
from option_coordinator.training.learners.mappo import Mappo
from team_bag import TeamBag, play_into

from ctrl_rl_bags import BagWriter, Topic
from ctrl_rl_core import CtrlRlError
from option_coordinator import OptionTrajectory, make_environment, recordings


def untrained(environment, presence=False):
    torch.manual_seed(0)
    return Mappo(environment.agents, "table", presence=presence).behaviour(0.0)


def assert_same(one, other):
    for field in fields(OptionTrajectory):
        a, b = getattr(one, field.name), getattr(other, field.name)
        assert a.dtype == b.dtype, field.name
        assert a == pytest.approx(b, rel=1e-12) if a.dtype == float else np.array_equal(a, b), field.name


@pytest.mark.parametrize(
    ("task", "synchronisation", "drop"),
    [
        ("tool_delivery", "async", 0.0),
        ("tool_delivery", "async", 1.0),
        ("tool_delivery", "wait", 0.0),
        ("water_filling", "async", 0.0),
    ],
)
def test_what_is_read_is_what_happened(tmp_path, task, synchronisation, drop):
    environment = make_environment(task, synchronisation, drop=drop)
    with TeamBag(tmp_path / "bag") as bag:
        played = play_into(bag, environment, untrained(environment, drop > 0.0), "abc", 2)
    found = recordings(tmp_path / "bag")
    assert [recording.digest for recording in found] == ["abc", "abc"]
    assert {recording.team for recording in found} == {TeamLayout.of(environment.agents)}
    for recording, trajectory in zip(found, played, strict=True):
        assert_same(recording.trajectory, trajectory)
    if drop:
        assert not all(trajectory.present.all() for trajectory in played)


class Tape:
    """Decisions of one episode, for writing with faults."""

    def __init__(self):
        environment = make_environment("tool_delivery")
        policy, generator = untrained(environment), np.random.default_rng(0)
        self.rows, decision = [], environment.reset(0)
        while not decision.over:
            given = policy.given(decision.observation, decision.choosing, decision.running, decision.legal)
            options = given.sample(generator)
            self.rows.append((decision, options, float(given.log_prob(options))))
            decision = environment.step(decision.named(options))
        self.rows.append((decision, decision.running, 0.0))

    def write(self, folder, change=lambda _: {}, skip=()):
        with TeamBag(folder) as bag:
            for number, row in enumerate(self.rows):
                if number not in skip:
                    bag.put(*row, **({"digest": "abc", "number": number} | change(number)))
        return folder


@pytest.fixture(scope="module")
def tape():
    return Tape()


def lengths(bag):
    return [len(recording.trajectory) for recording in recordings(bag)]


def test_a_lost_decision_a_new_life_and_another_policy_part_what_happened(tmp_path, tape):
    steps = len(tape.rows) - 1
    assert lengths(tape.write(tmp_path / "whole")) == [steps]
    assert lengths(tape.write(tmp_path / "gap", skip=(5,))) == [4, steps - 6]
    assert lengths(tape.write(tmp_path / "epoch", lambda number: {"epoch": 1 + (number >= 5)})) == [4, steps - 5]
    other = tape.write(tmp_path / "digest", lambda number: {"digest": "ab"[number >= 5]})
    assert lengths(other) == [5, steps - 5]  # the last step of the first still knows what came of it
    one, two = (recording.trajectory for recording in recordings(other))
    assert np.array_equal(one.next_observation[-1], two.observation[0])
    assert one.last[-1]
    assert not one.terminated[-1]
    failed = tape.write(tmp_path / "failed", lambda number: {"digest": "" if number == 5 else "a"})
    assert [(r.digest, len(r.trajectory)) for r in recordings(failed)] == [("a", 5), ("", 1), ("a", steps - 6)]


def test_two_coordinators_at_a_time_are_kept_apart(tmp_path, tape):
    with TeamBag(tmp_path / "bag") as bag:
        for number, row in enumerate(tape.rows):
            for epoch in (1, 2):
                bag.put(*row, digest="abc", number=number, epoch=epoch)
    one, two = recordings(tmp_path / "bag")
    assert_same(one.trajectory, two.trajectory)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"absent": np.array([False])}, "not all for 3 robots"),
        ({"observations": np.zeros(3, np.float32)}, "not as long"),
        ({"options": np.array([9, 0, 0], np.int32)}, "do not match the robots that are present"),
        ({"options": np.array([-1, 0, 0], np.int32)}, "do not match the robots that are present"),
        ({"legal": np.zeros(12, bool)}, "not legal"),
        ({"reward": np.nan}, "finite"),
        ({"discount": 0.0}, "discount 0"),
    ],
)
def test_decisions_that_make_no_sense_are_refused(tmp_path, tape, changes, words):
    bag = tape.write(tmp_path / "bag", lambda number: changes if number == 0 else {})
    with pytest.raises(CtrlRlError, match=rf"bag: /joint_option_step: decision 0: .*{words}"):
        recordings(bag)


def test_bags_that_hold_nothing_to_learn_from_are_refused(tmp_path, tape):
    with pytest.raises(CtrlRlError, match="no such bag"):
        recordings(tmp_path / "none")
    with BagWriter(tmp_path / "other") as writer:
        writer.add_topic(Topic("/word", "std_msgs/msg/String", "string data\n"))
        writer.write("/word", b"\x00\x01\x00\x00\x01\x00\x00\x00\x00", 1)
    with pytest.raises(CtrlRlError, match="no topic of ctrl_rl_msgs/msg/JointOptionStep"):
        recordings(tmp_path / "other")
    with pytest.raises(CtrlRlError, match="no decision has a successor"):
        recordings(tape.write(tmp_path / "one", skip=range(1, len(tape.rows))))
    whole = tape.write(tmp_path / "whole")
    cut = shutil.copytree(whole, tmp_path / "cut")
    (cut / "metadata.yaml").unlink()
    with pytest.raises(CtrlRlError, match=r"cut off, it has no metadata\.yaml; recover it"):
        recordings(cut)
    (file,) = whole.glob("*.mcap")
    content = bytearray(file.read_bytes())
    content[len(content) // 3 : len(content) // 2] = bytes(len(content) // 2 - len(content) // 3)
    file.write_bytes(content)
    with pytest.raises(CtrlRlError, match="whole"):
        recordings(whole)
