"""Safety values against closed forms: braking before walls, two-player games, targets, moving margins."""

import numpy as np
import pytest
from games import make
from safety_cases import air3d, double_integrator, pursuit

from ctrl_rl_core import Axis, Quantity, System, make_system
from ttr_reward_node import SafetyGame, SafetySolver, TimeToReachError


def _line(math, p):
    del math, p
    return lambda _x, u, d: (u[0] + d[0],)


def line(disturbance=0.0, count=61):
    """Return the game x' = u + d on [-3, 3] m with |u| <= 1 m/s."""
    return SafetyGame(make(_line, ("x",), 1, disturbance), (Axis("x", "m", -3.0, 3.0, count),))


LINE = line().axes[0].nodes


@pytest.mark.parametrize("disturbance", [0.0, 0.2])
@pytest.mark.parametrize("interpolation", ["linear", "cubic"])
def test_who_brakes_in_time_is_safe_for_ever(interpolation, disturbance):
    case = double_integrator(61, disturbance)
    solution = SafetySolver(case.game, interpolation=interpolation).solve(case.margin)
    assert solution.converged
    assert np.mean(np.abs(case.errors(solution.values))) < 0.004 * case.length


@pytest.mark.parametrize(("game", "counts", "bound"), [(air3d, (43, 37, 40), 0.005), (pursuit, (46, 46, 36), 0.01)])
def test_two_players_have_the_value_of_the_known_game(game, counts, bound):
    case = game(counts, 2000)
    solution = SafetySolver(case.game).solve(case.margin, horizon=case.horizon)
    assert np.mean(np.abs(case.errors(solution.values))) < bound * case.length


def test_a_target_is_reached_in_time_and_round_no_obstacle():
    """On a line from x to the target at 2 m, with an obstacle at -1 m that cannot be bypassed."""
    inside, margin = 0.5 - np.abs(LINE - 2.0), np.abs(LINE + 1.0) - 0.25
    solver = SafetySolver(line())
    soon = solver.solve(margin, target=inside, horizon=1.0).values >= 0.0
    np.testing.assert_array_equal(soon, (LINE > 0.45) & (LINE < 3.55))
    ever = solver.solve(margin, target=inside)
    assert ever.converged
    np.testing.assert_array_equal(ever.values >= 0.0, LINE > -0.76)


def test_what_comes_faster_than_one_can_flee_is_met():
    """A wall at x = 2 t - 2 m gains 1 m/s on a robot that flees at 1 m/s: the margin falls by T m in T s."""
    times = []

    def margin(time):
        times.append(time)
        return LINE + 2.0 - 2.0 * time

    solution = SafetySolver(line(), step=0.25).solve(margin, horizon=1.5)
    away = LINE < 1.0  # states farther right reach the end of the grid
    np.testing.assert_allclose(solution.values[away], (LINE + 2.0 - 1.5)[away], atol=1e-4)
    assert (times[0], times[-1]) == (1.5, 0.0)


def test_a_disc_of_disturbances_is_a_finite_set():
    angles = np.linspace(0.0, 2.0 * np.pi, 17)[:-1]
    system = make_system("dubins_car", control_bounds={"v": (0.0, 0.0), "omega": (0.0, 0.0)})
    axes = (Axis("x", "m", -3, 3, 31), Axis("y", "m", -3, 3, 31), Axis("theta", "rad", -np.pi, np.pi, 8, True))
    drift = 0.5 * np.column_stack((np.cos(angles), np.sin(angles), np.zeros(16)))
    x, y = np.meshgrid(axes[0].nodes, axes[1].nodes, indexing="ij")
    apart = np.hypot(x, y)[..., None] - 0.5
    values = SafetySolver(SafetyGame(system, axes, disturbances=drift)).solve(apart, horizon=1.0).values
    far = np.broadcast_to((apart > 0.75) & (apart < 1.5), values.shape)
    np.testing.assert_allclose(values[far], np.broadcast_to(apart - 0.5, values.shape)[far], atol=0.02)


def test_angles_wrap_round():
    """A turntable at 1 rad/s sweeps all angles within 1 rad in 1 s, also across the seam."""
    angle = Quantity("theta", "rad", -np.pi, np.pi, periodic=True)
    turn = Quantity("d_theta", "rad/s", -1.0, 1.0)
    system = System("turntable", (angle,), (), (turn,), {}, lambda _m, _p: lambda _x, _u, d: (d[0],))
    axis = Axis("theta", "rad", -np.pi, np.pi, 90, periodic=True)
    apart = np.abs(np.abs(axis.nodes) - np.pi)
    values = SafetySolver(SafetyGame(system, (axis,)), step=0.05).solve(apart, horizon=1.0).values
    np.testing.assert_allclose(values, np.maximum(apart - 1.0, 0.0), atol=0.04)


def _squared(math, p):
    del math, p
    return lambda _x, u, d: (u[0] * u[0] + d[0],)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: SafetySolver(line(), step=0.0), "a time step of 0 s"),
        (lambda: SafetySolver(line(), interpolation="spline"), "choose one of linear, cubic"),
        (lambda: SafetySolver(line()).solve(LINE[:5]), "broadcasts to (61,)"),
        (lambda: SafetySolver(line()).solve(np.full(61, np.nan)), "the margin is NaN or infinite"),
        (lambda: SafetySolver(line()).solve(LINE, target=np.full(61, np.inf)), "the target is NaN or infinite"),
        (lambda: SafetySolver(line()).solve(LINE, initial=LINE[:5]), "the initial values have shape (5,)"),
        (lambda: SafetySolver(line()).solve(LINE, horizon=-1.0), "horizon [s] is -1"),
        (lambda: SafetySolver(line()).solve(LINE, max_steps=0), "0 steps at most"),
        (lambda: SafetySolver(line()).solve(lambda _t: LINE), "needs a horizon"),
        (lambda: SafetyGame(make(_squared, ("x",), 1, 0.0), line().axes), "not affine in the controls"),
        (lambda: SafetyGame(line().system, line().axes, controls=np.zeros((2, 3))), "controls have shape (2, 3)"),
        (lambda: SafetyGame(line().system, (Axis("y", "m", 0.0, 1.0, 5),)), "needs one for each of ['x']"),
        (lambda: SafetySolver(double_integrator(11).game).shifted(np.zeros((11, 11)), (0, 1), 0.0), "along 'v'"),
    ],
)
def test_what_is_wrong_is_said(call, words):
    with pytest.raises(TimeToReachError) as error:
        call()
    assert words in str(error.value)
