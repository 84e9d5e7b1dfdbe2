import numpy as np
import pytest
from ctrl_rl_core.tasks import RobotSpec, wrap

from ctrl_rl_core import load_navigation_task


@pytest.fixture
def drive(simulate, make_room):
    """Return a function that drives a burger in an empty room.

    The function returns the change of its pose over `seconds` after `settle` seconds of one command, and its final
    velocity.
    """

    def run(command, seconds=2.0, settle=0.5):
        world = simulate(make_room())
        world.command(0, command)
        world.step(round(240 * settle))
        begin = world.pose(0)
        world.step(round(240 * seconds))
        return world.pose(0) - begin, world.velocity(0)

    return run


def test_burger_drives_straight_at_the_commanded_speed(drive):
    change, _ = drive((0.2, 0.0))
    assert change[0] == pytest.approx(0.4, rel=0.01)
    assert abs(change[1]) < 1e-3
    assert abs(change[2]) < 1e-3


@pytest.mark.parametrize("rate", [0.5, -1.0, 2.5])
def test_burger_turns_on_the_spot_at_the_commanded_rate(drive, rate):
    change, velocity = drive((0.0, rate))
    assert wrap(change[2] - 2.0 * rate) == pytest.approx(0.0, abs=0.01 * abs(2.0 * rate))
    assert velocity[2] == pytest.approx(rate, rel=0.01)
    assert np.hypot(*change[:2]) < 0.005


def test_burger_follows_an_arc(drive):
    change, _ = drive((0.2, 0.5), seconds=np.pi, settle=0.0)
    assert change[2] == pytest.approx(0.5 * np.pi, rel=0.03)
    assert np.hypot(*change[:2]) == pytest.approx(2 * 0.4 * np.sin(0.25 * np.pi), rel=0.03)


def test_burger_does_not_exceed_its_limits(drive):
    _, velocity = drive((5.0, 0.0))
    assert velocity[0] == pytest.approx(0.22, rel=0.01)
    _, velocity = drive((0.0, -50.0))
    assert velocity[2] == pytest.approx(-2.84, rel=0.01)


def test_wheels_take_their_time_then_settle(simulate, make_room):
    world = simulate(make_room())
    world.command(0, (0.2, 0.0))
    world.step(12)
    assert world.velocity(0)[0] == pytest.approx(0.2 * (1 - np.exp(-1.0)), rel=0.15)  # one time constant
    world.step(108)
    assert world.velocity(0)[0] == pytest.approx(0.2, rel=0.01)
    world.command(0, (0.0, 0.0))
    world.step(240)
    assert abs(world.velocity(0)[0]) < 2e-3


def test_turtlebot2_obeys_the_bounds_of_its_task(simulate):
    task = load_navigation_task("car_ttr")
    world = simulate(task, seed=3)
    world.command(0, (9.0, 9.0))
    world.step(240)
    assert world.velocity(0)[0] == pytest.approx(2.0, rel=0.02)
    assert world.velocity(0)[2] == pytest.approx(0.5, rel=0.02)


def test_jackal_drives_and_turns_as_commanded_in_every_engine(simulate, make_room, engine):
    commands = {"v": "-0.5 .. 2.0 m/s", "omega": "-4.0 .. 4.0 rad/s"}
    task = make_room().model_copy(update={"robot": RobotSpec.model_validate({"body": "jackal", "commands": commands})})
    ends = []
    for name in (engine, "planar"):
        world = simulate(task, engine=name)
        world.command(0, (1.0, 1.0))
        world.step(world.options.rate)
        ends.append(world.pose(0))
        assert world.velocity(0)[[0, 2]] == pytest.approx((1.0, 1.0), abs=0.03)
    assert ends[0] == pytest.approx(ends[1], abs=0.08)  # less than 0.1 s of driving


