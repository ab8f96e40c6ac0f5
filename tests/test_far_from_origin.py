# SPDX-License-Identifier: MIT
"""Coordinates of 1e6 m, whose round-off is seen in cells of less than a metre."""

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from forms_table import CELLS

from fenicsmpm import MaterialPoints, forms
from fenicsmpm.transfer import project

pytestmark = pytest.mark.ranks


@pytest.mark.mpi
@pytest.mark.parametrize("cell", CELLS)
def test_points_on_a_facet(cell):
    """Points on x = 1e6 + 1/3 m, give or take round-off, see the nodes there and no others."""
    dim = 2 if cell in ("triangle", "quadrilateral") else 3
    make = mesh.create_unit_square if dim == 2 else mesh.create_unit_cube
    domain = make(MPI.COMM_WORLD, *[3] * dim, CELLS[cell])
    domain.geometry.x[:] += 1e6
    at = 1e6 + 1 / 3
    rng = np.random.default_rng(2)
    x = 1e6 + 0.1 + 0.8 * rng.random((300, dim))
    x[:, 0] = at + np.spacing(at) * rng.integers(-3, 4, 300)
    body = MaterialPoints(domain, x if domain.comm.rank == 0 else x[:0], weight=1.0)
    assert body.size_global == 300
    body.add_field("mass", (), 1.0)
    body.add_field("f", (), np.where(body.id % 2, 1.0, 2.0))
    V = fem.functionspace(domain, ("Lagrange", 1))
    f = fem.Function(V)
    project([body], {"f": f})
    seen = f.x.array[f.x.array != 0]
    assert np.all((seen > 1 - 1e-9) & (seen < 2 + 1e-9))
    mass = ufl.TrialFunction(V) * ufl.TestFunction(V) * body.dx
    inactive = forms.inactive_dofs(forms.form(mass))
    active = np.setdiff1d(np.arange(V.dofmap.index_map.size_local), inactive)
    assert V.tabulate_dof_coordinates()[active, 0] == pytest.approx(at, abs=1e-6)
    assert domain.comm.allreduce(len(active)) == 4 ** (dim - 1)
