# SPDX-License-Identifier: MIT
"""Cook's membrane: all stabilizations on all meshes (figures 4 and 5 of VMS), and smooth functions.

The problem is that of demos/cooks_membrane.py. The script prints tip displacements beside the limit
of Taylor-Hood P2-P1 finite elements, and draws them and the pressure fields. The colour range is
that of the stabilized pressures. Without stabilization, two oscillating pressures do no work on any
P1 displacement, so the solution is unique only up to multiples of these. With FUNCTIONS other than
"linear", the panel is cut out of a lattice of squares, with 9 points each.
"""

from mpi4py import MPI

import numpy as np
import typer
from dolfinx import mesh

from fenicsmpm import basis, forms, formulations, io, points
from fenicsmpm.cells import ActiveCells, Tying
from fenicsmpm.diagnostics import probe
from fenicsmpm.materials import NeoHookean
from fenicsmpm.solvers import NewtonSolver

KINDS = {
    "linear": ("none", "ppp", "asgs", "osgs"),
    "smooth": ("none", "cip", "hessian", "split_osgs"),
}
CONVERGED = {0.5: 0.2761, 0.499: 0.2765}  # tip [m] by Poisson's ratio, P2-P1 elements


def panel(x):
    return (x[0] <= 48) & (x[1] >= x[0] * 44 / 48) & (x[1] <= 44 + x[0] * 16 / 48)


def solve_on_lattice(n, stabilization, nu=0.5, functions="quadratic"):
    """Return points, upward displacement of the tip [m], and iterations; n squares per side."""
    h, rows = 48 / n, n * 60 // 48 + 1
    domain = mesh.create_rectangle(
        MPI.COMM_WORLD, [(0, 0), (48 + h, rows * h)], [n + 1, rows], mesh.CellType.quadrilateral,
        partitioner=basis.shared_vertex_partitioner,
    )  # fmt: skip
    body = points.lattice(domain, h / 3, inside=panel)
    edge = points.on_curve(domain, (48, 44), (48, 60), spacing=h / 6)
    tip = points.at(domain, (48.0, 60.0))
    for p in (body, edge, tip):
        basis.use(p, functions, h / 6 if functions == "gimp" else None)
    cells, law = ActiveCells(body, loads=[edge, tip]), NeoHookean(E=70.0, nu=nu)  # Pa
    z = formulations.Unknown(domain, "u", "p")
    z.fix("u", lambda x: np.isclose(x[0], 0))
    R = formulations.stabilized(stabilization, z, body, law, cells=cells)
    R += formulations.dead_load(z.test.u, edge, (0, 0.0625))  # Pa
    newton = NewtonSolver(R, z.U, z.bcs, tying=Tying(z.space, body, cells)).solve()
    tip.add_field("u", (2,), forms.evaluate(z.u, tip))
    body.add_field("p", (), forms.evaluate(z.p, body))
    return body, probe(tip, "u")[1], newton.iterations


def solve(n, stabilization, nu=0.5):
    """Return nodal pressure, upward displacement of the tip [m], and Newton iterations."""
    domain = mesh.create_unit_square(MPI.COMM_WORLD, n, n, diagonal=mesh.DiagonalType.right)
    x, y, _ = domain.geometry.x.T.copy()
    domain.geometry.x[:, :2] = np.column_stack([48 * x, 44 * x + (44 - 28 * x) * y])
    body = points.quadrature(domain, degree=2)
    edge = points.on_facets(domain, lambda x: np.isclose(x[0], 48))
    tip = points.at(domain, (48.0, 60.0))
    z = formulations.Unknown(domain, "u", "p")
    z.fix("u", lambda x: np.isclose(x[0], 0))
    R = formulations.stabilized(stabilization, z, body, NeoHookean(E=70.0, nu=nu))  # Pa
    R += formulations.dead_load(z.test.u, edge, (0, 0.0625))  # Pa
    # MUMPS detects the pressures that do no work, and returns some multiple of them
    detect = {"mat_mumps_icntl_24": 1, "mat_mumps_cntl_3": -1e-10}
    options = detect if stabilization == "none" else None
    newton = NewtonSolver(R, z.U, z.bcs, petsc_options=options).solve()
    tip.add_field("u", (2,), forms.evaluate(z.u, tip))
    return z.function("p"), probe(tip, "u")[1], newton.iterations


def main(
    nu: float = 0.5, sizes: list[int] = [8, 16, 32, 64, 128], functions: str = "linear"
):  # fmt: skip
    """Compare stabilizations, for Poisson's ratio NU and numbers SIZES of squares per side."""
    limit, tips, pressures = CONVERGED.get(nu), {}, {}
    columns = {"squares": "d", "stabilization": "s", "tip [m]": ".4f", "to the limit": "+.2%"}
    table = io.Table({**columns, "Newton iterations": "d"})
    for n in io.progress(sizes, "Cook's membrane"):
        for name in KINDS.get(functions, KINDS["smooth"]):
            options = () if functions == "linear" else (functions,)
            p, tip, iterations = (solve_on_lattice if options else solve)(n, name, nu, *options)
            table.row(n, name, tip, limit and tip / limit - 1, iterations)
            tips.setdefault(name, []).append(tip)
            if n == min(32, max(sizes)):
                pressures[name] = p
    label, limits = "mean stress p [Pa]", (-0.15, 0.15)
    io.picture(f"output/cooks_membrane_{functions}.png", pressures, "p", label, limits=limits)
    curves = {name: (1 / np.array(sizes), found) for name, found in tips.items()}
    labels = "1 / squares along a side", "vertical displacement of the tip [m]"
    reference = {"P2-P1 finite elements": limit} if limit else None
    io.plot(f"output/cooks_membrane_{functions}_tips.png", curves, *labels, reference=reference)


if __name__ == "__main__":
    typer.run(main)
