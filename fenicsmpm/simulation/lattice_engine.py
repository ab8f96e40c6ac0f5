# SPDX-License-Identifier: MIT
"""Explicit steps of bodies on a lattice in phases, which a time loop calls one after the other.

A block of steps consists of ``begin``; for each step ``sum_nodes``, forces, ``move_nodes``,
``gather``, ``average`` and ``finish``; and finally ``settle``. Meanwhile the points stay as they
were. Each rank has the tiles of the lattice (`fenicsmpm.transfer.tiles`) that its points may reach,
with the sums of all ranks in all of them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
import numpy.typing as npt
from dolfinx import fem

from fenicsmpm.basis.lattice import lattice_of
from fenicsmpm.formulations.fbar import FBar
from fenicsmpm.materials import Law
from fenicsmpm.points import MaterialPoints
from fenicsmpm.rigid import RigidBody
from fenicsmpm.simulation.lattice_carried import Carried
from fenicsmpm.simulation.lattice_parts import Part
from fenicsmpm.simulation.lattice_supports import Supports
from fenicsmpm.simulation.unstable import force_without_material
from fenicsmpm.transfer import grid_rows as grid
from fenicsmpm.transfer.light_nodes import LIGHT, LIGHT_FOR_LOADS
from fenicsmpm.transfer.sharing import DofLink, NodeNumbers, Sharing, Sums
from fenicsmpm.transfer.tiles import Nodes, lay, nodes_of

Array = npt.NDArray[np.float64]

# First column of each nodal field, and whether it is a vector
COLUMNS = {
    "mass": (grid.MASS, False),
    "momentum": (grid.MOMENTUM, True),
    "force": (grid.FORCE, True),
    "velocity": (grid.VELOCITY, True),
    "increment": (grid.INCREMENT, True),
}


class LatticeEngine:
    """Bodies and loads on a lattice, and the phases of their steps.

    Args:
        V: Space of velocities, linear, with d components.
        bodies: Bodies with their laws.
        fbars: Averages of J of each body, or None.
        carried: Points that move along, and may carry forces.
        kind: Kind of the grid functions.

    Attributes:
        parts: The bodies.
        carried: Points that move along.
        nodes: Nodes of the lattice.
        rows: Sums of all bodies on all ranks, ``(n_tiles, nodes of a tile, 8)``, see
            `fenicsmpm.transfer.grid_rows`.
    """

    def __init__(
        self,
        V: fem.FunctionSpace,
        bodies: Mapping[MaterialPoints, Law],
        fbars: Sequence[FBar | None],
        carried: Sequence[MaterialPoints],
        kind: int,
    ) -> None:
        """Check the fields of points. Collective."""
        self._V, self._kind, self._comm = V, kind, V.mesh.comm
        self._dim = V.mesh.geometry.dim
        self.nodes: Nodes = nodes_of(lattice_of(V.mesh))
        self.parts = [
            Part(body, law, kind, fbar, self.nodes)
            for (body, law), fbar in zip(bodies.items(), fbars, strict=True)
        ]
        self.carried = [Carried(points, kind) for points in carried]
        self._sums: Sums | None = None
        self._sum_forces: Sums | None = None
        self._all_dofs: DofLink | None = None
        self._numbers = NodeNumbers(V)
        # for functions by id, the nodes whose values are not zero since they were last written
        self._written: dict[int, npt.NDArray[np.int32]] = {}
        self._strays = False

    # --- a block of steps --------------------------------------------------------------------

    def begin(
        self,
        laws: Mapping[MaterialPoints, Law],
        bcs: Sequence[fem.DirichletBC],
        slips: Sequence[str],
    ) -> None:
        """Make working copies of the points, and add them to the nodes. Collective.

        Args:
            laws: Laws of the bodies, of the same kinds as before, possibly with other parameters.
            bcs: Dirichlet conditions on velocities.
            slips: Names of the bodies' fields of slip on rigid bodies.
        """
        self._supports = Supports(self._V, bcs, self._numbers)
        for load in self.carried:
            load.begin()
        for part in self.parts:
            part.drop()
        self._sort()
        for part in self.parts:
            part.begin(laws[part.points], slips)
        self._lay()

    def _sort(self) -> None:
        self._reaches = [part.sort() for part in self.parts]
        self._reaches += [load.find(self.nodes) for load in self.carried]

    def _lay(self) -> None:
        """Build the tiles that the points can reach, and add the points to the nodes."""
        nodes = self.nodes
        first, last = (np.concatenate(ends) for ends in zip(*self._reaches, strict=True))
        layout = lay(first, last, nodes)
        sharing = Sharing(self._comm, layout)
        self._layout, self._sharing = layout, sharing
        several = len(self.parts) > 1
        layouts = [part.settle_down(layout, sharing, several) for part in self.parts]
        self._places = [np.searchsorted(layout.ids, own.ids) for own in layouts]
        self._free()
        self._sums = Sums(sharing, grid.COLUMNS)
        self.rows = (
            grid.tile_rows(len(layout.ids), nodes.per_tile) if several else self.parts[0].rows
        )
        self._bounds = np.zeros((len(layout.ids), 2))
        self._forces = np.zeros((len(layout.ids) if self.carried else 0, nodes.per_tile, 3))
        if self.carried:
            self._sum_forces = Sums(sharing, 3)
        self._all_dofs = None
        self._supports.find(sharing, nodes)
        for part in self.parts:
            part.scatter()
        self._strays = False

    def _free(self) -> None:
        for sums in (self._sums, self._sum_forces):
            if sums is not None:
                sums.free()
        self._sums = self._sum_forces = None

    def defer(self) -> None:
        """Defer the changed fields of the points until somebody reads them."""
        for part in self.parts:
            part.defer()

    @property
    def is_looked_at(self) -> bool:
        """Return whether somebody read deferred fields, or changed points, on this rank."""
        changed = any(load.is_changed for load in self.carried)
        return changed or any(part.is_looked_at for part in self.parts)

    def drop(self) -> None:
        """Discard a block of steps; the points stay as they are."""
        self._free()
        self.rows = self._forces = np.empty((0, 0, 0))
        for part in self.parts:
            part.free()
            part.drop()

    def settle(self, sort: bool) -> None:
        """Write the changes to the points, and bring their cells up to date. Collective.

        Args:
            sort: Whether to store points with the same nodes next to each other.
        """
        self._free()
        self.rows = self._forces = np.empty((0, 0, 0))
        for part in self.parts:
            part.settle(sort)
        for load in self.carried:
            load.settle()

    # --- phases of a step ----------------------------------------------------------------------

    def read_supports(self) -> None:
        """Read the current values of Dirichlet conditions. Collective."""
        self._supports.read()

    def support_forces(self) -> Callable[[], tuple[npt.NDArray[np.int32], Array]]:
        """Return a collective function for the forces of Dirichlet conditions in this step."""
        return self._supports.forces_at_dofs()

    def push(
        self, slip: str, rigid: RigidBody, dt: float, longest: float, total: Array
    ) -> list[str]:
        """Add contact forces of a rigid body to the nodes, and to totals, on this rank.

        Args:
            slip: Name of the field of slip on it.
            rigid: The body.
            dt: Time step in s.
            longest: Longest allowed time step in s.
            total: Totals ``(8,)``, see `fenicsmpm.transfer.contact`.

        Returns:
            Error messages of this rank.
        """
        contact = rigid.contact(longest)
        bad = [part.push(slip, contact, dt, total) for part in self.parts]
        return [f"a point is inside of the rigid body {rigid.name}"] if max(bad) >= 0 else []

    def sum_nodes(self, gravity: Mapping[MaterialPoints, fem.Constant]) -> None:
        """Sum mass, momentum, internal force and weight of all bodies on all ranks. Collective.

        Args:
            gravity: Force per mass on bodies in m/s^2; bodies that are missing have none.
        """
        if len(self.parts) > 1:
            grid.clear(self.rows)
        for part, place in zip(self.parts, self._places, strict=True):
            if part.points in gravity:
                g = np.zeros(3)
                g[: self._dim] = gravity[part.points].value
                grid.add_weight(part.rows, g)
            if len(self.parts) > 1:
                grid.add_body(part.rows, place, self.rows)
        assert self._sums is not None
        self._sums.add(self.rows)
        grid.masses(self.rows, self._bounds)

    def relieve_light_nodes(self) -> None:
        """Move the points' own forces from nodes with nearly no mass to those around them."""
        self._relieve(self.rows, grid.FORCE, of_loads=False)

    def _relieve(self, forces: Array, column: int, of_loads: bool) -> None:
        grid.relieve(
            self.rows, self._bounds, forces, column, of_loads, self._layout.neighbours,
            self._layout.ids, self.nodes, LIGHT_FOR_LOADS if of_loads else LIGHT,
        )  # fmt: skip

    def add_loads(
        self, loads: Mapping[MaterialPoints, Array], at_nodes: Array | None = None
    ) -> list[str]:
        """Add forces at carried points, and forces given at dolfinx' nodes. Collective.

        Args:
            loads: Forces in N at points that carry some, ``(n, d)``.
            at_nodes: Forces in N of the nodes of V that this rank owns, in their order, ``(n, d)``.

        Returns:
            Error messages of this rank.
        """
        if self._sum_forces is None and at_nodes is None:
            return []
        if self._sum_forces is None:
            self._forces = np.zeros((len(self.rows), self.nodes.per_tile, 3))
        self._forces[:] = 0.0
        messages = []
        for carried in self.carried:
            if carried.points in loads:
                bad = carried.add_forces(
                    loads[carried.points], self.rows, self._forces, self.nodes, self._layout.ids
                )
                if bad >= 0:
                    messages.append(carried.describe(bad, "is away from all bodies"))
        if self._sum_forces is not None:
            self._sum_forces.add(self._forces)
        if at_nodes is not None:
            link = self._dof_link()
            flat = self._forces.reshape(-1, 3)
            flat[link.places, : self._dim] += link.spread(at_nodes[self._dofs])
        self._relieve(self._forces, 0, of_loads=True)
        if at_nodes is not None:
            messages += self._without_material(at_nodes)
        self.rows[:, :, grid.FORCE :] += self._forces
        return messages

    def _without_material(self, at_nodes: Array) -> list[str]:
        """Return messages on forces ``(n, d)`` at nodes without mass, owned ones or in tiles."""
        outside = (at_nodes != 0).any(axis=1)
        outside[self._dofs[self._dof_link().asked]] = False
        idle = (self.rows[:, :, grid.MASS] == 0) & (self._forces != 0).any(axis=2)
        if not outside.any() and not idle.any():
            return []
        if outside.any():
            where = self._numbers.positions(np.flatnonzero(outside)[:1])[0]
        else:
            tile, node = np.argwhere(idle)[0]
            index = self.nodes.in_tiles(self._layout.ids[tile : tile + 1])[0, node]
            where = self.nodes.origin + index / self.nodes.per_metre
        return [force_without_material(where[: self._dim])]

    def add_forces(self, forces: Array) -> None:
        """Add forces of points of bodies that are given at dolfinx' nodes. Collective.

        Args:
            forces: Forces in N of the nodes of V that this rank owns, in their order, ``(n, d)``.
        """
        link = self._dof_link()
        nodal = np.zeros((len(self.rows), self.nodes.per_tile, 3))
        nodal.reshape(-1, 3)[link.places, : self._dim] += link.spread(forces[self._dofs])
        self._relieve(nodal, 0, of_loads=False)
        self.rows[:, :, grid.FORCE :] += nodal

    def move_nodes(self, dt: float, damping: float) -> Array:
        """Compute velocities of the nodes from mass, momentum and forces.

        Returns:
            The part of the reactions ``(3,)`` in N that this rank counts.
        """
        rows, fixed = self.rows, self._supports.now
        forces = grid.reactions(rows, dt, *fixed, self._sharing.counted)
        self._supports.forces = forces
        grid.update_nodes(rows, self._bounds, dt, damping)
        grid.constrain(rows, *fixed)
        return np.bincount(fixed[1], forces, minlength=3).astype(np.float64)

    def move_loads(self, dt: float) -> list[str]:
        """Move loads with the nodes.

        Returns:
            Error messages of this rank.
        """
        bad = []
        for load in self.carried:
            point, strays = load.follow(self.rows, self.nodes, self._layout.ids, dt)
            bad.append(point)
            self._strays |= strays
        return _describe(self.carried, bad, "leaves the lattice")

    def gather(self, dt: float, flip: float) -> list[str]:
        """Update velocities, positions and F of the points from the nodes, and add J to these.

        Returns:
            Error messages of this rank.
        """
        messages = []
        for part in self.parts:
            bad, strays = part.gather(self.rows, dt, flip)
            self._strays |= strays
            if bad >= 0:
                messages.append(part.describe(bad))
        return messages

    def hold_back(
        self, slip: str, rigid: RigidBody, dt: float, longest: float, total: Array
    ) -> list[str]:
        """Keep points out of a rigid body in its new position, on this rank, see ``push``.

        Returns:
            Error messages of this rank.
        """
        messages, contact = [], rigid.contact(longest)
        for part in self.parts:
            bad, strays = part.hold_back(slip, contact, dt, total)
            self._strays |= strays
            if bad >= 0:
                messages.append(part.describe(bad))
        return messages

    def deform(self, dt: float) -> list[str]:
        """Update F from velocities mapped back to the nodes, for linear functions. Collective.

        Returns:
            Error messages of this rank.
        """
        if not self.parts[0].maps_back:
            return []
        several = len(self.parts) > 1
        rows = grid.tile_rows(len(self.rows), self.nodes.per_tile) if several else self.rows
        for part, place in zip(self.parts, self._places, strict=True):
            back = part.map_back()
            if several:
                grid.add_body(back, place, rows)
            else:
                rows = back
        assert self._sums is not None
        self._sums.add(rows)
        grid.to_velocities(rows)
        grid.constrain(rows, *self._supports.now)
        bad = [(part, part.deform(rows, dt)) for part in self.parts]
        return [part.describe(block) for part, block in bad if block >= 0]

    @property
    def strays(self) -> bool:
        """Return whether a point of this rank has left its tiles: ``finish`` must rebuild them."""
        return self._strays

    def average(self) -> None:
        """Average J at the nodes. Collective."""
        for part in self.parts:
            part.average()

    def finish(self, again: bool, keep: bool, anew: bool) -> None:
        """Compute stresses and new positions, and add the points to the nodes for another step.

        Args:
            again: Whether another step may follow in this block.
            keep: Whether somebody may read the stresses of this step.
            anew: Whether to build tiles anew, because there are ``strays`` on any rank; this is
                collective.
        """
        for part in self.parts:
            part.finish(again and not anew, keep or (again and anew))
        if again and anew:
            self._sort()
            self._lay()

    # --- nodal fields ------------------------------------------------------------------------

    def write(self, name: str, function: fem.Function) -> None:
        """Write a nodal field to a function on V or on its scalar companion. Collective.

        Args:
            name: "mass" in kg, "momentum" in kg m/s and "force" in N between ``sum_nodes`` and
                ``move_nodes``; "mass", "velocity" in m/s and "increment" (of the velocity) from
                there to ``average``.
            function: Result, ghosts included; zero where there are no tiles.
        """
        self._write(self._column(name), function)

    def keep(self, name: str) -> Callable[[fem.Function], None]:
        """Return a function that writes the current nodal field later; both are collective."""
        link, dofs, values = self._dof_link(), self._dofs, self._column(name).copy()

        def write(function: fem.Function) -> None:
            link.collect(values, dofs, function.x.array.reshape(-1, values.shape[1]))
            function.x.scatter_forward()

        return write

    def _column(self, name: str) -> Array:
        column, is_vector = COLUMNS[name]
        n = self._dim if is_vector else 1
        return self.rows.reshape(-1, 8)[:, column : column + n]

    def write_average(self, body: int, function: fem.Function) -> None:
        """Write the averaged J of a body to a function, between ``average`` and ``finish``."""
        part = self.parts[body]
        values = np.zeros((self.rows.shape[0], self.nodes.per_tile, 1))
        values[self._places[body]] = part.averages
        self._write(values.reshape(-1, 1), function)

    def _write(self, values: Array, function: fem.Function) -> None:
        link = self._dof_link()
        nodal = function.x.array.reshape(-1, values.shape[1])
        written = self._written.get(id(function))
        if written is not self._dofs:
            if written is not None or nodal.any():  # writing zeros would need memory
                nodal[slice(None) if written is None else written] = 0.0
            self._written[id(function)] = self._dofs
        link.collect(values, self._dofs, nodal)
        function.x.scatter_forward()

    def _dof_link(self) -> DofLink:
        """Return the link from the owned nodes ``_dofs`` in tiles of any rank to these tiles."""
        if self._all_dofs is None:
            tiles = np.unique(np.concatenate(self._comm.allgather(self._layout.ids)))
            self._dofs, positions = self._numbers.owned_in(tiles, self.nodes)
            self._all_dofs = DofLink(self._sharing, self.nodes, positions)
        return self._all_dofs


def _describe(loads: list[Carried], bad: list[int], what: str) -> list[str]:
    return [load.describe(p, what) for load, p in zip(loads, bad, strict=True) if p >= 0]
