"""Compiles the filter's functions before the first command arrives."""

from __future__ import annotations

import numpy as np
from ctrl_rl_core.sensing import DIRECTIONS

from ctrl_rl_safety.filter.car_filter import make_filter
from ctrl_rl_safety.filter.seen_space import Sight
from ctrl_rl_safety.filter.verdict import FilterOptions, Reading
from ctrl_rl_safety.models.robot_model import RobotModel
from ctrl_rl_safety.monitor.robot_monitor import RobotMonitor


def warm_up(model: RobotModel, options: FilterOptions) -> None:
    """Compile the filter's functions, or load them from disk, before timing matters."""
    safety = make_filter(model, options)
    bearings = np.linspace(-3.0, 3.0, 60)
    echoes = 2.0 * model.radius * np.column_stack((np.cos(bearings), np.sin(bearings)))
    reading = Reading(np.zeros(3), 0.5 * model.speed, 0.0)
    for now, raw in ((0.0, model.speed), (0.1, 0.0)):
        safety.see(now, reading.pose, echoes, sight=Sight(np.full(DIRECTIONS, 2.0 * model.radius), 0.0))
        verdict = safety.decide(now, reading, np.array((raw, 0.0)))
        safety.sent(now, verdict.command)
        safety.escape(verdict)
        safety.use(safety.solve())
    monitor = RobotMonitor(model, 0.0)
    for place in (0.0, 0.3):
        pose = np.array((place, 0.0, 0.0))
        monitor.motion.measure(place, pose, 0.0, 0.0)
        monitor.mounting.look(pose, echoes)
