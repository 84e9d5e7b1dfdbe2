"""One stage of the study: a simulated robot, its safety filter, and `fine_tune`, each a process of its own."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import yaml
from ament_index_python.packages import get_package_prefix
from ctrl_rl_core.processes import end_child, start_child
from ctrl_rl_learning.study import Study
from ctrl_rl_safety.trials import CAR

from ctrl_rl_core import task_file
from ctrl_rl_trials.errors import TrialError

_OPEN = {"lidar_x": 0.0, "min_echo_share": 0.0, "largest_gap": 6.3}
"""Node parameters for an arena that is wider than the lidar's range."""
_FILTER_PERIOD = 0.11
_END_S = 20.0


@dataclass(frozen=True)
class Stage:
    """Stage of the study.

    Attributes:
        folder: Folder of the stage.
        task: Name of a car task.
        policy: Initial policy.
        engine: Physics engine of the robot.
        delay: Time from the arrival of a command to its effect [s]; the safety filter accounts for it.
        arguments: Additional arguments of `fine_tune`.
    """

    folder: Path
    task: str
    policy: str
    engine: str
    delay: float
    arguments: tuple[str, ...]

    def run(self) -> Mapping[str, Any]:
        """Return the result of `fine_tune`, from an earlier call or from running it now.

        Raises:
            TrialError: One of the processes failed.
        """
        return Study(self.folder).once("result", self._drive)

    def _drive(self) -> Mapping[str, Any]:
        task, robot = self.folder / f"{self.task}.yaml", self.folder / "robot.yaml"
        task.write_text(yaml.safe_dump(_with_whole_scan(self.task), sort_keys=False))
        replace(CAR, delay=self.delay).save(robot)
        bridge = {"task": task, "engine": self.engine, "start_paused": True, "command_delay": float(self.delay)}
        safety = {"robot": robot, "use_sim_time": True, "control_period": _FILTER_PERIOD, **_OPEN}
        words = [self.policy, "--task", str(task), "--folder", str(self.folder), "--starts", "simulator", "--stepped"]
        with (
            _node("sim_bridge", "bridge", bridge, self.folder),
            _node("ctrl_rl_safety", "safety_filter", safety, self.folder),
        ):
            command: list[str | Path] = [
                _path("ctrl_rl_learning", "fine_tune"),
                *words,
                *self.arguments,
                *_ros_words(_OPEN),
            ]
            code = start_child(command).wait()
        if code:
            raise TrialError(f"fine_tune ended with exit code {code}; logs of its robot are in {self.folder}")
        return {}  # fine_tune has written the result


def _with_whole_scan(task: str) -> dict[str, Any]:
    """Return a task's content with a 360-degree lidar, because the safety filter must see what it avoids."""
    content: dict[str, Any] = yaml.safe_load(task_file(task).read_text(encoding="utf-8"))
    around = {"beams": 360, "field": "-180.0 .. 180.0 deg", "placement": "edges", "noise": "0.01 m"}
    return {**content, "lidar": {**content["lidar"], **around}}


@contextmanager
def _node(package: str, executable: str, parameters: Mapping[str, Any], folder: Path) -> Iterator[None]:
    """Run a node while the context lasts; its output goes to a log in the folder."""
    with (folder / f"{executable}.log").open("wb") as log:
        process = start_child(
            [_path(package, executable), *_ros_words(parameters)], stdout=log, stderr=subprocess.STDOUT
        )
    try:
        yield
    finally:
        end_child(process, _END_S)


def _path(package: str, executable: str) -> Path:
    return Path(get_package_prefix(package)) / "lib" / package / executable


def _ros_words(parameters: Mapping[str, Any]) -> list[str]:
    words = [(name, str(value).lower() if isinstance(value, bool) else value) for name, value in parameters.items()]
    return ["--ros-args", *(part for name, value in words for part in ("-p", f"{name}:={value}"))]
