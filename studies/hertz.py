# SPDX-License-Identifier: MIT
"""Hertz contact of two elastic discs: width of the contact and peak pressure.

Two cylinders of radius R in plane strain touch along a line under a load P per length. The pressure
is a semi-ellipse with half width ``b = sqrt(4 P R (1 - nu^2) / (pi E))`` and peak ``p_0 = 2 P /
(pi b)`` (K. L. Johnson, Contact Mechanics, 1985, section 4.2 and appendix 3). The discs are halves,
whose flat sides approach each other by a given fraction of R; 0.03 makes b about 0.1 R.

Both loops give nodal forces, which are integrals of the pressure with quadratic B-splines. The half
width is that of the semi-ellipse with the same second moment. The peak is the force of the middle
node, divided by the force that Hertz's pressure of the same load gives this node. The theory has
small strains: with b = 0.2 R the exact width is some percent less.

``python studies/hertz.py --loops implicit --cells 40`` runs one loop on a finer grid.
"""

import time

from mpi4py import MPI

import numpy as np
import typer
from dolfinx import la, mesh

from fenicsmpm import ExplicitMPM, ImplicitMPM, MaterialPoints, basis, forms, io
from fenicsmpm import formulations as fm
from fenicsmpm.cells import ActiveCells, Tying
from fenicsmpm.materials import Hencky
from fenicsmpm.simulation import Contact, Observer

RADIUS, LAW, DENSITY = 1.0, Hencky(E=1000.0, nu=0.3), 1.0  # m, Pa, kg/m^3
COMM = MPI.COMM_WORLD


def hertz(P):
    """Return half width [m] and peak pressure [Pa]."""
    b = np.sqrt(4 * P * RADIUS * (1 - LAW.nu**2) / (np.pi * LAW.E))
    return b, 2 * P / (np.pi * b)


def ring(n, radius, up):
    """Return unit vectors to the middles of n parts of a half circle, above or below its centre."""
    t = np.pi * (np.arange(n) + 0.5) / n
    return np.column_stack([np.cos(t), up * np.sin(t)]), np.pi * radius / n


def half_disc(domain, height, up, spacing):
    """Return rings of points above or below (0, height), and points on the outer circle.

    A lattice would have steps at the surface, which make the pressure rough.
    """
    n = round(RADIUS / spacing)
    step, x, weight = RADIUS / n, [], []
    for k in range(n):
        radius = (k + 0.5) * step
        direction, length = ring(max(1, round(np.pi * (k + 0.5))), radius, up)
        x.append(radius * direction)
        weight.append(np.full(len(direction), length * step))
    normal, length = ring(round(2 * np.pi * RADIUS / spacing), RADIUS, up)
    sets = [(np.concatenate(x), np.concatenate(weight), {})]
    sets.append((RADIUS * normal, np.full(len(normal), length), {"normal": normal}))
    here, result = slice(None) if COMM.rank == 0 else slice(0), []
    for x, weight, fields in sets:
        fields = {name: values[here] for name, values in fields.items()}
        x = x[here] + [0, height]
        result.append(MaterialPoints(domain, x, weight[here], fields=fields))
        basis.use(result[-1], "quadratic")
    fm.set_initial_state(result[0], DENSITY)
    return result


def discs(cells, per_side):
    """Return the cell size, and two half discs that touch at the origin, with outer circles."""
    h, n = RADIUS / cells, cells + 2
    domain = mesh.create_rectangle(
        COMM,
        [(-n * h, -RADIUS), (n * h, RADIUS)],
        [2 * n, 2 * cells],
        mesh.CellType.quadrilateral,
        partitioner=basis.shared_vertex_partitioner,
    )
    return h, [half_disc(domain, -up * RADIUS, up, h / per_side) for up in (1, -1)]


def by_column(positions, forces):
    """Return positions of nodes along the contact [m], and their normal forces [N], by column."""
    pairs = zip(COMM.allgather(positions[:, 0]), COMM.allgather(forces[:, 1]), strict=True)
    x, f = (np.concatenate(a) for a in zip(*pairs, strict=True))
    columns, place = np.unique(np.round(x, 9), return_inverse=True)
    return columns, np.bincount(place, np.abs(f))


class NodalForces(Observer):
    """Nodal forces of a form at the displacement of an unknown, when a step is solved."""

    def __init__(self, z, form):
        self._z, self._form = z, forms.form(form)

    def solved(self, sim):
        b = forms.assemble_vector(self._form)
        b.scatter_reverse(la.InsertMode.add)
        space = self._z.part_space("u")
        n = space.dofmap.index_map.size_local
        f = b.array[self._z.dofs("u")[: 2 * n]].reshape(n, 2)
        self.columns = by_column(space.tabulate_dof_coordinates()[:n], f)


