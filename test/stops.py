"""Count collisions and stops of the shipped policies on broken scans and before obstacles, with and without the stops.

python test/stops.py [--starts 20] [--policies curved_corridor ...] [--scenes leg ...] [--bare]

Each start is one episode of the curved corridor in PyBullet, driven as the controller drives, but in one process. A
scene breaks the scans or puts something into the way. `--bare` drives as before there were scan checks and the obstacle
stop. The last column is the largest distance from the region of training, which `largest_distance` is set by.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ctrl_rl_core import (
    LIDAR_PARAMETERS,
    Box,
    CtrlRlError,
    Disc,
    DriveSafety,
    ObstacleStop,
    Outcome,
    ScanGeometry,
    ScanHealth,
    Shape,
    load_navigation_task,
)
from koopman_lqr_controller import Guard, KoopmanPolicy, find_policy, load_policy
from sim_bridge import LidarScan, SimulatedWorld, SimulationOptions

TASK = load_navigation_task("curved_corridor")
DEFAULTS = {parameter.name: parameter.default for parameter in LIDAR_PARAMETERS}
PERIOD = 48
"""Physics steps from scan to scan, 0.2 s."""
LONGEST = 400
"""Scans of an episode that has not ended by then: the robot stands."""
FREE = SimulationOptions(engine="pybullet", randomise_width=True)
LDS01 = replace(FREE, lidar="lds01", command_truncation=True, command_delay=0.1)
REAL = replace(LDS01, lidar="lds02", scan_dropout=0.1)

Break = Callable[[LidarScan, int, list[LidarScan]], LidarScan]


@dataclass(frozen=True)
class Scene:
    """What an episode is like.

    Attributes:
        options: options of the simulator.
        fault: what becomes of a scan, from the step at which it breaks.
        obstacle: what stands at a pose x, y, heading of the path.
        approaches: speed at which the obstacle comes along the path [m/s].
    """

    options: SimulationOptions = LDS01
    fault: Break | None = None
    obstacle: Callable[[np.ndarray, np.random.Generator], Shape] | None = None
    approaches: float = 0.0


@dataclass
class Tally:
    """How the episodes of one scene ended."""

    collisions: int = 0
    goals: int = 0
    stopped: dict[str, int] = field(default_factory=dict)
    farthest: list[float] = field(default_factory=list)


def changed(scan: LidarScan, ranges: np.ndarray) -> LidarScan:
    """Return a scan with other ranges."""
    out = ranges.astype(np.float32)
    return LidarScan(out, scan.angle_min, scan.angle_increment, scan.range_min, scan.range_max)


def half(scan: LidarScan, _step: int, _seen: list[LidarScan]) -> LidarScan:
    """Cover the left half."""
    return changed(scan, np.where(np.arange(len(scan.ranges)) < len(scan.ranges) // 2, 0.0, scan.ranges))


def two_lidars(scan: LidarScan, step: int, _seen: list[LidarScan]) -> LidarScan:
    """Let a second lidar, which looks to the left and farther, send every other scan."""
    if step % 2:
        return scan
    turned = np.roll(scan.ranges, len(scan.ranges) // 4)
    return LidarScan(turned, scan.angle_min, scan.angle_increment, 0.15, 12.0)


def across(part: float) -> Callable[[np.ndarray, np.random.Generator], Shape]:
    """Return what puts a box over a part of the corridor's width, from one of its walls."""

    def place(pose: np.ndarray, random: np.random.Generator) -> Shape:
        width = 0.8 * part
        side = (0.4 - 0.5 * width) * random.choice((-1.0, 1.0)) if part < 1.0 else 0.0
        x, y, heading = pose
        return Box((x - side * math.sin(heading), y + side * math.cos(heading)), (0.1, width), float(heading))

    return place


def leg(pose: np.ndarray, random: np.random.Generator) -> Shape:
    """Return a leg of 10 cm near the middle."""
    side = random.uniform(-0.1, 0.1)
    return Disc((float(pose[0] - side * math.sin(pose[2])), float(pose[1] + side * math.cos(pose[2]))), 0.05)


def box(pose: np.ndarray, _random: np.random.Generator) -> Shape:
    """Return a box of 20 cm in the middle."""
    return Box((float(pose[0]), float(pose[1])), (0.2, 0.2), float(pose[2]))


