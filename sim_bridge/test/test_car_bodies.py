import math

import numpy as np
import pytest
from yards import yard

from ctrl_rl_core import find_robot
from sim_bridge import PlanarFleet, SimulatedWorld, SimulationError, SimulationOptions


@pytest.fixture(params=["planar", "pybullet", "mujoco"])
def park(request):
    """Return a function that puts a car into an empty yard, in each engine."""
    if request.param != "planar":
        pytest.importorskip(request.param)
    worlds = []

    def make(robot):
        worlds.append(SimulatedWorld(yard(robot), options=SimulationOptions(engine=request.param)))
        return worlds[-1]

    yield make
    for world in worlds:
        world.close()


def settle(world, command, seconds):
    world.command(0, command)
    world.step(round(world.options.rate * seconds))


@pytest.mark.parametrize("robot", ["race_car", "road_car"])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_car_drives_the_circle_that_it_is_asked_for(park, robot, sign):
    world, radius = park(robot), 2.0 * find_robot(robot).steering.turning_radius
    v = 0.3 * find_robot(robot).speed
    settle(world, (sign * v, v / radius), 3.0)
    begin, theta = world.pose(), 0.0
    for _ in range(20):
        before = world.pose()[2]
        settle(world, (sign * v, v / radius), 0.1)
        theta += math.remainder(world.pose()[2] - before, 2.0 * math.pi)
    moved = np.hypot(*(world.pose() - begin)[:2])
    assert theta == pytest.approx(2.0 * v / radius, rel=0.03)
    assert moved == pytest.approx(2.0 * radius * math.sin(v / radius), rel=0.03)
    assert abs(world.velocity()[1]) < 0.03 * v  # the rear axle does not slip


@pytest.mark.parametrize("robot", ["race_car", "road_car"])
def test_a_car_turns_no_tighter_than_its_steering_lets_it(park, robot):
    world, car = park(robot), find_robot(robot)
    settle(world, (0.2 * car.speed, car.turn_rate), 4.0)
    v, _, omega = world.velocity()
    assert v == pytest.approx(0.2 * car.speed, rel=0.03)
    assert omega == pytest.approx(v / car.steering.turning_radius, rel=0.03)


def test_a_car_does_not_turn_on_the_spot(park):
    world = park("race_car")
    settle(world, (0.0, 2.0), 1.0)
    assert np.abs(world.pose()).max() < 2e-3


def test_steering_takes_its_time(park):
    world, car = park("road_car"), find_robot("road_car")
    settle(world, (1.0, 0.0), 2.0)
    settle(world, (1.0, 1.0 / car.steering.turning_radius), 0.25)
    angle = math.atan(car.steering.wheelbase * world.velocity()[2] / world.velocity()[0])
    assert 0.3 * car.steering.rate * 0.25 < angle < 1.1 * car.steering.rate * 0.25


def test_a_fleet_of_cars_is_refused():
    with pytest.raises(SimulationError, match="no steered wheels"):
        PlanarFleet(yard("race_car"), 2)
