# SPDX-License-Identifier: MIT
"""Order of convergence of the Taylor-Green vortex, and how it depends on the triangles.

The number of points along the side of a triangle grows from 4 to 16 as cells become smaller, or
stays at 4. In the latter case integration errors stop the convergence. With splines on squares
(FUNCTIONS), there are 1.5 times as many points along the side of a square.
"""

from mpi4py import MPI

import numpy as np
import typer
from dolfinx import mesh

from fenicsmpm import ImplicitMPM, basis, formulations, io, points
from fenicsmpm.cells import ActiveCells

POINTS = {8: 4, 16: 8, 32: 16}  # squares along the box: points along the side of a triangle


def exact(x, t, viscosity):
    a, b = np.pi * x[:2]
    decay = np.exp(-2 * viscosity * np.pi**2 * t)
    return decay * np.array([np.sin(a) * np.cos(b), -np.cos(a) * np.sin(b)])


def error(n, per_side, viscosity=0.1, diagonal="crossed", until=0.1, functions="linear"):
    """Return the relative L2 error of the points' velocity, and the points."""
    kind, is_smooth = getattr(mesh.DiagonalType, diagonal), functions != "linear"
    cell = mesh.CellType.quadrilateral if is_smooth else mesh.CellType.triangle
    partitioner = basis.shared_vertex_partitioner
    domain = mesh.create_unit_square(
        MPI.COMM_WORLD, n, n, cell, diagonal=kind, partitioner=partitioner
    )
    fluid = points.fill(domain, per_side)
    if is_smooth:
        basis.use(fluid, functions)
    formulations.set_initial_state(fluid, 1.0, velocity=lambda x: exact(x, 0.0, viscosity))
    z = formulations.Unknown(domain, "u", "p")
    for k in range(2):
        z.fix("u", lambda x, k=k: np.isclose(x[k], 0) | np.isclose(x[k], 1), component=k)
    z.fix("p", lambda x: np.isclose(x[0], 0) & np.isclose(x[1], 0.5))
    scheme = formulations.Newmark(z, dt=0.05 / n)
    law = formulations.NewtonianFlow(viscosity, 1.0, scheme)
    R = formulations.mixed(z, fluid, law) + scheme.lumped(fluid)
    if is_smooth:
        R += formulations.interior_penalty(z, ActiveCells(fluid), law)
    else:
        R += formulations.asgs(z, fluid, law, force=scheme.force(fluid))
    sim = ImplicitMPM(R, z, scheme, fluid, taylor=True)
    for _ in io.watch(sim.run(until), until, f"1/{n}, {per_side**2} points a cell"):
        pass
    wanted = exact(fluid.x.T, until, viscosity).T
    squares = [fluid.weight @ np.sum(v**2, axis=1) for v in (fluid["v"] - wanted, wanted)]
    found, size = domain.comm.allreduce(np.array(squares))
    return np.sqrt(found / size), fluid


def main(
    viscosity: float = 0.1, diagonal: str = "crossed", until: float = 0.1, finest: int = 32,
    functions: str = "linear",
):  # fmt: skip
    """Measure errors for a VISCOSITY in Pa s; DIAGONAL of squares: crossed, left_right or right."""
    if diagonal not in ("crossed", "left_right", "right"):
        raise typer.BadParameter(f"diagonal must be crossed, left_right or right, not {diagonal}")
    table = io.Table({"points a cell": "s", "h [m]": "s", "error": ".2e", "order": ".2f"})
    curves, sizes = {}, np.array([n for n in POINTS if n <= finest])
    for label, per in {"growing number": POINTS, "16": dict.fromkeys(POINTS, 4)}.items():
        found = []
        for n in sizes:
            side = per[n] if functions == "linear" else per[n] * 3 // 2
            found.append(error(n, side, viscosity, diagonal, until, functions)[0])
            order = np.log2(found[-2] / found[-1]) if len(found) > 1 else None
            table.row(f"{side**2}", f"1/{n}", found[-1], order)
        curves[f"{label} of points a cell"] = -np.log2(sizes), np.log10(found)
    second = np.log10(0.7 * found[-1]) - 2 * np.log10(sizes / sizes[-1])
    labels, known = ("log2 h", "log10 error of velocity"), {"order 2": (-np.log2(sizes), second)}
    kind = diagonal if functions == "linear" else functions
    io.plot(f"output/taylor_green_errors_{kind}.png", curves, *labels, reference=known)


if __name__ == "__main__":
    typer.run(main)
