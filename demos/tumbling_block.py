# SPDX-License-Identifier: MIT
#
# # Tumbling block, incompressible
#
# A rubber block is thrown: it flies, turns and wobbles, and nothing acts on it. Its volume must
# stay what it is, and so must energy and momenta. The demo shows
#
# - the mixed formulation of displacement and pressure with an energy-momentum stress,
# - what Newmark's method and generalized-alpha do to energy and angular momentum, both with ASGS
#   and the constraint J = 1,
# - the price: nothing damps the noise of points that cross cells.
#
# ## Formulation
#
# The pressure p of a step is the force that keeps the volume of the step, weakly,
#
# $$
# S = S_{iso} + p \, Z, \quad Z : \tfrac12 \Delta C = \Delta J, \qquad
#   (\Delta J, q) - \tfrac{\alpha}{\mu} (\Delta r, q - q_K) = 0 ,
# $$
#
# and $r_n$ at the points, the part of the pressure that varies within cells, stabilizes elements of
# equal order. All of it has an energy, so the sum stays constant.
#
# ## Implementation

import argparse
from pathlib import Path

from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import fem, mesh
from matplotlib.figure import Figure

from fenicsmpm import ImplicitMPM, formulations, io, points
from fenicsmpm.cells import ActiveCells, Tying
from fenicsmpm.diagnostics import angular_momentum, kinetic_energy, strain_energy
from fenicsmpm.materials import NeoHookean
from fenicsmpm.solvers import NewtonError

BOX = ((0.0, 0.0), (11.0, 4.0))  # of the background mesh, m
SIZE, START = (2.0, 1.0), (3.0, 2.0)  # of the block, and where it starts from, m
DENSITY = 2.0  # kg/m^2
LAW = NeoHookean(E=100.0, nu=0.5)  # Pa
H, SPACING = 0.25, 0.0625  # of cells and points, m
DT, END = 0.02, 12.0  # s

METHODS = ("energy-momentum", "newmark", "generalized-alpha")


def thrown(x):
    """Velocity at the start [m/s]: flight, turning, and bending."""
    right, up = (x - START).T
    return np.column_stack([0.3 - up + up**2, right])


class Block:
    """The block in flight, with its energies."""

    def __init__(self, method):
        cells = np.rint(np.array(BOX[1]) / H).astype(int)
        domain = mesh.create_rectangle(MPI.COMM_WORLD, BOX, cells, mesh.CellType.triangle)
        half = np.array(SIZE) / 2
        self.body = body = points.lattice(
            domain, SPACING, inside=lambda x: np.all(np.abs(x - START) < half, axis=1)
        )
        formulations.set_initial_state(body, DENSITY, velocity=thrown)

        space = formulations.mixed_space(domain)
        U, V = fem.Function(space), ufl.TestFunction(space)
        self.stress = None
        if method == "energy-momentum":
            scheme = formulations.Midpoint(U, dt=DT)
            self.stress = formulations.MixedEnergyMomentum(LAW, body, U)
            R = self.stress.power(V) + scheme.inertia(V, body)
            updates, newton = {body: self.stress.updates}, {"rtol": 1e-11, "atol": 1e-12}
            newton["tying"] = Tying(space, body, ActiveCells(body))
        else:
            if method == "newmark":
                scheme = formulations.Newmark(U, dt=DT)
            else:
                scheme = formulations.GeneralizedAlpha(U, dt=DT, rho_inf=0.8)
            R = formulations.stabilized("asgs", U, V, body, LAW, force=scheme.force(body))
            updates, newton = {}, {}
        self.sim = ImplicitMPM(R, U, scheme, body, updates=updates, newton=newton)

    def row(self):
        """Time; kinetic, strain and stabilization energy; angular momentum, volume, range of J."""
        body = self.body
        J = np.linalg.det(body["F"])
        comm = body.mesh.comm
        return (
            self.sim.time,
            kinetic_energy(body),
            strain_energy(body, LAW),
            0.0 if self.stress is None else self.stress.volumetric_energy(),
            angular_momentum(body),
            body.volume,
            comm.allreduce(J.min(initial=np.inf), MPI.MIN),
            comm.allreduce(J.max(initial=-np.inf), MPI.MAX),
        )


def run(method, until):
    """Histories as in ``Block.row``, and the points at the end."""
    block = Block(method)
    rows = [block.row()]
    try:
        for _ in io.watch(block.sim.run(until), until, method):
            rows.append(block.row())
    except NewtonError as error:
        io.say(f"  {method} ends at t = {block.sim.time:.4g} s: {error}")
    cloud = io.gather_points(block.body)
    return np.array(rows), cloud


# ## Results


def plot(path, histories):
    if MPI.COMM_WORLD.rank != 0:
        return
    figure = Figure(figsize=(7, 6), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True)
    for name, rows in histories.items():
        total = rows[:, 1:4].sum(axis=1)
        above.plot(rows[:, 0], 100 * (total / total[0] - 1), label=name)
        below.plot(rows[:, 0], rows[:, 6:], color=f"C{list(histories).index(name)}")
    above.set_ylabel("change of the energy [%]")
    below.set_ylabel("least and largest J [-]")
    below.set_xlabel("t [s]")
    for ax in (above, below):
        ax.grid(alpha=0.3)
    figure.legend(*above.get_legend_handles_labels(), loc="outside upper center", ncols=3)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=160)


def show(until, output):
    histories, panels = {}, []
    for method in METHODS:
        rows, cloud = run(method, until)
        histories[method] = rows
        panels.append(io.Panel(cloud, "p", f"{method}, t = {rows[-1, 0]:.4g} s"))
    columns = {"largest changes by": "s", "until [s]": ".4g", "energy": ".1e"}
    columns |= {"angular momentum": ".1e", "volume": ".1e", "least J": ".3f", "largest J": ".3f"}
    table = io.Table(columns | {"strain energy at the end [J]": ".4f"})
    for method, rows in histories.items():
        kept = (rows[:, 1:4].sum(axis=1), rows[:, 4], rows[:, 5])
        changes = [np.abs(values / values[0] - 1).max() for values in kept]
        table.row(method, rows[-1, 0], *changes, rows[:, 6].min(), rows[:, 7].max(), rows[-1, 2])
    plot(output / "tumbling_block_energy.png", histories)
    limits = io.colour_range(panels, cut=1)
    io.picture(output / "tumbling_block.png", panels, "mean stress p [Pa]", limits=limits)
    io.say(f"tumbling_block.png and tumbling_block_energy.png are in {output}")
    return histories


# ## Command line


def main(arguments=None):
    parser = argparse.ArgumentParser(description="Incompressible block in free flight")
    add = parser.add_argument
    add("--until", type=float, default=END, help="end in s (default: %(default)s)")
    add("--short", action="store_true", help="a few steps, for a test")
    add("--output", type=Path, default=Path("output"), metavar="DIR", help="(default: %(default)s)")
    if parser.parse_args(arguments).short:
        parser.set_defaults(until=0.1)
    options = parser.parse_args(arguments)
    if not options.until > 0:
        parser.error("--until must be positive")
    return show(options.until, options.output)


if __name__ == "__main__":
    main()
