"""The peer, in a process of its own: hj_reachability on the same grid, margin and game.

python _hj_reachability.py IN.npz OUT.npz

IN: name of the game, accuracy, counts (n,), domain (n, 2), periodic (n,), margin (counts), horizon [s]. OUT: values
(counts) and CPU seconds of one core without compilation.
"""

from __future__ import annotations

import os
import sys
import time

os.environ["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"

import hj_reachability as hj
import jax.numpy as jnp
import numpy as np


class Game(hj.ControlAndDisturbanceAffineDynamics):
    """A game with one control within +-1 that keeps away, and disturbances within their bounds."""

    def __init__(self, bounds, drift, control, disturbance):
        bounds = jnp.array(bounds)
        super().__init__("max", "min", hj.sets.Box(jnp.array([-1.0]), jnp.array([1.0])), hj.sets.Box(-bounds, bounds))
        self._drift, self._control, self._disturbance = drift, control, jnp.array(disturbance)

    def open_loop_dynamics(self, state, time):
        del time
        return jnp.array(self._drift(state))

    def control_jacobian(self, state, time):
        del time
        return jnp.array(self._control(state))[:, None]

    def disturbance_jacobian(self, state, time):
        del state, time
        return self._disturbance


GAMES = {
    "double integrator": Game([0.2], lambda x: [x[1], 0.0], lambda _x: [0.0, 1.0], [[0.0], [1.0]]),
    "air3D": Game(
        [1.0],
        lambda x: [-5.0 + 5.0 * jnp.cos(x[2]), 5.0 * jnp.sin(x[2]), 0.0],
        lambda x: [x[1], -x[0], -1.0],
        [[0.0], [0.0], [1.0]],
    ),
    "Dubins pursuit": Game(
        [0.4, 0.4],
        lambda x: [jnp.cos(x[2]), jnp.sin(x[2]), 0.0],
        lambda _x: [0.0, 0.0, 1.0],
        [[1.0, 0.0], [0.0, 1.0], [0.0, 0.0]],
    ),
}


def main() -> None:
    """Solve one game with one accuracy."""
    given = np.load(sys.argv[1])
    low, high = given["domain"].T
    periodic = tuple(int(k) for k in np.flatnonzero(given["periodic"]))
    grid = hj.Grid.from_lattice_parameters_and_boundary_conditions(
        hj.sets.Box(low, high), tuple(int(n) for n in given["counts"]), periodic_dims=periodic
    )
    settings = hj.SolverSettings.with_accuracy(
        str(given["accuracy"]), hamiltonian_postprocessor=hj.solver.backwards_reachable_tube
    )
    game, margin = GAMES[str(given["name"])], jnp.array(given["margin"])
    hj.step(settings, game, grid, 0.0, margin, -1e-3, progress_bar=False).block_until_ready()
    begin = time.process_time()
    values = hj.step(settings, game, grid, 0.0, margin, -float(given["horizon"]), progress_bar=False)
    values.block_until_ready()
    np.savez(sys.argv[2], values=np.asarray(values), seconds=time.process_time() - begin)


if __name__ == "__main__":
    main()
