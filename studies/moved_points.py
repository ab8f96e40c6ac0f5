# SPDX-License-Identifier: MIT
"""How well points that have moved integrate: a column under its weight, and a stretched block.

Both are loaded in steps, without inertia of any importance. Points cross cells, so that they are no
quadrature rule any more. Corrected weights, functions without kinks, and sizes that follow the
points help.
"""

from itertools import product

from mpi4py import MPI

import numpy as np
import typer
import ufl
from dolfinx import fem, mesh

from fenicsmpm import ImplicitMPM, basis, io, points
from fenicsmpm import formulations as fm
from fenicsmpm.cells import ActiveCells, BalancedWeights, Tying, correct_weights
from fenicsmpm.forms import evaluate
from fenicsmpm.materials import Hencky, NeoHookean
from fenicsmpm.simulation import Reaction

AS_THEY_ARE, CORRECTED, BALANCED = "as they are", "corrected", "balanced"
KINDS = [("linear", AS_THEY_ARE), ("linear", CORRECTED)]
KINDS += [(functions, AS_THEY_ARE) for functions in ("gimp", "quadratic", "cubic", "cpgimp")]
KINDS += [(functions, BALANCED) for functions in ("gimp", "quadratic", "cubic")]
app = typer.Typer(help=__doc__, pretty_exceptions_enable=False)


def see(body, functions, half_size):
    if functions != "linear":
        basis.use(body, functions, *([half_size] if functions.endswith("gimp") else []))


class Column:
    """A column of soft material under its own weight: L = 50 m, E = 10 kPa, nu = 0."""

    L, E, density, g = 50.0, 1e4, 80.0, 9.81

    def __init__(self, functions, h=1.0, weights=AS_THEY_ARE, steps=40, **newton):
        n = round(self.L / h)
        domain = mesh.create_rectangle(
            MPI.COMM_WORLD, [(0, 0), (h, self.L)], [1, n], mesh.CellType.quadrilateral
        )
        self.body = body = points.fill(domain, 2)
        see(body, functions, h / 4)
        fm.set_initial_state(body, self.density)
        z = fm.Unknown(domain, "u")
        self.floor = Reaction(z.fix("u", lambda x: np.isclose(x[1], 0), component=1))
        z.fix("u", lambda x: np.isclose(x[0], 0) | np.isclose(x[0], h), component=0)
        scheme = fm.QuasiStatic(z, dt=1 / steps)
        self.law = Hencky(self.E, 0.0)
        P = fm.Response(self.law, body, fm.Kinematics(z.u, body).F).P
        weight = fem.Constant(domain, np.zeros(2))

        def load(start, end):
            weight.value = (0, -self.g * end)

        R = fm.stress_power(P, z.test.u, body)
        R -= ufl.inner(scheme.force(body, weight), z.test.u) * body.dx
        observers = [self.floor]
        cells = ActiveCells(body)
        if weights == CORRECTED:
            observers.append(lambda sim, step: correct_weights(body, cells))
        elif weights == BALANCED:
            observers.append(BalancedWeights(body, cells))
        self.sim = ImplicitMPM(R, z, scheme, body, data=load, observers=observers, newton=newton)

    def error(self):
        """Mean deviation of the vertical stress from -rho g (L - Y), by the largest stress."""
        body = self.body
        F = body.field("F")
        sigma = evaluate(fm.Response(self.law, body, F).P * F.T / ufl.det(F), body)[:, 1, 1]
        Y = body.x[:, 1] - body["u"][:, 1]
        exact = -self.density * self.g * (self.L - Y)
        comm, V = body.mesh.comm, body["V_0"]
        total = comm.allreduce(float(V @ np.abs(sigma - exact)))
        return total / comm.allreduce(float(V.sum())) / (self.density * self.g * self.L)


@app.command()
def column(h: list[float] = [1.0, 0.5, 0.25], steps: int = 40):
    """Error of the vertical stress in a column that its weight makes half as long, cells of H m."""
    table = io.Table({"functions".ljust(25): "s"} | {f"h = {size:g} m": ".2%" for size in h})
    for functions, weights in KINDS:
        errors = []
        for size in h:
            body = Column(functions, size, weights, steps)
            for _ in body.sim.run(1.0):
                pass
            errors.append(body.error())
        title = functions if weights == AS_THEY_ARE else f"{functions}, {weights} weights"
        table.row(title.ljust(25), *errors)


def stretched(functions, corrected, steps, n=16, per_side=6, method=fm.Bossak):
    """Return force (by the exact one), stretch and largest |J - 1| of an incompressible block."""
    E, end = 3.0, 2.0  # Pa, s
    kind = mesh.CellType.triangle if functions == "linear" else mesh.CellType.quadrilateral
    corners, partitioner = [(0, 0), (3, 1.25)], basis.shared_vertex_partitioner
    domain = mesh.create_rectangle(
        MPI.COMM_WORLD, corners, [3 * n, 5 * n // 4], kind, partitioner=partitioner
    )
    body = points.fill(domain, per_side, inside=lambda x: (x[0] < 2) & (x[1] < 1))
    fm.set_initial_state(body, 1e-3)
    edge = points.on_curve(domain, (2, 0), (2, 1), spacing=0.25 / n)
    edge.add_field("u", (2,))
    for p in (body, edge):
        see(p, functions, 0.5 / n / per_side)
    z, law, pull = fm.Unknown(domain, "u", "p"), NeoHookean(E, 0.5), fem.Constant(domain, 0.0)
    for axis in (0, 1):
        z.fix("u", lambda x, a=axis: np.isclose(x[a], 0), component=axis)
    scheme, stiffness = method(z, dt=end / steps), 30 * E * n
    cells, name = ActiveCells(body, loads=[edge]), "asgs" if functions == "linear" else "cip"
    R = fm.stabilized(name, z, body, law, force=scheme.force(body), cells=cells)
    R += stiffness * (edge.field("u")[0] + z.u[0] - pull) * z.test.u[0] * edge.dx

    def data(start, end_of_step):
        pull.value = 0.4 * end_of_step / end

    sim = ImplicitMPM(
        R, z, scheme, body, carried=[edge], data=data,
        observers=[lambda sim, step: correct_weights(body, cells)] if corrected else [],
        newton={"tying": Tying(z.space, body, cells)},
    )  # fmt: skip
    for _ in sim.run(end):
        pass
    total = domain.comm.allreduce
    force = total(float(stiffness * np.sum((0.4 - edge["u"][:, 0]) * edge.weight)))
    mean = total(float(body["F"][:, 0, 0].sum())) / body.size_global
    # plane strain: mu (1.2^2 - 1.2^-2), over the thinner end
    change = float(np.abs(body["J"] - 1).max(initial=0.0))
    return force / (E / 3 * (1.2**2 - 1.2**-2) / 1.2), mean, change


@app.command()
def block(steps: list[int] = [20, 40, 80], n: int = 16):
    """Force at an incompressible block of N cells, stretched to 1.2 times its length in STEPS."""
    table = io.Table({"functions".ljust(25): "s", "steps": "d", "force off": "+.1%",
                      "stretch": ".4f"})  # fmt: skip
    kinds = [("linear", False), ("linear", True), ("quadratic", False), ("quadratic", True)]
    for (functions, corrected), number in product(kinds, steps):
        force, stretch, _ = stretched(functions, corrected, number, n)
        title = f"{functions}, corrected weights" if corrected else functions
        table.row(title.ljust(25), number, force - 1, stretch)


if __name__ == "__main__":
    app()
