# SPDX-License-Identifier: MIT
"""Condition numbers of mass and stiffness where points hardly fill a cell."""

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from dolfinx import mesh

from fenicsmpm import MaterialPoints, basis, forms
from fenicsmpm import formulations as fm
from fenicsmpm.cells import ActiveCells, Tying
from fenicsmpm.materials import Hencky


def sliver(share, kind):
    """Points of a square that are hardly seen by nodes beside it.

    With finite elements these are a thin layer of further points; with uGIMP the square is shifted.
    """
    x = np.stack(np.meshgrid(np.arange(0.125, 2, 0.25), np.arange(0.125, 2, 0.25)), -1)
    x = x.reshape(-1, 2)
    weight = np.full(len(x), 0.25**2)
    corners = [(0, 0), (4, 2)]
    if kind == "gimp":
        domain = mesh.create_rectangle(MPI.COMM_SELF, corners, [4, 2], mesh.CellType.quadrilateral)
        body = MaterialPoints(domain, x + (share, 0), weight)
        basis.use(body, "gimp", half_size=(0.125, 0.125))
    else:
        domain = mesh.create_rectangle(MPI.COMM_SELF, corners, [4, 2])
        layer = np.column_stack([np.full(8, 2 + share / 8), np.arange(0.125, 2, 0.25)])
        weight = np.append(weight, np.full(8, 0.25 * share / 4))
        body = MaterialPoints(domain, np.vstack([x, layer]), weight)
    fm.set_initial_state(body, 1.0)
    return body


def condition(remedy, share, kind, what):
    """Of the mass, or of the tangent of a step, on nodes near points."""
    body = sliver(share, kind)
    z = fm.Unknown(body.mesh, "u")
    scheme = fm.Midpoint(z, dt=0.1)
    law = Hencky(10.0, 0.3)
    R = scheme.inertia(body)
    cells = ActiveCells(body)
    if remedy == "ghost":
        R += fm.ghost_mass(cells, scheme, 1.0)
    if what == "tangent":
        R += fm.EnergyMomentum(law, body, z).power()
        if remedy == "ghost":
            R += fm.ghost_penalty(z, cells, law)
    J = forms.form(ufl.derivative(R, z.U))
    A = forms.petsc.assemble_matrix(J)
    if remedy == "tying":
        tying = Tying(z.space, body, cells)
        tying.update((), forms.inactive_dofs(J))
        A = tying.reduce(A, A.createVecLeft())
    rows, columns, values = A.getValuesCSR()
    dense = np.zeros(A.getSize())
    dense[np.repeat(np.arange(len(dense)), np.diff(rows)), columns] = values
    return np.linalg.cond(dense)


@pytest.mark.parametrize("what", ["mass", "tangent"])
@pytest.mark.parametrize("kind", ["linear", "gimp"])
def test_condition_number_of_cut_cells(kind, what):
    """Mass and stiffness fall with powers of the share that are those of the functions."""
    shares = (1e-1, 1e-2, 1e-3)
    without, ghost, tied = (
        [condition(remedy, share, kind, what) for share in shares]
        for remedy in ("none", "ghost", "tying")
    )
    growth = {"linear": {"mass": 1e3, "tangent": 10}, "gimp": {"mass": 1e4, "tangent": 100}}
    assert without[2] / without[1] == pytest.approx(growth[kind][what], rel=0.03)
    assert max(ghost) < 1.1 * min(ghost) < 200
    assert max(tied) < 1.1 * min(tied) < 200