def test_quadrotor_in_free_flight_follows_eq_3_10(simulate):
    world = simulate("quad_ttr", seed=1)
    x, random = world.state(0), np.random.default_rng(0)
    for _ in range(20):
        thrust = random.uniform(6.0, 9.0)
        u = np.array((thrust, thrust + random.uniform(-0.1, 0.1)))
        world.command(0, u)
        world.step(12)
        for _ in range(50):
            x = world.system.step(x, u, dt=0.001)
    assert world.episode(0).clearance > 0.3
    np.testing.assert_allclose(world.state(0), x, atol=5e-5)


def test_quadrotor_converges_at_second_order(simulate):
    errors = []
    for rate in (240, 480):
        world = simulate("quad_ttr", seed=1, rate=rate)
        x, u = world.state(0), np.array((6.5, 6.45))
        world.command(0, u)
        world.step(rate)
        for _ in range(1000):
            x = world.system.step(x, u, dt=0.001)
        errors.append(np.abs(world.state(0) - x).max())
    assert errors[1] == pytest.approx(errors[0] / 4, rel=0.2)


def test_first_rotor_pair_pitches_the_nose_down_and_hovering_needs_no_command(simulate):
    world = simulate("quad_ttr", seed=1)
    begin = world.state(0)
    world.step(24)
    assert world.state(0)[3] == pytest.approx(begin[3], abs=0.05)
    world.command(0, (6.2, 6.0))
    world.step(24)
    assert world.state(0)[5] > 0.1


def test_quadrotor_without_thrust_falls_freely(simulate):
    world = simulate("quad_ttr", seed=1)
    world.command(0, (0.0, 0.0))
    begin = x = world.state(0)
    world.step(72)
    for _ in range(300):
        x = world.system.step(x, (0.0, 0.0), dt=0.001)
    fall = begin[2] - world.state(0)[2]
    assert fall == pytest.approx(0.5 * 9.81 * 0.3**2, rel=0.03)  # a little less, by drag
    np.testing.assert_allclose(world.state(0), x, atol=5e-4)


def size_and_mass_in_pybullet(engine):
    pybullet = pytest.importorskip("pybullet")
    body, client = engine.robots[0], engine.client
    links = range(-1, pybullet.getNumJoints(body, physicsClientId=client))
    masses = [pybullet.getDynamicsInfo(body, link, physicsClientId=client)[0] for link in links]
    boxes = np.array([pybullet.getAABB(body, link, physicsClientId=client) for link in links if link >= 0])
    return boxes[:, 1].max(axis=0) - boxes[:, 0].min(axis=0), sum(masses)


def size_and_mass_in_mujoco(engine):
    model, data, robot = engine._model, engine._data, engine._robots[0]
    bodies = {int(model.geom_bodyid[geom]) for geom in robot.geoms}
    half = np.einsum(
        "gij,gj->gi", np.abs(data.geom_xmat[robot.geoms].reshape(-1, 3, 3)), model.geom_aabb[robot.geoms, 3:]
    )
    places = data.geom_xpos[robot.geoms]
    return (places + half).max(axis=0) - (places - half).min(axis=0), sum(model.body_mass[body] for body in bodies)


def test_burger_has_its_published_size_and_mass(simulate, make_room, engine):
    world = simulate(make_room())
    measure = {"pybullet": size_and_mass_in_pybullet, "mujoco": size_and_mass_in_mujoco}[engine]
    size, mass = measure(world._engine)
    assert mass == pytest.approx(0.826 + 2 * 0.0285)
    np.testing.assert_allclose(size, (0.138, 0.178, 0.192), atol=0.005)
    np.testing.assert_allclose(world._robots[0].body.sensor().origin, (-0.032, 0.0, 0.182), atol=1e-6)


def test_wheels_turn_as_far_as_the_robot_drives(simulate, make_room):
    world = simulate(make_room())
    world.command(0, (0.2, 0.0))
    world.step(480)
    left, right = world.wheel_angles(0)
    assert left == pytest.approx(right, rel=0.01)
    assert 0.033 * left == pytest.approx(world.pose(0)[0], rel=0.03)
