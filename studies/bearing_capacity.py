# SPDX-License-Identifier: MIT
"""Bearing capacity of a strip footing on soil with cohesion and friction, by load steps.

Weightless soil below a surcharge q bears c N_c + q N_q, with

    N_q = exp(pi tan(phi)) tan^2(45 + phi / 2)       (H. Reissner, 1924),
    N_c = (N_q - 1) cot(phi), or 2 + pi if phi = 0   (L. Prandtl, 1920).

The study finds N_c in soil with cohesion and no surcharge, and N_q in sand whose initial stress is
the surcharge in all directions. The soil follows Mohr and Coulomb with associated flow. It is so
stiff that the footing settles by less than 1e-6 of its width, as the theory is one of small
displacements.

Half of the ground is modelled. Nodes under the footing move down. They slide freely, or do not
slide with --rough; both have the same limit load in theory. Displacements are splines: with linear
functions on quadrilaterals, dilating soil locks. Clay (phi = 0) reaches its limit load later and
needs --settlement 7.
"""

import math

from mpi4py import MPI

import numpy as np
import typer
from dolfinx import mesh

from fenicsmpm import ImplicitMPM, basis, io, points
from fenicsmpm import formulations as fm
from fenicsmpm.materials import MohrCoulomb
from fenicsmpm.simulation import Reaction

E, NU, STRENGTH = 1e8, 0.3, 1.0  # Pa, -, Pa: cohesion or surcharge
STEPS = 25


def factors(friction):
    """Return N_c and N_q by the angle of friction in degrees."""
    tan = math.tan(math.radians(friction))
    N_q = math.exp(math.pi * tan) * math.tan(math.radians(45 + friction / 2)) ** 2
    return {"N_c": (N_q - 1) / tan if tan > 0 else 2 + math.pi, "N_q": N_q}


def bearing(factor, friction, functions, cells, size, rough=False, settlement=3.0):
    """Return settlements over B, and loads over strength, of a footing.

    Args:
        factor: "N_c" or "N_q".
        friction: Angle of friction and of dilatancy in degrees.
        functions: Grid functions.
        cells: Number of cells along the width B = 1 m, even.
        size: Width and depth of the ground in units of B.
        rough: Whether the footing fixes the ground horizontally.
        settlement: Final settlement in units of limit load * B / E.
    """
    width, depth = size
    shape = [round(width * cells), round(depth * cells)]
    domain = mesh.create_rectangle(
        MPI.COMM_WORLD, [(0, 0), size], shape, mesh.CellType.quadrilateral,
        partitioner=basis.shared_vertex_partitioner,
    )  # fmt: skip
    ground = points.fill(domain, 2)
    # just below the surface, which heaves
    ends = [(x, depth - 1e-3 / cells) for x in (0.5, width)]
    surface = points.on_curve(domain, *ends, spacing=1 / (4 * cells))
    for some in (ground, surface):
        basis.use(some, functions)
    surcharge = STRENGTH if factor == "N_q" else 0.0
    soil = MohrCoulomb(E, NU, STRENGTH - surcharge, friction=friction, dilatancy=friction)
    fm.set_initial_state(ground, 1.0)
    fm.initial_stress(ground, soil, -surcharge * np.eye(3))

    limit = STRENGTH * factors(friction)[factor]
    z = fm.Unknown(domain, "u")
    z.fix("u", lambda x: (x[0] < 1e-9) | (x[0] > width - 1e-9), component=0)
    z.fix("u", lambda x: x[1] < 1e-9)

    def footing(x):
        return (x[1] > depth - 1e-9) & (x[0] < 0.5 + 1e-9)

    under = z.fix("u", footing, lambda t: -t, component=1)
    if rough:
        z.fix("u", footing, component=0)
    P = fm.Response(soil, ground, fm.Kinematics(z.u, ground).F).P
    R = fm.stress_power(P, z.test.u, ground)
    R += fm.dead_load(z.test.u, surface, (0.0, -surcharge))
    end, force = settlement * limit / E, Reaction(under)
    scheme, way, load = fm.QuasiStatic(z, dt=end / STEPS), [0.0], [surcharge]
    # where much of the ground flows, the tangent depends strongly on which points flow
    newton = {"max_iterations": 100, "line_search": True}
    sim = ImplicitMPM(
        R, z, scheme, ground, carried=[surface], observers=[force], newton=newton
    )  # fmt: skip
    title = f"{factor} of {friction:g} degrees, {functions}, h = B/{cells}"
    for step in io.watch(sim.run(end, largest=end / STEPS), end, title):
        way.append(step.time)
        load.append(-force.value[1] / 0.5)
    return np.array(way), np.array(load) / STRENGTH


def main(
    friction: list[float] = [30.0, 20.0, 0.0],
    bases: list[str] = ["cubic", "quadratic"],
    cells: list[int] = [4, 8, 12],
    rough: bool = False,
    width: float = 5.0,
    depth: float = 2.0,
    settlement: float = 3.0,
):
    """Compare FRICTION angles in degrees, functions BASES, and CELLS along B with the theory.

    WIDTH and DEPTH of the ground are in units of B, the final SETTLEMENT in limit load * B / E.
    """
    columns = {"": "s", "friction": ".0f", "functions".ljust(9): "s", "h".ljust(4): "s"}
    columns |= {"found": ".3f", "exact": ".3f", "off": "+.1%", "still rises": ".1%"}
    table, curves = io.Table(columns), {}
    for angle in friction:
        for factor, exact in factors(angle).items():
            if factor == "N_q" and angle == 0:
                continue  # without friction, the surcharge adds no strength
            for functions in bases:
                for n in cells:
                    way, load = bearing(
                        factor, angle, functions, n, (width, depth), rough, settlement
                    )
                    rise = 1 - np.interp(0.8 * way[-1], way, load) / load[-1]
                    row = load[-1], exact, load[-1] / exact - 1, rise
                    table.row(factor, angle, functions.ljust(9), f"B/{n}", *row)
                    name = f"{factor}, {angle:g} degrees, {functions}, B/{n}"
                    curves[name] = E * way / (STRENGTH * exact), load / exact
    labels = "settlement * E / (limit load * B)", "load / limit load"
    io.plot("output/bearing_capacity.png", curves, *labels, reference={"limit analysis": 1.0})


if __name__ == "__main__":
    typer.run(main)
