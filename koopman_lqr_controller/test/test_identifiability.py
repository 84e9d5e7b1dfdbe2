"""A fit tells the true system, or it refuses: no third outcome, in whatever units and under whatever control."""

import re
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from koopman_lqr_controller.models.identifiability import check_controls_move
from koopman_lqr_controller.models.shrinkage import fit_with_shrinkage

from ctrl_rl_core import Interval
from koopman_lqr_controller import CorridorObservables, KoopmanError, LinearModel, Snapshots, fit, solve_lqr, train

Array = np.ndarray
Fit = Callable[[Snapshots], LinearModel]


def shrunk(data: Snapshots) -> LinearModel:
    return fit_with_shrinkage(data).model


def plain(data: Snapshots) -> LinearModel:
    return fit(data, regularisation=0.0)


BOTH = pytest.mark.parametrize("fitted", [fit, shrunk])
SEEDS = st.integers(0, 2**31)


def some_system(random: np.random.Generator, n: int, m: int) -> LinearModel:
    A = random.normal(size=(n, n))
    return LinearModel(
        random.choice([0.5, 0.9, 1.0, 1.02]) * A / np.abs(np.linalg.eigvals(A)).max(), random.normal(size=(n, m))
    )


def driven(true: LinearModel, law: Callable[[int, Array], Array], steps: int, begin: Array) -> Snapshots:
    z, u = [begin], []
    for k in range(steps):
        u.append(law(k, z[-1]))
        z.append(true.predict(z[-1], u[-1]))
    return Snapshots(np.array(z[:-1]), np.array(u), np.array(z[1:]))


def in_units(data: Snapshots, d: Array, e: Array) -> Snapshots:
    return Snapshots(data.z * d, data.u * e, data.z_next * d)


def units(random: np.random.Generator, size: int) -> Array:
    return 10.0 ** random.uniform(-9.0, 9.0, size)


def distance(found: LinearModel, true: LinearModel, d: Array, e: Array) -> float:
    """Return how far a model in other units is from the truth, relative to the larger entries of A and B."""
    A, B = found.A * d / d[:, None], found.B * e / d[:, None]
    return max(
        float(np.abs(A - true.A).max() / np.abs(true.A).max()), float(np.abs(B - true.B).max() / np.abs(true.B).max())
    )


def told_or_refused(
    data: Snapshots, fitted: Fit, true: LinearModel, random: np.random.Generator, within: float = 1e-6
) -> bool:
    """Return whether a fit tells the truth, in units of any size; it fails where it tells anything else."""
    d, e = units(random, len(true.A)), units(random, true.B.shape[1])
    try:
        found = fitted(in_units(data, d, e))
    except KoopmanError:
        return False
    assert distance(found, true, d, e) < within
    return True


@BOTH
@settings(deadline=None, max_examples=40)
@given(n=st.integers(1, 5), m=st.integers(1, 3), seed=SEEDS)
def test_controls_of_their_own_tell_the_system_in_any_units(fitted: Fit, n: int, m: int, seed: int) -> None:
    random = np.random.default_rng(seed)
    true = some_system(random, n, m)
    data = driven(true, lambda _, __: random.normal(size=m), 200, random.normal(size=n))
    assert told_or_refused(data, fitted, true, random)


@pytest.mark.parametrize("fitted", [fit, plain, shrunk])
@settings(deadline=None, max_examples=40)
@given(n=st.integers(1, 5), m=st.integers(1, 3), power=st.floats(-14.0, 0.0), steps=st.integers(1, 200), seed=SEEDS)
def test_feedback_with_a_dither_of_any_size_is_told_or_refused(
    fitted: Fit, n: int, m: int, power: float, steps: int, seed: int
) -> None:
    random = np.random.default_rng(seed)
    true, K = some_system(random, n, m), 0.1 * random.normal(size=(m, n))
    data = driven(true, lambda _, z: -K @ z + 10.0**power * random.normal(size=m), steps, random.normal(size=n))
    told_or_refused(data, fitted, true, random, 1e-5)  # of a dither of 1e-8, 16 digits leave 8, and few rows fewer


