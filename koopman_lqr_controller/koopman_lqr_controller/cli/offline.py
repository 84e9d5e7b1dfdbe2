"""The commands `fit`, `evaluate` and `learn_offline`: policies from recorded drives, without an environment."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import tyro
from ctrl_rl_core.command import OptionalFileToWrite, at_least, make_command
from tqdm import tqdm

from ctrl_rl_core import Interval, atomic_write
from koopman_lqr_controller.cli.bag_options import BagOptions, OutputOptions, PolicyOption, read_segments
from koopman_lqr_controller.data.trajectory_segments import (
    TrajectorySegment,
    check_held_out,
    fitted_steps,
    mean_time_step,
    split,
    split_by,
    to_snapshots,
)
from koopman_lqr_controller.identification.evaluation import evaluate_policy, time_step_mismatch
from koopman_lqr_controller.identification.offline import refit
from koopman_lqr_controller.identification.two_stage import Weights, train
from koopman_lqr_controller.policies.latent_policy import LatentPolicy
from koopman_lqr_controller.policies.policy_file import (
    KoopmanPolicy,
    digest,
    find_policy,
    load_policy,
    refuse_existing,
    save_policy,
)
from koopman_lqr_controller.sensing.lidar_observation import LidarObservation

_FITTED, _HELD_OUT, _UNKNOWN = "fitted", "held out", "unknown"
_FIGURES_OF_TRAIN = ("snapshots", "one_step_error", "persistence_error")
"""Metrics of `train` on the fitted part only; `_save` adds those of both parts."""


@dataclass(frozen=True, kw_only=True)
class FitOptions(OutputOptions, BagOptions, PolicyOption):
    """Refit a policy's model to recorded drives; encoder and behaviour stay, the regulator is recomputed."""


@dataclass(frozen=True, kw_only=True)
class EvaluateOptions(BagOptions, PolicyOption):
    """Evaluate a policy: its success and return in new episodes or, with bags, its prediction errors.

    On recorded drives, its errors are compared with those of persistence, and its commands with the driver's.
    """

    bags: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="[BAG ...]")] = ()
    """rosbag2 folders with the topics scan, odom and cmd_vel (default: none, simulated episodes instead)."""

    held_out: float = 0.2
    """Without effect: the policy's file says which part of the drives is held out from it."""

    task: str | None = None
    """Task of the episodes, as for `train` (default: the task the policy was trained on)."""

    episodes: at_least(1) = 100  # type: ignore[valid-type]
    """Number of episodes."""

    seed: at_least(0) = 0  # type: ignore[valid-type]
    """Seed of the first episode; the others are consecutive."""

    results: OptionalFileToWrite = None
    """JSON file for the metrics."""

    def __post_init__(self) -> None:
        """Accept any number of bags."""


@dataclass(frozen=True, kw_only=True)
class LearnOfflineOptions(OutputOptions, BagOptions):
    """Learn encoder, model and LQR from recorded drives only; the driver's commands replace a reward."""

    latent: at_least(2) = 16  # type: ignore[valid-type]
    """Dimension of the latent space."""

    updates: at_least(1) = 1500  # type: ignore[valid-type]
    """Number of network updates."""

    far: float = 3.5
    """Distance beyond which a scan has no echo [m]."""

    seed: int = 0
    """Random seed of weights and batches."""


def _fit(options: FitOptions) -> int:
    check_held_out(options.held_out)
    refuse_existing(options.output, options.overwrite)
    file = find_policy(options.policy)
    policy = load_policy(file)
    segments = read_segments(options.bags, options, policy.observation_fn)
    seen, unseen = split(segments, options.held_out)
    manifest = {"fitted_from": digest(file), **_source(options, segments)}
    fitted: KoopmanPolicy
    if isinstance(policy, LatentPolicy):
        fitted = refit(policy, seen)
    else:
        weights = Weights(**policy.manifest["weights"]) if "weights" in policy.manifest else None
        limits = [Interval(low, high) for low, high in zip(policy.u_low, policy.u_high, strict=True)]
        fitted = train(
            to_snapshots(seen),
            policy.observables,
            float(policy.z_ref[-1]),
            (limits[0], limits[1]),
            weights,
            held_out=0.0,
            manifest={"task": policy.manifest.get("task"), "dt": mean_time_step(seen)},
            shrunk=True,
        )
        fitted = replace(fitted, manifest={k: v for k, v in fitted.manifest.items() if k not in _FIGURES_OF_TRAIN})
    return _save(options, fitted, seen, unseen, manifest)


