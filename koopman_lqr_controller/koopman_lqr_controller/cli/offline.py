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
    mean_time_step,
    split,
    to_snapshots,
)
from koopman_lqr_controller.identification.evaluation import evaluate_policy, time_step_mismatch
from koopman_lqr_controller.identification.offline import refit
from koopman_lqr_controller.identification.two_stage import Weights, train
from koopman_lqr_controller.policies.koopman_policy import ObservationFn
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

_FITTED, _HELD_OUT = "fitted", "held out"
_FIGURES_OF_TRAIN = ("snapshots", "one_step_error", "persistence_error")
"""Figures of `train` about the fitted part alone; `_save` adds those of both parts."""


@dataclass(frozen=True, kw_only=True)
class FitOptions(OutputOptions, BagOptions, PolicyOption):
    """Fit a policy's model anew to recorded drives: its coordinates and what it does stay, its regulator follows."""


@dataclass(frozen=True, kw_only=True)
class EvaluateOptions(BagOptions, PolicyOption):
    """Tell how a policy does: its success and return in fresh episodes; or, with bags, how well it predicts them.

    On recorded drives its errors stand beside those of "nothing changes", and its commands beside the driver's.
    """

    bags: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="[BAG ...]")] = ()
    """Folders of rosbag2 with the topics scan, odom and cmd_vel (default: none, but episodes in simulation)."""

    task: str | None = None
    """Task of the episodes, as for `train` (default: the task that the policy has learnt)."""

    episodes: at_least(1) = 100  # type: ignore[valid-type]
    """Number of episodes."""

    seed: at_least(0) = 0  # type: ignore[valid-type]
    """Seed of the first episode; the others follow."""

    results: OptionalFileToWrite = None
    """JSON file to write the figures to."""

    def __post_init__(self) -> None:
        """Take any number of bags."""


@dataclass(frozen=True, kw_only=True)
class LearnOfflineOptions(OutputOptions, BagOptions):
    """Learn encoder, model and LQR from recorded drives alone: a driver's commands take the place of a reward."""

    latent: at_least(2) = 16  # type: ignore[valid-type]
    """Dimensions of the encoder."""

    updates: at_least(1) = 1500  # type: ignore[valid-type]
    """Number of updates of the networks."""

    far: float = 3.5
    """Distance beyond which a scan shows nothing [m]."""

    seed: int = 0
    """Seed of weights and batches."""


def _fit(options: FitOptions) -> int:
    refuse_existing(options.output, options.overwrite)
    file = find_policy(options.policy)
    policy = load_policy(file)
    seen, unseen = _parts(options, policy.observation_fn)
    manifest = {"fitted_from": digest(file), **_source(options)}
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
    parts = dict(zip((_FITTED, _HELD_OUT), _parts(options, policy.observation_fn), strict=True))
    figures = {name: evaluate_policy(policy, segments) for name, segments in parts.items() if segments}
    _print(figures)
    told = time_step_mismatch(policy, [*parts[_FITTED], *parts[_HELD_OUT]])
    if told:
        print(told)
    if options.results is not None:
        atomic_write(options.results, json.dumps(figures) + "\n")
    return 0


def _learn_offline(options: LearnOfflineOptions) -> int:
    refuse_existing(options.output, options.overwrite)
    observation = LidarObservation(far=options.far)
    seen, unseen = _parts(options, observation.observe)
    from koopman_lqr_controller.training.agents.imitation import ImitationSettings, imitate

    settings = ImitationSettings(latent=options.latent, updates=options.updates, seed=options.seed)
    with tqdm(total=settings.updates, desc="learning", unit="update", disable=None) as bar:
        learnt = imitate(seen, observation, settings, bar.update)
    manifest = {
        "method": "task-oriented Koopman control from recorded drives: imitation, then consolidation",
        "settings": vars(settings),
        **_source(options),
    }
    return _save(options, refit(learnt, seen), seen, unseen, manifest)


def _parts(options: BagOptions, observe: ObservationFn) -> tuple[list[TrajectorySegment], list[TrajectorySegment]]:
    check_held_out(options.held_out)
    return split(read_segments(options.bags, options, observe), options.held_out)


def _source(options: BagOptions) -> dict[str, Any]:
    return {"bags": [bag.name for bag in options.bags], "held_out": options.held_out}


def _save(
    options: OutputOptions,
    policy: KoopmanPolicy,
    seen: Sequence[TrajectorySegment],
    unseen: Sequence[TrajectorySegment],
    manifest: dict[str, Any],
) -> int:
    """Write a policy with its figures on both parts."""
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
