"""The command `ros2 run oc_baseline_node analyse`: model mismatch, MPC in the simulator, accuracy of gradients.

analyse mismatch      Table 3.5: distance of model and simulator after 1, 5 and 10 steps
analyse mpc           Fig. 3.17: receding-horizon MPC in the simulator, compared with the learnt policy
analyse speed         CPU time of warm-started MPC, compared with the interior point
analyse gradient      Table 3.7: cosine similarity of estimated and true policy gradient

Comparisons of learning (advantages, noise, entropy, other baselines) come from `train --compare ...`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro
from ctrl_rl_core.command import FolderToWrite, NotNegative, Positive, checked_list, make_command
from ctrl_rl_core.io import as_lines, spread_of
from tqdm import tqdm

from ctrl_rl_core import NavigationTask, Result, ResultsError, load_navigation_task, write_results
from oc_baseline_node.errors import OcError

_RESULTS = Path("docs/results")
_IMAGES = Path("docs/images")
THESIS_MISMATCH = {"car_navigation": (0.095, 0.391, 0.518), "quad_navigation": (0.542, 0.836, 1.144)}
"""Table 3.5 [m], after `mismatch.STEPS`."""
THESIS_COSINE = {
    "PPO": (0.238, 0.422, 0.674, 0.855, 0.914),
    "PPO, OC baseline": (0.331, 0.615, 0.858, 0.961, 0.982),
}
"""Table 3.7, at `gradients.SIZES`."""


def _per_cent(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not -100.0 < value < math.inf:
        raise ValueError(f"is {text} per cent: nothing can be that heavy")
    return value


_PerCents = Annotated[tuple[float, ...], checked_list(_per_cent, "PER_CENT", show="{:g}".format)]


@dataclass(frozen=True, kw_only=True)
class _Analysis:
    """Options common to all analyses."""

    seed: NotNegative = 0
    """Random seed."""
    results: FolderToWrite = _RESULTS
    """Folder for the JSON files."""
    images: FolderToWrite = _IMAGES
    """Folder for the figures."""


@dataclass(frozen=True, kw_only=True)
class Mismatch(_Analysis):
    """Measure the distance between model and simulator after 1, 5 and 10 steps (Table 3.5)."""

    roll_outs: Positive = 50
    """Number of roll-outs per row; the thesis has 10."""
    heavier: _PerCents = (10.0,)
    """Percentages by which the simulated quadrotor's mass and inertia also exceed the model's."""


@dataclass(frozen=True, kw_only=True)
class MpcDrives(_Analysis):
    """Run receding-horizon MPC in the simulator, and draw it next to the learnt policy (Fig. 3.17)."""

    task: str = "quad_navigation"
    """Name or .yaml file of the task."""
    episodes: Positive = 5
    """Number of MPC episodes."""
    learnt: Path | None = None
    """JSON file of `train --results` with a learned path to draw; by default none."""


@dataclass(frozen=True, kw_only=True)
class Speed(_Analysis):
    """Compare the CPU time of warm-started MPC with that of the interior point."""

    tasks: tuple[str, ...] = ("car_navigation", "quad_navigation", "quad_trap", "curved_corridor")
    """Names or .yaml files of the tasks."""
    starts: Positive = 40
    """Number of random starts per task."""


@dataclass(frozen=True, kw_only=True)
class Gradient(_Analysis):
    """Compare estimates of the policy gradient with the true one by cosine similarity (Table 3.7)."""

    task: str = "quad_trap"
    """Name or .yaml file of the task."""
    value: Path | None = None
    """File of V_oc; by default the shipped network."""
    samples: Positive | None = None
    """Number of samples of the true gradient; by default the thesis's 102400."""


_Command: Any = (
    Annotated[Mismatch, tyro.conf.subcommand("mismatch")]
    | Annotated[MpcDrives, tyro.conf.subcommand("mpc")]
    | Annotated[Speed, tyro.conf.subcommand("speed")]
    | Annotated[Gradient, tyro.conf.subcommand("gradient")]
)
_SUMMARY = "Analyse the optimal control model, its MPC, and the policy gradients that V_oc improves (thesis 3.3)."


def _mismatch(options: Mismatch) -> int:
    from oc_baseline_node.training.analysis.mismatch import STEPS, transition_errors, with_extra_mass

    pairs: dict[str, tuple[NavigationTask, NavigationTask]] = {}
    for name in THESIS_MISMATCH:
        task = load_navigation_task(name)
        pairs[name] = task, task
        for per_cent in options.heavier if task.robot.body == "planar_quadrotor" else ():
            pairs[f"{name}, mass and inertia {per_cent:+g} %"] = task, with_extra_mass(task, per_cent)
    rows = []
    for label, (task, plant) in pairs.items():
        errors = transition_errors(task, options.roll_outs, options.seed, plant)
        for index, steps in enumerate(STEPS):
            known = errors[~np.isnan(errors[:, index]), index]
            if not len(known):
                raise OcError(f"{label}: no episode lasts {steps} steps: ask for more --roll-outs")
            thesis = THESIS_MISMATCH[task.name][index]
            rows.append(Result(label, f"error after {steps} steps", "m", known.tolist(), thesis))
            ours = f"{known.mean():.4f}{spread_of(known, '.4f')} m over {len(known)} roll-outs"
            print(f"{label:<41} after {steps:>2} steps  {ours}   thesis {thesis:.3f} m")
    return _write(options, "oc_mismatch", rows)


