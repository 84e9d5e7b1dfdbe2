"""The angle at which a lidar is mounted shows in how echoes move, within the first metre."""

import math

import numpy as np
import pytest
from ctrl_rl_safety.monitor import Mounting

BEARINGS = np.radians(np.arange(0.0, 360.0, 1.0))
NOISE = 0.01


def scan(pose: np.ndarray, discs: np.ndarray, yaw: float, forward: float, random: np.random.Generator) -> np.ndarray:
    """Return echoes in the robot's frame as a lidar sees them that is turned by an angle nobody was told."""
    x = pose[0] + forward * math.cos(pose[2])
    y = pose[1] + forward * math.sin(pose[2])
    c, s = np.cos(BEARINGS + pose[2] + yaw), np.sin(BEARINGS + pose[2] + yaw)
    dx, dy = discs[:, :1] - x, discs[:, 1:2] - y
    along = dx * c + dy * s
    inside = discs[:, 2:] ** 2 - (dx**2 + dy**2 - along**2)
    ranges = np.where((inside > 0.0) & (along > 0.0), along - np.sqrt(np.maximum(inside, 0.0)), np.inf).min(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        wall = np.minimum(np.abs((np.sign(c) * 4.0 - x) / c), np.abs((np.sign(s) * 3.0 - y) / s))
    ranges = np.minimum(ranges, wall) + NOISE * np.clip(random.standard_normal(len(BEARINGS)), -2.5, 2.5)
    return np.column_stack((forward + ranges * np.cos(BEARINGS), ranges * np.sin(BEARINGS)))


def driven(yaw: float, seed: int, metres: float, curve: float = 0.0, walkers: int = 0) -> tuple[Mounting, float]:
    """Return the mounting after a drive among discs in a room, and the distance at which it was found wrong [m]."""
    random = np.random.default_rng(seed)
    count = int(random.integers(1, 8))
    discs = np.column_stack((random.uniform(-3.5, 3.5, count + walkers), random.uniform(-2.5, 2.5, count + walkers)))
    discs = np.column_stack((discs, random.uniform(0.03, 0.3, len(discs))))
    ways = random.uniform(-0.05, 0.05, (len(discs), 2)) * (np.arange(len(discs)) >= count)[:, None]
    pose, way, mounting = np.array((-2.0, 0.0, random.uniform(-0.4, 0.4))), 0.0, Mounting(0.05)
    while way < metres:
        mounting.look(pose + random.uniform(-1.0, 1.0, 3) * (0.002, 0.002, 0.002), scan(pose, discs, yaw, 0.05, random))
        if mounting.problem:
            return mounting, way
        pose = pose + 0.05 * np.array((math.cos(pose[2]), math.sin(pose[2]), curve))
        discs[:, :2] += ways
        way += 0.05
    return mounting, math.inf


@pytest.mark.parametrize("degrees", [-15.0, 15.0, 30.0, 90.0, 180.0])
def test_a_turned_lidar_is_found_within_a_metre(degrees: float) -> None:
    for seed in range(6):
        mounting, way = driven(math.radians(degrees), seed, 1.5)
        assert way <= 1.0, seed
        assert math.degrees(mounting.yaw) == pytest.approx(degrees, abs=8.0)
        assert "lidar is turned by about" in mounting.problem


@pytest.mark.parametrize(("curve", "walkers"), [(0.0, 0), (0.3, 0), (0.0, 3), (1.5, 2)])
def test_a_lidar_that_is_mounted_as_told_is_left_alone(curve: float, walkers: int) -> None:
    for seed in range(12):
        mounting, _ = driven(0.0, seed, 3.0, curve, walkers)
        assert not mounting.problem, seed


def test_a_jump_of_the_odometry_is_no_turned_lidar() -> None:
    random, mounting = np.random.default_rng(0), Mounting(0.0)
    discs = np.array(((1.0, 1.0, 0.2),))
    for k in range(40):
        pose = np.array((0.05 * k - 1.0, 0.0, 0.0))
        if k % 10 == 0:
            mounting.forget()
        shift = np.array((0.0, 0.3 * (k // 10), 0.0))
        mounting.look(pose + shift, scan(pose, discs, 0.0, 0.0, random))
    assert not mounting.problem