@BOTH
@settings(deadline=None, max_examples=30)
@given(n=st.integers(1, 5), m=st.integers(1, 3), seed=SEEDS)
def test_feedback_alone_is_refused(fitted: Fit, n: int, m: int, seed: int) -> None:
    random = np.random.default_rng(seed)
    true, K = some_system(random, n, m), 0.1 * random.normal(size=(m, n))
    data = driven(true, lambda _, z: -K @ z, 200, random.normal(size=n))
    with pytest.raises(KoopmanError, match=r"dither|together|never moves"):
        fitted(in_units(data, units(random, n), units(random, m)))


@settings(deadline=None, max_examples=40)
@given(n=st.integers(1, 5), power=st.floats(-3.0, 6.0), seed=SEEDS)
def test_states_around_an_offset_are_told_or_refused(n: int, power: float, seed: int) -> None:
    """Of z + c a model has the drift (I - A) c, which `fit` has no place for, and the other fit has."""
    random = np.random.default_rng(seed)
    true, offset = some_system(random, n, 1), 10.0**power * random.normal(size=n)
    data = driven(true, lambda _, __: random.normal(size=1), 200, random.normal(size=n))
    moved = Snapshots(data.z + offset, data.u, data.z_next + offset)
    one = np.ones(n), np.ones(1)
    assert distance(shrunk(moved), true, *one) < 1e-6
    told_or_refused(moved, fit, true, random)
    assert distance(fit(moved.centred(offset, np.zeros(1))), true, *one) < 1e-6 * max(1.0, 10.0 ** (power - 3.0))


def test_a_position_far_from_the_origin_is_no_drift() -> None:
    true = LinearModel(np.array([[1.0, 0.1], [0.0, 1.0]]), np.array([[0.005], [0.1]]))
    random = np.random.default_rng(0)
    data = driven(true, lambda _, __: random.normal(size=1), 300, np.array([1e6, 0.0]))
    assert distance(fit(data), true, np.ones(2), np.ones(1)) < 1e-6


@pytest.mark.parametrize("noise", [1e-4, 1e-3, 1e-2])
@pytest.mark.parametrize("dither", [0.0, 1e-3, 1e-2, 1.0])
@BOTH
def test_a_regulator_of_noisy_feedback_stabilises_the_true_system_or_is_refused(
    fitted: Fit, noise: float, dither: float
) -> None:
    """Noise of the sensors looks like a dither of a control that follows them, and has no effect."""
    true, K = LinearModel(np.array([[1.0, 0.1], [0.0, 1.0]]), np.array([[0.005], [0.1]])), np.array([[1.0, 1.5]])
    told = 0
    for seed in range(5):
        random = np.random.default_rng(seed)
        own = dither * random.normal(size=(300, 1))
        data = driven(true, lambda k, z, own=own: own[k] - K @ z, 300, np.array([1.0, 0.0]))  # type: ignore[misc]
        z = np.vstack((data.z, data.z_next[-1:]))
        z = z + noise * random.normal(size=z.shape)
        try:
            regulator = solve_lqr(fitted(Snapshots(z[:-1], data.u, z[1:])), np.eye(2), 0.01 * np.eye(1))
        except KoopmanError:
            continue
        told += 1
        assert np.abs(np.linalg.eigvals(true.A - true.B @ regulator.K)).max() < 1.0
    assert told == (5 if dither == 1.0 else 0) or 1e-3 <= dither <= 1e-2


# What one drive of two states and two controls becomes, and the words that refuse it
TRUE = LinearModel(np.array([[0.9, 0.2], [-0.1, 0.8]]), np.array([[0.1, 0.3], [1.0, -0.5]]))
RANDOM = np.random.default_rng(0)
U = RANDOM.normal(size=(200, 2))


def under(u: Array) -> Snapshots:
    return driven(TRUE, lambda k, _: u[k], len(u), np.ones(2))


GOOD = under(U)


def having(**changed: object) -> Snapshots:
    return Snapshots(**{**vars(GOOD), **changed})


