import math

import numpy as np
import pytest

from ctrl_rl_core import ObstacleStop, Robot, RobotError, find_robot

CAR = """
name: cart
kind: car
radius: 0.6 m
length: 0.8 m
width: 0.4 m
speed: 2.0 m/s
reverse_speed: 1.0 m/s
acceleration: 2.0 m/s^2
braking: 2.0 m/s^2
steering: {wheelbase: 0.5 m, turning_radius: 1.0 m, rate: 2.0 rad/s, centre: 0.15 m}
"""


@pytest.fixture
def write(tmp_path):
    def make(text):
        file = tmp_path / "cart.yaml"
        file.write_text(text)
        return file

    return make


def test_limits_of_a_car_follow_from_its_steering(write):
    car = Robot.load(write(CAR))
    assert car.turn_rate == pytest.approx(2.0)
    assert car.steering.angle == pytest.approx(math.atan(0.5))
    assert car.turn_acceleration == pytest.approx(2.0 * 2.0 * (1.0 / 0.5 + 0.5))
    assert car.commands == ("v", "omega")
    assert car.limits[1] == (2.0, car.turn_rate)


@pytest.mark.parametrize(
    ("old", "new", "why"),
    [
        ("kind: car\n", "", "steering: a robot of kind 'car' needs it"),
        ("steering: {", "urdf: '' #", "steering: a robot of kind 'car' needs it"),
        ("length: 0.8 m\nwidth: 0.4 m\n", "", "a car needs length and width"),
        ("speed: 2.0 m/s\n", "speed: 2.0 m/s\nturn_rate: 1.0 rad/s\n", "turn_rate: a car's follows"),
        ("radius: 0.6 m", "radius: 0.5 m", "is not in a disc"),
        ("turning_radius: 1.0 m", "turning_radius: 0.0 m", "turning_radius"),
        ("acceleration: 2.0 m/s^2\n", "", "lacks 'acceleration'"),
    ],
)
def test_a_car_that_cannot_be_is_refused_in_one_line(write, old, new, why):
    assert old in CAR
    with pytest.raises(RobotError, match=why) as error:
        Robot.load(write(CAR.replace(old, new, 1)))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("name", ["race_car", "road_car"])
def test_cars_of_the_suite_have_steering(name):
    car = find_robot(name)
    assert car.on_wheels
    assert car.steering.centre < 0.5 * car.length


def test_digests_of_other_robots_have_not_changed():
    assert find_robot("jackal").digest.startswith("c4ca91fa")


def stop_of(name):
    car = find_robot(name)
    return ObstacleStop(car.radius, 0.02, car.plan.braking, 0.3, car.rectangle)


def test_the_obstacle_stop_sweeps_a_cars_rectangle():
    stop, posts = stop_of("road_car"), np.array([[1.0, 0.95], [1.0, -0.95], [3.0, 0.95], [3.0, -0.95]])  # of a bay
    ahead, turning = np.array((0.5, 0.0)), np.array((0.5, 0.5 / 4.5))
    assert stop.limit(ahead, posts, 0.5, 0.0) == (pytest.approx(ahead), "")
    assert stop.limit(-ahead, posts, -0.5, 0.0)[1] == ""
    assert "ahead" in stop.limit(turning, posts, 0.5, 0.0)[1]  # the front swings out into a post
    wall = np.array([[3.7, 0.0]])
    assert "ahead" in stop.limit(ahead, wall, 0.5, 0.0)[1]
    assert stop.limit(-ahead, wall, -0.5, 0.0)[1] == ""
