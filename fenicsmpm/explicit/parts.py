# SPDX-License-Identifier: MIT
"""Point sets of an explicit simulation: bodies of some material, and points that carry forces."""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt

from fenicsmpm.basis.lattice import lattice_of
from fenicsmpm.basis.lines import GIMP
from fenicsmpm.explicit.carriers import carriers
from fenicsmpm.explicit.contact import RigidBox, contact
from fenicsmpm.explicit.fbar import FBar
from fenicsmpm.explicit.grid import Nodes
from fenicsmpm.explicit.kernels import Body, transfers
from fenicsmpm.explicit.stencils import in_blocks, out_of_blocks
from fenicsmpm.lanes import LANES
from fenicsmpm.materials import Law, NewtonianFluid
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

    Raises:
        ValueError: for points that miss fields, or have those of another law.
    """

    def __init__(self, points: MaterialPoints, law: Law, kind: int, fbar: FBar | None) -> None:
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
            isinstance(law, NewtonianFluid),
        )
        self._contact = contact(dim, kind)
        self._half = half_size(points, kind)

    def begin(self, threads: int, law: Law) -> None:
        """Take working copies of what steps change; the points stay as they are.

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
        state = [points[name].reshape(n, -1) for name in law.state]
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
        self._ranges = np.linspace(0, len(mass), threads + 1).astype(np.int64)

    @property
    def _working(self) -> Body:
        """Working arrays, which are there between ``begin`` and ``settle``."""
        assert self._body is not None
        return self._body

    def scatter(self, rows: Array, nodes: Nodes) -> None:
        """Add the points to the nodes before the first step."""
        sigma = in_blocks(self.points["sigma"])
        self._kernels.scatter(self._ranges, nodes, self._half, self._working, sigma, rows)

    def push(self, box: RigidBox, velocity: Array, dt: float, rows: Array, nodes: Nodes) -> Array:
        """Contact forces of a box to the nodes.

        Returns:
            Their sum ``(d,)`` [N].
        """
        body = self._working
        return self._contact.push(
            nodes, self._half, body.x, body.v, body.mass, box.lower, box.upper, velocity,
            box.reach, box.stiffness, box.friction, dt, rows,
        )  # fmt: skip

    def hold_back(self, box: RigidBox, velocity: Array, dt: float) -> Array:
        """Keep points out of a box.

        Returns:
            The force that this took ``(d,)`` [N].
        """
        body = self._working
        return self._contact.hold_back(
            body.x_next, body.v, body.mass, box.lower, box.upper, velocity, box.reach, dt
        )

    def gather(self, rows: Array, averages: Array, nodes: Nodes, dt: float, flip: float) -> int:
        """Velocities, positions and F from the nodes, and J to them.

        Returns:
            A block with a point that is inverted, not finite or outside; or -1.
        """
        average = self._fbar is not None
        r = self._fbar.r if self._fbar else 0.0
        return int(
            self._kernels.gather(
                self._ranges, nodes, self._half, self._working, rows, dt, flip, average, r, averages
            )
        )

    def finish(self, averages: Array, nodes: Nodes, again: bool, rows: Array) -> None:
        """Stresses and new positions; if ``again``, add the points to the nodes."""
        body, average = self._working, self._fbar is not None
        s = self._fbar.s if self._fbar else 0.0
        if not again:
            self._sigma = np.empty((9 * len(body.mass), LANES))
        self._kernels.finish(
            self._ranges, nodes, self._half, body, average, s, averages, again, self._sigma, rows
        )
        self._body = body._replace(x=body.x_next, x_next=body.x)

    def settle(self, nodes: Nodes, sort: bool) -> None:
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
            points.sort(nodes.nearest(points.x))

    def describe(self, block: int, nodes: Nodes) -> str:
        """What is wrong with a point of a block, and where it is."""
        d, body = self._dim, self._working
        first = block * LANES
        ids = self.points.id[first : first + LANES]
        x = out_of_blocks(body.x_next[block * d : (block + 1) * d], len(ids), (d,))
        F = out_of_blocks(body.F[block * d * d : (block + 1) * d * d], len(ids), (d, d))
        v = out_of_blocks(body.v[block * d : (block + 1) * d], len(ids), (d,))
        J = np.linalg.det(F) + 0 * v.sum(axis=1)  # no number, if one of both is none
        t = (x - nodes.origin[:d]) * nodes.per_metre[:d]
        inside = np.all((t >= 0) & (t <= nodes.shape[:d] - 1), axis=1)
        i = int(np.argmin(inside & (J > 0) & np.isfinite(J)))
        where = np.array2string(x[i], precision=6)
        what = (
            "is inverted"
            if J[i] <= 0
            else "leaves the lattice"
            if np.isfinite(J[i])
            else "is not finite"
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

    def add_forces(self, rows: Array, nodes: Nodes) -> None:
        """Add the forces to the nodes."""
        self._kernels.add_forces(nodes, self._half, self._x, self.points["force"], rows)

    def follow(self, rows: Array, nodes: Nodes, dt: float) -> None:
        """Move with the updated nodes."""
        self._kernels.follow(nodes, self._half, self._x, rows, dt)

    def settle(self) -> None:
        """Bring cells and displacements up to date (collective)."""
        points = self.points
        x = out_of_blocks(self._x, len(points), points.x.shape[1:])
        points.assign({"u": points["u"] + (x - points.x)})
        points.move(x)


def half_size(points: MaterialPoints, kind: int) -> Array:
    """Half of the points' size in units of cells, ``(3,)``; only uGIMP needs it.

    Points are taken for squares or cubes of the same size, those that carry loads for small.
    """
    half = np.full(3, 1e-6)
    if kind == GIMP and "V_0" in points:
        spacing = lattice_of(points.mesh).spacing
        comm = points.mesh.comm
        volume = comm.allreduce(float(points["V_0"].sum())) / points.size_global
        half[: len(spacing)] = 0.5 * volume ** (1 / len(spacing)) / spacing
    return half


@numba.njit(cache=True, parallel=True)
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
