"""The commands `train`, `evaluate`, `plot`, `loop` and `evaluate_offline` for learning joint options."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from ctrl_rl_core.command import FolderToWrite, NotNegative, OptionalFileToWrite, Positive, make_command
from ctrl_rl_core.io import as_lines
from ctrl_rl_learning.cli import EvaluateOptions, report
from ctrl_rl_learning.study import (
    ExperimentOptions,
    PlotOptions,
    make_old_command,
    one_of,
    some_of,
    train_and_collect,
)
from tqdm import tqdm

from ctrl_rl_core import CommandError, Result, write_results
from option_coordinator.cli import ReplayOptions, prepare_replay
from option_coordinator.data.bag_trajectory import recordings
from option_coordinator.environments.roll_out import play_episodes
from option_coordinator.environments.tasks import load_option_task, make_environment
from option_coordinator.policies.policy_file import HEADS, OptionPolicy, check_size, policy_file
from option_coordinator.training.experiments.methods import METHODS, usual_methods

ITERATIONS = 25
_METHODS = (
    "methods:\n"
    + "\n".join(f"  {name:<22} {method.label}" for name, method in METHODS.items())
    + "\n\nfrom bags: train --bags runs/*/bag --from policy.safetensors --task tool_delivery"
)


@dataclass(frozen=True, kw_only=True)
class Train(ExperimentOptions):
    """Learn joint options (thesis 5.3) from several seeds; an interrupted run continues where it stopped."""

    folder: FolderToWrite = Path("runs/options")
    """Folder of the runs; each run has a subfolder, from which it is resumed."""
    task: str | None = None
    """Task to learn (tool_delivery, water_filling, delivery_team or a file); with --bags, to evaluate in."""
    bags: tuple[Path, ...] = ()
    """Bags to learn from."""
    way: Literal["auto", "mappo", "imitation", "weighted"] = "auto"
    """Way to learn from bags: auto uses MAPPO on a policy's own decisions and imitates others;
    weighted imitates any decisions, weighted by advantage.
    """
    start: Annotated[Path | None, tyro.conf.arg(name="from")] = None
    """Policy to start from, with --bags."""
    head: Annotated[str, one_of(HEADS)] = "table"
    """Head of a policy learnt from bags alone."""
    methods: Annotated[tuple[str, ...], some_of([*METHODS, "all"])] = ()
    """Methods to learn with; by default async and sync_wait, or async_mixture where the joint table is too large."""
    sight: Literal["features", "image"] = "features"
    """Observation of Water Filling's robots."""
    drop: float = 0.0
    """Probability that a robot drops out in an episode; 0 for comparisons."""
    evaluations: Positive = 50
    """Number of episodes at the end."""


