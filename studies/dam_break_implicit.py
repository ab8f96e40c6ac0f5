# SPDX-License-Identifier: MIT
"""The implicit dam break on several meshes and with other time schemes.

The script prints the change of volume in two measures: the sum of det f - 1 over points and steps,
and the share of the water in excess of the volume around its nodes. It also prints how far front,
foremost point and residual height are from the experiment of Martin and Moyce.
"""

from mpi4py import MPI

import numpy as np
import typer
import ufl
from dolfinx import fem, la, mesh

from fenicsmpm import ImplicitMPM, basis, formulations, io, points
from fenicsmpm.cells import ActiveCells
from fenicsmpm.solvers import NewtonError
from fenicsmpm.transfer import p2g

BOX, DENSITY, G = (6.0, 2.4), 1000.0, 9.81  # m, kg/m^3, m/s^2
SCHEMES = "BDF2", "Newmark", "Bossak", "GeneralizedAlpha"
# Martin and Moyce (1952), a column of height 2 a and width a: z/a (table 2) at t sqrt(2 g / a), and
# height over its initial value (table 6) at t sqrt(g / a); fronts of Koshizuka and Oka (1996)
FRONT = np.array([
    [0.41, 0.84, 1.19, 1.43, 1.63, 1.83, 1.98, 2.20, 2.32, 2.51, 2.65, 2.83, 2.98, 3.11, 3.33],
    [1.11, 1.22, 1.44, 1.67, 1.89, 2.11, 2.33, 2.56, 2.78, 3.00, 3.22, 3.44, 3.67, 3.89, 4.11],
])  # fmt: skip
RESIDUAL = np.array([
    [0.56, 0.77, 0.93, 1.08, 1.28, 1.46, 1.66, 1.84, 2.00, 2.21, 2.45, 2.70],
    [0.94, 0.89, 0.83, 0.78, 0.72, 0.67, 0.61, 0.56, 0.50, 0.44, 0.39, 0.33],
])  # fmt: skip
OTHERS = np.array([
    [0.0, 0.38, 0.77, 1.15, 1.54, 1.94, 2.32, 2.72, 3.10],
    [1.0, 1.11, 1.25, 1.51, 1.89, 2.24, 2.62, 3.00, 3.62],
])  # fmt: skip


def build(
    h, dt, scheme="BDF2", stabilization="asgs", functions="linear", slip=False, consistent=False
):  # fmt: skip
    cells, crossed = [round(side / h) for side in BOX], mesh.DiagonalType.crossed
    is_smooth, inside = functions != "linear", lambda x: (x[0] < 1) & (x[1] < 2)
    kind = mesh.CellType.quadrilateral if is_smooth else mesh.CellType.triangle
    domain = mesh.create_rectangle(
        MPI.COMM_WORLD, [(0, 0), BOX], cells, kind, diagonal=crossed,
        partitioner=basis.shared_vertex_partitioner,
    )  # fmt: skip
    if is_smooth:  # about as many points per square as in four triangles
        water = points.fill(domain, 5, inside=inside)
        basis.use(water, functions, h / 10 if functions == "gimp" else None)
    else:
        water = points.quadrature(domain, degree=4, inside=inside)
    formulations.set_initial_state(water, DENSITY)
    z = formulations.Unknown(domain, "u", "p")
    z.fix("u", lambda x: np.isclose(x[0], 0) | np.isclose(x[0], BOX[0]), component=0)
    z.fix("u", lambda x: np.isclose(x[1], 0), component=1 if slip else None)
    scheme = getattr(formulations, scheme)(z, dt=dt)
    law, g = formulations.NewtonianFlow(1e-3, DENSITY, scheme), fem.Constant(domain, (0.0, -G))
    R = formulations.mixed(z, water, law, force=formulations.density(water) * g)
    R += scheme.inertia(water) if consistent else scheme.lumped(water)
    if is_smooth:
        R += formulations.interior_penalty(z, ActiveCells(water), law)
    else:
        subscales = getattr(formulations, stabilization)
        R += subscales(z, water, law, force=scheme.force(water, g))
    nodes, total = fem.functionspace(domain, ("Lagrange", 1)), domain.comm.allreduce
    around = fem.assemble_vector(fem.form(ufl.TestFunction(nodes) * ufl.dx))
    around.scatter_reverse(la.InsertMode.add)
    around = around.array[: nodes.dofmap.index_map.size_local]

    def ahead(share):
        gathered = (np.concatenate(domain.comm.allgather(a)) for a in (water.x[:, 0], water["V_0"]))
        x, volume = gathered
        order = np.argsort(-x)
        sums = np.cumsum(volume[order])
        return x[order[np.searchsorted(sums, share * sums[-1])]]

    def crowded(sim):
        taken = p2g(water, water["V_0"], nodes).array[: len(around)]
        return total(np.maximum(taken - around, 0).sum()) / water.volume()

    history = io.History({
        "front": lambda sim: ahead(1e-3),
        "foremost": lambda sim: ahead(0.0),
        "height": lambda sim: total(water.x[water.x[:, 0] < h, 1].max(initial=0), MPI.MAX) / 2,
        "volume": lambda sim: total(water["V_0"] @ water["dilation"]) / water.volume(),
        "crowded": crowded,
    })  # fmt: skip
    return ImplicitMPM(R, z, scheme, water, observers=[history]), history


