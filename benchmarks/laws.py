# SPDX-License-Identifier: MIT
"""Time of constitutive laws per point in 3D, as the fused kernels of explicit steps call them.

Blocks of eight points stay in the first-level cache. Deformation gradients are random and differ
from the identity by up to 1e-4 or 0.05. Laws with a state continue from their last state, so that
they yield if they can.
"""

import math
import time

import machine
import numpy as np
import ufl

from fenicsmpm import io, materials
from fenicsmpm._njit import njit
from fenicsmpm.lanes import LANES
from fenicsmpm.transfer.stresses import stresses

BLOCKS, REPEATS = 64, 200


def psi(F, mu, lame):
    J = ufl.det(F)
    return mu / 2 * (ufl.inner(F, F) - 3) - mu * ufl.ln(J) + lame / 2 * ufl.ln(J) ** 2


LAWS = {
    "NeoHookean": materials.NeoHookean(1e6, 0.3).pointwise(),
    "Hencky": materials.Hencky(1e6, 0.3),
    "VonMises, elastic": materials.VonMises(1e6, 0.3, sigma_y=1e9),
    "VonMises, plastic": materials.VonMises(1e6, 0.3, sigma_y=10.0),
    "DruckerPrager": materials.DruckerPrager(1e6, 0.3, cohesion=10.0, friction=30.0),
    "MohrCoulomb": materials.MohrCoulomb(1e6, 0.3, cohesion=10.0, friction=30.0),
    "ModifiedCamClay": materials.ModifiedCamClay(
        1e6, M=1.0, compression=0.1, swelling=0.02, pressure=1e4, preconsolidation=2e4
    ),
    "NewtonianFluid": materials.NewtonianFluid(1e9, 1e-3),
    "from_energy": materials.from_energy(psi, (1e6, 1e6)),
}


def time_of(law, size):
    """Return nanoseconds per point."""
    set_stresses = stresses(law.update, law.update_eight, law.n_state, law.needs_rate)

    @njit
    def run(F, L, parameters, states, work, state, sigma):
        for block in range(len(F)):
            set_stresses(block, F[block], L[block], parameters, states, work, state, sigma, 0)

    rng = np.random.default_rng(1)
    gradient = rng.uniform(-size, size, (REPEATS, BLOCKS, 9, LANES))
    F = gradient + np.eye(3).ravel()[:, None]
    states = np.repeat(np.tile(law.initial_state(1).ravel(), BLOCKS)[:, None], LANES, axis=1)
    rest = law.parameters, states, np.zeros((3, 3, 3)), np.zeros(law.n_state), np.zeros((9, LANES))
    times = []
    for k in range(REPEATS):
        start = time.perf_counter()
        run(F[k], 0.1 * gradient[k], *rest)
        times.append(time.perf_counter() - start)
    return 1e9 * min(times) / (BLOCKS * LANES)  # the run least disturbed by other processes


def main():
    io.say(machine.describe())
    table = io.Table({"law".ljust(17): "s", "small strains [ns]": ".1f", "large [ns]": ".1f"})
    for name, law in LAWS.items():
        small, large = (time_of(law, size) for size in (1e-4, 0.05))
        table.row(name.ljust(17), small, large if math.isfinite(large) else None)


if __name__ == "__main__":
    main()
