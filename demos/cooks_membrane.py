# SPDX-License-Identifier: MIT
#
# # Cook's membrane
#
# A tapered panel of an incompressible rubber is clamped on its left edge and pulled upwards on its
# right one. It bends and shears at once, which locks plain linear triangles and makes the pressure
# of unstabilized mixed ones jump from cell to cell. The demo shows how
#
# - material points are seeded and integrals are taken over them,
# - a mixed formulation and its stabilization are put together from UFL,
# - Newton's method, pictures and result files are called.
#
# It is the static example of section 6.2 of Moreno, Wüchner and Larese, *A mixed stabilized MPM
# formulation for incompressible hyperelastic materials using Variational Subgrid-Scales* (in short:
# VMS). `--study` makes the plot of its figure 4 and the pressure fields of its figure 5.
#
# ## Formulation
#
# Displacement $u$ and mean stress $p$ are sought as continuous P1 functions on the background mesh
# such that for all test functions $w$, $q$
#
# $$
# \int \sigma_\mathrm{dev} : \nabla w + p \, \nabla \cdot w \, \mathrm{d}v
#     = \int_{\Gamma} t \cdot w \, \mathrm{d}s, \qquad
# \int (J - 1) \, q \, \mathrm{d}V = 0 ,
# $$
#
# with $J = \det F$ and the neo-Hookean stress
# $\sigma_\mathrm{dev} = \mu J^{-5/3} \operatorname{dev}(F F^T)$. Equal orders of $u$ and $p$ do not
# meet the inf-sup condition of this problem. Three stabilizations are at hand:
#
# - `ppp`, polynomial pressure projection (C. R. Dohrmann and P. B. Bochev, IJNMF 46, 2004):
#   $-\int \frac{\alpha}{\mu} (p - \bar p)(q - \bar q) \, \mathrm{d}v$ is added, with averages
#   $\bar p$, $\bar q$ over the cell;
# - `asgs`, algebraic subgrid scales (VMS, section 4): the residuals $R_u = \nabla p$ and
#   $R_p = J - 1$, times $\tau_1 = h^2 / 2 \mu$ and $\tau_2 = 2 \mu$, are tested with the adjoint
#   operator. In $R_u$ the term $\nabla \cdot \sigma_\mathrm{dev}$ vanishes for linear elements;
# - `osgs`, orthogonal subgrid scales: the same with $R - \Pi R$, where $\Pi$ projects on the grid.
#
# ## Implementation

import argparse
import logging
from dataclasses import dataclass
from pathlib import Path

from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import fem, mesh
from matplotlib.figure import Figure

from fenicsmpm import MaterialPoints, forms, io
from fenicsmpm.formulations import asgs, mixed, mixed_space, osgs, ppp
from fenicsmpm.materials import NeoHookean
from fenicsmpm.points import quadrature
from fenicsmpm.solvers import NewtonSolver

METHODS = {"none": None, "ppp": ppp, "asgs": asgs, "osgs": osgs}
TITLES = {"none": "not stabilized", "ppp": "PPP", "asgs": "ASGS", "osgs": "OSGS"}
YOUNG = 70.0  # Pa
TRACTION = 0.0625  # Pa, upwards
TIP = (48.0, 60.0)  # m

# Tip displacements [m] to compare with: the limit of fine meshes by Taylor-Hood P2-P1 finite
# elements, and this formulation on n x n x 2 triangles by an independent prototype.

CONVERGED = {0.5: 0.2761, 0.499: 0.2765}
EXPECTED = {
    "asgs": {8: 0.2105, 16: 0.2489, 32: 0.2656, 64: 0.2719},
    "osgs": {8: 0.1951, 16: 0.2416, 32: 0.2628, 64: 0.2708},
}


# The mesh is a unit square of $n \times n$ squares, each cut along its right diagonal, mapped on
# the membrane. On coarse meshes the direction of the diagonals matters as much as the
# stabilization.


def membrane(n):
    domain = mesh.create_unit_square(MPI.COMM_WORLD, n, n, diagonal=mesh.DiagonalType.right)
    x, y = domain.geometry.x[:, 0].copy(), domain.geometry.x[:, 1].copy()
    domain.geometry.x[:, 0] = 48 * x
    domain.geometry.x[:, 1] = 44 * x + (44 - 28 * x) * y
    return domain


# Three material points a cell, at the points of the quadrature rule of degree 2: the points are
# nothing but integration points here. `points.dx` is an ordinary UFL measure, so the traction on
# the right edge, an integral over facets, is simply added to the form. (The paper names the left
# edge, which is the clamped one.) Newton's method takes the tangent from `ufl.derivative`.


