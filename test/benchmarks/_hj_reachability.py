"""The peer of `time_to_reach.py`, in a process of its own: hj_reachability on the same grid, goal and car.

python _hj_reachability.py IN.npz OUT.npz

IN: counts (3,), domain (3, 2), box (3, 2), horizon [s]. OUT, for each accuracy: the time to reach at the nodes, +inf
where it is above the horizon, and CPU seconds without compilation. Its value function is that of a reachable tube; the
time to reach is where it passes zero, linearly between stamps of 0.1 s.
"""

from __future__ import annotations

import os
import sys
import time

os.environ["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"

import hj_reachability as hj
import jax.numpy as jnp
import numpy as np

STAMP = 0.1
ACCURACIES = {"low": "first_order", "very_high": "weno5"}


class Car(hj.ControlAndDisturbanceAffineDynamics):
    """The Dubins car of 1 m/s and up to 1 rad/s."""

    def __init__(self):
        super().__init__(
            "min", "max", hj.sets.Box(jnp.array([-1.0]), jnp.array([1.0])), hj.sets.Box(*jnp.zeros((2, 1)))
        )

    def open_loop_dynamics(self, state, time):
        del time
        return jnp.array([jnp.cos(state[2]), jnp.sin(state[2]), 0.0])

    def control_jacobian(self, state, time):
        del state, time
        return jnp.array([[0.0], [0.0], [1.0]])

    def disturbance_jacobian(self, state, time):
        del state, time
        return jnp.zeros((3, 1))


def main() -> None:
    """Solve with each accuracy and write what came out."""
    given = np.load(sys.argv[1])
    domain, box = given["domain"], given["box"]
    grid = hj.Grid.from_lattice_parameters_and_boundary_conditions(
        hj.sets.Box(domain[:, 0], domain[:, 1]), tuple(int(n) for n in given["counts"]), periodic_dims=2
    )
    offset = grid.states - box.mean(axis=1)
    offset = offset.at[..., 2].set(jnp.mod(offset[..., 2] + jnp.pi, 2.0 * jnp.pi) - jnp.pi)
    first = jnp.max(jnp.abs(offset) - 0.5 * (box[:, 1] - box[:, 0]), axis=-1)
    out = {}
    for accuracy, name in ACCURACIES.items():
        settings = hj.SolverSettings.with_accuracy(
            accuracy, hamiltonian_postprocessor=hj.solver.backwards_reachable_tube
        )
        car = Car()
        hj.step(settings, car, grid, 0.0, first, -1e-3, progress_bar=False).block_until_ready()
        begin = time.process_time()
        values, now = first, 0.0
        phi = np.where(np.asarray(first) <= 0.0, 0.0, np.inf)
        while now < float(given["horizon"]):
            later = hj.step(settings, car, grid, -now, values, -(now + STAMP), progress_bar=False)
            before, after = np.asarray(values), np.asarray(later)
            arrived = np.isinf(phi) & (after <= 0.0)
            phi[arrived] = now + STAMP * before[arrived] / (before[arrived] - after[arrived])
            values, now = later, now + STAMP
        out[f"{name}_phi"], out[f"{name}_seconds"] = phi, time.process_time() - begin
    np.savez(sys.argv[2], **out)


if __name__ == "__main__":
    main()
