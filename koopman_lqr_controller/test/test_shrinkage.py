"""Models from few and noisy data: no worse than a constant prediction, and exact where the data allow."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from koopman_lqr_controller.models.shrinkage import RIDGES, ShrinkageFit, fit_with_shrinkage

from koopman_lqr_controller import KoopmanError, LinearModel, Snapshots, fit


def ratio(found: ShrinkageFit, data: Snapshots) -> float:
    missed = data.z_next - found.drift - found.model.predict(data.z, data.u)
    return float(np.linalg.norm(missed) / np.linalg.norm(data.z_next - data.z))


def driven(model: LinearModel, steps: int, noise: float, seed: int, drift: float = 0.0) -> Snapshots:
    """Return a drive of a system whose states are measured with noise."""
    random = np.random.default_rng(seed)
    z, u = np.zeros((steps + 1, len(model.A))), random.normal(size=(steps, model.B.shape[1]))
    for k in range(steps):
        z[k + 1] = model.predict(z[k], u[k]) + drift
    z = z + noise * random.normal(size=z.shape)
    return Snapshots(z[:-1], u, z[1:])


@settings(deadline=None, max_examples=20)
@given(st.integers(1, 5), st.integers(1, 2), st.integers(0, 2**31))
def test_a_system_that_is_seen_well_is_recovered(n: int, m: int, seed: int) -> None:
    random = np.random.default_rng(seed)
    A = random.normal(size=(n, n))
    true = LinearModel(0.9 * A / np.abs(np.linalg.eigvals(A)).max(), random.normal(size=(n, m)))
    data = driven(true, 400, 0.0, seed, drift=0.3)
    found = fit_with_shrinkage(data)
    assert found.ridge == RIDGES[0]
    assert ratio(found, data) < 1e-3
    assert found.cross_validation_error < 1e-3


@pytest.mark.parametrize("seed", range(3))
def test_of_noise_alone_only_what_regresses_to_the_mean_is_predicted(seed: int) -> None:
    """A random walk is unpredictable: the best prediction is its present value."""
    random = np.random.default_rng(seed)
    z = np.cumsum(random.normal(size=(301, 12)), axis=0)
    u = random.normal(size=(300, 2))
    seen, unseen = (Snapshots(z[a:b], u[a:b], z[a + 1 : b + 1]) for a, b in ((0, 200), (200, 300)))
    assert ratio(fit_with_shrinkage(seen), unseen) < 1.05
    plain = fit(seen, 1e-3)
    assert np.linalg.norm(unseen.z_next - plain.predict(unseen.z, unseen.u)) > np.linalg.norm(unseen.z_next - unseen.z)


def test_a_short_noisy_drive_is_predicted_better_than_by_plain_least_squares() -> None:
    true = LinearModel(0.97 * np.eye(10), np.vstack((np.eye(2), np.zeros((8, 2)))) * 0.3)
    data = driven(true, 300, 0.3, 1)
    seen, unseen = (Snapshots(data.z[a:b], data.u[a:b], data.z_next[a:b]) for a, b in ((0, 60), (60, 300)))
    found, plain = fit_with_shrinkage(seen), fit(seen, 1e-3)
    assert ratio(found, unseen) < 1.0
    assert ratio(found, unseen) < ratio(ShrinkageFit(plain, np.zeros(10), 0.0, 0.0), unseen)


def test_mirrored_twins_give_a_model_that_commutes_with_the_mirror() -> None:
    random = np.random.default_rng(1)
    data = Snapshots(random.normal(size=(100, 3)), random.normal(size=(100, 2)), random.normal(size=(100, 3)))
    z_sign, u_sign = np.array([-1.0, -1.0, 1.0]), np.array([1.0, -1.0])
    found = fit_with_shrinkage(data, data.mirrored(z_sign, u_sign), drift=False)
    assert np.diag(z_sign) @ found.model.A @ np.diag(z_sign) == pytest.approx(found.model.A)
    assert np.diag(z_sign) @ found.model.B @ np.diag(u_sign) == pytest.approx(found.model.B)
    assert not found.drift.any()


def test_what_nothing_can_be_learnt_from_is_refused() -> None:
    still = np.zeros((40, 2))
    with pytest.raises(KoopmanError, match="nothing changes"):
        fit_with_shrinkage(Snapshots(still, still, still))
    with pytest.raises(KoopmanError, match="too few"):
        fit_with_shrinkage(Snapshots(still[:9], still[:9], still[:9]))
    with pytest.raises(KoopmanError, match="not finite"):
        fit_with_shrinkage(Snapshots(still + np.nan, still, still))