def _train(options: Train) -> int:
    if options.bags:
        return _train_on_bags(options)
    if options.task is None or options.start is not None:
        raise CommandError("give a --task to learn in, or --bags to learn from; --from goes with --bags")
    task = load_option_task(options.task)  # rejects an unknown method before torch is imported and workers start
    simulation = make_environment(options.task).simulation
    longest = simulation.step_limit
    least = 2 * longest * ITERATIONS  # so that an episode ends in every iteration, regardless of earlier overshoot
    samples = task.training_samples if options.samples is None else options.samples
    if samples < least:
        raise CommandError(
            f"--samples must be at least {least}, not {samples}: two longest episodes for each point of the curve"
        )
    if not 0.0 <= options.drop <= 1.0:
        raise CommandError(f"--drop must be a probability, 0 to 1, not {options.drop:g}")
    from ctrl_rl_learning.study import RunOptions

    from option_coordinator.training.experiments.results import LABELS, collect
    from option_coordinator.training.experiments.runs import option_runs

    every = [name for name, method in METHODS.items() if task.kind in method.kinds]
    usual = usual_methods([len(agent.options) for agent in simulation.agents])
    methods = every if "all" in options.methods else options.methods or usual
    if wrong := set(methods) - set(every):
        raise CommandError(f"task '{task.name}' has no method {', '.join(sorted(wrong))}: there are {', '.join(every)}")
    runs = option_runs(options.task, methods, options.seeds, options.sight, options.drop)
    for run in runs:
        agents = run.environment().agents  # raises if the task does not support images, options or drop-outs
        check_size(run.method.head, [len(agent.options) for agent in agents])
    how = RunOptions(options.folder, ITERATIONS, samples // ITERATIONS, final_evaluations=options.evaluations)
    train_and_collect(options, task, runs, "options", collect, how, LABELS)
    return 0


def _train_on_bags(options: Train) -> int:
    from ctrl_rl_learning.study import RunOptions, run_experiments

    from option_coordinator.training.experiments.bag_runs import ROUNDS, BagRun

    asked = None if options.way == "auto" else options.way
    run = BagRun(options.bags, options.start, options.task, options.head, asked=asked)
    run.environment()  # raises for a task with other robots, like `way` and `name` for unsuitable data
    own = f"this policy's own, {run.left_out} others are left out"
    whose = {"mappo": own, "imitation": "imitated", "weighted": "imitated as far as they paid"}[run.way]
    print(f"learning   {len(run.trajectory)} decisions, {whose}")
    how = RunOptions(options.folder, ROUNDS[run.way], final_evaluations=options.evaluations)
    (result,) = run_experiments([run], how, 1, run.name, options.ray)
    for when in ("before", "after"):
        if when in result:
            draws, mode = (result[when][use]["return"] for use in ("draws", "mode"))
            print(f"{when:<10} return {draws:.4g} by draws, {mode:.4g} by most likely options")
    print(f"policy     {options.folder / run.name / 'policy.safetensors'}")
    return 0


def _evaluate(options: EvaluateOptions) -> int:
    task = options.task or str(OptionPolicy.load(options.policy).manifest.get("task"))
    environment, choose = prepare_replay(ReplayOptions(task, str(options.policy), seed=options.seed))
    episodes = list(play_episodes(environment, choose, range(options.seed, options.seed + options.episodes)))
    done, returned = zip(*((episode.terminated, episode.returned) for episode in episodes), strict=True)
    return report(options, load_option_task(task).name, done, returned)


def _figures(options: PlotOptions) -> int:
    from ctrl_rl_learning.study import read_figures

    from option_coordinator.training.plots import Learning, draw_curves  # matplotlib is not installed on robots

    figures = read_figures(options.results, Learning)
    file = options.output / f"{figures['task']}_options.svg"
    draw_curves(figures, file)
    print(f"picture    {file}")
    return 0


evaluate = make_command("evaluate", EvaluateOptions, _evaluate)
train = make_command("train", Train, _train, _METHODS)
plot = make_command("plot", PlotOptions, _figures)
training_figures = make_old_command("training_figures", "plot", plot)


@dataclass(frozen=True, kw_only=True)
class LoopOptions:
    """Close the loop: learn a policy from a careless script's bags, the next from all bags so far, and compare them.

    After Ctrl-C, the next call resumes the runs; until then, the results contain the runs so far.
    """

    tasks: tuple[str, ...] = ("tool_delivery",)
    """Team tasks: names from the suite, or task files."""
    seeds: Positive = 5
    """Number of seeds, counted from 0."""
    rounds: Positive = 3
    """Number of rounds after the script's."""
    episodes: Positive = 100
    """Number of episodes recorded per round."""
    tests: Positive = 50
    """Number of evaluation episodes per round."""
    careless: float = 0.5
    """Probability that the script takes a random legal option."""
    folder: FolderToWrite = Path("runs/options_loop")
    """Folder of the runs; interrupted runs are resumed."""
    results: OptionalFileToWrite = None
    """JSON file for return and success of each round."""


def _loop(options: LoopOptions) -> int:
    if not 0.0 <= options.careless <= 1.0:
        raise CommandError(f"--careless must be a probability, 0 to 1, not {options.careless:g}")
    tasks = [load_option_task(task).name for task in options.tasks]
    from option_coordinator.training.experiments.closed_loop import LoopSettings, run_loop
    from option_coordinator.training.experiments.offline_evaluation import LEAST_EPISODES

    if options.episodes < LEAST_EPISODES:
        raise CommandError(f"--episodes must be at least {LEAST_EPISODES}: each round is evaluated from them")
    found: dict[str, list[list[dict[str, Any]]]] = {}
    try:
        for seed in range(options.seeds):
            for named, task in zip(options.tasks, tasks, strict=True):
                settings = LoopSettings(options.rounds, options.episodes, options.tests, options.careless, seed)
                run = f"{task}-s{seed}"
                rounds = run_loop(
                    named,
                    options.folder / run,
                    settings,
                    lambda line, run=run: print(f"{run}: {line}"),  # type: ignore[misc]
                )
                found.setdefault(task, []).append(rounds)
    finally:
        rows = _rows(found)
        print(as_lines(rows))
        if rows and options.results is not None:
            write_results(options.results, "options_loop", range(options.seeds), rows)
            print(f"results    {options.results}")
    return 0


def _rows(found: dict[str, list[list[dict[str, Any]]]]) -> list[Result]:
    """Return metrics of each round, one value per seed."""
    rows = []
    for task, runs in found.items():
        for number in range(len(runs[0])):
            name = f"{task}: weighted imitation, round {number}" if number else f"{task}: careless script"
            for metric, key, unit in (
                ("return", "return", "1"),
                ("success", "terminated", "1"),
                ("steps", "steps", "1"),
            ):
                rows.append(Result(name, metric, unit, [float(rounds[number][key]) for rounds in runs]))
            if all("predicted" in rounds[number] for rounds in runs):  # missing in runs that predate the prediction
                predicted = [float(rounds[number]["predicted"]["mean"]) for rounds in runs]
                rows.append(Result(name, "predicted, discounted", "1", predicted))
                rows.append(Result(name, "called better", "1", [float(rounds[number]["better"]) for rounds in runs]))
    return rows


loop = make_command("loop", LoopOptions, _loop)


@dataclass(frozen=True, kw_only=True)
class OfflineOptions:
    """Estimate a joint policy's return from bags, with 95 % intervals, and report whether it is an improvement.

    Exits with 1 unless the bags show that the policy is better than the ones that recorded them.
    """

    bags: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="BAG [BAG ...]")]
    """Bags with `joint_option_step`."""
    policy: str
    """Joint policy: a file, or the name of a shipped one."""
    updates: Positive = 1500
    """Number of updates of each fit."""
    fits: Positive = 3
    """Number of fits; their spread is part of the intervals."""
    seed: NotNegative = 0
    """Seed of fits, sampling and resampling."""
    results: OptionalFileToWrite = None
    """JSON file for the estimates."""


