# SPDX-License-Identifier: MIT
#
# # A stabilization of one's own
#
# Every weak form of this package is UFL, so a new stabilization is a function that returns a few
# lines of it. The exact tangent follows by `ufl.derivative`, and no line of C, numba or assembly
# code needs to be touched. The demo writes three stabilizations of the mixed displacement-pressure
# formulation and compares them with ASGS on Cook's membrane, whose mesh, load and solution are
# those of `cooks_membrane.py`.

# ## Implementation

import argparse
import logging
from pathlib import Path

from mpi4py import MPI

import ufl
from cooks_membrane import CONVERGED, pressure_panel, solve
from matplotlib.figure import Figure

from fenicsmpm import io
from fenicsmpm.formulations import Kinematics, asgs, element_size, residuals, tau

# ### Penalized pressure gradients
#
# The oldest remedy for linear triangles (F. Brezzi and J. Pitkäranta, 1984) takes roughness out of
# the pressure by
#
# $$
# - \int \alpha \frac{h^2}{2 \mu} \, \nabla p \cdot \nabla q \, \mathrm{d}v .
# $$
#
# It is written over the material points with `points.dx`, which integrates over their volumes
# before the step. Gradients and volumes after it come from `Kinematics`:
# $\nabla p = f^{-T} \nabla_n p$ with $f = I + \nabla_n u$ of the increment $u$, and
# $\mathrm{d}v = j \, \mathrm{d}v_n$ with $j = \det f$.


def brezzi_pitkaranta(U, V, points, law, alpha=0.5):
    (u, p), (_, q) = ufl.split(U), ufl.split(V)
    k = Kinematics(u, points)
    h = element_size(points)
    grad_p, grad_q = k.grad(p), k.grad(q)
    return -alpha * h**2 / (2 * law.mu) * k.j * ufl.inner(grad_p, grad_q) * points.dx


# ### Least squares
#
# The residuals of momentum and of the volumetric law may instead be squared, weighted with the
# parameters of ASGS, and made stationary (after T. J. R. Hughes, L. P. Franca and M. Balestra,
# 1986):
#
# $$
# \delta \int - \frac{\tau_1}{2} |R_u|^2 + \frac{\tau_2}{2} R_p^2 \, \mathrm{d}v ,
# $$
#
# where the first term has the sign of the saddle point. The function `residuals` returns $j R_u$,
# per volume before the step. UFL writes the variation, which nobody would like to do by hand.


def least_squares(U, V, points, law):
    R_u, R_p = residuals(U, points, law)
    tau_1, tau_2 = tau(points, law)
    j = Kinematics(ufl.split(U)[0], points).j
    functional = (-tau_1 / (2 * j) * ufl.inner(R_u, R_u) + tau_2 / 2 * R_p**2) * points.dx
    return ufl.derivative(functional, U, V)


# ### Jumps of the pressure gradient
#
# Forms over points add to forms over cells and facets of the mesh. Continuous interior penalty (E.
# Burman and P. Hansbo, 2006) punishes kinks of the pressure across the inner facets of the
# background mesh,
#
# $$
# - \int_{\mathcal{F}} \gamma \frac{h^3}{2 \mu} \, [\![ \nabla p \cdot n ]\!] \,
#     [\![ \nabla q \cdot n ]\!] \, \mathrm{d}s .
# $$


def gradient_jumps(U, V, points, law, gamma=0.1):
    p, q = ufl.split(U)[1], ufl.split(V)[1]
    n = ufl.FacetNormal(points.mesh)
    h = ufl.avg(element_size(points))
    jumps = ufl.jump(ufl.grad(p), n) * ufl.jump(ufl.grad(q), n)
    return -gamma * h**3 / (2 * law.mu) * jumps * ufl.dS


# The functions are used exactly like those of the package: the residual is
# `mixed(U, V, points, law) + gradient_jumps(U, V, points, law)`.

METHODS = {
    "asgs": asgs,
    "brezzi_pitkaranta": brezzi_pitkaranta,
    "least_squares": least_squares,
    "gradient_jumps": gradient_jumps,
}

# ## Results
#
# Tip displacements are printed beside those of ASGS and beside the limit of fine Taylor-Hood P2-P1
# meshes; the pressure fields are those of the finest mesh. A stabilization that is too weak shows a
# checkerboard there, one that is too strong flattens the peak at the upper left corner: try other
# values of `alpha` and `gamma`.
#
# Differences between methods must go away on fine meshes. Least squares differ from ASGS only by
# the variation of $1 / j$, which is multiplied by a squared residual and hardly seen here.


def compare(sizes, output):
    limit = CONVERGED[0.5]
    rows = io.Table(
        {
            "elements a side": "d",
            "    stabilization": "s",
            "tip u_y [m]": ".4f",
            "to ASGS": "+.4%",
            "P2-P1 limit": ".4f",
            "to the limit": "+.2%",
            "Newton iterations": "d",
        }
    )
    tips = {name: [] for name in METHODS}
    panels = []
    for n, name in io.progress([(n, name) for n in sizes for name in METHODS], "own forms"):
        solution = solve(n, METHODS[name], nu=0.5)
        tip = solution.tip
        tips[name].append(tip)
        to_asgs = tip / tips["asgs"][-1] - 1
        rows.row(n, name, tip, to_asgs, limit, tip / limit - 1, solution.iterations)
        assert abs(to_asgs) < (1e-4 if name == "least_squares" else 1 / n)
        assert solution.iterations <= 4
        if n == sizes[-1]:
            panels.append(pressure_panel(solution, name))
            parameters = {"n": n, "stabilization": name}
            io.write(output / f"{name}.vtp", io.gather_points(solution.points), parameters)
            io.write(output / f"{name}.vtu", panels[-1].data, parameters)

    limits = io.colour_range(panels, cut=1)
    io.picture(output / "pressures.png", panels, "mean stress p [Pa]", limits=limits)
    if MPI.COMM_WORLD.rank == 0:
        plot(sizes, tips, limit, output / "tip_displacement.png")
    io.say(f"pressures.png, tip_displacement.png, and files .vtp and .vtu are in {output}")


def plot(sizes, tips, limit, path):
    figure = Figure(figsize=(6, 4), layout="constrained")
    ax = figure.subplots()
    ax.axhline(limit, color="black", lw=1, ls="--", label="P2-P1 finite elements")
    for (name, values), marker in zip(tips.items(), "so+^", strict=True):
        ax.plot(sizes, values, marker=marker, ms=8, label=name)
    ax.set_xscale("log", base=2)
    ax.set_xticks(sizes, [str(n) for n in sizes])
    ax.set_xlabel("elements a side")
    ax.set_ylabel("vertical displacement of the tip [m]")
    ax.grid(alpha=0.3)
    ax.legend()
    figure.savefig(path, dpi=160)


# ## Command line


def main(arguments=None):
    parser = argparse.ArgumentParser(description="stabilizations of one's own on Cook's membrane")
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
    compare([8, 16] if options.short else [8, 16, 32, 64], options.output)


if __name__ == "__main__":
    main()
