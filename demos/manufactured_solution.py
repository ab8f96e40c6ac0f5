# SPDX-License-Identifier: MIT
#
# # Convergence to a manufactured solution
#
# How fast do stabilized equal-order elements converge in large deformation? The demo prescribes a
# motion and a pressure, lets UFL derive the body force that they need, and measures the errors on
# finer and finer meshes: the study of section 6.1 of Moreno, Wüchner and Larese, *A mixed
# stabilized MPM formulation for incompressible hyperelastic materials using Variational
# Subgrid-Scales* (in short: VMS).
#
# Beyond the paper, it repeats the study with material points at random places. In a Material Point
# Method points do not stay where quadrature rules would put them, and here one can see what that
# costs alone, without anything moving.
#
# ## The exact solution
#
# On the unit square, with $s = x + y$ and $k = 0.01$,
#
# $$
# u = k s^2 e^s \begin{pmatrix} 1 \\ -1 \end{pmatrix}, \qquad
# p = \frac{E}{3} \sin(2 \pi x) \cos(2 \pi y) .
# $$
#
# Both are functions of the reference coordinates. The motion preserves volume exactly,
# $\det(I + \nabla u) = 1$, and moves points by up to 0.3 m, so this is one step on the undeformed
# mesh. For the neo-Hookean energy $\psi$ the first Piola-Kirchhoff stress and the body force per
# reference volume are
#
# $$
# P = \frac{\partial \psi}{\partial F} + J p F^{-T}, \qquad b = -\operatorname{Div} P .
# $$

# ## Implementation

import argparse
import logging
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import fem, mesh
from matplotlib.figure import Figure

from fenicsmpm import MaterialPoints, forms, io
from fenicsmpm.formulations import asgs, embed, mixed, mixed_space, osgs, ppp
from fenicsmpm.materials import NeoHookean
from fenicsmpm.points import quadrature, random
from fenicsmpm.solvers import NewtonSolver, solve_in_load_steps

METHODS = ("ppp", "asgs", "osgs")
YOUNG = 10e6  # Pa
LAW = NeoHookean(YOUNG, nu=0.5)

# Three points at the places of a quadrature rule, or twelve at random places of each cell, which
# share its volume equally.

SEEDINGS = {
    "gauss": partial(quadrature, degree=2),
    "random": partial(random, per_cell=12, seed=1),
}

# Relative L2 errors of displacement and pressure with points at the quadrature rule, by an
# independent prototype, and the orders of convergence to be reached at least. VMS expects 2 for the
# displacement and 1 for the pressure, and observes 2 for both.

EXPECTED = {
    ("ppp", 16): (1.20e-2, 6.06e-2),
    ("asgs", 16): (9.10e-3, 4.04e-2),
    ("osgs", 16): (3.99e-3, 3.73e-2),
    ("ppp", 32): (3.08e-3, 1.85e-2),
    ("asgs", 32): (2.43e-3, 1.38e-2),
    ("osgs", 32): (7.65e-4, 9.15e-3),
}
ORDERS = {"ppp": (1.85, 1.5), "asgs": (1.85, 1.5), "osgs": (2.2, 1.9)}


def displacement(x, exp):
    s = x[0] + x[1]
    u = 0.01 * s**2 * exp(s)
    return u, -u


def pressure(x):
    return YOUNG / 3 * ufl.sin(2 * ufl.pi * x[0]) * ufl.cos(2 * ufl.pi * x[1])


def body_force(u, p):
    F = ufl.variable(ufl.Identity(3) + embed(ufl.grad(u)))
    J = ufl.det(F)
    P = ufl.diff(LAW.energy(F, J), F) + J * p * ufl.inv(F).T
    return -ufl.div(ufl.as_tensor([[P[i, j] for j in range(2)] for i in range(2)]))


# The displacement is prescribed on the whole boundary, so the pressure is found up to a constant:
# it is fixed at one node, and its mean is removed before errors are measured.
#
# The body force is a long expression. It is evaluated at the points into a field of theirs, which
# stands for it in the forms; it does so exactly, for forms need it nowhere else.
#
# Exact solution and body force have a common load factor. Newton's method starts from zero. Should
# it fail, for boundary displacements that are imposed at once can turn cells inside out,
# `solve_in_load_steps` goes back and takes smaller steps.


