# SPDX-License-Identifier: MIT
"""Condition numbers of mass and tangent where points hardly fill a cell.

Beside a square of points there are cells that a small share of material fills, or that its
functions hardly reach. The script prints the condition numbers of the consistent mass and of the
tangent of a step without a remedy, with the ghost penalty and the ghost mass, and with tied nodes.
"""

from itertools import product

from mpi4py import MPI

import numpy as np
import typer
import ufl
from dolfinx import mesh

from fenicsmpm import MaterialPoints, basis, forms, io
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


def main(shares: list[float] = [0.1, 0.01, 0.001, 0.0001]):
    """Print condition numbers for these SHARES of a cell."""
    columns = {"matrix".ljust(8): "s", "functions": "s", "remedy".ljust(8): "s"}
    table = io.Table(columns | {f"{share:g}": ".1e" for share in shares})
    for kind, what, remedy in product(
        ("linear", "gimp"), ("mass", "tangent"), ("none", "ghost", "tying")
    ):
        found = [condition(remedy, share, kind, what) for share in shares]
        table.row(what.ljust(8), kind.ljust(9), remedy.ljust(8), *found)


if __name__ == "__main__":
    typer.run(main)
