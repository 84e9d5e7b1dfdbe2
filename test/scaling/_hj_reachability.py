"""The peer, in a process of its own: hj_reachability with WENO5 on the same grid, box and dynamics.

python _hj_reachability.py IN.npz OUT.npz

IN: system ("car" or "pendulum pair"), counts (n,), domain (n, 2), periodic (n,), box (n, 2), horizon [s]. OUT: CPU
seconds of one core without compilation. The time to reach is read from the tube at stamps of 0.1 s.
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


class Affine(hj.ControlAndDisturbanceAffineDynamics):
    """A system with controls within +-1 and no disturbance."""

    def __init__(self, drift, controls):
        n, m = controls.shape
        bounds = jnp.ones(m)
        super().__init__("min", "max", hj.sets.Box(-bounds, bounds), hj.sets.Box(*jnp.zeros((2, 1))))
        self._drift, self._controls, self._n = drift, jnp.array(controls), n

    def open_loop_dynamics(self, state, time):
        del time
        return jnp.array(self._drift(state))

    def control_jacobian(self, state, time):
        del state, time
        return self._controls

    def disturbance_jacobian(self, state, time):
        del state, time
        return jnp.zeros((self._n, 1))


def _pair(x):
    pull = jnp.sin(x[2] - x[0])
    return [x[1], jnp.sin(x[0]) + 0.5 * pull, x[3], jnp.sin(x[2]) - 0.5 * pull]


SYSTEMS = {
    "car": Affine(lambda x: [jnp.cos(x[2]), jnp.sin(x[2]), 0.0], np.array([[0.0], [0.0], [1.0]])),
    "pendulum pair": Affine(_pair, np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 0.0], [0.0, 1.0]])),
}


def main() -> None:
    """Solve and write the seconds."""
    given = np.load(sys.argv[1])
    domain, box, horizon = given["domain"], given["box"], float(given["horizon"])
    grid = hj.Grid.from_lattice_parameters_and_boundary_conditions(
        hj.sets.Box(domain[:, 0], domain[:, 1]),
        tuple(int(n) for n in given["counts"]),
        periodic_dims=tuple(int(k) for k in np.flatnonzero(given["periodic"])),
    )
    offset = jnp.abs(grid.states - box.mean(axis=1))
    values = jnp.max(offset - 0.5 * (box[:, 1] - box[:, 0]), axis=-1)
    settings = hj.SolverSettings.with_accuracy(
        "very_high", hamiltonian_postprocessor=hj.solver.backwards_reachable_tube
    )
    system = SYSTEMS[str(given["system"])]
    hj.step(settings, system, grid, 0.0, values, -1e-3, progress_bar=False).block_until_ready()
    begin, now = time.process_time(), 0.0
    while now < horizon:
        values = hj.step(settings, system, grid, -now, values, -(now + STAMP), progress_bar=False)
        np.asarray(values)
        now += STAMP
    np.savez(sys.argv[2], seconds=time.process_time() - begin)


if __name__ == "__main__":
    main()
