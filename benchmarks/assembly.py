# SPDX-License-Identifier: MIT
"""Time to assemble the complete ASGS form over material points, compared with dolfinx.

Both assemble the same UFL form, with a deformation gradient stored at each of the 12 points of
a cell, on the same mesh, into the same kind of matrix, alternately in one run. For dolfinx the
points are a custom quadrature rule and the deformation gradient is a function on it.

With ``--undeformed`` the form has no stored deformation gradient. With linear functions it is
then a polynomial in each cell. dolfinx moves nearly everything out of its quadrature loop, and this
package sums over a few sites instead of all points.
"""

import argparse
import time

from mpi4py import MPI

import basix.ufl
import machine
import numba
import numpy as np
import ufl
from dolfinx import fem, mesh

from fenicsmpm import MaterialPoints, _compat, forms
from fenicsmpm.formulations import Unknown, asgs, mixed
from fenicsmpm.materials import NeoHookean

PER_CELL = 12


class OverCells:
    """The interface of a point set that formulations need, for integrals over cells."""

    def __init__(self, domain, dx, F):
        self.mesh, self.dx, self._F = domain, dx, F
        self.grid_functions = None

    def __contains__(self, name):
        return name == "F" and self._F is not None

    def field(self, name):
        return self._F


def reference_points(dim):
    """Return 12 points in the reference simplex, as random as material points are."""
    rng = np.random.default_rng(1)
    barycentric = rng.dirichlet(np.full(dim + 1, 2.0), PER_CELL)
    return barycentric[:, 1:], np.full(PER_CELL, 1 / PER_CELL / (2 if dim == 2 else 6))


def seed(domain, xi):
    """Seed the same points in every cell."""
    dim = domain.topology.dim
    cells = np.arange(domain.topology.index_map(dim).size_local, dtype=np.int32)
    corners = domain.geometry.x[_compat.geometry_dofmap(domain)[cells], :dim]
    edges = corners[:, 1:] - corners[:, :1]
    x = corners[:, :1] + np.einsum("pk,cki->cpi", xi, edges)
    volume = np.abs(np.linalg.det(edges)) / (2 if dim == 2 else 6)
    return MaterialPoints(
        domain,
        x.reshape(-1, dim),
        np.repeat(volume / PER_CELL, PER_CELL),
        cells=np.repeat(cells, PER_CELL),
        xi=np.tile(xi, (len(cells), 1)),
    )


def alternate(tasks, repeats):
    """Return median times of the tasks in s, run alternately after one warm-up."""
    times = {name: [] for name in tasks}
    for k in range(repeats + 1):
        for name, task in tasks.items():
            start = time.perf_counter()
            task()
            if k > 0:
                times[name].append(time.perf_counter() - start)
    return {name: float(np.median(t)) for name, t in times.items()}


def measure(dim, cells, deformed, threads, repeats):
    """Return microseconds per point, and seconds of compilation, for one space dimension."""
    n = round((cells / (2 if dim == 2 else 6)) ** (1 / dim))
    create = mesh.create_unit_square if dim == 2 else mesh.create_unit_cube
    domain = create(MPI.COMM_WORLD, *[n] * dim)
    xi, weights = reference_points(dim)
    body = seed(domain, xi)
    rule = {"quadrature_rule": "custom", "quadrature_points": xi, "quadrature_weights": weights}
    F = None
    rng = np.random.default_rng(0)
    if deformed:
        body.add_field("F", (3, 3), np.eye(3) + 0.01 * rng.standard_normal((len(body), 3, 3)))
        element = basix.ufl.quadrature_element(
            domain.basix_cell(), value_shape=(3, 3), points=xi, weights=weights
        )
        F = fem.Function(fem.functionspace(domain, element))
        F.x.array[:] = body["F"].ravel()
    z = Unknown(domain, "u", "p")
    z.U.x.array[:] = 1e-3 / n * rng.standard_normal(len(z.U.x.array))
    law = NeoHookean(E=70.0, nu=0.5)
    cells_dx = ufl.dx(domain=domain, metadata=rule)

    def residual(points):
        return mixed(z, points, law) + asgs(z, points, law)

    def timed(function):
        start = time.perf_counter()
        return function(), time.perf_counter() - start

    R, compile_R = timed(lambda: forms.form(residual(body)))
    J, compile_J = timed(lambda: forms.form(ufl.derivative(residual(body), z.U)))
    theirs = residual(OverCells(domain, cells_dx, F))
    R_dolfinx = fem.form(theirs, jit_options={"timeout": 600})
    J_dolfinx, compile_dolfinx = timed(
        lambda: fem.form(ufl.derivative(theirs, z.U), jit_options={"timeout": 600})
    )
    A = forms.create_matrix(J)
    B = fem.create_matrix(J_dolfinx)

    def dolfinx_matrix():
        B.set_value(0.0)
        fem.assemble_matrix(B, J_dolfinx)

    difference = abs(
        forms.assemble_matrix(J, A=A).to_scipy() - (dolfinx_matrix() or B.to_scipy())
    ).max()
    assert difference < 1e-12 * abs(B.to_scipy()).max(), difference
    tasks = {
        "residual dolfinx": lambda: fem.assemble_vector(R_dolfinx),
        "tangent dolfinx": dolfinx_matrix,
    }
    for k in threads:

        def with_threads(function, k=k):
            numba.set_num_threads(k)
            function()

        tasks[f"residual {k}"] = lambda w=with_threads: w(lambda: forms.assemble_vector(R))
        tasks[f"tangent {k}"] = lambda w=with_threads: w(lambda: forms.assemble_matrix(J, A=A))
    medians = alternate(tasks, repeats)
    per_point = {name: 1e6 * t / len(body) for name, t in medians.items()}
    compilation = {"residual": compile_R, "tangent": compile_J, "dolfinx": compile_dolfinx}
    return len(body), per_point, compilation


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--cells", type=int, default=12000, help="approximate number of cells")
    parser.add_argument("--repeats", type=int, default=7, help="number of runs for the median")
    parser.add_argument("--threads", type=int, nargs="+", default=[1, 2], help="numbers of threads")
    parser.add_argument("--undeformed", action="store_true", help="no stored deformation gradient")
    options = parser.parse_args()
    print(machine.describe())
    kind = "undeformed points" if options.undeformed else "deformation gradient at each point"
    print(f"microseconds per point, complete ASGS form, P1-P1, {PER_CELL} points per cell, {kind}")
    columns = [f"{k} thread{'s' * (k > 1)}" for k in options.threads]
    print(f"{'':14}{'points':>9}" + "".join(f"{c:>12}" for c in [*columns, "dolfinx", "ratio"]))
    for dim in (2, 3):
        points, times, compilation = measure(
            dim, options.cells, not options.undeformed, options.threads, options.repeats
        )
        for kind in ("residual", "tangent"):
            ours = [times[f"{kind} {k}"] for k in options.threads]
            values = [*ours, times[f"{kind} dolfinx"], ours[0] / times[f"{kind} dolfinx"]]
            print(f"{dim}D {kind:11}{points:9}" + "".join(f"{v:12.3f}" for v in values))
        print(
            f"   forms ready after {compilation['residual']:.2f} s (residual), "
            f"{compilation['tangent']:.2f} s (tangent), {compilation['dolfinx']:.2f} s "
            "(tangent, dolfinx); from the cache if they have been compiled before"
        )


if __name__ == "__main__":
    main()
