"""The loop that drives every episode: order of calls, effect of filters, and stored data."""

from typing import Any

import numpy as np
import pytest

from ctrl_rl_core import Episodes, FunctionDriver, Outcome, Step, drive, drive_fleet


class Cart:
    """A cart on a line with its seed as start; the goal is at 10, and a wall below 0."""

    def __init__(self, longest: int = 50) -> None:
        self._longest = longest

    def reset(self, *, seed: int) -> tuple[float, dict[str, Any]]:
        self.place, self._steps = float(seed), 0
        return self.place, {"outcome": "RUNNING", "state": np.array([self.place])}

    def step(self, command: np.ndarray) -> tuple[float, float, bool, bool, dict[str, Any]]:
        self.place += float(command[0])
        self._steps += 1
        outcome = "GOAL" if self.place >= 10.0 else "COLLISION" if self.place < 0.0 else "RUNNING"
        info = {"outcome": outcome, "state": np.array([self.place]), "seconds": 0.1 * self._steps}
        return self.place, -1.0, outcome != "RUNNING", self._steps >= self._longest, info


AHEAD = FunctionDriver(lambda _: np.array((1.0, 0.0)))


def test_each_seed_is_an_episode_of_its_own_with_its_facts() -> None:
    episodes = drive(Cart(), AHEAD, seeds=(0, 7, 4))
    assert isinstance(episodes, Episodes)
    assert episodes.seeds.tolist() == [0, 7, 4]
    assert episodes.outcomes == ("GOAL", "GOAL", "GOAL")
    assert (episodes.steps.tolist(), episodes.returns.tolist()) == ([10, 3, 6], [-10.0, -3.0, -6.0])
    assert episodes.seconds == pytest.approx((1.0, 0.3, 0.6))
    assert (episodes.success, episodes.collisions, episodes.rate(Outcome.TIMEOUT)) == (1.0, 0.0, 0.0)
    assert repr(episodes) == "3 episodes: 3 GOAL"
    assert len(episodes[0].trace) == 0


def test_a_filter_goes_before_the_driver_and_what_it_changes_is_counted() -> None:
    def keep_away_from_the_wall(place: float, command: np.ndarray) -> np.ndarray:
        return command if place + command[0] >= 0.0 else np.zeros(2)

    back = FunctionDriver(lambda _: np.array((-1.0, 0.0)))
    assert drive(Cart(), back, seeds=(3,)).outcomes == ("COLLISION",)
    held = drive(Cart(8), back, keep_away_from_the_wall, seeds=(3,))
    assert held.outcomes == ("RUNNING",)
    assert held.changed.tolist() == [5 / 8]


def test_states_are_watched_as_they_come_and_kept_where_that_is_wanted() -> None:
    seen: list[Step[float]] = []
    (episode,) = drive(Cart(), AHEAD, seeds=(8,), keep=True, watch=seen.append)
    assert [step.sensors for step in seen] == [8.0, 9.0, 10.0]
    assert seen[0].command is None
    assert [step.terminated for step in seen] == [False, False, True]
    assert episode.states.tolist() == [[8.0], [9.0], [10.0]]
    assert list(episode.trace) == seen


def test_a_driver_that_fails_ends_the_drive_with_its_error() -> None:
    def refuse(_: float) -> np.ndarray:
        raise ValueError("no command")

    with pytest.raises(ValueError, match="no command"):
        drive(Cart(), FunctionDriver(refuse), seeds=(0,))


class Carts:
    """Carts driven in parallel."""

    def begin(self, seeds: Any) -> tuple[np.ndarray, np.ndarray]:
        self.places = np.array(seeds, float)
        return self.places.copy(), self.places[:, None].copy()

    def step(self, commands: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        self.places += commands
        outcomes = np.where(self.places >= 10.0, int(Outcome.GOAL), int(Outcome.RUNNING))
        return self.places.copy(), self.places[:, None].copy(), -np.ones(len(self.places)), outcomes


def test_a_fleet_is_driven_side_by_side_and_ends_like_one_after_another() -> None:
    together = drive_fleet(Carts(), np.ones_like, (0, 7, 4))
    apart = drive(Cart(), AHEAD, seeds=(0, 7, 4), keep=True)
    for one, other in zip(together, apart, strict=True):
        assert (one.outcome, one.steps, one.total) == (other.outcome, other.steps, other.total)
        assert one.states.tolist() == other.states.tolist()
    cut = drive_fleet(Carts(), np.ones_like, (0, 7), longest=3)
    assert (cut.outcomes, cut.steps.tolist()) == (("RUNNING", "GOAL"), [3, 3])
    assert len(drive_fleet(Carts(), np.ones_like, ())) == 0
