# SPDX-License-Identifier: MIT
"""Explicit steps of bodies on a lattice in phases: what a time loop does one after the other.

A block of steps is ``begin``, for each step ``sum_nodes``, forces, ``move_nodes``, ``gather``,
``average`` and ``finish``, and at last ``settle``. In between, the points are as they were. Each
rank has the tiles of the lattice (`fenicsmpm.explicit.tiles`) that its points may reach, and the
right sums in all of them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
from dolfinx import fem

from fenicsmpm import _compat
from fenicsmpm.basis.lattice import lattice_of
from fenicsmpm.basis.lines import LINEAR
from fenicsmpm.explicit import grid
from fenicsmpm.explicit.contact import RigidBox
from fenicsmpm.explicit.fbar import FBar
from fenicsmpm.explicit.parts import Load, Part
from fenicsmpm.explicit.sharing import DofLink, Sharing, Sums
from fenicsmpm.explicit.tiles import Nodes, lay, nodes_of
from fenicsmpm.materials import Law
from fenicsmpm.points import MaterialPoints
from fenicsmpm.solvers.checks import check_bcs

Array = npt.NDArray[np.float64]

# Share of the largest mass around it below which a node is light (``grid.full_share``). Where
# functions have kinks, light nodes have forces like others; elsewhere both vanish together, and
# round-off only has to be kept from them
_LIGHT_LINEAR, _LIGHT_SMOOTH = 0.1, 1e-8

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
        V: space of velocities, linear, with d components.
        bodies: with their laws.
        fbars: averages of J of each body, or None.
        loads: points that carry forces.
        kind: of grid functions.

    Attributes:
        parts: the bodies.
        loads: what carries forces.
        nodes: of the lattice.
        rows: ``(n_tiles, nodes of a tile, 8)``, sums of all bodies on all ranks, see `grid`.
    """

    def __init__(
        self,
        V: fem.FunctionSpace,
        bodies: Mapping[MaterialPoints, Law],
        fbars: Sequence[FBar | None],
        loads: Sequence[MaterialPoints],
        kind: int,
    ) -> None:
        """Check the fields of points (collective)."""
        self._V, self._kind, self._comm = V, kind, V.mesh.comm
        self._dim = V.mesh.geometry.dim
        self.nodes: Nodes = nodes_of(lattice_of(V.mesh))
        self.parts = [
            Part(body, law, kind, fbar, self.nodes)
            for (body, law), fbar in zip(bodies.items(), fbars, strict=True)
        ]
        self.loads = [Load(points, kind) for points in loads]
        masses = [float(np.min(body["mass"], initial=np.inf)) for body in bodies]
        # far below any point's share in a node whose support it is in
        self._least_mass = 1e-16 * self._comm.allreduce(min(masses), MPI.MIN)
        self._light = _LIGHT_LINEAR if kind == LINEAR else _LIGHT_SMOOTH
        self._sums: Sums | None = None
        self._sum_forces: Sums | None = None
        self._all_dofs: DofLink | None = None
        self._strays = False

    # --- a block of steps --------------------------------------------------------------------

    def begin(self, laws: Mapping[MaterialPoints, Law], bcs: Sequence[fem.DirichletBC]) -> None:
        """Take working copies of the points, and add them to the nodes (collective).

        Args:
            laws: of the bodies, of the kinds that they had, with other parameters if wanted.
            bcs: Dirichlet conditions on velocities.
        """
        self._supports = Supports(self._V, bcs)
        for load in self.loads:
            load.begin()
        for part in self.parts:
            part.drop()
        self._sort()
        for part in self.parts:
            part.begin(laws[part.points])
        self._lay()

    def _sort(self) -> None:
        self._reaches = [part.sort() for part in self.parts]
        self._reaches += [load.find(self.nodes) for load in self.loads]

    def _lay(self) -> None:
        """Make the tiles that the points can reach, and add the points to the nodes."""
        nodes = self.nodes
        first, last = (np.concatenate(ends) for ends in zip(*self._reaches, strict=True))
        layout = lay(first, last, nodes)
        sharing = Sharing(self._comm, layout)
        self._layout, self._sharing = layout, sharing
        several = len(self.parts) > 1
        layouts = [part.settle_down(layout, sharing, several) for part in self.parts]
        self._places = [np.searchsorted(layout.ids, own.ids) for own in layouts]
        self._free()
        moved = [i for i in range(8) if i != grid.VOLUME]
        self._sums = Sums(sharing, nodes.per_tile, moved)
        self.rows = (
            grid.tile_rows(len(layout.ids), nodes.per_tile) if several else self.parts[0].rows
        )
        self._bounds = np.zeros((len(layout.ids), 2))
        self._forces = np.zeros((len(layout.ids) if self.loads else 0, nodes.per_tile, 3))
        if self.loads:
            self._sum_forces = Sums(sharing, nodes.per_tile, [0, 1, 2])
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

    def settle(self, sort: bool) -> None:
        """Give the points what has changed, and bring their cells up to date (collective).

        Args:
            sort: whether points with the same nodes are to stand one after the other.
        """
        self._free()
        self.rows = self._forces = np.empty((0, 0, 0))
        for part in self.parts:
            part.settle(sort)
        for load in self.loads:
            load.settle()

    # --- phases of a step ----------------------------------------------------------------------

    def read_supports(self) -> None:
        """Take the present values of Dirichlet conditions (collective)."""
        self._supports.read()

    def push(self, box: RigidBox, velocity: Array, dt: float) -> list[str]:
        """Contact forces of a rigid box to the nodes, and their sum to the box, on this rank.

        Returns:
            What is wrong, on this rank.
        """
        messages = []
        for part in self.parts:
            force, bad = part.push(box, velocity, dt)
            box.force += force
            if bad >= 0:
                messages.append(f"a point is inside of the box {box.lower} ... {box.upper}")
        return messages

    def sum_nodes(self) -> None:
        """Mass, momentum and internal force of all bodies on all ranks (collective)."""
        if len(self.parts) > 1:
            grid.clear(self.rows)
            for part, place in zip(self.parts, self._places, strict=True):
                grid.add_body(part.rows, place, self.rows)
        assert self._sums is not None
        self._sums.add(self.rows)

    def add_loads(self) -> list[str]:
        """Add the forces of loads to nodes that have mass (collective).

        Returns:
            What is wrong, on this rank.
        """
        if self._sum_forces is None:
            return []
        self._forces[:] = 0.0
        bad = [
            load.add_forces(self.rows, self._forces, self.nodes, self._layout.ids, self._least_mass)
            for load in self.loads
        ]
        self._sum_forces.add(self._forces)
        self.rows[:, :, grid.FORCE :] += self._forces
        return _describe(self.loads, bad, "is away from all bodies")

    def add_forces(self, forces: Array) -> None:
        """Add forces that are known at dolfinx' nodes (collective).

        Args:
            forces: ``(n, d)`` [N] of the nodes of V that this rank owns, in their order.
        """
        link = self._dof_link()
        flat = self.rows.reshape(-1, 8)
        flat[link.places, grid.FORCE : grid.FORCE + self._dim] += link.spread(forces)

    def move_nodes(self, dt: float, gravity: Array, damping: float) -> Array:
        """From mass, momentum and forces to velocities of the nodes.

        Returns:
            The part of the reactions ``(3,)`` [N] that this rank counts.
        """
        rows, bounds = self.rows, self._bounds
        grid.masses(rows, bounds)
        grid.spare_light_nodes(rows, bounds, self._layout.neighbours, self.nodes.side, self._light)
        fixed = self._supports.now
        reaction = grid.reactions(rows, dt, gravity, *fixed, self._sharing.counted)
        grid.update_nodes(rows, bounds, dt, gravity, damping)
        grid.constrain(rows, *fixed)
        return np.asarray(reaction)

    def move_loads(self, dt: float) -> list[str]:
        """Loads go with the nodes.

        Returns:
            What is wrong, on this rank.
        """
        bad = []
        for load in self.loads:
            point, strays = load.follow(
                self.rows, self.nodes, self._layout.ids, self._least_mass, dt
            )
            bad.append(point)
            self._strays |= strays
        return _describe(self.loads, bad, "leaves the lattice")

    def gather(self, dt: float, flip: float) -> list[str]:
        """Velocities, positions and F of the points from the nodes, and J back to them.

        Returns:
            What is wrong, on this rank.
        """
        messages = []
        for part in self.parts:
            bad, strays = part.gather(self.rows, dt, flip)
            self._strays |= strays
            if bad >= 0:
                messages.append(part.describe(bad))
        return messages

    def hold_back(self, box: RigidBox, velocity: Array, dt: float) -> list[str]:
        """Keep points out of a rigid box; the force that this takes to the box, on this rank.

        Returns:
            What is wrong, on this rank.
        """
        messages = []
        for part in self.parts:
            force, bad, strays = part.hold_back(box, velocity, dt)
            box.force += force
            self._strays |= strays
            if bad >= 0:
                messages.append(part.describe(bad))
        return messages

    @property
    def strays(self) -> bool:
        """Whether a point of this rank has left its tiles: ``finish`` has to lay them anew."""
        return self._strays

    def average(self) -> None:
        """Average J at the nodes (collective)."""
        for part in self.parts:
            part.average()

    def finish(self, again: bool, anew: bool) -> None:
        """Stresses and new positions; the points to the nodes, if another step follows.

        Args:
            again: whether another step follows in this block.
            anew: tiles must be laid anew, because there are ``strays`` on any rank; collective.
        """
        for part in self.parts:
            part.finish(again and not anew)
        if again and anew:
            self._sort()
            self._lay()

    # --- nodal fields ------------------------------------------------------------------------

    def write(self, name: str, function: fem.Function) -> None:
        """A nodal field as a function on V or on its scalar companion (collective).

        Args:
            name: "mass", "momentum" [kg m/s] and "force" [N] between ``sum_nodes`` and
                ``move_nodes``, "mass", "velocity" [m/s] and "increment" (of the velocity) from
                there to ``average``.
            function: to be set, ghosts too; zero where there are no tiles.
        """
        column, is_vector = COLUMNS[name]
        n = self._dim if is_vector else 1
        self._write(self.rows.reshape(-1, 8)[:, column : column + n], function)

    def write_average(self, body: int, function: fem.Function) -> None:
        """Averaged J of a body as a scalar function, between ``average`` and ``finish``."""
        part = self.parts[body]
        values = np.zeros((self.rows.shape[0], self.nodes.per_tile, 1))
        values[self._places[body]] = part.averages
        self._write(values.reshape(-1, 1), function)

    def _write(self, values: Array, function: fem.Function) -> None:
        link = self._dof_link()
        owned = link.collect(values[link.places])
        function.x.array[: owned.size] = owned.ravel()
        function.x.scatter_forward()

    def _dof_link(self) -> DofLink:
        if self._all_dofs is None:
            owned = np.arange(self._V.dofmap.index_map.size_local, dtype=np.int32)
            self._all_dofs = DofLink(self._sharing, self.nodes, self._V, owned)
        return self._all_dofs


