"""The navigator of a node's robot: of one that turns on the spot, or of a car."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from ctrl_rl_core import find_robot
from ctrl_rl_navigation.cars import CarNavigator, car_limits_of, warm_up_car
from ctrl_rl_navigation.driving.decision import NavigatorOptions
from ctrl_rl_navigation.driving.navigator import Navigator, warm_up
from ctrl_rl_navigation.robot import limits_of

Bounds = tuple[tuple[float, float], tuple[float, float]]

_GUARD_GAP = 0.005
"""Additional distance to obstacles of the look-ahead compared with the obstacle stop [m]."""


def make_navigator(value: Mapping[str, Any]) -> tuple[Navigator | CarNavigator, Bounds]:
    """Create the navigator for a node's parameters, with its code compiled, and return it with its command bounds.

    Raises:
        NavigationError: The robot has no wheels.
    """
    robot, margin = find_robot(value["robot"]), value["obstacle_margin"] + _GUARD_GAP
    options = NavigatorOptions(
        tolerance=value["goal_tolerance"],
        heading_tolerance=value["goal_heading_tolerance"],
        memory=value["obstacle_memory"],
        max_detour=value["max_detour"],
        period=value["control_period"],
        delay=value["control_period"] + 0.1,
        deceleration=value["deceleration"],
        corridor=value["path_corridor"],
    )
    if robot.steering is not None:
        car = car_limits_of(robot)
        car = replace(
            car,
            speed=value["max_speed"],
            reverse_speed=min(car.reverse_speed, value["max_speed"]),
            acceleration=value["acceleration"],
            braking=min(car.braking, value["deceleration"]),
            margin=max(car.margin, 2.0 * margin),
        )
        warm_up_car(car)
        options = replace(options, delay=options.period + robot.delay)
        turn = car.speed / car.turning_radius
        return CarNavigator(car, options), ((-car.reverse_speed, -turn), (car.speed, turn))
    limits = replace(
        limits_of(robot, margin),
        speed=value["max_speed"],
        turn_rate=value["max_turn_rate"],
        acceleration=value["acceleration"],
        turn_acceleration=value["turn_acceleration"],
        radius=value["robot_radius"],
        length=0.0,
        width=0.0,
    )
    warm_up(limits)
    back = min(limits.reverse_speed, limits.speed)  # to make room for people
    return Navigator(limits, options), ((-back, -limits.turn_rate), (limits.speed, limits.turn_rate))
