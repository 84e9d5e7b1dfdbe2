"""Extracts an optimal control problem from an RL task: RL info, candidate models, two criteria (thesis 3.3.2).

extraction = extract(load_navigation_task("car_navigation"))
print(extraction.report())
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from ctrl_rl_core import SYSTEM_MODELS, NavigationTask
from oc_baseline_node.errors import OcError
from oc_baseline_node.problems.problem import MODELS_OWN, Form, OptimalControlProblem, formulate

ROBOT_TYPES: Mapping[str, str] = {
    "turtlebot3_burger": "car",
    "turtlebot2": "car",
    "jackal": "car",
    "planar_quadrotor": "quadrotor",
}
"""Robot types by body."""
CANDIDATES: Mapping[str, tuple[str, ...]] = {
    "car": ("dubins_car", "extended_dubins_car", "bicycle"),
    "quadrotor": ("planar_quadrotor", "quadrotor_rotation", "point_mass"),
}
"""Models of Table 3.1 by robot type."""


@dataclass(frozen=True)
class RlInfo:
    """The four components of a task from which an optimal control problem is formed.

    Attributes:
        robot_type: Type of the robot, "car" or "quadrotor"; the system's name for a custom model.
        state: Components of the full RL state s, beams last.
        reward: Reward of each set, and the state components that define it.
        constraints: Description of the environment's constraints.
    """

    robot_type: str
    state: tuple[str, ...]
    reward: Mapping[str, tuple[float, tuple[str, ...]]]
    constraints: tuple[str, ...]


@dataclass(frozen=True)
class Candidate:
    """A model of Table 3.1 with the reasons for its rejection; without reasons it meets both criteria."""

    model: str
    reasons: tuple[str, ...]


@dataclass(frozen=True)
class Extraction:
    """The optimal control problem extracted from a task, with the reasons.

    Attributes:
        info: RL info of the task.
        candidates: Models of the robot's type, assessed by the two criteria.
        chosen: Name of the task's own model, which meets both criteria.
        problem: Resulting optimal control problem.
    """

    info: RlInfo
    candidates: tuple[Candidate, ...]
    chosen: str
    problem: OptimalControlProblem

    def report(self) -> str:
        """Format the extraction as text."""
        lines = [f"robot type    {self.info.robot_type}", f"RL state s    {_run_together(self.info.state)}"]
        for index, (name, (pays, parts)) in enumerate(self.info.reward.items()):
            lines.append(f"{'reward' if index == 0 else '':13} {pays:+g} {name} ({', '.join(parts) or 'elsewhere'})")
        lines += _labelled("constraints", self.info.constraints)
        lines += _labelled("candidates", [_verdict(c, c.model == self.chosen) for c in self.candidates])
        return "\n".join([*lines, *_labelled("problem", problem_lines(self.problem))])


def extract(task: NavigationTask, form: Form = "free_speed", clearance: float | None = None) -> Extraction:
    """Extract the RL info of a task, the assessed candidate models and the resulting problem.

    Args:
        task: Task to extract the problem from.
        form: Form of the problem, one of `FORMS`.
        clearance: Minimum distance d_min from obstacles [m]; None for the task's, raised above the body's radius if
            necessary.

    Raises:
        OcError: No candidate meets the criteria, the task's own model does not, or `formulate` rejects the task.
    """
    info = rl_info(task)
    candidates = tuple(assess(name, info) for name in CANDIDATES.get(info.robot_type, (task.system.model,)))
    fit = [candidate.model for candidate in candidates if not candidate.reasons]
    if not fit:
        refused = "; ".join(f"{candidate.model}: {candidate.reasons[0]}" for candidate in candidates)
        raise OcError(f"task '{task.name}': no model of a {info.robot_type} meets the criteria: {refused}")
    if task.system.model not in fit:
        raise OcError(f"task '{task.name}': system.model '{task.system.model}' is not one of the models that meet the "
                      f"criteria: {', '.join(fit)}")  # fmt: skip
    return Extraction(info, candidates, task.system.model, formulate(task, form, clearance))


def rl_info(task: NavigationTask) -> RlInfo:
    """Return the RL info of a task."""
    robot_type = ROBOT_TYPES.get(task.robot.body, task.system.model)
    places = ("x", task.plane[1])
    pays = task.rewards
    reward: dict[str, tuple[float, tuple[str, ...]]] = {
        "intermediate": (pays.intermediate, ()),
        "goal": (pays.goal, _components(() if task.corridor is not None else task.goal.intervals, places)),
        "collision": (pays.collision, places),
    }
    if task.trap is not None:
        reward["trap"] = (pays.trap or 0.0, _components(task.trap.intervals, places))
    if task.robot.tilt_limit is not None:
        reward["tilt"] = (pays.collision if pays.tilt is None else pays.tilt, ("psi",))
    constraints = (
        f"at most {task.episode.steps} steps of {task.episode.time_step:g} s",
        _map(task),
        f"{len(task.obstacles)} obstacles",
        "commands " + ", ".join(f"{name} {low:g} .. {high:g}" for name, (low, high) in task.robot.commands.items()),
    )
    beams = tuple(f"d_{index + 1}" for index in range(task.lidar.beams))
    return RlInfo(robot_type, (*task.observed_states, *beams), reward, constraints)


def assess(model: str, info: RlInfo) -> Candidate:
    """Check a model's criteria: its state is part of the RL state, and the reward depends only on its state."""
    own = tuple(state.name for state in SYSTEM_MODELS[model].states)
    reasons = []
    lacking = [name for name in own if name not in info.state]
    if lacking:
        reasons.append(
            f"criterion 1: its {', '.join(lacking)} {'is' if len(lacking) == 1 else 'are'} not in the RL state"
        )
    for name, (_, parts) in info.reward.items():
        unknown = [part for part in parts if part not in own]
        if unknown:
            reasons.append(f"criterion 2: the reward's '{name}' needs {', '.join(unknown)}, which it lacks")
    return Candidate(model, tuple(reasons))