def _evaluate(options: EvaluateOptions) -> int:
    file = find_policy(options.policy)
    if not options.bags:
        from koopman_lqr_controller.training.experiments.evaluation import evaluate_in_episodes

        return evaluate_in_episodes(file, options.task, options.episodes, options.seed, options.results)
    policy = load_policy(file)
    observe = policy.observation_fn
    check_held_out(options.held_out)
    segments = read_segments(options.bags, options, observe)
    parts = _parts(policy, segments)
    figures = {name: evaluate_policy(policy, part) for name, part in parts.items() if part}
    _print(figures)
    if _UNKNOWN in parts:
        print("The policy's file does not say which drives it was fitted to: none of these is known to be held out.")
    told = time_step_mismatch(policy, segments)
    if told:
        print(told)
    if options.results is not None:
        atomic_write(options.results, json.dumps(figures) + "\n")
    return 0


def _learn_offline(options: LearnOfflineOptions) -> int:
    check_held_out(options.held_out)
    refuse_existing(options.output, options.overwrite)
    observation = LidarObservation(far=options.far)
    segments = read_segments(options.bags, options, observation.observe)
    seen, unseen = split(segments, options.held_out)
    from koopman_lqr_controller.training.agents.imitation import ImitationSettings, imitate

    settings = ImitationSettings(latent=options.latent, updates=options.updates, seed=options.seed)
    with tqdm(total=settings.updates, desc="learning", unit="update", disable=None) as bar:
        learnt = imitate(seen, observation, settings, bar.update)
    manifest = {
        "method": "task-oriented Koopman control from recorded drives: imitation, then consolidation",
        "settings": vars(settings),
        **_source(options, segments),
    }
    return _save(options, refit(learnt, seen), seen, unseen, manifest)


def _parts(policy: KoopmanPolicy, segments: list[TrajectorySegment]) -> dict[str, list[TrajectorySegment]]:
    """Return the drives a policy was fitted to and the held-out ones, according to its manifest."""
    fitted = policy.manifest.get("fitted_to")
    if not isinstance(fitted, dict):
        return {_UNKNOWN: segments}
    steps = {name: count for name, count in fitted.items() if isinstance(count, int)}
    return dict(zip((_FITTED, _HELD_OUT), split_by(segments, steps), strict=True))


def _source(options: BagOptions, segments: Sequence[TrajectorySegment]) -> dict[str, Any]:
    return {
        "bags": [bag.name for bag in options.bags],
        "held_out": options.held_out,
        "fitted_to": fitted_steps(segments, options.held_out),
    }


def _save(
    options: OutputOptions,
    policy: KoopmanPolicy,
    seen: Sequence[TrajectorySegment],
    unseen: Sequence[TrajectorySegment],
    manifest: dict[str, Any],
) -> int:
    """Write a policy with its metrics on both parts."""
    figures = {
        name: evaluate_policy(policy, segments) for name, segments in ((_FITTED, seen), (_HELD_OUT, unseen)) if segments
    }
    told = figures.get(_HELD_OUT, figures[_FITTED])
    more = {"error_over_persistence": told["over_persistence"][0], "drives": figures}
    save_policy(
        replace(policy, manifest={**policy.manifest, **manifest, **more}), options.output, overwrite=options.overwrite
    )
    _print(figures)
    constant = policy.manifest.get("constant_observables")
    if constant:
        names = ", ".join(constant)
        print(
            f"These observables never changed, so the model leaves them out (does the lidar see only ahead?): {names}"
        )
    print(f"policy            {options.output}")
    return 0


def _print(figures: dict[str, Any]) -> None:
    for part, found in figures.items():
        errors = found["over_persistence"]
        told = ", ".join(f"{errors[step - 1]:.3f} after {step}" for step in (1, 2, 5, 10) if step <= len(errors))
        print(f"{part:<10} {found['steps']:5d} steps: error {told}; 1 is 'nothing changes'")
        for name, each in found["commands"].items():
            share = "it never changes" if each["explained"] is None else f"{100 * each['explained']:.0f} % explained"
            print(f"{'':<18}{name}: differs by {each['difference']:.3f} of {each['spread']:.3f}, {share}")
    unseen = figures.get(_HELD_OUT)
    if unseen is not None and not unseen["over_persistence"][0] < 1.0:
        print("One step ahead the model is no better than 'nothing changes' on what it was not fitted to.")


fit = make_command("fit", FitOptions, _fit)
evaluate = make_command("evaluate", EvaluateOptions, _evaluate, renamed={"--json": "--results"})
learn_offline = make_command("learn_offline", LearnOfflineOptions, _learn_offline)