def _evaluate_offline(options: OfflineOptions) -> int:
    policy = OptionPolicy.load(policy_file(options.policy))
    from option_coordinator.training.experiments.offline_evaluation import evaluate_offline as judge

    found = [recording for bag in options.bags for recording in recordings(bag)]
    with tqdm(total=options.fits * options.updates, desc="evaluating", unit="update", disable=None) as bar:
        report = judge(found, policy, updates=options.updates, fits=options.fits, seed=options.seed, tell=bar.update)
    estimates = {"deciders of the bags": report.driver, "fitted Q evaluation": report.policy, "gain": report.gain}
    print(f"{'discounted return':<22} mean       95 % interval, {report.episodes} episodes")
    for name, estimate in estimates.items():
        print(f"{name:<22} {estimate}")
    if options.results is not None:
        rows = [
            Result(Path(options.policy).name, f"{name}{end}", "1", [getattr(estimate, key)])
            for name, estimate in estimates.items()
            for key, end in (("mean", ""), ("low", ", low"), ("high", ", high"))
        ]
        write_results(options.results, "evaluate_offline_team", [options.seed], rows, {"better": report.better})
        print(f"results    {options.results}")
    if report.better:
        print("verdict    better than who decided in the bags")
        return 0
    print(
        f"evaluate_offline: not called better: the gain is {report.gain.low:.3f} to {report.gain.high:.3f}",
        file=sys.stderr,
    )
    return 1


evaluate_offline = make_command("evaluate_offline", OfflineOptions, _evaluate_offline)