def problem_lines(problem: OptimalControlProblem) -> list[str]:
    """Describe a problem, line by line."""
    system, H = problem.system, problem.horizon
    place = ", ".join(system.state_names[index] for index in problem.positions)
    trap = "" if problem.trap is None else f" - {problem.trap_weight:g} |p_k - p_trap|^2"
    cost = f"{problem.gamma:g}^(k+1) ({problem.state_weight:g} |p_k - p*|^2{trap}) + {problem.control_weight:g} |u_k|^2"
    low, high = problem.state_bounds
    bounds = [
        f"{name} {least:g} .. {most:g}"
        for name, least, most in zip(system.state_names, low, high, strict=True)
        if np.isfinite(least) or np.isfinite(most)
    ]
    controls = [
        f"{name} {a:g} .. {b:g}{f' ({source})' if source == MODELS_OWN else ''}"
        for name, a, b, source in zip(system.control_names, *system.control_bounds, problem.sources, strict=True)
    ]
    centre = "" if problem.trap is None else f", p_trap = ({problem.trap[0]:g}, {problem.trap[1]:g})"
    step = "free" if problem.form == "free_time" else f"{problem.time_step:g} s"
    return [
        f"form '{problem.form}', model {system.name}, x = ({', '.join(system.state_names)})",
        f"minimise the sum over k = 0 .. {H - 1} of {cost}",
        f"p = ({place}), p* = ({problem.goal[0]:g}, {problem.goal[1]:g}){centre}",
        f"x_{{k+1}} = f(x_k, u_k), a step of {step}",
        f"|p_k - obstacle| >= {problem.clearance:g} m",
        "bounds " + ", ".join([*bounds, *controls]),
        f"x_{H} in the goal",
    ]


def _map(task: NavigationTask) -> str:
    if task.corridor is not None:
        return f"a corridor {task.corridor.path.length:.3g} m long and {task.corridor.width:g} m wide"
    return "map " + ", ".join(f"{name} {low:g} .. {high:g} m" for name, (low, high) in task.plane_bounds.items())


def _components(intervals: Iterable[str], places: tuple[str, str]) -> tuple[str, ...]:
    return (*places, *(name for name in intervals if name not in places))


def _verdict(candidate: Candidate, chosen: bool) -> str:
    states = f"{candidate.model} ({', '.join(state.name for state in SYSTEM_MODELS[candidate.model].states)})"
    if candidate.reasons:
        return f"{states}: refused, {'; '.join(candidate.reasons)}"
    return f"{states}: meets both criteria{', chosen' if chosen else ''}"


def _labelled(label: str, texts: list[str] | tuple[str, ...]) -> list[str]:
    return [f"{label if index == 0 else '':13} {text}" for index, text in enumerate(texts)]


def _run_together(names: tuple[str, ...]) -> str:
    beams = [name for name in names if name.startswith("d_")]
    rest = [name for name in names if name not in beams]
    return ", ".join([*rest, f"{beams[0]} .. {beams[-1]}"] if beams else rest)
