# SPDX-License-Identifier: MIT
"""Point sets of an explicit simulation: bodies of some material, and points that carry forces."""

from __future__ import annotations

import math
from collections.abc import Callable

import numba
import numpy as np
import numpy.typing as npt

from fenicsmpm._njit import njit
from fenicsmpm.basis.lattice import lattice_of
from fenicsmpm.basis.lines import GIMP
from fenicsmpm.explicit import grid
from fenicsmpm.explicit.body import Body
from fenicsmpm.explicit.carriers import carriers
from fenicsmpm.explicit.contact import RigidBox, contact
from fenicsmpm.explicit.fbar import FBar
from fenicsmpm.explicit.grid import Nodes
from fenicsmpm.explicit.kernels import transfers
from fenicsmpm.explicit.stencils import in_blocks, out_of_blocks
from fenicsmpm.lanes import LANES, LINE_LANES
from fenicsmpm.materials import Law
from fenicsmpm.points import MaterialPoints

_NEEDED = ("mass", "V_0", "F", "J", "J_bar", "u", "v", "sigma")

Array = npt.NDArray[np.float64]


class Part:
    """A body and its law.

    Between ``begin`` and ``settle``, steps work on arrays of their own, and the points are as they
    were: dolfinx' cells are not needed in a step, nor displacements and stresses.

    Args:
        points: the body.
        law: its law.
        kind: of grid functions.
        fbar: averages of J, or None.
        nodes: of the lattice.

    Attributes:
        rows: ``(threads, nodes, 8)``, what its points give to the nodes; rows of threads are summed
            up in the first.

    Raises:
        ValueError: for points that miss fields, or have those of another law.
    """

    def __init__(
        self, points: MaterialPoints, law: Law, kind: int, fbar: FBar | None, nodes: Nodes
    ) -> None:
        """Check the fields."""
        missing = [name for name in (*_NEEDED, *law.state) if name not in points]
        wrong = [
            name
            for name, (shape, _) in law.state.items()
            if name in points and points.field_shape(name) != shape
        ]
        if missing or wrong:
            raise ValueError(
                f"a body without the fields {', '.join([*missing, *wrong])}: call "
                "explicit.set_initial_state(points, law, density) first"
            )
        dim = points.mesh.geometry.dim
        self.points, self._law, self._fbar = points, law, fbar
        self._dim, self._rates = dim, law.needs_rate
        self._kernels = transfers(
            dim,
            kind,
            law.update,
            law.update_eight,
            law.n_state,
            law.needs_rate,
            law.is_fluid,
        )
        self._contact = contact(dim, kind)
        self._half = half_size(points, kind)
        self._nodes, threads = nodes, numba.get_num_threads()
        self.rows = grid.empty_rows(threads, nodes.size, LANES)
        averaged = 0 if fbar is None else nodes.size
        self._averages = grid.empty_rows(threads, averaged, LINE_LANES)
        self._sums = np.zeros(averaged)

    def begin(self, law: Law) -> None:
        """Take working copies of what steps change, and add the points to the nodes.

        The points stay as they are.

        Raises:
            ValueError: for a law of another kind than the first.
        """
        if law.update is not self._law.update:
            raise ValueError(f"a body's law may change its parameters only: {law}")
        points, d = self.points, self._dim
        n = len(points)
        somewhere = points.x[-1] if n else 0.0
        # the largest first, since blocks are made by way of copies
        F = in_blocks(points["F"][:, :d, :d], np.eye(d))
        x = in_blocks(points.x, somewhere)
        mass = in_blocks(points["mass"])
        state = [points[k].reshape(n, math.prod(shape)) for k, (shape, _) in law.state.items()]
        self._body: Body | None = Body(
            x=x,
            x_next=np.empty_like(x),
            v=in_blocks(points["v"]),
            F=F,
            J_bar=in_blocks(points["J_bar"], 1.0),
            mass=mass,
            V_0=in_blocks(points["V_0"]),
            state=in_blocks(np.hstack([np.empty((n, 0)), *state]), law.initial_state(1)[0]),
            L=np.zeros_like(F) if self._rates else np.empty((0, LANES)),
            parameters=np.asarray(law.parameters),
        )
        self._sigma = np.empty((0, LANES))
        self._ranges = np.linspace(0, len(mass), len(self.rows) + 1).astype(np.int64)
        grid.clear(self.rows)
        sigma = in_blocks(points["sigma"])
        self._kernels.scatter(
            self._ranges, self._nodes, self._half, self._working, sigma, self.rows
        )

    @property
    def _working(self) -> Body:
        """Working arrays, which are there between ``begin`` and ``settle``."""
        assert self._body is not None
        return self._body

    def push(self, box: RigidBox, velocity: Array, dt: float) -> tuple[Array, int]:
        """Contact forces of a box to the nodes.

        Returns:
            Their sum ``(d,)`` [N], and a block with a point inside of the box; or -1.
        """
        body = self._working
        force, bad = self._contact.push(
            self._nodes, self._half, body.x, body.v, body.mass, box.lower, box.upper, velocity,
            box.reach, box.stiffness, box.friction, dt, self.rows[0],
        )  # fmt: skip
        return force, bad

    def hold_back(self, box: RigidBox, velocity: Array, dt: float) -> tuple[Array, int]:
        """Keep points out of a box.

        Returns:
            The force that this took ``(d,)`` [N], and a block with a point that has left the
            lattice by this; or -1.
        """
        body = self._working
        force, bad = self._contact.hold_back(
            self._nodes, body.x_next, body.v, body.mass, box.lower, box.upper, velocity,
            box.reach, dt,
        )  # fmt: skip
        return force, bad

    def gather(self, rows: Array, dt: float, flip: float) -> int:
        """Velocities, positions and F from the nodes of all bodies, and J to its own.

        Returns:
            A block with a point that is inverted, not finite or outside; or -1.
        """
        average = self._fbar is not None
        r, s = (self._fbar.r, self._fbar.s) if self._fbar else (0.0, 0.0)
        if average:
            grid.clear(self._averages)
        return int(
            self._kernels.gather(
                self._ranges, self._nodes, self._half, self._working, rows, dt, flip, average, r,
                s, self._averages,
            )
        )  # fmt: skip

    def average(self, add_ranks: Callable[[Array], None]) -> None:
        """Average J at the nodes, and clear the rows for the next step."""
        if self._fbar is None:
            grid.clear(self.rows)
            return
        grid.sum_averages(self._averages, self._sums)
        add_ranks(self._sums)
        grid.average_nodes(self.rows, self._sums, self._averages[0])

    def finish(self, again: bool) -> None:
        """Stresses and new positions; if ``again``, add the points to the nodes."""
        body, average = self._working, self._fbar is not None
        if not again:
            self._sigma = np.empty((9 * len(body.mass), LANES))
        self._kernels.finish(
            self._ranges, self._nodes, self._half, body, average, self._averages[0], again,
            self._sigma, self.rows,
        )  # fmt: skip
        self._body = body._replace(x=body.x_next, x_next=body.x)

    def bad_stress(self) -> int:
        """A block with a stress that is not finite after the last step; or -1."""
        bad = np.flatnonzero(~np.isfinite(self._sigma).all(axis=1))
        return int(bad[0] // 9) if len(bad) else -1

    def settle(self, sort: bool) -> None:
        """Give the points what has changed, and bring their cells up to date (collective).

        If ``sort``, points with the same nodes come to stand one after the other.
        """
        points, d, n = self.points, self._dim, len(self.points)
        # one after the other, each working array gone before the next: this is where memory peaks
        body, self._body = self._working._asdict(), None
        del body["x_next"], body["L"], body["mass"], body["V_0"]
        points.assign({"v": out_of_blocks(body.pop("v"), n, (d,))})
        points.assign({"J_bar": out_of_blocks(body.pop("J_bar"), n)})
        if self._law.state:
            state = out_of_blocks(body.pop("state"), n, (self._law.n_state,))
            points.assign({k: self._law.state_field(state, k).copy() for k in self._law.state})
            del state
        points.assign({"sigma": out_of_blocks(self._sigma, n, (3, 3))})
        self._sigma = np.empty((0, LANES))
        F = out_of_blocks(body.pop("F"), n, (d, d))
        if d == 2:
            F = np.pad(F, ((0, 0), (0, 1), (0, 1)))
            F[:, 2, 2] = 1.0
        J = determinants(F)
        points.assign({"F": F, "J": J, "weight": J * points["V_0"]})
        x = out_of_blocks(body.pop("x"), n, (d,))
        points.assign({"u": points["u"] + (x - points.x)})
        points.move(x)
        if sort:
            points.sort(self._nodes.nearest(points.x))

    def describe(self, block: int) -> str:
        """What is wrong with a point of a block, and where it is."""
        d, body, nodes = self._dim, self._working, self._nodes
        first = block * LANES
        ids = self.points.id[first : first + LANES]
        # the last step is over where there are stresses to look at
        over = len(self._sigma) > 0
        x_next = body.x if over else body.x_next
        x = out_of_blocks(x_next[block * d : (block + 1) * d], len(ids), (d,))
        F = out_of_blocks(body.F[block * d * d : (block + 1) * d * d], len(ids), (d, d))
        v = out_of_blocks(body.v[block * d : (block + 1) * d], len(ids), (d,))
        J = np.linalg.det(F) + 0 * v.sum(axis=1)  # no number, if one of both is none
        t = (x - nodes.origin[:d]) * nodes.per_metre[:d]
        inside = np.all((t >= 0) & (t <= nodes.shape[:d] - 1), axis=1)
        good = inside & (J > 0) & np.isfinite(J)
        if over:
            sigma = self._sigma[block * 9 : (block + 1) * 9]
            good &= np.isfinite(out_of_blocks(sigma, len(ids), (9,))).all(axis=1)
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


class Load:
    """Points that carry forces and move with the grid.

    Args:
        points: boundary points with a field "force" ``(d,)`` [N]; they get "u" if it is missing.
        kind: of grid functions.

    Raises:
        ValueError: for points without forces.
    """

    def __init__(self, points: MaterialPoints, kind: int) -> None:
        """Check the field."""
        dim = points.mesh.geometry.dim
        if "force" not in points or points.field_shape("force") != (dim,):
            raise ValueError(f"points of a load need a field 'force' of shape ({dim},) in N")
        if "u" not in points:
            points.add_field("u", (dim,))
        self.points = points
        self._kernels = carriers(dim, kind)
        self._half = half_size(points, kind)
        self._x = in_blocks(points.x)

    def begin(self) -> None:
        """Take the present positions."""
        points = self.points
        self._x = in_blocks(points.x, points.x[-1] if len(points) else 0.0)

    def add_forces(self, rows: Array, forces: Array, nodes: Nodes, least_mass: float) -> int:
        """Add the forces to those of the nodes ``(n, 3)``, of which those with mass count.

        Returns:
            A point without any mass at its nodes; or -1.
        """
        force = self.points["force"]
        return self._kernels.add_forces(nodes, self._half, self._x, force, rows, least_mass, forces)

    def follow(self, rows: Array, nodes: Nodes, least_mass: float, dt: float) -> int:
        """Move with the updated nodes.

        Returns:
            A point that has left the lattice; or -1.
        """
        count = len(self.points)
        return self._kernels.follow(nodes, self._half, self._x, count, rows, least_mass, dt)

    def describe(self, point: int, what: str) -> str:
        """Which point it is, and where."""
        x = out_of_blocks(self._x, len(self.points), self.points.x.shape[1:])[point]
        return (
            f"point {self.points.id[point]} of a load {what} at {np.array2string(x, precision=6)}"
        )

    def settle(self) -> None:
        """Bring cells and displacements up to date (collective)."""
        points = self.points
        x = out_of_blocks(self._x, len(points), points.x.shape[1:])
        points.assign({"u": points["u"] + (x - points.x)})
        points.move(x)


def half_size(points: MaterialPoints, kind: int) -> Array:
    """Half of the points' size in units of cells, ``(3,)``; only uGIMP needs it (collective).

    Points are taken for squares or cubes of the same size, those without volume for small.

    Raises:
        ValueError: for points that are larger than cells.
    """
    half = np.full(3, 1e-6)
    n = points.size_global
    if kind == GIMP and "V_0" in points and n > 0:
        spacing = lattice_of(points.mesh).spacing
        volume = points.mesh.comm.allreduce(float(points["V_0"].sum())) / n
        size = volume ** (1 / len(spacing))
        half[: len(spacing)] = 0.5 * size / spacing
        if half.max() > 0.5 + 1e-9:
            raise ValueError(
                f"points of {size:g} m are larger than cells of {spacing} m, which uGIMP cannot "
                "do: seed more points"
            )
    return np.minimum(half, 0.5)


@njit(parallel=True)
def determinants(F):  # type: ignore[no-untyped-def]
    """Determinants ``(n,)`` of ``(n, 3, 3)``."""
    J = np.empty(len(F))
    for p in numba.prange(len(F)):
        a = F[p]
        J[p] = (
            a[0, 0] * (a[1, 1] * a[2, 2] - a[1, 2] * a[2, 1])
            - a[0, 1] * (a[1, 0] * a[2, 2] - a[1, 2] * a[2, 0])
            + a[0, 2] * (a[1, 0] * a[2, 1] - a[1, 1] * a[2, 0])
        )
    return J
