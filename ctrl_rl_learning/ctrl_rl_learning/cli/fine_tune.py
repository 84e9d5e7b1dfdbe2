"""The command `fine_tune`: train a policy further on its robot."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from ctrl_rl_core.command import (
    FiniteNumber,
    FolderToWrite,
    NotNegative,
    Positive,
    one_of,
    parse_options,
    run_command,
)
from ctrl_rl_core.io import with_digest
from ctrl_rl_core.tasks import require

from ctrl_rl_core import Outcome, atomic_write, load_navigation_task, task_digest
from ctrl_rl_learning.errors import LearningError

if TYPE_CHECKING:
    from ctrl_rl_learning.on_robot.learning.session import EpisodeLog

_STARTS = ("operator", "simulator")
_EPILOG = """The robot drives only while the safety filter runs beside this command:
ros2 run ctrl_rl_safety safety_filter. Give node parameters (pose, operator_timeout, joy_button and so on) and
remappings after --ros-args. Ctrl-C stops the robot; the same command resumes after the last complete episode."""


@dataclass(frozen=True, kw_only=True)
class FineTune:
    """Fine-tune a policy on its robot: it drives behind the safety filter and learns between episodes.

    An operator may take over at any time by joystick (joy) or keyboard (cmd_vel_operator); the policy learns from the
    operator's commands, too.
    """

    policy: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="POLICY")]
    """Initial policy: the name of a shipped policy, or a policy file. A policy that `train` or `learn_offline` did not
    write, such as a Koopman policy, is first cloned into a network in the task's simulator."""
    task: str
    """Task name or .yaml file, which gives goal, arena and episode length."""
    minutes: FiniteNumber = 30.0
    """Total driving time [min], without resets and learning between episodes."""
    tests: NotNegative = 0
    """Number of test episodes of the finished policy, without exploration."""
    starts: Annotated[str, one_of(_STARTS)] = "operator"
    """Who resets the robot to its start: an operator, or the simulator that stands in for the robot."""
    stepped: bool = False
    """Step the simulator, which pauses it while nothing drives."""
    motion: bool = False
    """Add speed, turn rate and the last command to the observation, for a robot that is delayed or sluggish."""
    seed: NotNegative = 0
    """Seed of starts, exploration and learning."""
    updates: NotNegative = 5
    """Network updates per robot step."""
    noise: FiniteNumber = 0.25
    """Standard deviation of the exploration noise, as a fraction of half the command range."""
    threads: Positive = 1
    """Threads of the learner."""
    values: FolderToWrite = Path("runs/values")
    """Folder of times to reach; missing ones are solved."""
    folder: FolderToWrite = Path("runs/fine_tune")
    """Folder of checkpoint, policy.safetensors and result.json."""


def fine_tune(arguments: Sequence[str] | None = None) -> int:
    """Run the command."""
    from rclpy.utilities import remove_ros_args

    words = list(sys.argv if arguments is None else ["fine_tune", *arguments])
    options = parse_options("fine_tune", FineTune, list(remove_ros_args(words))[1:], _EPILOG)
    return run_command("fine_tune", lambda: _work(options, words))


def _work(options: FineTune, words: list[str]) -> int:
    if options.minutes < 0.0 or not 0.0 <= options.noise <= 2.0:
        raise LearningError("--minutes must not be negative, and --noise must be 0 to 2")
    if options.stepped and options.starts != "simulator":
        raise LearningError("--stepped needs --starts simulator: a real robot cannot be paused")
    # Torch takes seconds to import: wait until the arguments are valid.
    import torch
    from tqdm import tqdm

    from ctrl_rl_learning.cli.connection import Connection, connect
    from ctrl_rl_learning.on_robot.learning.fine_tuner import FineTuner, TuneSettings
    from ctrl_rl_learning.on_robot.learning.policy import read_or_clone
    from ctrl_rl_learning.on_robot.learning.session import Session

    torch.set_num_threads(options.threads)
    task = load_navigation_task(options.task)
    require("ctrl_rl_learning fine_tune", task)
    actor, interface = read_or_clone(options.policy, options.motion, task, options.seed, options.folder)
    total = 60.0 * options.minutes
    steps = round(total / (interface.period or task.episode.time_step)) + task.episode.steps
    tuner = FineTuner(actor, TuneSettings(updates=options.updates, noise=options.noise), steps, options.seed)
    options.folder.mkdir(parents=True, exist_ok=True)
    how = Connection(options.starts == "simulator", options.stepped, options.values)
    with connect(how, task, interface, words) as environment:
        terms = {"policy": options.policy, "task_digest": task_digest(task), "motion": options.motion}
        terms |= {"seed": options.seed, "updates": options.updates, "noise": options.noise}
        session = Session(environment, tuner, options.folder, options.seed, terms)
        with tqdm(total=round(total), initial=round(session.seconds), unit="s", disable=None) as bar:

            def tell(log: EpisodeLog) -> None:
                bar.update(round(session.seconds) - bar.n)
                bar.write(f"episode {len(session.episodes)}: {_line(log)}", file=sys.stdout)

            session.learn(total, tell)
        tested = session.test(options.tests, lambda log: print(f"test: {_line(log)}"))
    session.save_policy()
    success = sum(each.outcome == Outcome.GOAL.name for each in tested) / len(tested) if tested else None
    content = {
        "policy": options.policy,
        "task": task.name,
        "seed": options.seed,
        "seconds": session.seconds,
        "success": success,
        "tests": [asdict(each) for each in tested],
        "episodes": [asdict(each) for each in session.episodes],
    }
    atomic_write(options.folder / "result.json", json.dumps(with_digest(content)))
    if success is not None:
        print(f"success    {success:.3f} of {len(tested)} episodes")
    print(f"policy     {options.folder / 'policy.safetensors'}")
    return 0


def _line(log: EpisodeLog) -> str:
    said = f"{log.outcome.lower()} after {log.seconds:.1f} s, filter changed {log.changed:.0%} of the commands"
    for count, words in (
        (log.missed, "steps missed"),
        (log.late_scans, "late scans"),
        (log.operator, "steps by the operator"),
    ):
        said += f", {count} {words}" if count else ""
    return said
