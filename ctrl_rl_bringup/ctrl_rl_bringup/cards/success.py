"""How often a policy succeeds, from results files; each figure is matched to the policy's file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from ctrl_rl_core.io import read_experiment
from ctrl_rl_core.policies import policy_digest

from ctrl_rl_core import Experiment, PolicyDescription, TaskError, load_navigation_task, load_policy

NOMINAL = "nominal"
ENGINES = {"pybullet": "PyBullet", "mujoco": "MuJoCo"}
_CONFIDENCE = 0.95


@dataclass(frozen=True)
class Share:
    """Drives that reached the goal.

    Attributes:
        reached: Number of drives that reached the goal.
        count: Number of drives.
    """

    reached: int
    count: int

    @property
    def interval(self) -> tuple[float, float]:
        """The 95 % interval of the success rate (Wilson)."""
        from scipy.stats import binomtest

        found = binomtest(self.reached, self.count).proportion_ci(_CONFIDENCE, method="wilson")
        return float(found.low), float(found.high)

    def __str__(self) -> str:
        low, high = self.interval
        return f"{self.reached} of {self.count} ({100 * low:.0f} to {100 * high:.0f} %)"


@dataclass(frozen=True)
class Success:
    """A policy's success by engine and condition.

    Attributes:
        shares: Drives that reached the goal, by engine and condition.
        origin: File, command and commit of the figures.
    """

    shares: Mapping[tuple[str, str], Share]
    origin: str

    @property
    def conditions(self) -> list[str]:
        """The conditions, in order; nominal first."""
        return list(dict.fromkeys(condition for _, condition in self.shares))

    def limits(self) -> list[str]:
        """Return the conditions whose interval lies below that of nominal drives in the same engine, with figures."""
        found: dict[str, list[str]] = {}
        for (engine, condition), share in self.shares.items():
            nominal = self.shares.get((engine, NOMINAL))
            if nominal is not None and share.interval[1] < nominal.interval[0]:
                found.setdefault(condition, []).append(f"{share} in {ENGINES[engine]}")
        return [f"{condition}: {', '.join(shares)}" for condition, shares in found.items()]


def read_success(results: Path, file: Path, task: str) -> Success | None:
    """Return a policy's success from a results file of `transfer`; None if the file has no drives of this policy.

    A figure counts only if its cell's digest is that of this very policy file, task and conditions.

    Args:
        results: Results file.
        file: File of the policy.
        task: Name or file of the task that the policy was trained on.

    Raises:
        CtrlRlError: A file cannot be read, or the task is unknown.
    """
    from ctrl_rl_bringup.transfer.table import SHIFTS, Entry, plan_cells  # imports the simulator, for seconds

    experiment = read_experiment(results)
    methods = {digest: method for method, digest in digests_of(experiment).items()}
    if experiment is None or not methods:
        return None
    entry = Entry("", load_navigation_task(task), {policy_digest(file): load_policy(file)})
    rows = {row.method: row.values for row in experiment.rows if row.metric == "success"}
    shares = {}
    for _, cell in plan_cells([entry], tuple(ENGINES), tuple(SHIFTS), experiment.seeds):
        values = rows.get(methods.get(cell.digest, ""))
        if values is not None:
            shares[cell.engine, cell.shift] = Share(round(sum(values)), len(values))
    return Success(shares, _origin(results, experiment)) if shares else None


def read_team_figures(results: Path, training: Mapping[str, object]) -> list[str]:
    """Return lines on how a team's policy fared, from the results file of its training; empty without such figures.

    Figures count only if the makespan of the policy's seed is the one in the policy's own file.

    Raises:
        CtrlRlError: The file cannot be read.
    """
    experiment = read_experiment(results)
    method, seed = training.get("method"), training.get("seed")
    if experiment is None or seed not in experiment.seeds:
        return []
    rows = {row.metric: row.values for row in experiment.rows if row.method == method}
    place = experiment.seeds.index(int(str(seed)))
    if "makespan" not in rows or rows["makespan"][place] != _own_makespan(training):
        return []
    makespan, deliveries = rows["makespan"], rows["deliveries"]
    return [
        f"- deliveries: {deliveries[place]:g} on average of its test episodes",
        f"- makespan: {makespan[place]:.1f} s; {min(makespan):.1f} to {max(makespan):.1f} s over "
        f"{len(makespan)} seeds of learning",
        "",
        _origin(results, experiment),
    ]


def task_of(description: PolicyDescription) -> str | None:
    """Return the name of the task that a policy was trained on; None if its file does not name one."""
    task = description.training.get("task")
    return task if isinstance(task, str) else None


def success_of(description: PolicyDescription, file: Path, results: Path | None, task: str | None) -> Success | None:
    """Return a policy's success; None if results, task or drives are missing."""
    name = task or task_of(description)
    if results is None or name is None or description.manifest is None or not results.exists():
        return None
    try:
        return read_success(results, file, name)
    except TaskError:
        if task is not None:
            raise
        return None  # the policy's file names a task that is not here


def _own_makespan(training: Mapping[str, object]) -> object:
    final = training.get("final")
    used = final.get(training.get("used")) if isinstance(final, Mapping) else None
    return used.get("makespan") if isinstance(used, Mapping) else None


def digests_of(experiment: Experiment | None) -> dict[str, str]:
    """Return the digest of what each method of an experiment was measured on, as its figures hold them."""
    figures = experiment.figures if experiment is not None else None
    digests = figures.get("digests") if isinstance(figures, Mapping) else None
    return {str(method): str(digest) for method, digest in digests.items()} if isinstance(digests, Mapping) else {}


def _origin(results: Path, experiment: Experiment) -> str:
    commits: Sequence[str] = [f", commit {experiment.commit}"] if experiment.commit else []
    return f"From `{results.name}`: `{experiment.command}`{''.join(commits)}."