@dataclass
class Solution:
    points: MaterialPoints  # with the fields "displacement", "pressure", "exact pressure"
    u: fem.Function
    p: fem.Function
    errors: tuple[float, float]  # relative L2 errors of displacement and pressure
    iterations: int


def solve(n, name, seeding="gauss"):
    domain = mesh.create_unit_square(MPI.COMM_WORLD, n, n, diagonal=mesh.DiagonalType.right)
    points = SEEDINGS[seeding](domain)
    W = mixed_space(domain, projections=name == "osgs")
    U, V = fem.Function(W), ufl.TestFunction(W)

    x = ufl.SpatialCoordinate(domain)
    u_exact, p_exact = ufl.as_vector(displacement(x, ufl.exp)), pressure(x)
    factor = fem.Constant(domain, 1.0)
    force = forms.PointExpression(body_force(factor * u_exact, factor * p_exact), points)
    points.add_field("body force", (2,))
    b = points.field("body force")
    residual = mixed(U, V, points, LAW, force=b)
    if name == "ppp":
        residual += ppp(U, V, points, LAW)
    else:
        residual += {"asgs": asgs, "osgs": osgs}[name](U, V, points, LAW, force=b)

    W_u, _ = W.sub(0).collapse()
    W_p, _ = W.sub(1).collapse()
    u_boundary = fem.Function(W_u)
    edges = mesh.locate_entities_boundary(domain, 1, lambda x: np.full(x.shape[1], True))
    boundary = fem.locate_dofs_topological((W.sub(0), W_u), 1, edges)
    corner = fem.locate_dofs_geometrical((W.sub(1), W_p), lambda x: np.isclose(x[0] + x[1], 0))
    bcs = [
        fem.dirichletbc(u_boundary, boundary, W.sub(0)),
        fem.dirichletbc(fem.Function(W_p), corner, W.sub(1)),
    ]

    def set_load(value):
        factor.value = value
        points["body force"] = force.evaluate()
        u_boundary.interpolate(lambda x: value * np.stack(displacement(x, np.exp)))

    solver = NewtonSolver(residual, U, bcs, line_search=True)
    steps = solve_in_load_steps(solver, set_load)

    u, p = U.sub(0).collapse(), U.sub(1).collapse()
    u.name, p.name = "displacement", "pressure"
    errors = relative_errors(u, p, u_exact, p_exact)
    points.add_field("displacement", (2,), forms.evaluate(u, points))
    points.add_field("pressure", (), forms.evaluate(p, points))
    points.add_field("exact pressure", (), forms.evaluate(p_exact, points))
    return Solution(points, u, p, errors, sum(step.iterations for step in steps))


# Errors are integrated over the cells with a rule of degree 8, wherever the material points are.


def relative_errors(u, p, u_exact, p_exact):
    domain = u.function_space.mesh
    dx = ufl.dx(domain=domain, metadata={"quadrature_degree": 8})

    def integral(f):
        return domain.comm.allreduce(fem.assemble_scalar(fem.form(f * dx)))

    p.x.array[:] -= integral(p) - integral(p_exact)  # the square has the area 1
    p_mean = integral(p_exact)
    square_u = integral(ufl.inner(u - u_exact, u - u_exact)) / integral(ufl.inner(u_exact, u_exact))
    square_p = integral((p - p_exact) ** 2) / integral((p_exact - p_mean) ** 2)
    return float(np.sqrt(square_u)), float(np.sqrt(square_p))


# ## Results
#
# Orders of convergence are slopes of the regression line of $\log e$ over $\log h$, on the meshes
# from 8 squares a side on.


