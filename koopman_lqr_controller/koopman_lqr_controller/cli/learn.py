"""The commands `learn` and `consolidate`: task-oriented Koopman control (thesis chapter 4) from interaction."""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ctrl_rl_core.command import check_least, file_to_write, run_command
from ctrl_rl_core.io.results import write_results

from koopman_lqr_controller.cli.run_options import add_learning_options, as_command, check_learning_options, given_words
from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.training.environments.benchmark_tasks import BENCHMARK_TASKS, find_task, task_of_manifest
from koopman_lqr_controller.training.experiments.methods import LEARNERS

_LEARN_WORDS = ("learner", "chunks", "actions", "episodes", "consolidation", "device")
_CONSOLIDATE_WORDS = ("latent", "episodes", "live", "noise", "seed")
"""Options that say what comes out: a policy's file tells them."""
_TASKS = "\n".join(
    f"  {problem.name:<24} {problem.about}; {problem.chunks} chunks of {problem.chunk} actions"
    for problem in BENCHMARK_TASKS.values()
)


def learn(arguments: Sequence[str] | None = None) -> int:
    """Learn a latent linear model and its LQR from interaction (thesis Algorithm 2), then consolidate it."""
    parser = argparse.ArgumentParser(
        prog="learn",
        description=learn.__doc__,
        epilog=f"tasks:\n{_TASKS}\n\nThe same command goes on where an earlier one was cut off. Each run leaves "
        "policy.safetensors (as learnt)\nand consolidated.safetensors (the LQR of its own model, to be deployed) in a "
        "folder of its own.\n\nexample:\n  learn --task cartpole_swingup --seeds 5 --set latent=30",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--task", required=True, help="one of the tasks below, or a .yaml file with a corridor")
    parser.add_argument("--learner", default="koopman", choices=LEARNERS, help="default %(default)s")
    add_learning_options(parser, seeds=1)
    parser.add_argument("--results", type=file_to_write, help="JSON file to write table and curves to")
    options = parser.parse_args(arguments)
    return run_command(
        "learn",
        lambda: _learn(options, given_words(parser, options, _LEARN_WORDS)),
    )


def consolidate(arguments: Sequence[str] | None = None) -> int:
    """Turn a learnt policy into the true LQR of its own model: inverse LQR in fewer latent dimensions that predict."""
    parser = argparse.ArgumentParser(prog="consolidate", description=consolidate.__doc__)
    parser.add_argument("policy", type=Path, help="policy.safetensors that `learn` made")
    parser.add_argument("--output", type=file_to_write, required=True, help="policy file to write (.safetensors)")
    parser.add_argument("--latent", type=int, nargs="+", help="latent dimensions to try (default: 4 to 24)")
    parser.add_argument(
        "--episodes",
        type=int,
        default=20,
        help="fresh ones at the end, for each policy (default %(default)s)",
    )
    parser.add_argument("--live", type=int, default=30, help="episodes of each round (default %(default)s)")
    parser.add_argument("--noise", type=float, default=0.5, help="most that is added to u (default %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="of all episodes (default %(default)s)")
    parser.add_argument("--overwrite", action="store_true", help="replace an existing policy file")
    options = parser.parse_args(arguments)
    return run_command(
        "consolidate",
        lambda: _consolidate(options, given_words(parser, options, _CONSOLIDATE_WORDS)),
    )


def _learn(options: argparse.Namespace, words: Sequence[str]) -> int:
    problem = find_task(options.task)
    chunks, actions = options.chunks or problem.chunks, options.actions or problem.chunk
    changes = check_learning_options(options)
    problem = problem.with_settings(**dict(changes))  # refuses what is wrong before torch, which takes seconds, is here
    from ctrl_rl_training.experiments.matrix import run_experiments
    from ctrl_rl_training.experiments.run import RunOptions
    from ctrl_rl_training.experiments.run_folder import result_file

    from koopman_lqr_controller.training.experiments.results import collect
    from koopman_lqr_controller.training.experiments.runs import LearningRun

    command = as_command("learn", "--task", options.task, *(["--set", *options.set] if options.set else []), *words)
    runs = [
        LearningRun(
            problem.name,
            seed,
            changes,
            options.device,
            f"{command} --seeds {seed + 1}",
            options.consolidation,
            options.learner,
        )
        for seed in range(options.seeds)
    ]
    how = RunOptions(options.folder, chunks, actions, problem.evaluations, options.episodes)
    title = Path(problem.name).stem
    results = run_experiments(runs, how, options.workers, title, options.ray)
    rows, figures = collect(problem, results)
    for row in rows:
        print(f"{row.method:<38} {row.metric:<32} {' '.join(f'{value:8.4g}' for value in row.values)}")
    for run, result in zip(runs, results, strict=True):
        print(f"policy     {result_file(options.folder, run).with_name(list(result['digests'])[-1])}")
    if options.results is not None:
        write_results(options.results, f"koopman_{title}", range(options.seeds), rows, figures)
        print(f"results    {options.results}")
    return 0


def _consolidate(options: argparse.Namespace, words: Sequence[str]) -> int:
    import torch
    from tqdm import tqdm

    from koopman_lqr_controller.policies.policy_file import refuse_existing, save_policy
    from koopman_lqr_controller.training.consolidation.consolidation_config import ConsolidationConfig
    from koopman_lqr_controller.training.consolidation.finishing import consolidate_policy, load_latent

    check_least(options, episodes=1, live=5, seed=0)
    if min(options.latent or [1]) < 1 or not 0.0 < options.noise < math.inf:
        raise KoopmanError("--latent must be at least 1, and --noise positive")
    refuse_existing(options.output, options.overwrite)
    problem = task_of_manifest(load_latent(options.policy).manifest)
    torch.set_num_threads(1)  # more only get into each other's way
    environment = problem.make(False)
    sizes = {"sizes": tuple(sorted(set(options.latent)))} if options.latent else {}
    plan = ConsolidationConfig.of(options.live, options.episodes, noise=options.noise, **sizes)
    command = as_command("consolidate", options.policy.name, "--output", options.output.name, *words)
    try:
        with tqdm(desc="consolidating", unit="part", disable=None) as bar:

            def on_progress(what: str) -> None:
                bar.set_postfix_str(what)
                bar.update()

            policy, found = consolidate_policy(
                options.policy, problem, environment, plan, command, options.seed, on_progress
            )
    finally:
        environment.close()
    save_policy(policy, options.output, overwrite=options.overwrite)
    _report(found, options.output)
    return 0


def _report(found: dict[str, Any], path: Path) -> None:
    learnt = found["learnt"]
    before, after = (sum(each["returns"]) / len(each["returns"]) for each in (learnt, found))
    print(f"return               {before:.1f} as learnt, {after:.1f} consolidated ({len(found['returns'])} episodes)")
    print(f"latent dimensions    {found['latent']}")
    print(f"closed loop          spectral radius {learnt['spectral_radius']:.3f} -> {found['spectral_radius']:.3f}")
    print(f"Riccati residual     {found['dare_residual']:.1e}")
    errors = (learnt["error_over_persistence"], found["error_over_persistence"])
    print(f"one-step error       {errors[0]:.2f} -> {errors[1]:.2f} of that of 'nothing changes'")
    curve = " ".join(
        f"{found['horizon_errors'][step - 1]:.2f}" for step in (1, 2, 5, 10) if step <= len(found["horizon_errors"])
    )
    print(f"  after 1 2 5 10     {curve} steps")
    errors = (learnt["law_error"], found["law_error"])
    print(f"  of K z             {errors[0]:.2f} -> {errors[1]:.2f}")
    print(f"steps cut off        {100 * found['saturated']:.0f} %")
    missed = [name for name, met in found["meets"].items() if not met]
    print(f"targets              {'met' if not missed else 'missed: ' + ', '.join(missed)}")
    print(f"policy               {path}")