def spoilt(array: Array, value: float) -> Array:
    array = array.copy()
    array[3, 1] = value
    return array


REFUSED_BY_BOTH = {
    "constant": (under(np.full((200, 2), 0.3)), r"control 0 never moves \(it is 0.3 throughout\).*excite all controls"),
    "nearly constant": (under(0.3 + 1e-12 * U), "control 0 never moves"),
    "one is zero": (under(U * [1.0, 0.0]), "control 1 never moves"),
    "collinear": (under(U[:, :1] * [1.0, 2.0]), "control 0, control 1 move together"),
    "nearly collinear": (under(U[:, :1] * [1.0, 2.0] + 1e-12 * U), "control 0, control 1 move together"),
    "NaN": (having(z=spoilt(GOOD.z, np.nan)), r"not finite: z\[3, 1\] is nan"),
    "infinite": (having(u=spoilt(GOOD.u, np.inf)), r"not finite: u\[3, 1\] is inf"),
    "empty": (Snapshots(GOOD.z[:0], GOOD.u[:0], GOOD.z_next[:0]), "empty"),
    "no state": (having(z=GOOD.z[:, :0], z_next=GOOD.z[:, :0]), "empty"),
    "one sample": (Snapshots(GOOD.z[:1], GOOD.u[:1], GOOD.z_next[:1]), "1 (snapshots|steps) are too few"),
    "fewer than unknowns": (Snapshots(GOOD.z[:3], GOOD.u[:3], GOOD.z_next[:3]), "too few"),
    "a row less": (having(u=GOOD.u[1:]), "do not fit each other"),
    "wider": (having(z_next=np.hstack((GOOD.z, GOOD.z))), "do not fit each other"),
    "one row": (having(u=GOOD.u[:, 0]), r"u has shape \(200,\).*u\[:, None\]"),
    "complex": (having(z=GOOD.z + 0j), "z holds complex128 values"),
    "text": (having(u=GOOD.u.astype(str)), "give real numbers"),
    "objects": (having(u=GOOD.u.astype(object)), "u holds object values"),
    "ragged": (having(u=[[1.0, 2.0], [1.0]]), "rows of unequal length"),
    "too large": (having(z=1e200 * GOOD.z, z_next=1e200 * GOOD.z_next), "other units"),
}


@BOTH
@pytest.mark.parametrize("what", REFUSED_BY_BOTH)
def test_what_cannot_be_told_is_refused_in_a_line_that_says_what_to_do(fitted: Fit, what: str) -> None:
    data, words = REFUSED_BY_BOTH[what]
    with pytest.raises(KoopmanError) as refused:
        fitted(data)
    assert re.search(words, str(refused.value))
    assert "\n" not in str(refused.value)


def test_numbers_of_other_types_are_taken() -> None:
    one = np.ones(2), np.ones(2)
    lists = Snapshots(GOOD.z.tolist(), GOOD.u.tolist(), GOOD.z_next.tolist())  # type: ignore[arg-type]
    assert distance(fit(lists), TRUE, *one) < 1e-9
    coarse = Snapshots(*(it.astype(np.float32) for it in (GOOD.z, GOOD.u, GOOD.z_next)))
    assert distance(fit(coarse), TRUE, *one) < 1e-5
    switched = RANDOM.random((200, 2)) < 0.5
    assert distance(fit(under(switched)), TRUE, *one) < 1e-9
    assert fit(having(u=np.zeros((200, 0)))).B.shape == (2, 0)


def with_state(here: Array, there: Array) -> Snapshots:
    return having(z=np.column_stack((GOOD.z, here)), z_next=np.column_stack((GOOD.z_next, there)))


