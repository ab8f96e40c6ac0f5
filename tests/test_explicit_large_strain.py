# SPDX-License-Identifier: MIT
"""A nearly incompressible column, thrown to the side, bends as in an implicit analysis."""

from pathlib import Path

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem, mesh
from explicit_runs import simulate

from fenicsmpm import formulations, points
from fenicsmpm.diagnostics import mean_stress, probe
from fenicsmpm.materials import NeoHookean

pytestmark = pytest.mark.once

REFERENCE = Path(__file__).parent.parent / "benchmarks" / "references" / "bending_beam.csv"
H = 0.25  # m
PEAK = 0.45  # s, where the reference bends most


def bend(fbar, basis):
    """Deviation of the tip at the peak as a share of the way, and the range of mean stress [Pa]."""
    lower, upper = (-3.5, -1.5, 0.0), (3.5, 1.5, 7.0)
    shape = [round((b - a) / H) for a, b in zip(lower, upper, strict=True)]
    domain = mesh.create_box(MPI.COMM_SELF, [lower, upper], shape, mesh.CellType.hexahedron)

    def inside(x):
        return (np.abs(x[:2]).max(axis=0) < 0.5) & (x[2] < 6)

    body = points.lattice(domain, H / 2, inside=inside)
    law = NeoHookean(E=1.7e7, nu=0.499).pointwise()
    formulations.set_initial_state(body, 1100.0, lambda x: np.outer((5 / 3, 0, 0), x[2]))
    tip = body.select(lambda x: (np.abs(x.T - (0.5, 0.5, 6)) < H / 2).all(axis=1))
    tip.add_field("force", (3,))
    V = fem.functionspace(domain, ("Lagrange", 1, (3,)))
    base = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[2], 0))
    bc = fem.dirichletbc(np.zeros(3), base, V)
    sim = simulate(V, {body: law}, functions=basis, bcs=[bc], cfl=0.3, fbar=fbar, loads=[tip])
    for _ in sim.run(PEAK, PEAK):
        pass
    table = np.loadtxt(REFERENCE, delimiter=",")
    expected = [np.interp(PEAK, table[:, 0], table[:, i]) for i in (1, 2, 3)]
    deviation = np.linalg.norm(probe(tip, "u") - expected) / np.linalg.norm(expected)
    return deviation, np.ptp(mean_stress(body["sigma"]))


@pytest.mark.parametrize("basis", ["quadratic", "gimp"])
def test_a_column_bends_without_locking(basis):
    deviation, stresses = bend("default", basis)
    locked, oscillating = bend(None, basis)
    assert deviation < 0.025 < 0.05 < locked
    assert stresses < 0.2 * oscillating
