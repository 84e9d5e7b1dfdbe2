"""The commands `fit`, `evaluate` and `learn_offline`: policies and recorded drives, no environment."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from ctrl_rl_core.command import check_least, file_to_write, run_command
from ctrl_rl_core.geometry.units import Interval
from ctrl_rl_core.io.atomic_write import atomic_write
from tqdm import tqdm

from koopman_lqr_controller.cli.drive_options import add_drives, add_output, read_segments
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
from koopman_lqr_controller.policies.edmd_policy import EdmdPolicy
from koopman_lqr_controller.policies.koopman_policy import ObservationFn
from koopman_lqr_controller.policies.latent_policy import LatentPolicy
from koopman_lqr_controller.policies.policy_file import digest, find_policy, load_policy, refuse_existing, save_policy
from koopman_lqr_controller.sensing.lidar_observation import LidarObservation

_FITTED, _HELD_OUT = "fitted", "held out"
_OF_NOTHING_HELD_OUT = ("snapshots", "one_step_error", "persistence_error")
"""What `train` says of its data, here all of what is fitted; `_save` says more, and of both parts."""


def fit(arguments: Sequence[str] | None = None) -> int:
    """Fit a policy's model anew to recorded drives: its coordinates and what it does stay, its regulator follows."""
    parser = argparse.ArgumentParser(prog="fit", description=fit.__doc__)
    parser.add_argument("policy", help="policy file of either kind, or the name of one that comes with the package")
    add_drives(parser)
    add_output(parser)
    options = parser.parse_args(arguments)
    return run_command("fit", lambda: _fit(options))


def evaluate(arguments: Sequence[str] | None = None) -> int:
    """Say how well a policy predicts recorded drives, against "nothing changes", and whether it commands the same."""
    parser = argparse.ArgumentParser(prog="evaluate", description=evaluate.__doc__)
    parser.add_argument("policy", help="policy file of either kind, or the name of one that comes with the package")
    add_drives(parser)
    parser.add_argument("--json", type=file_to_write, help="file to write the figures to")
    options = parser.parse_args(arguments)
    return run_command("evaluate", lambda: _evaluate(options))


def learn_offline(arguments: Sequence[str] | None = None) -> int:
    """Learn encoder, model and LQR from recorded drives alone: a driver's commands take the place of a reward."""
    parser = argparse.ArgumentParser(prog="learn_offline", description=learn_offline.__doc__)
    add_drives(parser)
    add_output(parser)
    parser.add_argument("--latent", type=int, default=16, help="dimensions of the encoder (default %(default)s)")
    parser.add_argument("--updates", type=int, default=1500, help="of the networks (default %(default)s)")
    parser.add_argument("--far", type=float, default=3.5, help="distance beyond which nothing counts [m]")
    parser.add_argument("--seed", type=int, default=0, help="of weights and batches (default %(default)s)")
    options = parser.parse_args(arguments)
    return run_command("learn_offline", lambda: _learn_offline(options))


def _fit(options: argparse.Namespace) -> int:
    refuse_existing(options.output, options.overwrite)
    file = find_policy(options.policy)
    policy = load_policy(file)
    seen, unseen = _parts(options, policy.observation_fn)
    manifest = {"fitted_from": digest(file), **_source(options)}
    fitted: EdmdPolicy | LatentPolicy
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
        fitted = replace(fitted, manifest={k: v for k, v in fitted.manifest.items() if k not in _OF_NOTHING_HELD_OUT})
    return _save(options, fitted, seen, unseen, manifest)


def _evaluate(options: argparse.Namespace) -> int:
    policy = load_policy(find_policy(options.policy))
    parts = dict(zip((_FITTED, _HELD_OUT), _parts(options, policy.observation_fn), strict=True))
    figures = {name: evaluate_policy(policy, segments) for name, segments in parts.items() if segments}
    _print(figures)
    told = time_step_mismatch(policy, [*parts[_FITTED], *parts[_HELD_OUT]])
    if told:
        print(told)
    if options.json is not None:
        atomic_write(options.json, json.dumps(figures) + "\n")
    return 0


def _learn_offline(options: argparse.Namespace) -> int:
    check_least(options, latent=2, updates=1)
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


def _parts(
    options: argparse.Namespace, observe: ObservationFn
) -> tuple[list[TrajectorySegment], list[TrajectorySegment]]:
    check_held_out(options.held_out)
    return split(read_segments(options, observe), options.held_out)


def _source(options: argparse.Namespace) -> dict[str, Any]:
    return {"bags": [bag.name for bag in options.bags], "held_out": options.held_out}


def _save(
    options: argparse.Namespace,
    policy: EdmdPolicy | LatentPolicy,
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
        print(
            f"These never changed and are left out of the model (a lidar that sees only ahead?): {', '.join(constant)}"
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
