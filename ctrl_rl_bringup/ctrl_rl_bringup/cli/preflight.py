"""The command `preflight`: inspects a live robot and says go or no-go."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from ctrl_rl_core.command import EXIT_USAGE, FiniteNumber, folder_to_write
from ctrl_rl_core.robots import DEFAULT_ROBOT
from rclpy.executors import Executor, SingleThreadedExecutor
from tqdm import tqdm

from ctrl_rl_bringup.cli.running import own_arguments, run_folder
from ctrl_rl_bringup.preflight.finding import Finding, Limits, left_out
from ctrl_rl_bringup.preflight.inspection import as_text, inspect_moving, inspect_standing, may_go, write_report
from ctrl_rl_bringup.preflight.listener import Listener
from ctrl_rl_bringup.preflight.motion_checks import Motion
from ctrl_rl_bringup.preflight.mover import Mover, mover_parameters, run_pattern
from ctrl_rl_bringup.runner.processes import ros
from ctrl_rl_core import CommandError, RobotError, find_robot, parse_options, run_command

_LONGEST_S = 600.0
_EPILOG = """Exit code 0: go; 1: no-go; 2: the command line is wrong, or the report cannot be written.
ROS arguments may follow, as in: preflight --ros-args -r scan:=lidar_scan"""
_QUESTION = {
    "air": "The wheels will turn. Are they in the air?",
    "floor": "The robot will turn by 45 degrees and drive 16 cm ahead and back. Is a metre around it free?",
}


@dataclass(frozen=True)
class PreflightOptions:
    """Inspect a live robot, or the simulator, before it drives: list what is wrong and say GO or NO-GO."""

    output: Path | None = None
    """Folder of the report, preflight.txt and preflight.json; by default runs/preflight-<date>-<time>."""

    seconds: FiniteNumber = 5.0
    """Time to listen after the first scan and odometry [s]."""

    wait: FiniteNumber = 10.0
    """Longest time to wait for scan and odometry [s]."""

    namespace: str = ""
    """Namespace of the robot."""

    unstamped: bool = False
    """Commands will be Twist (Humble) instead of TwistStamped (Jazzy)."""

    commands: str = "cmd_vel"
    """Topic that commands will be sent on: cmd_vel_raw if the watchdog runs."""

    move: Literal["none", "air", "floor"] = "none"
    """Drive a short pattern, wheels in the air or with a metre of free space, and compare odometry and scans."""

    yes: bool = False
    """Move without asking."""

    robot: str = DEFAULT_ROBOT
    """Name of the robot, or path of its .yaml file with lidar mounting, size and battery."""

    limits: Annotated[Limits, tyro.conf.arg(name="")] = field(default_factory=Limits)

    def check(self) -> None:
        """Check the values. Raises: CommandError: A value is out of range."""
        for name, least, largest in (("seconds", 1.0, _LONGEST_S), ("wait", 0.0, _LONGEST_S)):
            if not least <= getattr(self, name) <= largest:
                raise CommandError(f"--{name} {getattr(self, name):g}: must be {least:g} to {largest:g} s")
        signed = ("lidar_x", "lidar_yaw")
        for each in fields(Limits):
            value, option = getattr(self.limits, each.name), each.name.replace("_", "-")
            if each.name not in signed and value < 0.0:
                raise CommandError(f"--{option} {value:g}: must not be negative")
        if not (abs(self.limits.lidar_x) <= 1.0 and abs(self.limits.lidar_yaw) <= 3.1416):
            raise CommandError("--lidar-x must be -1 to 1 m, --lidar-yaw -3.1416 to 3.1416 rad")
        if self.move != "none" and not self.yes and not sys.stdin.isatty():
            raise CommandError(f"--move {self.move} asks before it moves the robot: run it in a terminal, or add --yes")


def preflight() -> int:
    """Inspect a live robot and say go or no-go."""
    return run_command("preflight", _preflight, failure=EXIT_USAGE)


def _preflight() -> int:
    options = parse_options("preflight", PreflightOptions, own_arguments("preflight"), _EPILOG)
    options.check()
    try:
        options = replace(options, limits=options.limits.of(find_robot(options.robot)))
    except RobotError as error:
        raise CommandError(str(error)) from None
    folder = run_folder(options.output, "preflight")
    try:
        folder_to_write(str(folder))
    except ValueError as error:
        raise CommandError(str(error)) from None
    moves = options.move != "none" and _agreed(options)
    with ros(_ros_arguments(options)), _listener(options) as (listener, executor):
        findings = _stand(options, listener, executor)
        findings += _move(options, listener, executor, may_go(findings)) if moves else [_not_moved(options)]
    write_report(folder, findings, options.limits)
    print(as_text(findings))
    print(f"report  {folder / 'preflight.txt'}")
    return 0 if may_go(findings) else 1


def _stand(options: PreflightOptions, listener: Listener, executor: Executor) -> list[Finding]:
    """Inspect a standing robot and return the findings."""
    print("preflight: waiting for scan and odometry", file=sys.stderr)
    listener.wait(executor, options.wait)
    print(f"preflight: listening for {options.seconds:g} s", file=sys.stderr)
    with tqdm(total=options.seconds, unit="s", bar_format="{l_bar}{bar}| {n:.0f} s", disable=None) as bar:
        heard = listener.listen(executor, options.seconds, lambda passed: _show(bar, passed))
    return inspect_standing(heard, options.limits)


def _move(options: PreflightOptions, listener: Listener, executor: Executor, healthy: bool) -> list[Finding]:
    """Drive the pattern if the standing robot is healthy, and return the findings."""
    if not healthy:
        return [left_out("drive", "the robot is not moved until the above is fixed")]
    mover = Mover()
    executor.add_node(mover)
    try:
        listener.heard.scans.clear()
        listener.heard.odometry.clear()
        parts = run_pattern(mover, executor, lambda name: print(f"preflight: {name}", file=sys.stderr))
    finally:
        executor.remove_node(mover)
        mover.destroy_node()
    return inspect_moving(Motion(listener.heard, parts), options.limits, options.move == "floor")


def _not_moved(options: PreflightOptions) -> Finding:
    reason = "not agreed to" if options.move != "none" else "no --move air or --move floor"
    return left_out("drive", f"{reason}: odometry and lidar are not held to commands, nor what stops the robot")


def _agreed(options: PreflightOptions) -> bool:
    """Ask whether the robot may move."""
    if options.yes:
        return True
    print(f"{_QUESTION[options.move]} [yes/no] ", end="", flush=True, file=sys.stderr)
    return sys.stdin.readline().strip().lower() in ("y", "yes")


def _ros_arguments(options: PreflightOptions) -> list[str]:
    """Return the process's arguments with the options for rclpy."""
    namespace = options.namespace.strip("/")
    out = [*sys.argv, "--ros-args"]
    out += ["-r", f"__ns:=/{namespace}"] if namespace else []
    for parameter in mover_parameters(options.move == "air", options.unstamped, options.limits):
        out += ["-p", f"preflight_mover:{parameter}"]
    out += ["-p", f"preflight_mover:robot:={options.robot}"]
    if options.commands != "cmd_vel":
        out += ["-r", f"preflight_mover:cmd_vel:={options.commands}"]
    return out


@contextmanager
def _listener(options: PreflightOptions) -> Iterator[tuple[Listener, Executor]]:
    listener, executor = Listener(options.unstamped, options.commands), SingleThreadedExecutor()
    executor.add_node(listener)
    try:
        yield listener, executor
    finally:
        executor.shutdown()
        listener.destroy_node()


def _show(bar: tqdm[Any], passed: float) -> None:
    bar.update(passed - bar.n)