@dataclass
class Solution:
    points: MaterialPoints  # with the fields "displacement" and "pressure"
    u: fem.Function
    p: fem.Function
    tip: float  # vertical displacement of the upper right corner in m
    iterations: int


def solve(n, stabilization, nu):
    domain = membrane(n)
    points = quadrature(domain, degree=2)
    law = NeoHookean(YOUNG, nu)

    W = mixed_space(domain, projections=stabilization is osgs)
    U, V = fem.Function(W), ufl.TestFunction(W)
    residual = mixed(U, V, points, law)
    if stabilization is not None:
        residual += stabilization(U, V, points, law)

    right = mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[0], 48))
    tags = mesh.meshtags(domain, 1, np.sort(right), np.full(len(right), 1, np.int32))
    ds = ufl.Measure("ds", domain=domain, subdomain_data=tags)
    w = ufl.split(V)[0]
    residual -= ufl.inner(ufl.as_vector((0, TRACTION)), w) * ds(1)

    left = mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[0], 0))
    W_u, _ = W.sub(0).collapse()
    clamped = fem.locate_dofs_topological((W.sub(0), W_u), 1, left)
    bc = fem.dirichletbc(fem.Function(W_u), clamped, W.sub(0))

    # Without stabilization the tangent is singular on these meshes: two oscillating pressures do no
    # work on any P1 displacement. MUMPS is to detect them and take some multiple of them.

    detect = {"mat_mumps_icntl_24": 1, "mat_mumps_cntl_3": -1e-10}
    options = detect if stabilization is None else None
    newton = NewtonSolver(residual, U, [bc], petsc_options=options).solve()

    # Any UFL expression can be evaluated at points, also at a single one of no weight in the body.

    u, p = ufl.split(U)[:2]
    points.add_field("displacement", (2,), forms.evaluate(u, points))
    points.add_field("pressure", (), forms.evaluate(p, points))
    here = domain.comm.rank == 0
    tip = MaterialPoints(domain, [TIP] if here else np.empty((0, 2)), weight=1.0)
    u_tip = domain.comm.allreduce(forms.evaluate(u, tip).sum(axis=0))

    u, p = U.sub(0).collapse(), U.sub(1).collapse()
    u.name, p.name = "displacement", "pressure"
    return Solution(points, u, p, float(u_tip[1]), newton.iterations)


# ## Results
#
# Every result is printed beside what it should be, and written to files for ParaView: the material
# points (`.vtp`) and the functions on the background mesh (`.vtu`).


def table():
    return io.Table(
        {
            "elements a side": "d",
            "stabilization": "s",
            "tip u_y [m]": ".4f",
            "expected": ".4f",
            "P2-P1 limit": ".4f",
            "to the limit": "+.2%",
            "Newton iterations": "d",
        }
    )


def print_row(rows, n, name, nu, solution):
    limit = CONVERGED.get(nu)
    expected = EXPECTED.get(name, {}).get(n) if nu == 0.5 else None
    to_limit = None if limit is None else solution.tip / limit - 1
    rows.row(n, name, solution.tip, expected, limit, to_limit, solution.iterations)


def pressure_panel(solution, title):
    grid = io.gather_functions([solution.u, solution.p])  # None on all ranks but the first
    panel = io.Panel(grid, "pressure", title, displacement="displacement")
    if grid is not None:
        low, high = io.colour_range([panel])
        panel.title += f"\n{low:.3g} to {high:.3g} Pa"
    return panel


def check(n, name, nu, solution):
    if nu == 0.5 and n in EXPECTED.get(name, {}):
        assert abs(solution.tip - EXPECTED[name][n]) < 1e-3
        assert solution.iterations <= 4
    if nu == 0.5 and n == 128 and name != "none":
        assert abs(solution.tip / CONVERGED[nu] - 1) < 0.01


def single(n, name, nu, output):
    solution = solve(n, METHODS[name], nu)
    points = solution.points
    io.say(
        f"{points.size_global} material points, {points.volume:g} m^2 of {NeoHookean(YOUNG, nu)}"
    )
    print_row(table(), n, name, nu, solution)

    parameters = {"n": n, "stabilization": name, "E [Pa]": YOUNG, "nu": nu}
    cloud = io.gather_points(points)
    panels = [
        pressure_panel(solution, f"{TITLES[name]}, on the grid"),
        io.Panel(cloud, "pressure", "at the material points\n", displacement="displacement"),
    ]
    io.write(output / "points.vtp", cloud, parameters)
    io.write(output / "grid.vtu", panels[0].data, parameters)
    limits = io.colour_range(panels, cut=1)
    io.picture(output / "pressure.png", panels, "mean stress p [Pa]", limits=limits)
    io.say(f"points.vtp, grid.vtu and pressure.png are in {output}")
    check(n, name, nu, solution)


