"""Training distribution: distances, boundaries, and storage in a policy file."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from ctrl_rl_core.io import encode_tensors, read_tensors
from hypothesis import given, settings
from hypothesis import strategies as st
from koopman_lqr_controller.safety.guards import fit_distribution_to_episodes
from scipy.spatial.distance import mahalanobis
from scipy.stats import chi2

from ctrl_rl_core import Interval
from koopman_lqr_controller import (
    CorridorObservables,
    EdmdPolicy,
    KoopmanError,
    LatentDistribution,
    Snapshots,
    fit_distribution,
    load_policy,
    save_policy,
    train,
)

LIMITS = (Interval(-0.22, 0.22), Interval(-2.84, 2.84))


def some_latents(count: int = 5000, seed: int = 0) -> np.ndarray:
    random = np.random.default_rng(seed)
    return random.normal(size=(count, 4)) @ random.normal(size=(4, 4)) + random.normal(size=4)


def some_policy() -> EdmdPolicy:
    random = np.random.default_rng(0)
    observables = CorridorObservables()
    z, u = random.normal(size=(600, len(observables.names))), random.normal(size=(600, 2))
    z_next = 0.9 * z + 0.01 * random.normal(size=z.shape)
    z_next[:, -2:] += 0.9 * u[:, ::-1]
    return train([Snapshots(z, u, z_next)], observables, speed=0.18, limits=LIMITS)


@settings(deadline=None, max_examples=20)
@given(st.integers(0, 1000))
def test_the_distance_is_mahalanobis(seed: int) -> None:
    latents = some_latents(50, seed)
    distribution = fit_distribution(latents, np.ones(1))
    inverse = np.linalg.inv(distribution.covariance)
    expected = [mahalanobis(z, distribution.mean, inverse) for z in latents]
    assert distribution.distances(latents) == pytest.approx(expected, rel=1e-6)
    assert distribution.relative_distance(latents[0]) == pytest.approx(expected[0] / distribution.distance, rel=1e-6)


@settings(deadline=None, max_examples=20)
@given(st.integers(0, 1000))
def test_units_of_the_latents_do_not_matter(seed: int) -> None:
    latents = some_latents(200, seed)
    M = np.random.default_rng(seed).normal(size=(4, 4)) + 4.0 * np.eye(4)
    one, other = fit_distribution(latents, np.ones(1)), fit_distribution(latents @ M.T, np.ones(1))
    assert one.distances(latents) == pytest.approx(other.distances(latents @ M.T), rel=1e-3)


def test_of_normal_latents_the_border_is_that_of_chi_squared() -> None:
    distribution = fit_distribution(some_latents(200_000), np.linspace(0.0, 1.0, 101))
    assert distribution.distance == pytest.approx(np.sqrt(chi2(4).ppf(0.999)), rel=0.02)
    assert distribution.error == pytest.approx(0.99)


def test_a_direction_that_never_varies_does_not_make_rounding_an_alarm() -> None:
    latents = np.column_stack((some_latents(), np.full(5000, 0.3)))
    distribution = fit_distribution(latents, np.ones(1))
    z = latents[0] + 1e-7
    assert distribution.relative_distance(z) == pytest.approx(distribution.relative_distance(latents[0]), abs=1e-3)
    assert distribution.relative_distance(latents[0] + [0, 0, 0, 0, 0.1]) > 1.0


def test_episodes_give_the_errors_of_their_own_steps() -> None:
    random = np.random.default_rng(1)
    A, B = 0.5 * np.eye(4), random.normal(size=(4, 2))
    z, actions = [random.normal(size=(n + 1, 4)) for n in (30, 20)], [random.normal(size=(n, 2)) for n in (30, 20)]
    distribution = fit_distribution_to_episodes(lambda here, done: here @ A.T + done @ B.T, z, actions)
    steps = [
        (a, u, b) for each, done in zip(z, actions, strict=True) for a, u, b in zip(each, done, each[1:], strict=False)
    ]
    errors = [np.linalg.norm(b - A @ a - B @ u) for a, u, b in steps]
    assert distribution.error == pytest.approx(np.percentile(errors, 99))
    assert distribution.mean == pytest.approx(np.concatenate(z).mean(axis=0))


@pytest.mark.parametrize(
    ("latents", "errors"),
    [
        (np.zeros((4, 4)), np.ones(1)),
        (some_latents(), np.ones(0)),
        (np.full((50, 4), np.nan), np.ones(1)),
        (np.zeros((50, 4)), np.ones(1)),
        (some_latents(), np.zeros(5)),
    ],
)
def test_what_makes_no_region_is_refused(latents: np.ndarray, errors: np.ndarray) -> None:
    with pytest.raises(KoopmanError):
        fit_distribution(latents, errors)


def test_edmd_writes_down_what_it_saw_mirrored_drives_too(tmp_path: Path) -> None:
    policy = some_policy()
    assert policy.distribution is not None
    assert policy.distribution.mean[:-1] == pytest.approx(np.zeros(len(policy.z_ref) - 1))
    save_policy(policy, tmp_path / "policy.safetensors")
    again = load_policy(tmp_path / "policy.safetensors").distribution
    assert again is not None
    assert (again.distance, again.error) == (policy.distribution.distance, policy.distribution.error)
    z = np.random.default_rng(0).normal(size=len(policy.z_ref))
    assert again.relative_distance(z) == policy.distribution.relative_distance(z)


def test_a_policy_without_a_region_stays_without(tmp_path: Path) -> None:
    save_policy(replace(some_policy(), distribution=None), tmp_path / "policy.safetensors")
    assert load_policy(tmp_path / "policy.safetensors").distribution is None


def test_a_region_of_other_latents_is_refused() -> None:
    with pytest.raises(KoopmanError, match="the region is of 4 dimensions, the latent has 19"):
        replace(some_policy(), distribution=fit_distribution(some_latents(), np.ones(1)))


@pytest.mark.parametrize(
    ("name", "words"),
    [("region.mean", "are finite"), ("region.covariance", "are finite"), ("", "lacks the tensor 'region.mean'")],
)
def test_a_region_that_is_broken_is_refused(name: str, words: str, tmp_path: Path) -> None:
    path = tmp_path / "policy.safetensors"
    save_policy(some_policy(), path)
    header, tensors, _ = read_tensors(path, "policy")
    if name:
        tensors[name].flat[0] = np.nan
    else:
        del tensors["region.mean"]
    path.write_bytes(encode_tensors(tensors, "policy", header))
    with pytest.raises(KoopmanError, match=words):
        load_policy(path)


@pytest.mark.parametrize(
    "given", [{"distance": 0.0}, {"error": -1.0}, {"covariance": np.zeros((4, 4))}, {"mean": np.zeros(3)}]
)
def test_numbers_that_bound_nothing_are_refused(given: dict[str, object]) -> None:
    parts = {"mean": np.zeros(4), "covariance": np.eye(4), "distance": 3.0, "error": 0.1}
    with pytest.raises(KoopmanError):
        LatentDistribution(**(parts | given))