class Supports:
    """Dirichlet conditions on velocities, at the nodes of all ranks that have them.

    Args:
        V: space of velocities, linear, with a block of d components a node.
        bcs: conditions on V or its components.

    Attributes:
        now: rows of the nodes, components and their values [m/s], each ``(n,)``.
    """

    def __init__(self, V: fem.FunctionSpace, bcs: Sequence[fem.DirichletBC]) -> None:
        """Check the conditions (collective)."""
        check_bcs(bcs, V)
        self._V, self._bcs, self._value = V, list(bcs), fem.Function(V)
        dim, owned = V.mesh.geometry.dim, V.dofmap.index_map.size_local
        dofs = _compat.fixed_dofs(bcs)
        # values at ghosts may differ from their owners' by round-off
        self._dofs = dofs[dofs < owned * dim]

    def find(self, sharing: Sharing, nodes: Nodes) -> None:
        """Find the rows of the nodes, and read the values (collective)."""
        dim = self._V.mesh.geometry.dim
        self._link = DofLink(sharing, nodes, self._V, self._dofs // dim)
        self._components = self._link.spread((self._dofs % dim).astype(np.int64))
        self.read()

    def read(self) -> None:
        """Take the present values (collective)."""
        for bc in self._bcs:
            _compat.bc_set(bc, self._value.x.array, None, 1.0)
        values = self._link.spread(self._value.x.array[self._dofs])
        self.now = self._link.places, self._components, values


def _describe(loads: list[Load], bad: list[int], what: str) -> list[str]:
    return [load.describe(p, what) for load, p in zip(loads, bad, strict=True) if p >= 0]