# The study repeats figures 4 and 5 of VMS: all methods on all meshes, and their pressure fields on
# the mesh of 32 elements a side. The colours are those of the stabilized pressures. One percent of
# them at either end is left out, because the pressure is singular at the clamped upper corner; the
# ranges above the panels tell how much of the peak each method catches. The amplitude of the jumps
# without stabilization says nothing: the solution is determined up to such jumps only.


def study(sizes, nu, output):
    rows = table()
    tips = {name: [] for name in METHODS}
    panels = {}
    cases = [(n, name) for n in sizes for name in METHODS]
    for n, name in io.progress(cases, "Cook's membrane"):
        solution = solve(n, METHODS[name], nu)
        print_row(rows, n, name, nu, solution)
        check(n, name, nu, solution)
        tips[name].append(solution.tip)
        if n == min(32, max(sizes)):
            panels[name] = pressure_panel(solution, TITLES[name])
            parameters = {"n": n, "stabilization": name, "E [Pa]": YOUNG, "nu": nu}
            io.write(output / f"{name}.vtu", panels[name].data, parameters)

    limits = io.colour_range([panels[name] for name in METHODS if name != "none"], cut=1)
    label = "mean stress p [Pa]"
    io.picture(output / "pressures.png", list(panels.values()), label, limits=limits)
    if MPI.COMM_WORLD.rank == 0:
        plot_tips(sizes, tips, nu, output / "tip_displacement.png")
    io.say(f"pressures.png, tip_displacement.png and a file .vtu for each method are in {output}")


def plot_tips(sizes, tips, nu, path):
    figure = Figure(figsize=(6, 4), layout="constrained")
    ax = figure.subplots()
    if nu in CONVERGED:
        ax.axhline(CONVERGED[nu], color="black", lw=1, ls="--", label="P2-P1 finite elements")
    for (name, values), marker in zip(tips.items(), "xs^o", strict=True):
        ax.plot(sizes, values, marker=marker, label=TITLES[name])
    ax.set_xscale("log", base=2)
    ax.set_xticks(sizes, [str(n) for n in sizes])
    ax.set_xlabel("elements a side")
    ax.set_ylabel("vertical displacement of the tip [m]")
    ax.grid(alpha=0.3)
    ax.legend()
    figure.savefig(path, dpi=160)


# ## Command line


def main(arguments=None):
    parser = argparse.ArgumentParser(description="Cook's membrane, static and incompressible")
    parser.add_argument("-n", type=int, help="elements a side (default: 32, with --short 8)")
    parser.add_argument(
        "--stabilization", choices=METHODS, help="of the equal-order elements (default: asgs)"
    )
    parser.add_argument(
        "--nu", type=float, default=0.5, help="Poisson's ratio, 0.5 is incompressible (the default)"
    )
    parser.add_argument(
        "--study", action="store_true", help="all stabilizations on 8, 16, ... 128 elements a side"
    )
    parser.add_argument("--short", action="store_true", help="coarse meshes only, for a test")
    parser.add_argument(
        "--output",
        type=Path,
        default="output",
        metavar="DIR",
        help="directory for pictures and results (default: %(default)s)",
    )
    parser.add_argument(
        "-v", "--verbose", action="store_true", help="print a line for each Newton iteration"
    )
    options = parser.parse_args(arguments)
    if options.n is not None and options.n < 1:
        parser.error(f"argument -n: at least 1 element a side is needed, not {options.n}")
    if not -1 < options.nu <= 0.5:
        parser.error(f"argument --nu: must lie in (-1, 0.5], not {options.nu}")
    if options.study and (options.n or options.stabilization):
        parser.error(
            "argument --study: takes all meshes and stabilizations, so -n and "
            "--stabilization cannot be chosen"
        )
    io.show_log(logging.INFO if options.verbose else logging.WARNING)

    if options.study:
        study([8, 16] if options.short else [8, 16, 32, 64, 128], options.nu, options.output)
    else:
        n = options.n or (8 if options.short else 32)
        single(n, options.stabilization or "asgs", options.nu, options.output)


if __name__ == "__main__":
    main()
