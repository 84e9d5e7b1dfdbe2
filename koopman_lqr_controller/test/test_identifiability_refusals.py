"""Data rejected and accepted by a fit, and the contents of a lifting."""

import re

import numpy as np
import pytest
from koopman_lqr_controller.models.identifiability import check_controls_move
from koopman_lqr_controller.models.shrinkage import fit_with_shrinkage
from linear_drives import GOOD, TRUE, Array, Fit, U, distance, driven, having, shrunk, spoilt, under

from ctrl_rl_core import Interval
from koopman_lqr_controller import CorridorObservables, KoopmanError, LinearModel, Snapshots, fit, solve_lqr, train

BOTH = pytest.mark.parametrize("fitted", [fit, shrunk])

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
    switched = np.random.default_rng(1).random((200, 2)) < 0.5
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
    noisy = having(z_next=GOOD.z_next + 3.0 * np.random.default_rng(1).normal(size=GOOD.z.shape))
    assert np.linalg.norm(fit(noisy, 1e-1).A) < np.linalg.norm(fit(noisy, 0.0).A)
    with pytest.raises(KoopmanError, match="regularisation is -1"):
        fit(GOOD, -1.0)


def test_a_lifting_s_ridge_that_hides_a_control_is_refused() -> None:
    """If the ridge must remain, controls must be larger than it."""
    K, own = np.array([[0.3, 0.2]]), 0.01 * np.random.default_rng(1).normal(size=(400, 1))
    true = LinearModel(TRUE.A, TRUE.B[:, :1])
    data = driven(true, lambda k, z: -K @ z + own[k] * np.abs(z).max(), 400, np.ones(2))
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
    random = np.random.default_rng(1)
    z, u = random.normal(size=(300, len(observables.names))), random.normal(size=(300, 2)) * [0.1, 0.0]
    limits = Interval(-0.22, 0.22), Interval(-2.84, 2.84)
    with pytest.raises(KoopmanError, match="the commanded turn rate never moves"):
        train([Snapshots(z, u, 0.9 * z)], observables, 0.18, limits)
    u = random.normal(size=(300, 2))
    for data, words in (
        (Snapshots(z, spoilt(u, np.nan), z), r"u\[3, 1\] is nan"),
        (Snapshots(z[:, 1:], u, z[:, 1:]), "must have 19 observables and 2 commands"),
        (Snapshots(z, u[:-1], z), "do not fit each other"),
    ):
        with pytest.raises(KoopmanError, match=words):
            train([data], observables, 0.18, limits)


def test_two_controls_that_follow_the_state_are_both_looked_at() -> None:
    """The first control's own part is smaller but identifiable; that of the second is below the noise."""
    random = np.random.default_rng(1)
    z, own, noise = random.normal(size=(3, 400, 2))
    u = z + own * [0.01, 0.02]
    quiet = Snapshots(z, u, 0.9 * z + u * [1.0, 1e-3])
    assert pytest.approx(np.diag([1.0, 1e-3]), abs=1e-9) == fit(quiet, 0.0, lifted=True).B
    noisy = Snapshots(z, u, quiet.z_next + [0.0, 0.01] * noise)
    with pytest.raises(KoopmanError, match=r"control 1: all but .* follows from the state"):
        fit(noisy, 0.0, lifted=True)


def test_a_model_that_forgets_at_once_is_contracted_already() -> None:
    model = LinearModel(np.array([[0.0, 1.0], [0.0, 0.0]]), np.ones((2, 1)))
    assert model.contracted()[0] == 1.0