def test_a_state_that_tells_nothing_is_named_and_left_to_those_who_want_it() -> None:
    zero, twin = with_state(0.0 * U[:, 0], 0.0 * U[:, 0]), with_state(GOOD.z[:, 0], GOOD.z_next[:, 0])
    with pytest.raises(KoopmanError, match="state 2 is 0 throughout"):
        fit(zero)
    with pytest.raises(KoopmanError, match="state 0, state 2 repeat each other"):
        fit(twin)
    for data in (zero, twin):
        found = fit(data, regularisation=0.0, lifted=True)
        assert data.z_next == pytest.approx(found.predict(data.z, data.u), abs=1e-9)
        assert found.B[:2] == pytest.approx(TRUE.B, abs=1e-9)
        K = solve_lqr(found, np.diag([1.0, 1.0, 0.0]), np.eye(2)).K
        weight = K[:, :2] + np.outer(K[:, 2], [1.0, 0.0]) * float(data is twin)
        assert weight == pytest.approx(solve_lqr(TRUE, np.eye(2), np.eye(2)).K, abs=1e-9)


def test_the_constant_one_is_a_function_like_others() -> None:
    moved = Snapshots(GOOD.z + 3.0, GOOD.u, GOOD.z_next + 3.0)
    one = np.ones((200, 1))
    found = fit(Snapshots(np.hstack((moved.z, one)), moved.u, np.hstack((moved.z_next, one))))
    assert found.A[:2, :2] == pytest.approx(TRUE.A, abs=1e-9)
    assert found.A[:2, 2] == pytest.approx((np.eye(2) - TRUE.A) @ [3.0, 3.0], abs=1e-9)
    assert found.B[:2] == pytest.approx(TRUE.B, abs=1e-9)


def test_the_ridge_damps_noise_and_stays_out_where_there_is_none() -> None:
    assert pytest.approx(TRUE.A, abs=1e-9) == fit(GOOD, 1e-1).A
    noisy = having(z_next=GOOD.z_next + 3.0 * RANDOM.normal(size=GOOD.z.shape))
    assert np.linalg.norm(fit(noisy, 1e-1).A) < np.linalg.norm(fit(noisy, 0.0).A)
    with pytest.raises(KoopmanError, match="regularisation is -1"):
        fit(GOOD, -1.0)


def test_a_lifting_s_ridge_that_hides_a_control_is_refused() -> None:
    """Where the ridge has to stay, controls must be larger than it is."""
    K = np.array([[0.3, 0.2]])
    true = LinearModel(TRUE.A, TRUE.B[:, :1])
    data = driven(true, lambda _, z: -K @ z + 0.01 * RANDOM.normal(size=1) * np.abs(z).max(), 400, np.ones(2))
    with pytest.raises(KoopmanError, match="hides what they do"):
        fit(data, 1e-1, lifted=True)
    assert distance(fit(data, 0.0, lifted=True), true, np.ones(2), np.ones(1)) < 1e-6


def test_commands_are_judged_before_they_are_mirrored() -> None:
    with pytest.raises(KoopmanError, match="the turn rate never moves"):
        check_controls_move(U * [1.0, 0.0] + [0.0, 0.5], ("the speed", "the turn rate"))
    with pytest.raises(KoopmanError, match="control 1 never moves"):
        fit_with_shrinkage(under(U * [1.0, 0.0] + [0.0, 0.5]), under(U * [1.0, 0.0] - [0.0, 0.5]))
    with pytest.raises(KoopmanError, match="twin has shape"):
        fit_with_shrinkage(GOOD, Snapshots(GOOD.z[1:], GOOD.u[1:], GOOD.z_next[1:]))


def test_two_stages_refuse_a_drive_that_never_turns() -> None:
    observables = CorridorObservables()
    z = RANDOM.normal(size=(300, len(observables.names)))
    u = RANDOM.normal(size=(300, 2)) * [0.1, 0.0]
    limits = Interval(-0.22, 0.22), Interval(-2.84, 2.84)
    with pytest.raises(KoopmanError, match="the commanded turn rate never moves"):
        train([Snapshots(z, u, 0.9 * z)], observables, 0.18, limits)


def test_a_model_that_forgets_at_once_is_contracted_already() -> None:
    model = LinearModel(np.array([[0.0, 1.0], [0.0, 0.0]]), np.ones((2, 1)))
    assert model.contracted()[0] == 1.0
