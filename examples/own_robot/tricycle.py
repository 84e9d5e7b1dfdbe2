"""A user-defined system model: a tricycle that turns its front wheel at a limited rate."""

from ctrl_rl_core.systems import Parameter

from ctrl_rl_core import Quantity, SystemModel


def equations(math, p):
    """Dynamics with states x, y, theta and steering angle delta, and controls speed and rate of delta."""
    cos, sin, tan = math.cos, math.sin, math.tan
    wheelbase = p["L"]

    def f(x, u, d):
        return (
            u[0] * cos(x[2]) + d[0],
            u[0] * sin(x[2]) + d[1],
            u[0] * tan(x[3]) / wheelbase + d[2],
            u[1] + d[3],
        )

    return f


TRICYCLE = SystemModel(
    states=(
        Quantity("x", "m"),
        Quantity("y", "m"),
        Quantity("theta", "rad", -3.141592653589793, 3.141592653589793, periodic=True),
        Quantity("delta", "rad", -0.6, 0.6),
    ),
    controls=(Quantity("v", "m/s", -0.3, 0.6), Quantity("delta_rate", "rad/s", -1.5, 1.5)),
    parameters=(Parameter("L", "m", 0.3),),
    equations=equations,
)
