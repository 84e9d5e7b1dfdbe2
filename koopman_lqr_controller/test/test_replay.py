"""The replay: each step with its successor, across episodes and after wrapping around."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from koopman_lqr_controller.training.replay import Later, Mirror, Replay, SequenceReplay, Sequences, Transitions


def live(replay: Replay, lengths: list[int], first: int = 0, terminated: bool = True) -> None:
    """Add episodes; an observation is its global index, and an action and a reward are those of their observation."""
    count = first
    for length in lengths:
        for step in range(length):
            x, u = np.array([count], np.float32), np.array([count / 1000], np.float32)
            replay.add(x, u, count, terminated and step == length - 1)
            count += 1
        replay.end_episode(np.array([count], np.float32))
        count += 1


@settings(deadline=None, max_examples=50)
@given(st.lists(st.integers(1, 9), min_size=1, max_size=8), st.integers(12, 30), st.integers(0, 99))
def test_a_step_is_drawn_with_what_followed_it(lengths: list[int], capacity: int, seed: int) -> None:
    replay = Replay(capacity, (1,), 1, np.float32)
    live(replay, lengths)
    drawn = replay.draw(200, np.random.default_rng(seed))
    assert np.array_equal(drawn.x_next, drawn.x + 1)
    assert np.array_equal(drawn.reward, drawn.x[:, 0])
    ends = np.cumsum(np.array(lengths) + 1) - 2
    assert np.array_equal(drawn.terminated, np.isin(drawn.x[:, 0], ends).astype(np.float32))
    newest = sum(lengths) + len(lengths) - 1
    assert drawn.x.min() > newest - capacity


def test_an_unfinished_episode_gives_all_steps_but_its_last() -> None:
    replay = Replay(10, (1,), 1, np.float32)
    for number in range(4):
        replay.add(np.array([number], np.float32), np.zeros(1, np.float32), 0.0, False)
    assert set(replay.draw(100, np.random.default_rng(0)).x[:, 0]) == {0.0, 1.0, 2.0}


def test_what_was_kept_can_be_taken_up_again() -> None:
    one, other = Replay(16, (1,), 1, np.uint8), Replay(16, (1,), 1, np.uint8)
    live(one, [5, 4, 7, 3])
    other.restore({name: array.copy() for name, array in one.arrays().items()})
    for replay in (one, other):
        live(replay, [3], first=30)
    drawn = [replay.draw(50, np.random.default_rng(1)) for replay in (one, other)]
    assert all(np.array_equal(a, b) for a, b in zip(*drawn, strict=True))


@settings(deadline=None, max_examples=50)
@given(st.lists(st.integers(1, 9), min_size=1, max_size=8), st.integers(14, 30), st.integers(0, 99))
def test_single_pictures_give_the_stacks_that_were_seen(lengths: list[int], capacity: int, seed: int) -> None:
    """A frame contains its number; the first one of an episode also stands for those before it."""
    replay, count, stacks = Replay(capacity, (3, 1, 1), 1, np.uint8), 0, {}
    for length in lengths:
        first = count
        for step in range(length + 1):
            stack = np.array([max(first, count - back) for back in (2, 1, 0)], np.uint8).reshape(3, 1, 1)
            stacks[count] = stack
            if step < length:
                replay.add(stack, np.zeros(1, np.float32), count, False)
            else:
                replay.end_episode(stack)
            count += 1
    drawn = replay.draw(200, np.random.default_rng(seed))
    for x, x_next, number in zip(drawn.x, drawn.x_next, drawn.reward, strict=True):
        assert np.array_equal(x, stacks[int(number)])
        assert np.array_equal(x_next, stacks[int(number) + 1])
    assert all(np.array_equal(x, stacks[int(n)]) for x, n in zip(*replay.everything()[:3:2], strict=True))


def test_a_stack_can_be_taken_up_again_within_an_episode() -> None:
    one, other = (Replay(16, (2, 1, 1), 1, np.uint8) for _ in range(2))
    for number in range(3):
        one.add(np.full((2, 1, 1), number, np.uint8), np.zeros(1, np.float32), 0.0, False)
    other.restore({name: array.copy() for name, array in one.arrays().items()})
    for replay in (one, other):
        replay.add(np.full((2, 1, 1), 3, np.uint8), np.zeros(1, np.float32), 0.0, False)
        replay.end_episode(np.full((2, 1, 1), 4, np.uint8))
    assert np.array_equal(one.everything().x, other.everything().x)
    assert one.everything().x[:, :, 0, 0].tolist() == [[0, 0], [0, 1], [1, 2], [2, 3]]


def test_a_mirrored_step_is_mirrored_as_a_whole_and_twice_is_nothing() -> None:
    mirror = Mirror(np.array([1, 0, 2]), np.array([1.0, 1.0, -1.0]), np.array([1.0, -1.0]))
    random = np.random.default_rng(0)
    x, x_next = random.normal(size=(2, 64, 3)).astype(np.float32)
    steps = Transitions(
        x, random.normal(size=(64, 2)).astype(np.float32), *random.random((1, 64)), x_next, np.zeros(64)
    )
    steps = steps._replace(later=Later(steps.reward, x_next, np.ones(64, np.float32)))
    once = mirror.mirror_at_random(steps, np.random.default_rng(1))
    turned = once.u[:, 1] != steps.u[:, 1]
    assert 16 < turned.sum() < 48
    assert np.array_equal(once.x[turned], steps.x[turned][:, [1, 0, 2]] * np.float32([1, 1, -1]))
    assert np.array_equal(once.x_next[turned, 2], -steps.x_next[turned, 2])
    assert once.later is not None
    assert np.array_equal(once.later.x, once.x_next)
    assert all(np.array_equal(a[~turned], b[~turned]) for a, b in zip(once[:5], steps[:5], strict=True))
    assert all(a.dtype == b.dtype for a, b in zip(once[:5], steps[:5], strict=True))
    twice = mirror.mirror_at_random(once, np.random.default_rng(1))
    assert all(np.array_equal(*each) for each in zip(twice[:5], steps[:5], strict=True))


@given(
    lengths=st.lists(st.integers(1, 6), min_size=1, max_size=6),
    capacity=st.integers(4, 40),
    ahead=st.integers(2, 5),
    seed=st.integers(0, 100),
)
@settings(max_examples=50, deadline=None)
def test_values_go_on_after_several_steps_but_not_beyond_an_episode(
    lengths: list[int], capacity: int, ahead: int, seed: int
) -> None:
    replay, number, episode_of, ends = Replay(capacity, (1,), 1, np.float64), 0, {}, {}
    for episode, length in enumerate(lengths):
        terminated = episode % 2 == 0  # the last step of each second episode ends for good
        for step in range(length):
            episode_of[number] = episode
            replay.add(np.array([float(number)]), np.zeros(1, np.float32), number, terminated and step == length - 1)
            number += 1
        replay.end_episode(np.array([float(number)]))
        ends[episode] = (number, terminated)
        number += 1
    drawn = replay.draw(50, np.random.default_rng(seed), ahead, 0.5)
    assert drawn.later is not None
    for x, gained, later, weight in zip(drawn.x[:, 0], *drawn.later, strict=True):
        end, terminated = ends[episode_of[int(x)]]
        stop = min(int(x) + ahead, end)
        assert later[0] == stop
        assert gained == pytest.approx(sum(0.5**k * (x + k) for k in range(stop - int(x))))
        assert weight == (0.0 if terminated and stop == end else 0.5 ** (stop - int(x)))


def sequence_replay(capacity: int = 30, length: int = 3) -> SequenceReplay:
    return SequenceReplay(capacity, (1,), 1, np.float32, length)


@settings(deadline=None, max_examples=200)
@given(
    st.lists(st.tuples(st.integers(1, 9), st.booleans()), min_size=1, max_size=8),
    st.integers(14, 30),
    st.integers(1, 5),
)
def test_a_stretch_lies_within_an_episode_or_ends_with_one_that_terminated(
    episodes: list[tuple[int, bool]], capacity: int, length: int
) -> None:
    replay, first, expected, ends = sequence_replay(capacity, length), 0, set[int](), set[int]()
    for steps, terminated in episodes:
        live(replay, [steps], first, terminated)
        expected |= set(range(first, first + (steps if terminated else steps - length + 1)))
        ends |= {first + steps - 1} if terminated else set()
        first += steps + 1
    expected = {step for step in expected if step >= first - capacity}
    assert replay.ready == bool(expected)
    if not expected:
        return
    drawn = replay.draw_sequences(1000, np.random.default_rng(0))
    assert set(drawn.x[:, 0, 0].astype(int)) == expected
    goes_on = np.cumprod(1.0 - drawn.terminated, axis=1)
    counts = np.concatenate((np.ones((1000, 1)), goes_on[:, :-1]), axis=1) > 0.0
    assert np.array_equal(drawn.reward[counts], drawn.x[:, :-1, 0][counts])
    assert np.array_equal(drawn.x[:, 1:, 0][counts], drawn.x[:, :-1, 0][counts] + 1)
    assert np.array_equal(drawn.terminated[counts], np.isin(drawn.reward[counts], list(ends)).astype(np.float32))


def test_an_episode_that_was_cut_off_gives_whole_stretches_alone() -> None:
    replay = sequence_replay()
    for number in range(6):
        assert replay.ready == (number > 3), "three steps and what followed them"
        replay.add(np.array([number], np.float32), np.zeros(1, np.float32), 0.0, False)
    replay.end_episode(np.array([6], np.float32))
    replay.add(np.array([7], np.float32), np.zeros(1, np.float32), 0.0, False)
    assert set(replay.draw_sequences(200, np.random.default_rng(0)).x[:, 0, 0]) == {0.0, 1.0, 2.0, 3.0}


def test_stretches_are_drawn_by_their_priorities_and_new_ones_by_the_largest() -> None:
    replay = sequence_replay()
    live(replay, [4])
    replay.set_priority(np.arange(4), np.array([1.0, 0.0, 2.0, 5.0]))
    live(replay, [2], first=5)
    begun = replay.draw_sequences(40_000, np.random.default_rng(0)).x[:, 0, 0].astype(int)
    shares = np.bincount(begun, minlength=7) / 40_000
    assert shares == pytest.approx(np.array([1.0, 0.0, 2.0, 5.0, 0.0, 5.0, 5.0]) / 18.0, abs=0.01)


def test_a_replay_of_stretches_can_be_taken_up_again() -> None:
    one, other = sequence_replay(16), sequence_replay(16)
    live(one, [5, 4, 7, 3])
    one.set_priority(np.flatnonzero(one._priority)[:3], np.array([3.0, 4.0, 5.0]))
    other.restore({name: array.copy() for name, array in one.arrays().items()})
    for replay in (one, other):
        live(replay, [3], first=30)
    drawn = [replay.draw_sequences(50, np.random.default_rng(1)) for replay in (one, other)]
    assert all(np.array_equal(a, b) for a, b in zip(*drawn, strict=True))


def test_stretches_are_mirrored_whole() -> None:
    mirror = Mirror(np.array([1, 0]), np.array([1.0, 1.0]), np.array([-1.0]))
    x, u = np.random.default_rng(0).normal(size=(100, 4, 2)).astype(np.float32), np.ones((100, 3, 1), np.float32)
    zeros = np.zeros((100, 3), np.float32)
    turned = mirror.mirror_sequences_at_random(Sequences(np.arange(100), x, u, zeros, zeros), np.random.default_rng(1))
    chosen = turned.u[:, 0, 0] < 0.0
    assert 30 < chosen.sum() < 70
    assert np.array_equal(turned.u, np.where(chosen[:, None, None], -u, u))
    assert np.array_equal(turned.x, np.where(chosen[:, None, None], x[..., ::-1], x))
