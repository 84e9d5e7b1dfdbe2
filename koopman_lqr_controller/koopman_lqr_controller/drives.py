"""From bags of a drive to snapshots for EDMD."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from ctrl_rl_core.alignment import EXTRACTORS
from ctrl_rl_core.bags import Aligned, Extractor, align, bag_info
from numpy.typing import NDArray

from koopman_lqr_controller.edmd import Snapshots
from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.lidar import ScanGeometry
from koopman_lqr_controller.observables import CorridorObservables

_EPISODE = Extractor(lambda message: (message.episode, message.outcome.value), ("episode", "outcome"))
_SAME_STEP = 0.25
"""Steps that differ from the usual one by more than this part are left out: a scan was lost."""


def snapshots_of(bag: Path, observables: CorridorObservables, robot: str = "") -> list[Snapshots]:
    """Return the snapshots of one bag, apart for each sequence without a gap.

    Where the bag holds ground truth about episodes (a simulator's), what follows a collision or the goal is left out.

    Args:
        bag: with the topics scan, odom and cmd_vel (Twist or TwistStamped).
        observables: Psi.
        robot: namespace of the topics.

    Raises:
        KoopmanError: a topic is missing or holds nothing usable.
        BagError: the bag cannot be read.
    """
    prefix = f"/{robot.strip('/')}" if robot else ""
    scan, odom, command, episode = (f"{prefix}/{name}" for name in ("scan", "odom", "cmd_vel", "episode"))
    info = {name: topic.type for name, topic in bag_info(bag).topics.items()}
    missing = [topic for topic in (scan, odom, command) if topic not in info]
    if missing:
        raise KoopmanError(f"{bag}: no topic {', '.join(missing)}; it has {', '.join(sorted(info))}")
    topics: dict[str, Extractor | None] = {scan: None, odom: None, command: None}
    if episode in info:
        topics[episode] = _EPISODE
    stamped = info[command].endswith("TwistStamped")
    sequences = align(bag, _extractors(topics, info), reference=scan, methods={odom: "linear"})
    out: list[Snapshots] = []
    for sequence in sequences:
        out += _pieces(sequence, observables, (scan, odom, command, episode), stamped)
    if not out:
        raise KoopmanError(f"{bag}: no two consecutive scans with odometry and a command: was the robot driven?")
    return out


def _extractors(topics: Mapping[str, Extractor | None], info: Mapping[str, str]) -> dict[str, Extractor]:
    out = {}
    for topic, given in topics.items():
        extractor = given or EXTRACTORS.get(info[topic])
        if extractor is None:
            raise KoopmanError(f"{topic} is of type {info[topic]}: must be one of {', '.join(EXTRACTORS)}")
        out[topic] = extractor
    return out


def _pieces(
    sequence: Aligned, observables: CorridorObservables, topics: Sequence[str], stamped: bool
) -> list[Snapshots]:
    scan, odom, command, episode = topics
    odometry, commands = sequence.values[odom], sequence.values[command]
    z = np.array([_lift(observables, s, o) for s, o in zip(sequence.values[scan], odometry, strict=True)])
    # A stamped command carries the stamp of the scan it answers; an unstamped one was sent after it, before the next.
    u = commands[:-1] if stamped else commands[1:]
    step = np.diff(sequence.seconds)
    usable = np.isfinite(z[:-1]).all(axis=1) & np.isfinite(z[1:]).all(axis=1) & np.isfinite(u).all(axis=1)
    if len(step):
        usable &= np.abs(step / np.median(step) - 1.0) < _SAME_STEP
    if episode in sequence.values:
        number, outcome = sequence.values[episode].T
        usable &= (number[:-1] == number[1:]) & (outcome[1:] == 0)
    cuts = np.flatnonzero(~usable)
    runs = np.split(np.arange(len(usable)), np.unique(np.concatenate((cuts, cuts + 1))))
    return [Snapshots(z[rows], u[rows], z[rows + 1]) for rows in runs if len(rows) and usable[rows].all()]


def _lift(observables: CorridorObservables, scan: Any, odometry: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return Psi of one sample, NaN where the scan shows nothing."""
    geometry = ScanGeometry(len(scan.ranges), scan.angle_min, scan.angle_increment, scan.range_min, scan.range_max)
    try:
        distances = observables.sectors.distances(scan.ranges, geometry)
    except KoopmanError:
        return np.full(len(observables.names), np.nan)
    return observables.lift(distances, v=odometry[3], omega=odometry[4])