def implicit(cells, way, per_side=3, factor=5.0, steps=5):
    """Return columns of nodal forces after load steps, with a penalty at the lower disc."""
    h, ((lower, edge), (upper, surface)) = discs(cells, per_side)
    z = fm.coupled_unknowns(lower.mesh, ["u"], ["u"])
    z[0].fix("u", lambda x: x[1] < -RADIUS + 1e-9)
    # conditions hold nodes: the body must stay in the cells around these
    z[1].fix("u", lambda x: x[1] > RADIUS - way - h, lambda t: (0.0, -way * min(t, 1.0)))
    R = contact = fm.contact(z[0], edge, z[1], surface, LAW, factor=factor)
    for own, body in zip(z, (lower, upper), strict=True):
        P = fm.Response(LAW, body, fm.Kinematics(own.u, body).F).P
        R += fm.stress_power(P, own.test.u, body)
    active = [ActiveCells(lower, loads=[edge])]
    active += [ActiveCells(upper, loads=[surface], touching=[edge])]
    found = NodalForces(z[1], contact)
    sim = ImplicitMPM(
        R,
        z,
        [fm.QuasiStatic(own, dt=1 / steps) for own in z],
        [lower, upper],
        carried=[[edge], [surface]],
        observers=[found],
        newton={"tying": Tying.of_each(z, [lower, upper], active)},
    )
    # the last step has no motion, as forces refer to the positions at the beginning of a step
    for _ in io.watch(sim.run(1 + 1 / steps), 1 + 1 / steps, f"implicit, R / h = {cells}"):
        pass
    return h, *found.columns


def explicit(cells, way, per_side=3, damping=0.3, crossings=10):
    """Return columns of nodal forces after a slow approach and a rest, with damping."""
    h, ((lower, _), (upper, _)) = discs(cells, per_side)
    z = fm.Unknown(lower.mesh, "v")
    wave = np.sqrt((LAW.kappa + 4 / 3 * LAW.mu) / DENSITY)
    end = crossings * 2 * RADIUS / wave
    z.fix("v", lambda x: x[1] < -RADIUS + 1e-9)
    # a ramp whose velocity has no jumps
    speed = lambda t: -way / end * (1 - np.cos(2 * np.pi * min(t / end, 1.0)))  # noqa: E731
    z.fix("v", lambda x: x[1] > RADIUS - way - h, lambda t: (0.0, speed(t)))
    R, other = (fm.internal_force(z.test.v, body, LAW) for body in (lower, upper))
    contact = Contact(lower, upper)
    sim = ExplicitMPM(R + other, z, [lower, upper], contacts=[contact], damping=damping)
    for _ in io.watch(sim.run(2 * end, end / 10), 2 * end, f"explicit, R / h = {cells}"):
        pass
    f, n = sim.contact_forces(contact), z.space.dofmap.index_map.size_local
    return h, *by_column(z.space.tabulate_dof_coordinates()[:n], f.x.array.reshape(-1, 2)[:n])


def splines(t):
    """Return the quadratic B-spline at a distance in cells; its variance is 1/4."""
    t = np.abs(t)
    return np.where(t < 0.5, 0.75 - t**2, 0.5 * np.maximum(1.5 - t, 0.0) ** 2)


def compare(h, x, f):
    """Return load [N], b and p_0 by Hertz, and the deviations of width and peak from these."""
    b, peak = hertz(f.sum())
    width = 2 * np.sqrt((f * x**2).sum() / f.sum() - h**2 / 4)
    y = b * (np.arange(10000) + 0.5) / 10000
    middle = 2 * np.mean(splines(y / h) * peak * np.sqrt(1 - (y / b) ** 2)) * b
    return f.sum(), b, peak, width / b - 1, f[np.argmin(np.abs(x))] / middle - 1


LOOPS = {"implicit": implicit, "explicit": explicit}


def main(
    loops: list[str] = ["implicit", "explicit"],
    cells: list[int] = [20],
    ways: list[float] = [0.03],
):
    """Compare LOOPS, CELLS along the radius, and approaches WAYS in units of the radius."""
    if unknown := set(loops) - set(LOOPS):
        raise typer.BadParameter(f"loops are {', '.join(LOOPS)}, not {', '.join(unknown)}")
    formats = {"load [N/m]": ".3f", "b / R": ".4f", "p_0 [Pa]": ".2f"}
    formats |= {"width": "+.1%", "peak": "+.1%", "seconds": ".0f"}
    table = io.Table({"loop".ljust(8): "s", "R / h": "d"} | formats)
    curves = {}
    for name in loops:
        for n in cells:
            for way in ways:
                start = time.perf_counter()
                h, x, f = LOOPS[name](n, way * RADIUS)
                row = compare(h, x, f)
                table.row(name, n, row[0], row[1] / RADIUS, *row[2:], time.perf_counter() - start)
                near = np.abs(x) < 2.1 * row[1]
                label = f"{name}, R / h = {n}, b = {row[1]:.3f} R"
                curves[label] = x[near] / row[1], f[near] / h / row[2]
    s = np.linspace(-1, 1, 201)
    curves["Hertz"] = s, np.sqrt(1 - s**2)
    io.plot("output/hertz.png", curves, "x / b", "nodal force / (h p_0)")


if __name__ == "__main__":
    typer.run(main)
