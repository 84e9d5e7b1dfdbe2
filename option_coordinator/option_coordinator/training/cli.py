"""The commands `train` and `training_figures`: learning joint options, in simulation or from bags."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from ctrl_rl_core.command import CommandError, check_least, file_to_write, folder_to_write, run_command

from option_coordinator.environments.tasks import load_option_task, make_environment
from option_coordinator.policies.policy_file import HEADS
from option_coordinator.training.experiments.methods import METHODS

FOLDER = Path("runs/options")
ITERATIONS = 25
_MAIN = ("async", "sync_wait")


def train(arguments: Sequence[str] | None = None) -> int:
    """Learn joint options (thesis 5.3) from several seeds; go on where it was cut off."""
    parser = argparse.ArgumentParser(
        prog="train",
        description=train.__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog="methods:\n"
        + "\n".join(f"  {name:<22} {method.label}" for name, method in METHODS.items())
        + "\nfrom bags: train --bags runs/*/bag --from policy.safetensors --task tool_delivery",
    )
    parser.add_argument(
        "--task", help="tool_delivery, water_filling, delivery_team or a file; with --bags: to judge in"
    )
    parser.add_argument(
        "--bags", nargs="+", type=Path, help="to learn from: a policy's own decisions by MAPPO, others by imitation"
    )
    parser.add_argument("--from", dest="start", type=Path, help="policy to go on from, with --bags")
    parser.add_argument("--head", choices=tuple(HEADS), default="table", help="of a policy learnt from bags alone")
    parser.add_argument(
        "--methods", nargs="+", choices=[*METHODS, "all"], default=_MAIN, help="default: async sync_wait"
    )
    parser.add_argument("--sight", choices=("features", "image"), default="features", help="of Water Filling's robots")
    parser.add_argument(
        "--drop", type=float, default=0.0, help="chance that a robot vanishes in an episode (default 0, as compared)"
    )
    parser.add_argument("--folder", type=folder_to_write, default=FOLDER, help="of the runs (default %(default)s)")
    parser.add_argument("--seeds", type=int, default=5, help="how many, from 0 (default %(default)s)")
    parser.add_argument("--samples", type=int, help="low-level samples of a run (default: the task's)")
    parser.add_argument("--evaluations", type=int, default=50, help="episodes at the end (default %(default)s)")
    parser.add_argument("--workers", type=int, default=0, help="runs at a time (default: 0, one for each core)")
    parser.add_argument("--results", type=file_to_write, help="JSON file to write table and curves to")
    parser.add_argument("--ray", metavar="ADDRESS", help="Ray cluster that runs them, auto for this machine's")
    options = parser.parse_args(arguments)
    return run_command("train", lambda: _train(options) if options.bags is None else _train_on_bags(options))


def training_figures(arguments: Sequence[str] | None = None) -> int:
    """Draw the curves of learning (thesis Fig. 5.4) from the results that `train` wrote."""
    parser = argparse.ArgumentParser(prog="training_figures", description=training_figures.__doc__)
    parser.add_argument("results", type=Path, help="JSON file of `train --results`")
    parser.add_argument("--output", type=Path, default=Path("docs/images"), help="folder (default %(default)s)")
    options = parser.parse_args(arguments)
    return run_command("training_figures", lambda: _figures(options))


def _train(options: argparse.Namespace) -> int:
    if options.task is None or options.start is not None:
        raise CommandError("give a --task to learn in, or --bags to learn from; --from goes with --bags")
    task = load_option_task(options.task)  # refuses an unknown one before torch is imported and workers start
    longest = make_environment(options.task).simulation.step_limit
    least = 2 * longest * ITERATIONS  # so that an episode ends in every iteration, whatever the one before overshot
    check_least(options, seeds=1, evaluations=1, workers=0, samples=least)
    if not 0.0 <= options.drop <= 1.0:
        raise CommandError(f"--drop must be a probability, 0 to 1, not {options.drop:g}")
    samples = task.training_samples if options.samples is None else options.samples
    from ctrl_rl_training.cli import train_and_collect
    from ctrl_rl_training.experiments.run import RunOptions

    from option_coordinator.training.experiments.results import collect, table
    from option_coordinator.training.experiments.runs import option_runs

    every = [name for name, method in METHODS.items() if task.kind in method.kinds]
    methods = every if "all" in options.methods else options.methods
    if wrong := set(methods) - set(every):
        raise CommandError(f"task '{task.name}' has no method {', '.join(sorted(wrong))}: there are {', '.join(every)}")
    runs = option_runs(options.task, methods, options.seeds, options.sight, options.drop)
    for run in runs:
        run.environment()  # refuses images, options or robots that vanish where there are none
    how = RunOptions(options.folder, ITERATIONS, samples // ITERATIONS, final_evaluations=options.evaluations)
    train_and_collect(options, task, runs, "options", collect, table, how)
    return 0


def _train_on_bags(options: argparse.Namespace) -> int:
    check_least(options, evaluations=1)
    from ctrl_rl_training.experiments.matrix import run_experiments
    from ctrl_rl_training.experiments.run import RunOptions

    from option_coordinator.training.experiments.bag_runs import ROUNDS, BagRun

    run = BagRun(tuple(options.bags), options.start, options.task, options.head)
    run.environment()  # refuses a task of other robots, as `way` and `name` refuse what cannot be learnt from
    whose = f"this policy's own, {run.left_out} others are left out" if run.way == "mappo" else "imitated"
    print(f"learning   {len(run.trajectory)} decisions, {whose}", flush=True)
    how = RunOptions(options.folder, ROUNDS[run.way], final_evaluations=options.evaluations)
    (result,) = run_experiments([run], how, 1, run.name, options.ray)
    for when in ("before", "after"):
        if when in result:
            draws, mode = (result[when][use]["return"] for use in ("draws", "mode"))
            print(f"{when:<10} return {draws:.4g} by draws, {mode:.4g} by most likely options")
    print(f"policy     {options.folder / run.name / 'policy.safetensors'}")
    return 0


def _figures(options: argparse.Namespace) -> int:
    from ctrl_rl_training.experiments.results import read_figures

    from option_coordinator.training.plots import Learning, draw_curves  # matplotlib is not for robots

    figures = read_figures(options.results, Learning)
    options.output.mkdir(parents=True, exist_ok=True)
    file = options.output / f"{figures['task']}_options.png"
    draw_curves(figures, file)
    print(f"picture    {file}")
    return 0
