"""The command `identify`: measures the constants of a robot from a bag, and writes a file for the filter."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from ctrl_rl_bags.datasets import print_note
from ctrl_rl_core.command import FileToWrite, FiniteNumber, make_command

from ctrl_rl_safety.errors import SafetyError
from ctrl_rl_safety.identification.drive import STEP, read_drives
from ctrl_rl_safety.identification.fit import fit_drives
from ctrl_rl_safety.identification.missing import Missing, read_missing
from ctrl_rl_safety.models.robot_model import UNITS, RobotModel

_MUCH = 0.1
"""Unexplained fraction of the variance above which a model is rejected as poor."""
_MEASURED = (
    *("speed", "reverse_speed", "turn_rate", "acceleration", "braking", "turn_acceleration"),
    *("lag", "delay", "disturbance"),
)


@dataclass(frozen=True)
class Identify:
    """Measure a robot's acceleration, braking, turn acceleration, delay, top speeds and disturbance from a bag.

    The bag must contain commands and odometry of a drive of at least half a minute with starts, stops, turns and top
    speeds. Values that a drive does not reveal (radius, lidar errors) are options. If the bag has scans, they show how
    often the lidar misses a surface.
    """

    bag: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="BAG")]
    """Bag with commands and odometry."""
    radius: FiniteNumber
    """Radius of the disc around the robot's centre that encloses the robot [m]."""
    output: FileToWrite = Path("robot.yaml")
    """File to write, for the filter's parameter `robot`."""
    track: FiniteNumber = 0.0
    """Distance between two driven wheels whose force limits speed and turn rate together [m]; 0 for separate limits."""
    commands: str = ""
    """Topic of the commands (default: the one named cmd_vel)."""
    odometry: str = ""
    """Topic of the odometry (default: the one named odom)."""
    range_error: FiniteNumber = 0.03
    """Bound of the position error of lidar echoes [m]."""
    scan_age: FiniteNumber = 0.0
    """Bound of the time by which an echo is older than its scan's stamp [s]."""
    missing_rate: FiniteNumber = 0.1
    """Probability that a scan misses what its beams hit; more if the bag's scans show more."""


def _identify(options: Identify) -> int:
    name = options.output.stem
    if options.output.suffix not in (".yaml", ".yml"):
        raise SafetyError(f"--output {options.output}: name a .yaml file")
    drives = read_drives(options.bag, options.commands, options.odometry, partial(print_note, "identify"))
    fit = fit_drives(drives, options.track)
    measured = {each: getattr(fit, each) for each in _MEASURED}
    given = {each: getattr(options, each) for each in ("range_error", "scan_age", "track")}
    missing = read_missing(options.bag)
    rate = max(options.missing_rate, 0.0 if missing is None else missing.bound)
    model = RobotModel(name, options.radius, **measured, **given, missing_rate=rate)
    model.save(options.output)
    seconds = STEP * sum(len(each.speeds) for each in drives)
    print(f"{seconds:.1f} s of commands and odometry; the model leaves {fit.error:.1%} of the variance")
    for each in _MEASURED:
        print(f"{each:<18} {getattr(model, each):8.4g} {UNITS[each]}")
    print(_lidar(missing, rate))
    told = max(float(np.abs(each.commands[:, 0]).max()) for each in drives)
    if told > 1.1 * max(fit.speed, fit.reverse_speed):
        print(f"note: commands reached {told:.3g} m/s, the robot did not")
    if fit.error > _MUCH:
        print("note: the robot deviates from the model: drive on an even floor, without other commands")
    print(f"written to {options.output}")
    return 0


def _lidar(missing: Missing | None, rate: float) -> str:
    if missing is None:
        return f"missing_rate       {rate:8.4g}   as given: the bag has too few scans to measure it"
    return (
        f"missing_rate       {rate:8.4g}   {missing.missed} of {missing.beams} beams missed the surface that they hit"
    )


main = make_command("identify", Identify, _identify)