def study(sizes, seedings, output):
    rows = io.Table(
        {
            "points": "s",
            "stabilization": "s",
            "squares a side": "d",
            "error of u": ".3e",
            "expected u": ".2e",
            "error of p": ".3e",
            "expected p": ".2e",
            "Newton iterations": "d",
        }
    )
    errors = {}
    cases = [(s, name, n) for s in seedings for name in METHODS for n in sizes]
    for seeding, name, n in io.progress(cases, "manufactured solution"):
        solution = solve(n, name, seeding)
        errors[seeding, name, n] = solution.errors
        expected = EXPECTED.get((name, n)) if seeding == "gauss" else None
        of_u, of_p = expected or (None, None)
        e_u, e_p = solution.errors
        rows.row(seeding, name, n, e_u, of_u, e_p, of_p, solution.iterations)
        if expected is not None:
            assert np.allclose(solution.errors, expected, rtol=0.02)
    write(solution, {"n": n, "stabilization": name, "points": seeding, "E [Pa]": YOUNG}, output)

    fine = [n for n in sizes if n >= 8]
    if len(fine) > 1:
        print_orders(errors, seedings, fine)
    if MPI.COMM_WORLD.rank == 0:
        plot(errors, seedings, sizes, output / "errors.png")
    io.say(f"points.vtp, grid.vtu, pressure.png and errors.png are in {output}")


def print_orders(errors, seedings, sizes):
    io.say(
        f"\nOrders of convergence by regression over {', '.join(map(str, sizes))} squares a side"
    )
    rows = io.Table(
        {
            "points": "s",
            "stabilization": "s",
            "order of u": ".2f",
            "at least u": ".2f",
            "order of p": ".2f",
            "at least p": ".2f",
        }
    )
    for seeding in seedings:
        for name in METHODS:
            e = np.array([errors[seeding, name, n] for n in sizes])
            of_u, of_p = -np.polyfit(np.log(sizes), np.log(e), 1)[0]
            wanted = ORDERS[name] if seeding == "gauss" else (None, None)
            rows.row(seeding, name, of_u, wanted[0], of_p, wanted[1])
            if seeding == "gauss":
                assert of_u >= wanted[0] and of_p >= wanted[1]
    io.say()


def write(solution, parameters, output):
    points = io.gather_points(solution.points)
    grid = io.gather_functions([solution.u, solution.p])
    io.write(output / "points.vtp", points, parameters)
    io.write(output / "grid.vtu", grid, parameters)
    panels = [
        io.Panel(points, "exact pressure", "exact"),
        io.Panel(points, "pressure", f"computed, {parameters['stabilization'].upper()}"),
    ]
    io.picture(output / "pressure.png", panels, "mean stress p [Pa]")


def plot(errors, seedings, sizes, path):
    figure = Figure(figsize=(9, 4.2), layout="constrained")
    h = 1 / np.array(sizes)
    titles = ("displacement", "pressure")
    for k, (ax, title) in enumerate(zip(figure.subplots(1, 2), titles, strict=True)):
        for seeding, line in zip(seedings, ("-", "--"), strict=False):
            for color, name in enumerate(METHODS):
                e = [errors[seeding, name, n][k] for n in sizes]
                label = f"{name.upper()}, {seeding} points"
                ax.loglog(h, e, f"C{color}o{line}", ms=4, label=label)
        lowest = min(errors[key][k] for key in errors)
        ax.loglog(h, 0.7 * lowest * (h / h[-1]) ** 2, "k:", label="order 2")
        ax.set_xticks(h, [f"1/{n}" for n in sizes])
        ax.minorticks_off()
        ax.set_xlabel("h [m]")
        ax.set_ylabel(f"relative L2 error of the {title} [-]")
        ax.grid(alpha=0.3)
    ax.legend(fontsize=8, handlelength=3)
    figure.savefig(path, dpi=160)


# ## Command line


def main(arguments=None):
    parser = argparse.ArgumentParser(description="convergence to a manufactured solution")
    parser.add_argument(
        "--points",
        choices=["gauss", "random", "both"],
        default="both",
        help="places of the material points: 3 of a quadrature rule or 12 at random in each cell "
        "(default: %(default)s)",
    )
    parser.add_argument("--short", action="store_true", help="the two coarsest meshes only")
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
    io.show_log(logging.INFO if options.verbose else logging.WARNING)

    seedings = ["gauss", "random"] if options.points == "both" else [options.points]
    study([8, 16] if options.short else [5, 8, 16, 32], seedings, options.output)


if __name__ == "__main__":
    main()
