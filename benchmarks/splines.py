# SPDX-License-Identifier: MIT
"""Tangent of the mixed form with quadratic B-splines, and a step of the bending beam with them.

The tangent is that of a deformed block with 8 points per cell. It alternates with dolfinx' assembly
of the same UFL form over equally many quadrature points of quadratic hexahedra; both element
matrices have 108 rows in 3D. The step is that of ``studies/columns.py bending_beam --cases
smooth``.
"""

import runpy
import time
from pathlib import Path

from mpi4py import MPI

import basix
import basix.ufl
import machine
import numpy as np
import typer
import ufl
from assembly import OverCells, alternate
from dolfinx import fem, mesh

from fenicsmpm import basis, forms, io, points
from fenicsmpm.formulations import Unknown, mixed
from fenicsmpm.materials import NeoHookean

ROOT = Path(__file__).parents[1]
LAW = NeoHookean(E=70.0, nu=0.5)


def lattice(n, functions=None):
    """Return a cube of n cells per side with a layer of empty ones around it, and its points."""
    kind = mesh.CellType.hexahedron
    domain = mesh.create_box(MPI.COMM_WORLD, [(-1,) * 3, (n + 1,) * 3], [n + 2] * 3, kind)
    body = points.lattice(domain, 0.5, inside=lambda x: np.all((x > 0) & (x < n), axis=0))
    if functions:
        basis.use(body, functions)
    return domain, body


def disturbed(z, shape):
    rng = np.random.default_rng(0)
    z.U.x.array[:] = 1e-3 * rng.standard_normal(len(z.U.x.array))
    return np.eye(3) + 0.01 * rng.standard_normal((*shape, 3, 3))


def of_points(n, functions):
    """Return a task that assembles the tangent, and the number of points."""
    domain, body = lattice(n, functions)
    z = Unknown(domain, "u", "p")
    body.add_field("F", (3, 3), disturbed(z, (len(body),)))
    J = forms.form(ufl.derivative(mixed(z, body, LAW), z.U))
    A = forms.create_matrix(J, compact=True)
    return lambda: forms.assemble_matrix(J, A=A), len(body)


def of_dolfinx(n):
    """Return the same for quadratic elements of dolfinx."""
    domain = mesh.create_box(
        MPI.COMM_WORLD, [(0,) * 3, (n,) * 3], [n] * 3, mesh.CellType.hexahedron
    )
    xi, weights = basix.make_quadrature(domain.basix_cell(), 3)  # 2 x 2 x 2
    rule = {"quadrature_rule": "custom", "quadrature_points": xi, "quadrature_weights": weights}
    element = basix.ufl.quadrature_element(
        domain.basix_cell(), value_shape=(3, 3), points=xi, weights=weights
    )
    F, z = fem.Function(fem.functionspace(domain, element)), Unknown(domain, "u", "p", degree=2)
    F.x.array[:] = disturbed(z, (n**3 * len(xi),)).ravel()
    cells = OverCells(domain, ufl.dx(domain=domain, metadata=rule), F)
    J = fem.form(ufl.derivative(mixed(z, cells, LAW), z.U), jit_options={"timeout": 1200})
    A = fem.create_matrix(J)

    def task():
        A.set_value(0.0)
        fem.assemble_matrix(A, J)

    return task, n**3 * len(xi)


def main(n: int = 16, repeats: int = 5, steps: int = 10):
    """Print microseconds per point for N cells per side, and seconds per step."""
    io.say(machine.describe())
    cases = {f"{kind} splines": of_points(n, kind) for kind in ("quadratic", "cubic")}
    cases |= {"linear functions": of_points(n, None), "dolfinx, quadratic": of_dolfinx(n)}
    medians = alternate({name: task for name, (task, _) in cases.items()}, repeats)
    table = io.Table({"tangent".ljust(20): "s", "points": "d", "us a point": ".2f"})
    for name, (_, count) in cases.items():
        table.row(name.ljust(20), count, 1e6 * medians[name] / count)
    study = runpy.run_path(str(ROOT / "studies" / "columns.py"))
    columns = {"case": "s", "points": "d", "step [s]": ".2f", "assembly [s]": ".2f"}
    columns |= {"pattern [s]": ".2f", "linear [s]": ".2f", "Newton": "d", "linear solver": "s"}
    table = io.Table(columns)
    for case in ("smooth", "energy"):
        sim, _ = study["build"]("bending_beam", **{"dt": 0.005}, **study["CASES"][case])
        rows, names = [], ("assembly", "matrix pattern", "linear solver")
        for _ in range(3 + steps):
            before, begin = dict(sim.seconds), time.perf_counter()
            step = sim.step()
            now = time.perf_counter() - begin
            rows.append([now, *(sim.seconds[name] - before.get(name, 0.0) for name in names)])
        medians = np.median(rows[3:], axis=0)
        table.row(case, len(sim.bodies[0]), *medians, step.newton.iterations, sim.linear.method)


if __name__ == "__main__":
    typer.run(main)
