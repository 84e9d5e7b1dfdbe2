"""`ros2 run koopman_lqr_controller train`: from bags of a drive to a policy file."""

from __future__ import annotations

import argparse
from pathlib import Path

from ctrl_rl_core.command import run_command
from ctrl_rl_core.tasks.task import load_navigation_task, task_digest

from koopman_lqr_controller.cli.drive_options import add_drives, add_output, read_segments
from koopman_lqr_controller.data.trajectory_segments import check_held_out, mean_time_step, to_snapshots
from koopman_lqr_controller.identification.two_stage import train
from koopman_lqr_controller.policies.edmd_policy import EdmdPolicy
from koopman_lqr_controller.policies.policy_file import refuse_existing, save_policy
from koopman_lqr_controller.sensing.observables import CorridorObservables


def main(arguments: list[str] | None = None) -> int:
    """Run the command and return its exit code."""
    options = _parser().parse_args(arguments)

    def work() -> int:
        refuse_existing(options.output, options.overwrite)
        policy = _train(options)
        save_policy(policy, options.output, overwrite=options.overwrite)
        _report(policy, options.output)
        return 0

    return run_command("train", work)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="train",
        description="Learn the two-stage Koopman controller (thesis 2.3.1): EDMD on recorded drives, then its LQR.",
    )
    add_drives(parser)
    add_output(parser)
    parser.add_argument(
        "--task", default="curved_corridor", help="task that sets the command limits (default %(default)s)"
    )
    parser.add_argument("--speed", type=float, default=0.18, help="speed to drive at [m/s] (default %(default)s)")
    return parser


def _train(options: argparse.Namespace) -> EdmdPolicy:
    check_held_out(options.held_out)
    task = load_navigation_task(options.task)
    limits = (task.robot.commands["v"], task.robot.commands["omega"])
    observables = CorridorObservables()
    segments = read_segments(options, observables.observe)
    manifest = {
        "task": task.name,
        "task_digest": task_digest(task),
        "bags": [bag.name for bag in options.bags],
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