def deviations(history):
    """Return the largest deviations of front, foremost point and height, up to a front of 3.5 a."""
    t, front = history["t [s]"] * np.sqrt(G), FRONT[:, FRONT[1] <= 3.5]
    found = {"front": (front, 2**0.5), "foremost": (front, 2**0.5), "height": (RESIDUAL, 1.0)}
    for title, ((times, known), c) in found.items():
        off = np.interp(times, c * t, history[title]) - known
        share = np.abs(off if title == "height" else off / known)
        found[title] = share[times <= c * t[-1]].max(initial=0.0)
    return found


def main(
    h: list[float] = [0.2, 0.1],
    dt: float = 1e-3,
    until: float = 0.9,
    scheme: str = "BDF2",
    stabilization: str = "asgs",
    functions: str = "linear",
    slip: bool = False,
    consistent: bool = False,
):
    """Run the dam break on cells of size H in m.

    Schemes are those of formulations. Stabilizations are asgs or osgs; functions other than linear
    have the interior penalty. The floor may let the water SLIP, and the mass be CONSISTENT.
    """
    if scheme not in SCHEMES or stabilization not in ("asgs", "osgs"):
        raise typer.BadParameter(f"schemes: {', '.join(SCHEMES)}; stabilizations: asgs, osgs")
    if any(not np.isclose(0.2 / size % 1, [0, 1]).any() for size in h):
        raise typer.BadParameter("the cell size must be 0.2 m, or 0.2 m divided by an integer")
    how = stabilization if functions == "linear" else functions
    rows, fronts, name = [], {}, f"output/dam_break_implicit_{scheme}_{how}"
    for size in h:
        halved = 0
        sim, history = build(size, dt, scheme, stabilization, functions, slip, consistent)
        try:
            for step in io.watch(sim.run(until), until, f"h = {size:g} m"):
                halved += step.attempts > 1
        except NewtonError as error:
            io.say(f"h = {size:g} m ends at t = {sim.time:.4g} s: {error}")
        volumes = (np.abs(history[title]).max() for title in ("volume", "crowded"))
        rows.append((f"{size:g}", sim.time, *volumes, *deviations(history).values(), halved))
        fronts[f"h = {size:g} m"] = np.sqrt(2 * G) * history["t [s]"], history["front"]
        io.picture(f"{name}_{size:g}m.png", sim.bodies, "p", "mean stress [Pa]", cut=2)
    columns = {"h [m]": "s", "until [s]": ".3g", "det f - 1": ".1e", "crowded": ".1%"}
    table = io.Table(columns | {"front": ".1%", "foremost": ".1%", "height": ".1%", "halved": "d"})
    for row in rows:
        table.row(*row)
    known = {"Martin and Moyce": tuple(FRONT), "Koshizuka and Oka": tuple(OTHERS)}
    io.plot(f"{name}.png", fronts, "t sqrt(2 g / a)", "front z / a", reference=known)


if __name__ == "__main__":
    typer.run(main)