SCENES = {
    "free": Scene(FREE),
    "free, LDS-01": Scene(LDS01),
    "free, LDS-02, drop-out": Scene(REAL),
    "all zero": Scene(fault=lambda scan, _step, _seen: changed(scan, 0.0 * np.ones(len(scan.ranges)))),
    "all infinite": Scene(fault=lambda scan, _step, _seen: changed(scan, np.full(len(scan.ranges), np.inf))),
    "half zero": Scene(fault=half),
    "frozen": Scene(fault=lambda _scan, step, seen: seen[min(len(seen) - 1, step // 1000)]),
    "two lidars": Scene(fault=two_lidars),
    "leg of 10 cm": Scene(obstacle=leg),
    "dead end": Scene(obstacle=across(1.0)),
    "box across the way": Scene(obstacle=across(0.6)),
    "oncoming box": Scene(obstacle=box, approaches=0.15),
}
FAULT_BEGINS = 25
"""Scans before the lidar breaks."""


def episode(policy: KoopmanPolicy, scene: Scene, seed: int, bare: bool, largest_distance: float, tally: Tally) -> None:
    """Drive one start to its end."""
    world = SimulatedWorld(TASK, seed=seed, options=scene.options)
    random = np.random.default_rng((seed, 7))
    try:
        path = world.geometry.path
        assert path is not None
        s = random.uniform(2.5, 5.0)
        if scene.obstacle is not None:
            shape = scene.obstacle(path.pose(s), random)
            engine_of(world).add_fixed((shape,), "xy")
        safety = None if bare else new_safety()
        guard = Guard(policy.distribution, largest_distance, 1.0, 1.0)
        if not bare:
            guard.set_retries(3.0, 5)
        seen: list[LidarScan] = []
        predicted: np.ndarray | None = None
        why, farthest = "", 0.0
        for step in range(LONGEST):
            scan = world.laser_scan()
            seen.append(scan)
            if scene.fault is not None and step >= FAULT_BEGINS:
                scan = scene.fault(scan, step, seen[:FAULT_BEGINS])
            v, _, omega = world.odometry().velocity
            command, why, predicted, outside = decide(policy, guard, safety, scan, (v, omega), predicted, step)
            farthest = max(farthest, outside)
            world.command(0, command)
            for _ in range(6):
                world.step(PERIOD // 6)
                if scene.approaches:
                    s = come_nearer(world, path, s, scene.approaches * PERIOD / 6 / 240)
            if world.episode().outcome != Outcome.RUNNING:
                break
        outcome = world.episode().outcome
        tally.collisions += outcome == Outcome.COLLISION
        tally.goals += outcome == Outcome.GOAL
        tally.farthest.append(farthest)
        if outcome == Outcome.RUNNING:
            reason = "".join(letter for letter in why if not letter.isdigit()).split("(")[0].strip()[:60]
            tally.stopped[reason] = tally.stopped.get(reason, 0) + 1
    finally:
        world.close()


def come_nearer(world: SimulatedWorld, path: object, s: float, step: float) -> float:
    """Move the obstacle along the path until it is near the robot, where whoever comes stops as well."""
    import pybullet

    engine = engine_of(world)
    body = engine.fixed[-1]
    here, there = path.pose(s)[:2], path.pose(s - step)[:2]  # type: ignore[attr-defined]
    if np.hypot(*(world.pose()[:2] - there)) < 0.35:
        return s
    position, attitude = pybullet.getBasePositionAndOrientation(body, physicsClientId=engine.client)
    moved = (position[0] + there[0] - here[0], position[1] + there[1] - here[1], position[2])
    pybullet.resetBasePositionAndOrientation(body, moved, attitude, physicsClientId=engine.client)
    return s - step


def engine_of(world: SimulatedWorld) -> Any:
    """Return the engine of a world, in which obstacles are put up and moved behind its back."""
    return world._engine


def new_safety() -> DriveSafety:
    """Return the checks with the nodes' own defaults."""
    value = DEFAULTS
    health = ScanHealth(value["min_echo_share"], value["largest_gap"], value["frozen_scans"])
    obstacles = ObstacleStop(
        value["robot_radius"], value["obstacle_margin"], value["deceleration"], value["reaction_time"]
    )
    return DriveSafety(health, obstacles, value["lidar_x"], 1.0)


def decide(
    policy: KoopmanPolicy,
    guard: Guard,
    safety: DriveSafety | None,
    scan: LidarScan,
    motion: tuple[float, float],
    predicted: np.ndarray | None,
    step: int,
) -> tuple[np.ndarray, str, np.ndarray | None, float]:
    """Return command, reason of a stop, predicted latent, and distance from the region, as the controller has them."""
    stand = np.zeros(2)
    geometry = ScanGeometry(len(scan.ranges), scan.angle_min, scan.angle_increment, scan.range_min, scan.range_max)
    try:
        if safety is not None:
            frame = f"{scan.range_max:g}"
            safety.update(0.2 * step, step, frame, scan.ranges, geometry, motion)
            if safety.fault:
                return stand, safety.fault, None, 0.0
        decision = policy.decide(scan.ranges, geometry, *motion)
        error = math.nan if predicted is None else float(np.linalg.norm(decision.z - predicted))
        why = guard.update(0.2 * step, decision.z, error)
        command = stand if why else guard.speed_scale * decision.command
        if safety is not None and not why:
            command, why = safety.limit(command, motion[0], 0.0)
        return command, why, policy.predict(decision.z, command), guard.distance
    except CtrlRlError as error:
        return stand, str(error), None, 0.0


def main() -> None:
    """Print one line for each policy and scene."""
    parser = argparse.ArgumentParser(prog="stops", description=__doc__.splitlines()[0])
    parser.add_argument("--starts", type=int, default=20, help="episodes of each (default %(default)s)")
    parser.add_argument("--policies", nargs="+", default=["curved_corridor", "curved_corridor_edmd"])
    parser.add_argument("--scenes", nargs="+", choices=SCENES, default=list(SCENES), metavar="SCENE")
    parser.add_argument("--largest-distance", type=float, default=1.3, help="guard of the region (default %(default)s)")
    parser.add_argument("--bare", action="store_true", help="without scan checks and obstacle stop")
    options = parser.parse_args()
    print(f"{'policy':<22} {'scene':<24} {'collisions':>10} {'goals':>6}  farthest   stands at the end, and why")
    for name in options.policies:
        policy = load_policy(find_policy(name))
        for scene in options.scenes:
            tally = Tally()
            for seed in range(options.starts):
                episode(policy, SCENES[scene], seed, options.bare, options.largest_distance, tally)
            why = ", ".join(f"{count} {reason}" for reason, count in tally.stopped.items())
            print(
                f"{name:<22} {scene:<24} {tally.collisions:>10} {tally.goals:>6}  "
                f"{min(tally.farthest):.2f}..{max(tally.farthest):.2f}  {why}",
                flush=True,
            )


if __name__ == "__main__":
    main()
