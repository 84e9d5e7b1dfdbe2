"""The commands `train` and `consolidate`: task-oriented Koopman control (thesis chapter 4) from interaction."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias

import tyro
from ctrl_rl_core.command import FileToWrite, at_least
from ctrl_rl_core.io import results_lock, with_others
from ctrl_rl_learning.study import NotNegative, Positive, make_command, make_old_command, one_of

from ctrl_rl_core import write_results
from koopman_lqr_controller.cli.run_options import LearningOptions, as_command, given_words
from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.training.environments.benchmark_tasks import BENCHMARK_TASKS, find_task, task_of_manifest
from koopman_lqr_controller.training.environments.environment_tasks import name_environment
from koopman_lqr_controller.training.experiments.methods import LEARNERS
from koopman_lqr_controller.training.settings import RECIPES

_LEARN_WORDS = ("recipe", "learner", "keep", "samples", "chunks", "actions", "episodes", "consolidation", "device")
_CONSOLIDATE_WORDS = ("latent", "episodes", "live", "noise", "seed")
"""Options recorded in a policy's file, because they affect its content."""
_EPILOG = (
    "tasks:\n"
    + "\n".join(
        f"  {task.name:<24} {task.about}; {task.chunks} times {task.chunk} actions" for task in BENCHMARK_TASKS.values()
    )
    + "\n\nThe same command goes on where an earlier one was cut off. Each run leaves policy.safetensors (as learnt)\n"
    "and consolidated.safetensors (the LQR of its own model, to be deployed) in a folder of its own.\n\n"
    "examples:\n  train --task cartpole_swingup --seeds 5 --set latent=30\n"
    "  train --env Pendulum-v1 --recipe model_based --samples 20000\n"
    "  train --env walker_walk --recipe model_based --keep last"
)
if TYPE_CHECKING:
    _AtLeast5: TypeAlias = int
else:
    _AtLeast5 = at_least(5)


@dataclass(frozen=True, kw_only=True)
class Train(LearningOptions):
    """Learn a latent linear model and its LQR from interaction (thesis Algorithm 2), then consolidate it."""

    task: str = ""
    """Task to learn: one of those below, or a .yaml file with a corridor."""
    env: str = ""
    """Environment to learn in place of a task: one of Gymnasium's with continuous actions ("Pendulum-v1",
    "my_package:Mine-v0"), FILE.py:NAME of a class or function that makes one, or a task of the DeepMind control suite
    ("walker_walk")."""
    repeat: NotNegative = 0
    """Steps of the environment per action; 0 for two in the control suite, otherwise one."""
    seeds: Positive = 1
    """Number of seeds, counted from --first-seed."""
    first_seed: NotNegative = 0
    """First seed. Machines that train different seeds with --keep last can add to one --results file in turn."""
    recipe: Annotated[str, one_of(tuple(RECIPES))] = "thesis"
    """Base settings: the task's own, as in the thesis; or, for vector observations, "quick", which needs far fewer
    simulated frames, or "model_based", which starts more slowly and ends higher on the cheetah, in three times the
    time. Values from --set are applied afterwards."""
    learner: Annotated[str, one_of(LEARNERS)] = "koopman"
    """Learning algorithm."""
    keep: Literal["best", "last"] = "best"
    """Policy kept by a run: the best in the evaluations after each chunk, or the last, which involves no selection.
    With the last, --results contains returns by task and frames, merged with those already in the file: of other tasks,
    and of other seeds with the same settings."""


@dataclass(frozen=True, kw_only=True)
class Consolidate:
    """Turn a learnt policy into the LQR of its own model: inverse LQR in fewer latent dimensions that predict well."""

    policy: Annotated[Path, tyro.conf.Positional]
    """Policy learnt by `train` (policy.safetensors)."""
    output: FileToWrite
    """Policy file to write (.safetensors)."""
    latent: tuple[Positive, ...] = ()
    """Latent dimensions to try (default: 4 to 24)."""
    episodes: Positive = 20
    """New episodes for the final evaluation of each policy."""
    live: _AtLeast5 = 30
    """Episodes per round."""
    noise: float = 0.5
    """Maximum noise added to u."""
    seed: NotNegative = 0
    """Random seed of all episodes."""
    overwrite: bool = False
    """Replace an existing policy file."""