def _mpc(options: MpcDrives) -> int:
    from oc_baseline_node.training.analysis.mismatch import run_mpc_episodes

    task = load_navigation_task(options.task)
    learnt = [] if options.learnt is None else _learnt_paths(options.learnt, task)
    with tqdm(desc="MPC", unit="step", mininterval=5.0) as bar:
        drives = run_mpc_episodes(task, options.episodes, options.seed, bar.update)
    rows = [
        Result("MPC in the simulator", name, "1", [float(drive.outcome == outcome) for drive, _ in drives])
        for name, outcome in (("success", "GOAL"), ("collision rate", "COLLISION"), ("time-out rate", "TIMEOUT"))
    ]
    rows.append(Result("MPC in the simulator", "return", "1", [drive.total for drive, _ in drives]))
    rows.append(Result("MPC in the simulator", "steps with a solution", "1", [solved for _, solved in drives]))
    for row in rows:
        print(f"{row.method}: {row.metric} {np.mean(row.values):.3g}")
    paths = {
        "MPC": [{"outcome": drive.outcome, "states": drive.states.round(4).tolist()} for drive, _ in drives[:3]],
        "learnt": learnt[:3],
    }
    picture = options.images / f"{task.name}_mpc.png"
    from ctrl_rl_core.plots import draw_paths  # matplotlib is not installed on robots

    draw_paths(picture, f"{task.name} in the simulator", task, {name: each for name, each in paths.items() if each})
    print(f"picture    {picture}")
    return _write(options, f"oc_mpc_{task.name}", rows, {"task": task.name, "paths": paths})


def _learnt_paths(file: Path, task: NavigationTask) -> Sequence[Mapping[str, Any]]:
    from ctrl_rl_learning.study import read_figures

    from oc_baseline_node.training.plots import Learnt  # matplotlib is not installed on robots

    figures = read_figures(file, Learnt)
    if figures["task"] != task.name or "oc_ppo" not in figures["paths"]:
        raise ResultsError(f"{file}: holds no paths of oc_ppo in task '{task.name}': give what its `train` wrote")
    paths: Sequence[Mapping[str, Any]] = figures["paths"]["oc_ppo"]
    if any(len(path["states"][0]) != len(task.system.build().state_names) for path in paths):
        raise ResultsError(f"{file}: its paths have other states than task '{task.name}'")
    return paths


def _speed(options: Speed) -> int:
    from oc_baseline_node.training.analysis.speed import warm_rows

    rows: list[Result] = []
    tasks = [load_navigation_task(name) for name in options.tasks]
    with tqdm(total=len(tasks) * options.starts, desc="plans", unit="plan", mininterval=5.0) as bar:
        for task in tasks:
            rows += warm_rows(task, options.starts, options.seed, bar.update)
    print(as_lines(rows))
    return _write(options, "mpc_speed", rows)


def _gradient(options: Gradient) -> int:
    from oc_baseline_node.training.analysis import gradients
    from oc_baseline_node.training.analysis.gradients import find_early_policy
    from oc_baseline_node.training.experiments.runs import OcRun

    run = OcRun(load_navigation_task(options.task), "oc_ppo", options.seed, options.value)
    wanted = gradients.TRUTH if options.samples is None else options.samples
    with tqdm(desc="early policy", unit="roll-out", mininterval=5.0) as bar:
        model, ended = find_early_policy(run, bar.update)
    print(f"policy     after {model.num_timesteps} samples: {ended}")
    assert model.env is not None
    policy = model.policy
    pool = gradients.POOL
    with tqdm(total=wanted + max(gradients.SIZES) + pool, desc="samples", unit="sample", mininterval=5.0) as bar:
        known = gradients.collect_samples(policy, model.env, wanted, run.discount, bar.update)
        fitted = gradients.collect_samples(policy, model.env, max(gradients.SIZES), run.discount, bar.update)
        fresh = gradients.collect_samples(policy, model.env, pool, run.discount, bar.update)
    model.env.close()
    truth = gradients.policy_gradient(policy, known, None, np.arange(len(known.returns)))
    value = gradients.fit_value(fitted, options.seed)(fresh.observations)
    of_oc = run.baseline()(fresh.observations)
    baselines = {
        "PPO": value,
        "PPO, OC baseline": of_oc,
        "PPO, OC baseline less its mean error": of_oc + np.float32(np.mean(fresh.returns - of_oc)),
        "no baseline": None,
    }
    found = gradients.similarities(policy, truth, fresh, baselines, np.random.default_rng(options.seed))
    rows = []
    for name, sizes in found.items():
        for index, (size, values) in enumerate(sizes.items()):
            thesis = THESIS_COSINE[name][index] if name in THESIS_COSINE else None
            rows.append(Result(name, f"cosine similarity, {size} samples", "1", values, thesis))
            beside = "" if thesis is None else f"   thesis {thesis:.3f}"
            print(f"{name:<38} {size:>6} samples  {np.mean(values):.3f}{spread_of(values, '.3f')}{beside}")
    return _write(options, "oc_gradient", rows)


def _write(options: _Analysis, name: str, rows: Sequence[Result], figures: dict[str, object] | None = None) -> int:
    file = options.results / f"{name}.json"
    write_results(file, name, [options.seed], rows, figures)
    print(f"results    {file}")
    return 0


_WORK: dict[type, Callable[[Any], int]] = {Mismatch: _mismatch, MpcDrives: _mpc, Speed: _speed, Gradient: _gradient}
main = make_command("analyse", _Command, lambda options: _WORK[type(options)](options), _SUMMARY)

if __name__ == "__main__":
    raise SystemExit(main())
