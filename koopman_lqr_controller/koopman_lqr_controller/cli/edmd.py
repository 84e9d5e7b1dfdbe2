"""The command `edmd`: fits a two-stage policy to bags of a drive."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ctrl_rl_bags.datasets import check_task
from ctrl_rl_core.command import make_command
from ctrl_rl_core.tasks import require

from ctrl_rl_bags import bag_info
from ctrl_rl_core import load_navigation_task, task_digest
from koopman_lqr_controller.cli.bag_options import TELL, BagOptions, OutputOptions, read_segments
from koopman_lqr_controller.data.trajectory_segments import check_held_out, fitted_steps, mean_time_step, to_snapshots
from koopman_lqr_controller.identification.two_stage import train
from koopman_lqr_controller.policies.edmd_policy import EdmdPolicy
from koopman_lqr_controller.policies.policy_file import refuse_existing, save_policy
from koopman_lqr_controller.sensing.observables import CorridorObservables


@dataclass(frozen=True, kw_only=True)
class EdmdOptions(OutputOptions, BagOptions):
    """Learn the two-stage Koopman controller (thesis 2.3.1): EDMD on recorded drives, then its LQR."""

    task: str = "curved_corridor"
    """Task that sets the command limits: a name or a .yaml file."""

    speed: float = 0.18
    """Driving speed [m/s]."""

    other_task: bool = False
    """Also accept bags of another task, or of another version of it."""


def _learn(options: EdmdOptions) -> int:
    refuse_existing(options.output, options.overwrite)
    policy = _train(options)
    save_policy(policy, options.output, overwrite=options.overwrite)
    _report(policy, options.output)
    return 0


def _train(options: EdmdOptions) -> EdmdPolicy:
    check_held_out(options.held_out)
    task = load_navigation_task(options.task)
    require("koopman_lqr_controller edmd", task)
    limits = (task.robot.commands["v"], task.robot.commands["omega"])
    observables = CorridorObservables()
    digest = task_digest(task)
    for bag in options.bags:
        check_task(bag, bag_info(bag).custom_data, task.name, digest, allowed=options.other_task, tell=TELL)
    segments = read_segments(options.bags, options, observables.observe)
    manifest = {
        "task": task.name,
        "task_digest": digest,
        "bags": [bag.name for bag in options.bags],
        "fitted_to": fitted_steps(segments, options.held_out),
        "dt": mean_time_step(segments),
    }
    return train(
        to_snapshots(segments), observables, options.speed, limits, held_out=options.held_out, manifest=manifest
    )


def _report(policy: EdmdPolicy, path: Path) -> None:
    figures = policy.manifest
    counts = figures["snapshots"]
    print(f"snapshots            {counts['fitted']} fitted, {counts['held_out']} held out")
    judged = "held out" if counts["held_out"] else "fitted"
    print(f"one-step error       {figures['error_over_persistence']:.2f} of that of 'nothing changes' ({judged})")
    print(f"closed loop          spectral radius {figures['spectral_radius']:.3f}")
    print(f"Riccati residual     {figures['dare_residual']:.1e}")
    print(f"policy               {path}")


main = make_command("edmd", EdmdOptions, _learn)