def _learn(options: Train) -> int:
    problem = find_task(_task_name(options))
    changes = tuple(sorted({**RECIPES[options.recipe], **dict(options.changes())}.items()))
    problem = problem.with_settings(**dict(changes))  # validate before importing torch, which takes seconds
    from ctrl_rl_learning.study import result_file, run_experiments

    from koopman_lqr_controller.training.experiments.last_curves import collect_curves, read_curves
    from koopman_lqr_controller.training.experiments.results import collect, collect_last

    if options.results is not None and options.keep == "last":
        read_curves(options.results)  # rejects a file that cannot be extended, before hours are spent
    settings = ["--set", *options.set_words] if options.set else []
    words = [*settings, *given_words(options, _LEARN_WORDS)]
    runs = options.learning_runs(
        problem.name, changes, words, options.consolidation, options.learner, options.keep, options.first_seed
    )
    title = problem.title
    results = run_experiments(runs, options.run_options(problem), options.workers, title, options.ray)
    rows, figures = collect(problem, results)
    for row in rows:
        print(f"{row.method:<38} {row.metric:<32} {' '.join(f'{value:8.4g}' for value in row.values)}")
    for run, result in zip(runs, results, strict=True):
        print(f"policy     {result_file(options.folder, run).with_name(list(result['digests'])[-1])}")
    if options.results is not None:
        seeds = [run.seed for run in runs]
        if options.keep == "last":
            last = collect_last(problem, results)
            with results_lock(options.results):
                last_curves = collect_curves(title, last[0].terms, results, options.results)
                rows = with_others(options.results, last, same_metric=True)
                seeds = sorted({*seeds, *(seed for row in rows for seed in row.seeds)})
                write_results(options.results, options.results.stem, seeds, rows, last_curves)
        else:
            write_results(options.results, f"koopman_{title}", seeds, rows, figures)
        print(f"results    {options.results}")
    return 0


def _task_name(options: Train) -> str:
    """Return the name of the task or environment.

    Raises:
        KoopmanError: Neither or both are given, or a repeat without an environment.
    """
    if bool(options.task) == bool(options.env):
        raise KoopmanError("give either --task or --env: what to learn")
    if options.repeat and not options.env:
        raise KoopmanError("--repeat goes with --env: a task has its own")
    return name_environment(options.env, options.repeat) if options.env else options.task


def _consolidate(options: Consolidate) -> int:
    import torch
    from tqdm import tqdm

    from koopman_lqr_controller.policies.policy_file import refuse_existing, save_policy
    from koopman_lqr_controller.training.consolidation.consolidation import consolidate_policy, load_latent
    from koopman_lqr_controller.training.consolidation.consolidation_config import ConsolidationConfig

    if not 0.0 < options.noise < math.inf:
        raise KoopmanError(f"--noise must be positive, not {options.noise}")
    refuse_existing(options.output, options.overwrite)
    problem = task_of_manifest(load_latent(options.policy).manifest)
    torch.set_num_threads(1)  # more threads slow each other down
    environment = problem.make(False)
    sizes = {"sizes": tuple(sorted(set(options.latent)))} if options.latent else {}
    plan = ConsolidationConfig.of(options.live, options.episodes, noise=options.noise, **sizes)
    command = as_command(
        "consolidate", options.policy.name, "--output", options.output.name, *given_words(options, _CONSOLIDATE_WORDS)
    )
    try:
        with tqdm(desc="consolidating", unit="part", disable=None) as bar:

            def on_progress(what: str) -> None:
                bar.set_postfix_str(what)
                bar.update()

            policy, found = consolidate_policy(
                options.policy, problem, environment, plan, command, seed=options.seed, on_progress=on_progress
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


train = make_command("train", Train, _learn, _EPILOG)
learn = make_old_command("learn", "train", train)
consolidate = make_command("consolidate", Consolidate, _consolidate)
