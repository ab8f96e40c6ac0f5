# SPDX-License-Identifier: MIT
"""Bodies with one material each in an explicit simulation on a lattice."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numba
import numpy as np
import numpy.typing as npt

from fenicsmpm._njit import njit
from fenicsmpm.basis.blocks import empty_rows, in_blocks, out_of_blocks, plain_order
from fenicsmpm.basis.lines import LINEAR, WIDTH
from fenicsmpm.basis.windows import MARGIN, ON_WALL
from fenicsmpm.formulations.fbar import FBar
from fenicsmpm.lanes import LANES
from fenicsmpm.materials import Law
from fenicsmpm.points import MaterialPoints
from fenicsmpm.points.location import locator
from fenicsmpm.rigid.contact_law import Contact
from fenicsmpm.simulation.lattice_carried import flat, half_size
from fenicsmpm.transfer import grid_rows as grid
from fenicsmpm.transfer.body import Body
from fenicsmpm.transfer.contact import contact
from fenicsmpm.transfer.fused import Kernels, transfers
from fenicsmpm.transfer.sharing import Sharing, Sums
from fenicsmpm.transfer.stresses import STORED
from fenicsmpm.transfer.tiles import (
    Integers,
    Layout,
    Nodes,
    Numbers,
    Units,
    chunks_of,
    fill_blocks,
    lay,
    limits,
    reaches,
    sort_keys,
    stays_home,
    targets,
)
from fenicsmpm.transfer.wall_averages import WallsOfBody, continue_to_walls

Array = npt.NDArray[np.float64]


class Part:
    """A body and its law.

    Between ``begin`` and ``settle``, steps work on arrays of their own, and the points stay as they
    were: a step needs neither dolfinx' cells nor displacements and stresses of the points.

    Args:
        points: The body.
        law: Its law.
        kind: Kind of the grid functions.
        fbar: Averages of J, or None.
        nodes: Nodes of the lattice.

    Attributes:
        rows: Contributions of its points to the nodes, ``(n_tiles, nodes of a tile, 8)``.
        maps_back: Whether points are deformed by their new velocities, mapped back to the nodes,
            see `fenicsmpm.transfer.light_nodes`.
    """

    def __init__(
        self, points: MaterialPoints, law: Law, kind: int, fbar: FBar | None, nodes: Nodes
    ) -> None:
        """Store what the steps need."""
        dim = points.mesh.geometry.dim
        self.points, self._law, self._fbar = points, law, fbar
        self._dim, self._rates, self._kind = dim, law.needs_rate, kind
        self._n_stored = len(STORED[dim])
        self.maps_back = kind == LINEAR
        self._contact = contact(dim, kind)
        self._half = half_size(points)
        self._walls_of = WallsOfBody(points) if fbar is not None else None
        self._nodes = nodes
        self._body: Body | None = None
        self._order: Numbers = np.empty(0, dtype=np.int32)
        self._sigma: Array = np.empty((0, LANES))
        self._slips: dict[str, Array] = {}
        self._sum_volumes: Sums | None = None
        self._sum_averages: Sums | None = None

    # --- where the points are ----------------------------------------------------------------

    def sort(self) -> tuple[Integers, Integers]:
        """Sort the points, or their working arrays, by tile.

        Returns:
            First and last nodes ``(n_units, 3)`` that points of each tile may see.
        """
        points, nodes, width = self.points, self._nodes, WIDTH[self._kind]
        n, d = len(points), self._dim
        x = points.x if self._body is None else out_of_blocks(self._body.x, self._order, n, (d,))
        keys, self._occupied = sort_keys(np.ascontiguousarray(x), nodes, width)
        del x
        order, self._blocks = fill_blocks(keys, nodes.per_tile, len(self._occupied))
        self._low, self._high = reaches(keys, nodes, self._occupied, width, MARGIN[d])
        del keys
        if self._body is not None:
            self._reorder(order)
        self._order = order
        return self._low, self._high + width - 1

    def _reorder(self, order: npt.NDArray[np.int32]) -> None:
        """Bring the working arrays into another order."""
        old, n = self._working._asdict(), len(self.points)
        self._body = None
        for name, rows in old.items():
            if name not in ("parameters", "x_next") and len(rows):
                shape = (LANES * len(rows) // len(self._order),)
                values = out_of_blocks(rows, self._order, n, shape)
                old[name] = rows = None
                old[name] = in_blocks(values, order, copied=name not in ("mass", "V_0"))
        old["x_next"] = np.empty_like(old["x"])
        for name, rows in self._slips.items():
            slip = out_of_blocks(rows, self._order, n, (2, self._dim))
            self._slips[name] = in_blocks(slip, order)
        sigma = out_of_blocks(self._sigma, self._order, n, (self._n_stored,))
        self._sigma = in_blocks(sigma, order)
        self._body = Body(**old)

    def settle_down(self, everything: Layout, shared: Sharing, own: bool) -> Layout:
        """Get the tiles that the points need, after ``sort``. Collective.

        Args:
            everything: Tiles of all bodies and loads.
            shared: Ranks that have them.
            own: Whether the body needs its own layout, because there are other bodies.

        Returns:
            The body's tiles.
        """
        nodes, width, comm = self._nodes, WIDTH[self._kind], self.points.mesh.comm
        layout = lay(self._low, self._high + width - 1, nodes) if own else everything
        sharing = Sharing(comm, layout) if own else shared
        tiles = np.ravel_multi_index(tuple(self._occupied.T), tuple(nodes.tiles))
        units = np.searchsorted(layout.ids, tiles)
        chunks = chunks_of(self._blocks, numba.get_num_threads())
        target, self._copies = targets(units, self._low, self._high, layout, nodes, width, chunks)
        t_low, t_high = limits(self._low, self._high, nodes, self._kind)
        margin = np.zeros(3)
        margin[: self._dim] = MARGIN[self._dim]
        self._units = Units(
            chunks=chunks,
            blocks=self._blocks,
            lower=self._occupied * nodes.side - margin,
            t_low=t_low,
            t_high=t_high,
            source=everything.neighbours[np.searchsorted(everything.ids, tiles)],
            body_source=layout.neighbours[units],
            target=target,
            first=np.zeros((len(units), 3), np.int64),
            last=np.zeros((len(units), 3), np.int64),
        )
        self._border: Integers | None = None
        self._ids, self._n_tiles = layout.ids, len(layout.ids)
        everywhere = self._n_tiles + len(self._copies)
        self._all_rows = grid.tile_rows(everywhere, nodes.per_tile)
        self.rows = self._all_rows[: self._n_tiles]
        averaged = 0 if self._fbar is None else everywhere
        self._all_sums: Array = np.zeros((averaged, nodes.per_tile, 1))
        self._sums = self._all_sums[: self._n_tiles]
        self._volumes = np.empty(self._sums.shape)
        self.free()
        if self._walls_of is not None:
            self._walls = self._walls_of.in_tiles(layout.ids, nodes)
        if self._fbar is not None:
            # for a single body, they are summed up with the other columns
            self._sum_volumes = Sums(sharing, 1) if own else None
            self._sum_averages = Sums(sharing, 1)
        return layout

    def drop(self) -> None:
        """Discard the working arrays of a block that has failed."""
        self._body, self._sigma, self._slips = None, np.empty((0, LANES)), {}

    @property
    def averages(self) -> Array:
        """Return the averaged J ``(n_tiles, nodes, 1)``; without tiles if J is not averaged."""
        return self._sums

    def free(self) -> None:
        """Free the MPI requests of the block."""
        for sums in (self._sum_volumes, self._sum_averages):
            if sums is not None:
                sums.free()

    # --- steps -------------------------------------------------------------------------------

    def begin(self, law: Law, slips: Sequence[str]) -> None:
        """Make working copies of what steps change, in the order of ``sort``.

        The points stay as they are.

        Args:
            law: The law with its current parameters.
            slips: Names of fields of slip on rigid bodies.

        Raises:
            ValueError: For a law of another kind than the first one.
        """
        if law.update is not self._law.update:
            raise ValueError(f"only the parameters of a body's law may change, not its kind: {law}")
        points, d, order = self.points, self._dim, self._order
        n = len(points)
        # those with temporary copies first
        self._sigma = in_blocks(points["sigma"].reshape(n, 9)[:, STORED[d]], order)
        F, F33 = _plane_parts(points["F"], d, law.is_fluid)
        J_0 = np.empty(0) if self._fbar is None else points["J_0"]
        J_0 = J_0[:0] if np.all(J_0 == 1) else J_0
        self._kernels = self._kernels_for(len(F33) > 0, len(J_0) > 0)
        F, F33, J_0 = (in_blocks(a, order if len(a) else order[:0]) for a in (F, F33, J_0))
        x = in_blocks(points.x, order)
        state = [points[k].reshape(n, math.prod(shape)) for k, (shape, _) in law.state.items()]
        self._body = Body(
            x=x,
            x_next=np.empty_like(x),
            v=in_blocks(points["v"], order),
            F=F,
            F33=F33,
            J_bar=in_blocks(points["J" if self._fbar is None else "J_bar"], order),
            J_0=J_0,
            mass=in_blocks(points["mass"], order, copied=False),
            V_0=in_blocks(points["V_0"], order, copied=False),
            state=in_blocks(np.hstack([np.empty((n, 0)), *state]), order),
            L=np.zeros_like(F) if self._rates else np.empty((0, LANES)),
            parameters=np.asarray(law.parameters),
        )
        self._slips = {name: in_blocks(points[name], order) for name in slips}
        self._reference: Array | None = None  # initial positions, if those at the beginning change
        self._version = points.version

    def _kernels_for(self, has_F33: bool, has_J_0: bool) -> Kernels:
        """Return the kernels, which are compiled at first use."""
        law = self._law
        return transfers(
            self._dim, self._kind, law.update, law.update_eight, law.n_state, law.needs_rate,
            law.is_fluid, has_F33, has_J_0,
        )  # fmt: skip

    def scatter(self) -> None:
        """Add the points with their known stresses to the nodes."""
        self._kernels.scatter(
            self._units, self._nodes, self._half, self._working, self._sigma, flat(self._all_rows)
        )
        grid.merge(self._all_rows, self._copies)

    @property
    def _working(self) -> Body:
        """Working arrays, which exist between ``begin`` and ``settle``."""
        assert self._body is not None
        return self._body

    def push(self, slip: str, contact: Contact, dt: float, total: Array) -> int:
        """Add contact forces of a rigid body to the nodes, and to its totals.

        Args:
            slip: Name of the field of slip on it, which need not exist.
            contact: The body in its current state.
            dt: Time step in s.
            total: Totals ``(8,)``, see `fenicsmpm.transfer.contact`.

        Returns:
            A block with a point inside the body, or -1.
        """
        body = self._working
        return int(
            self._contact.push(
                self._nodes, self._ids, self._half, body.x, body.v, self._slip(slip), body.mass,
                contact, dt, flat(self.rows), total,
            )
        )  # fmt: skip

    def hold_back(self, slip: str, contact: Contact, dt: float, total: Array) -> tuple[int, bool]:
        """Keep points out of a rigid body in its new position, see ``push``.

        Returns:
            A block with a point that leaves the lattice by this, or -1; and whether a point has
            left its window.
        """
        body = self._working
        bad, strays = self._contact.hold_back(
            self._nodes, self._units, body.x, body.x_next, body.v, self._slip(slip), body.mass,
            contact, dt, total,
        )  # fmt: skip
        return int(bad), bool(strays)

    def _slip(self, name: str) -> Array:
        return self._slips.get(name, np.empty((0, LANES)))

    def gather(self, rows: Array, dt: float, flip: float) -> tuple[int, bool]:
        """Update velocities, positions and F from the nodes of all bodies, and add J to its own.

        Returns:
            A block with a point that is inverted, not finite or outside, or -1; and whether a point
            has left its window.
        """
        self._sigma = np.empty((0, LANES))  # drop those of the previous step
        self._all_sums[:] = 0.0
        return self._pass(
            self._kernels.move if self.maps_back else self._kernels.gather, rows, dt, flip
        )

    def _pass(
        self, kernel: Callable[..., Any], rows: Array, dt: float, flip: float
    ) -> tuple[int, bool]:
        r, s = (self._fbar.r, self._fbar.s) if self._fbar else (0.0, 0.0)
        bad, strays = kernel(
            self._units, self._nodes, self._half, self._working, flat(rows), dt, flip,
            self._fbar is not None, r, s, self._all_sums.ravel(),
        )  # fmt: skip
        return int(bad), bool(strays)

    def map_back(self) -> Array:
        """Return mass and momentum of moved points at old positions, ``(n_tiles, nodes, 8)``."""
        back = grid.tile_rows(len(self._all_rows), self._nodes.per_tile)
        self._kernels.momenta(self._units, self._nodes, self._half, self._working, flat(back))
        grid.merge(back, self._copies)
        return back[: self._n_tiles]

    def deform(self, rows: Array, dt: float) -> int:
        """Update F from velocities that were mapped back, and add J to the body's nodes.

        Returns:
            A block with a point that is inverted, or -1.
        """
        return self._pass(self._kernels.deform, rows, dt, 1.0)[0]

    def average(self) -> None:
        """Average J at the nodes, and clear the rows for the next step. Collective."""
        if self._sum_averages is None:
            grid.clear(self.rows)
            return
        grid.merge(self._all_sums, self._copies)
        if self._sum_volumes is not None:
            volumes = self.rows[:, :, grid.VOLUME].copy()
            self._sum_volumes.add(volumes)
            self.rows[:, :, grid.VOLUME] = volumes
        self._sum_averages.add(self._sums)
        grid.average_nodes(self.rows, self._sums, self._volumes)
        continue_to_walls(self._sums.ravel(), self._volumes.ravel(), self._walls)

    def finish(self, again: bool, keep: bool) -> None:
        """Compute stresses and new positions.

        Args:
            again: Whether to add the points to the nodes, for another step.
            keep: Whether to keep the stresses.
        """
        body, average = self._working, self._fbar is not None
        self._sigma = empty_rows(self._n_stored * len(body.mass) if keep else 0, LANES)
        self._kernels.finish(
            self._units, self._nodes, self._half, body, average, self._all_sums.ravel(), again,
            self._sigma, flat(self._all_rows),
        )  # fmt: skip
        if again:
            grid.merge(self._all_rows, self._copies)
        self._body = body._replace(x=body.x_next, x_next=body.x)

    @property
    def near_border(self) -> Array:
        """Return positions in m of points that may be in other ranks' cells, ``(n, d)``.

        Some occur repeatedly. The other points cannot have come so far in the windows of their
        units.
        """
        if self._border is None:
            home = stays_home(self._units, self._nodes, locator(self.points.mesh).geometry)
            self._border = np.flatnonzero(np.repeat(~home, np.diff(self._blocks)))
        x = self._working.x.reshape(-1, self._dim, LANES)[self._border]
        return x.transpose(0, 2, 1).reshape(-1, self._dim)

    def bad_stress(self) -> int:
        """Return a block with a stress that is not finite after the last step, or -1."""
        if np.isfinite(self._sigma.sum()):
            return -1
        bad = np.flatnonzero(~np.isfinite(self._sigma).all(axis=1))
        return int(bad[0] // self._n_stored) if len(bad) else -1

    @property
    def changing(self) -> list[str]:
        """Names of the fields that steps change."""
        averaged = [] if self._fbar is None else ["J_bar"]
        of_law = [*averaged, *self._law.state]
        return ["x", "u", "v", "F", "J", "weight", "sigma", *of_law, *self._slips]

    def provide(self, name: str) -> dict[str, Array]:
        """Return new arrays of a field that steps change, and of those that come with it."""
        body, n, d, order = self._working, len(self.points), self._dim, self._order
        if name == "x":
            return {"x": out_of_blocks(body.x, order, n, (d,))}
        if name == "u":
            u = out_of_blocks(body.x, order, n, (d,))
            if self._reference is not None:
                u -= self._reference
            else:
                u -= self.points.x
                u += self.points["u"]
            return {"u": u}
        if name == "v":
            return {"v": out_of_blocks(body.v, order, n, (d,))}
        if name == "J_bar":
            return {"J_bar": out_of_blocks(body.J_bar, order, n)}
        if name == "sigma":
            stored = out_of_blocks(self._sigma, order, n, (self._n_stored,))
            sigma = np.zeros((n, 3, 3))
            for k, component in enumerate(STORED[d]):
                i, j = divmod(component, 3)
                sigma[:, i, j] = sigma[:, j, i] = stored[:, k]
            return {"sigma": sigma}
        if name in self._slips:
            return {name: out_of_blocks(self._slips[name], order, n, (2, d))}
        if name in self._law.state:
            state = out_of_blocks(body.state, order, n, (self._law.n_state,))
            return {k: self._law.state_field(state, k).copy() for k in self._law.state}
        F = out_of_blocks(body.F, order, n, (d, d))
        if d == 2:
            F = np.pad(F, ((0, 0), (0, 1), (0, 1)))
            F[:, 2, 2] = out_of_blocks(body.F33, order, n) if len(body.F33) else 1.0
        J = determinants(F)
        return {"F": F, "J": J, "weight": J * self.points["V_0"]}

    def defer(self) -> None:
        """Defer the changed fields of the points until somebody reads them."""
        if self._reference is None:
            self._reference = self.points.x - self.points["u"]
        self.points.defer(self.changing, self.provide)
        self._version = self.points.version

    @property
    def is_looked_at(self) -> bool:
        """Return whether somebody read deferred fields, or changed the set of points."""
        points = self.points
        return points.version != self._version or not points.present().keys().isdisjoint(
            self.changing
        )

    def settle(self, sort: bool) -> None:
        """Write the changes to the points, and bring their cells up to date. Collective.

        Fields that somebody has written since they were deferred are kept.

        Args:
            sort: Whether to store points with the same nodes next to each other.
        """
        points = self.points
        self.free()
        self._forget_nodes()
        if points.version == self._version:
            self._give_back()
        self.drop()
        if sort:
            width = WIDTH[self._kind]
            points.sort(sort_keys(np.ascontiguousarray(points.x), self._nodes, width)[0])

    def _forget_nodes(self) -> None:
        self._all_rows = self._all_sums = np.empty((0, 0, LANES))
        self.rows, self._sums = self._all_rows, self._all_sums

    def _give_back(self) -> None:
        points, none = self.points, np.empty((0, LANES))
        new = [name for name in self.changing if name not in points.changed]
        # Memory peaks here. The old fields are dropped first, then each working array before the
        # next one is read. Displacements are relative to the positions that the points had.
        self._body = self._working._replace(x_next=none)
        if "u" in new:
            points.assign(self.provide("u"))
        x = self.provide("x")["x"]
        self._body = self._working._replace(x=none)
        points.defer([name for name in new if name not in ("x", "u")], self.provide)
        points.assign({k: self.provide(k)[k] for k in self._slips if k in new})
        working = {
            "F": "F", "sigma": "", "v": "v", **dict.fromkeys(self._law.state, "state"),
            "J_bar": "J_bar",
        }  # fmt: skip
        done: set[str] = set()
        for name, rows in working.items():
            if name in done or name not in self.changing:
                continue
            arrays = self.provide(name)
            done |= set(arrays)
            points.assign({k: a for k, a in arrays.items() if k in new})
            if rows:
                self._body = self._working._replace(**{rows: none})
            else:
                self._sigma = none
        points.move(x)

    def describe(self, block: int) -> str:
        """Return what is wrong with a point of a block, and where it is."""
        d, body, nodes = self._dim, self._working, self._nodes
        of_block = self._order[block * LANES : (block + 1) * LANES]
        of_block = of_block[of_block >= 0]
        ids, one = self.points.id[of_block], plain_order(len(of_block))
        # if there are stresses to inspect, the last step is over
        over = len(self._sigma) > 0
        x_next = body.x if over else body.x_next
        x = out_of_blocks(x_next[block * d : (block + 1) * d], one, len(ids), (d,))
        F = out_of_blocks(body.F[block * d * d : (block + 1) * d * d], one, len(ids), (d, d))
        v = out_of_blocks(body.v[block * d : (block + 1) * d], one, len(ids), (d,))
        J = np.linalg.det(F) + 0 * v.sum(axis=1)  # NaN if either is
        if len(body.F33):
            J *= out_of_blocks(body.F33[block : block + 1], one, len(ids))
        t = (x - nodes.origin[:d]) * nodes.per_metre[:d]
        inside = np.all((t >= -ON_WALL) & (t <= nodes.shape[:d] - 1 + ON_WALL), axis=1)
        good = inside & (J > 0) & np.isfinite(J)
        if over:
            rows = self._n_stored
            sigma = self._sigma[block * rows : (block + 1) * rows]
            good &= np.isfinite(out_of_blocks(sigma, one, len(ids), (rows,))).all(axis=1)
        i = int(np.argmin(good))
        where = np.array2string(x[i], precision=6)
        what = (
            "is inverted"
            if J[i] <= 0
            else "is not finite"
            if not np.isfinite(J[i])
            else "leaves the lattice"
            if not inside[i]
            else "has a stress that is not finite"
        )
        return f"point {ids[i]} {what} at {where} with J = {J[i]:g}"


def _plane_parts(F: Array, dim: int, is_fluid: bool) -> tuple[Array, Array]:
    """Return deformation gradients ``(n, d, d)``, and out-of-plane stretches unless all are 1."""
    F33 = F[:, 2, 2]
    if dim == 3 or np.all(F33 == 1):
        return F[:, :dim, :dim], np.empty(0)
    if is_fluid:  # only J matters
        return np.sqrt(determinants(F))[:, None, None] * np.eye(2), np.empty(0)
    return F[:, :2, :2], F33


@njit(parallel=True)
def determinants(F):  # type: ignore[no-untyped-def]
    """Return determinants ``(n,)`` of ``(n, 3, 3)``."""
    J = np.empty(len(F))
    for p in numba.prange(len(F)):
        a = F[p]
        J[p] = (
            a[0, 0] * (a[1, 1] * a[2, 2] - a[1, 2] * a[2, 1])
            - a[0, 1] * (a[1, 0] * a[2, 2] - a[1, 2] * a[2, 0])
            + a[0, 2] * (a[1, 0] * a[2, 1] - a[1, 1] * a[2, 0])
        )
    return J
