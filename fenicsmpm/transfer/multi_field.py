# SPDX-License-Identifier: MIT
"""Contact of bodies with nodal velocities of their own (multi-field contact).

Where two bodies give mass to the same node, their trial velocities there are bound to Signorini's
and Coulomb's laws (S. Bardenhagen, J. Brackbill, D. Sulsky, CMAME 187, 2000; S. Bardenhagen et al.,
CMES 2, 2001). The plane between them at a node is found from the positions of their points, by
logistic regression (J. Nairn, C. Hammerquist, G. Smith, CMAME 362, 2020), and so is their gap: the
bodies feel each other when their points' domains meet, not when their grid functions do.

All of this consists of sums over points at nodes, so points of other ranks take part.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem, la

from fenicsmpm._njit import njit
from fenicsmpm.basis import stencil_of
from fenicsmpm.points import MaterialPoints

Array = npt.NDArray[np.float64]

# Penalty on the squared slope of the regression, in the cell's size: without it, there is no
# steepest plane between sets of points that do not overlap
_RIDGE = 1e-4
# Newton's steps of the regression, and the longest of them, in the cell's size
_ITERATIONS, _LONGEST = 12, 4.0
# Steepness of the weights that single out the outermost points, per spacing of points
_STEEPNESS = 5.0
# Rounds over the pairs of bodies where more than two meet at a node
_ROUNDS = 30


class Meeting(NamedTuple):
    """Nodes at which two fields meet.

    Attributes:
        nodes: ``(n,)`` local numbers, ghosts included.
        normal: ``(n, d)`` from the first field to the second.
        gap: ``(n,)`` between their points' domains along the normal [m]; negative if they overlap.
    """

    nodes: npt.NDArray[np.int64]
    normal: Array
    gap: Array


class Interfaces:
    """Finds where fields meet.

    Args:
        scalars: Lagrange space of degree 1 whose nodes are taken (collective).
    """

    def __init__(self, scalars: fem.FunctionSpace) -> None:
        """Measure the nodes' shares of the mesh."""
        self._scalars = scalars
        self._dim = scalars.mesh.geometry.dim
        share = fem.assemble_vector(fem.form(ufl.TestFunction(scalars) * ufl.dx))
        share.scatter_reverse(la.InsertMode.add)
        share.scatter_forward()
        self._sizes = share.array ** (1 / self._dim)
        self._x = scalars.tabulate_dof_coordinates()[:, : self._dim].copy()

    def between(
        self, first: Sequence[MaterialPoints], second: Sequence[MaterialPoints],
        masses: tuple[Array, Array],
    ) -> Meeting:  # fmt: skip
        """The nodes at which two fields meet (collective).

        Args:
            first: bodies of the first field, with "mass", "V_0" and "F".
            second: those of the second.
            masses: ``(n_nodes,)`` of each field at all local nodes, ghosts up to date [kg].
        """
        meets = (masses[0] > 0) & (masses[1] > 0)
        nodes = np.flatnonzero(meets)
        if not self._scalars.mesh.comm.allreduce(len(nodes), MPI.SUM):
            return Meeting(nodes, np.empty((0, self._dim)), np.empty(0))
        sides = ((first, -1.0, masses[0]), (second, 1.0, masses[1]))
        planes = np.zeros((len(meets), self._dim + 1))
        self._regress(sides, nodes, meets, planes)
        normal = planes[:, : self._dim]
        length = np.linalg.norm(normal, axis=1)
        # points that lie the same way on both sides of a node have no plane between them
        np.divide(normal, length[:, None], out=normal, where=length[:, None] > 0)
        gap = np.zeros(len(nodes))
        for bodies, sign, mass in sides:
            gap -= self._heights(bodies, -sign * normal, meets, mass)[nodes]
        return Meeting(nodes, normal[nodes], gap)

    def _regress(self, sides, nodes, meets, planes) -> None:  # type: ignore[no-untyped-def]
        """Planes between points by logistic regression, with Newton's method at all nodes at once.

        Least ``-sum_p w_p ln P_p + r |n|^2 / 2`` with ``P_p = 1 / (1 + exp(-c_p (n . xi_p + n_0)))``
        and c_p = -1 and 1 on the two sides, ``xi = (x - x_I) / h`` and weights ``N_I m_p`` that
        have the same sum on both sides.
        """
        size = self._dim + 1
        rows, columns = np.triu_indices(size)
        for _ in range(_ITERATIONS):
            sums = 0.0
            for bodies, sign, mass in sides:
                share = np.divide(0.5, mass, out=np.zeros_like(mass), where=meets)
                total = self._sum(
                    bodies, size + len(rows), meets, _add_logistic, planes, self._sizes, sign
                )
                sums = sums + total * share[:, None]
            here = sums[nodes]
            H = np.zeros((len(nodes), size, size))
            H[:, rows, columns] = H[:, columns, rows] = here[:, size:]
            g = here[:, :size].copy()
            g[:, :-1] += _RIDGE * planes[nodes, :-1]
            H[:, range(self._dim), range(self._dim)] += _RIDGE
            step = np.linalg.solve(H, g[:, :, None])[:, :, 0]
            long = np.linalg.norm(step, axis=1, keepdims=True)
            planes[nodes] -= step * np.minimum(1.0, _LONGEST / np.maximum(long, 1e-300))

    def _heights(
        self, bodies: Sequence[MaterialPoints], direction: Array, meets: Array, mass: Array
    ) -> Array:
        """How far the domains of points reach beyond each node in a direction (d,) [m].

        Mean over the outermost points, with weights N_I exp(s z). A domain is a ball whose volume
        belongs to that of the point's square or cube, deformed by F.
        """
        comm = self._scalars.mesh.comm
        spacing = [float(np.sum(b["V_0"] ** (1 / self._dim))) for b in bodies]
        count = sum(b.size_global for b in bodies)
        steepness = _STEEPNESS * count / comm.allreduce(sum(spacing))
        sums = self._sum(bodies, 2, meets, _add_heights, direction, self._sizes, steepness)
        return np.divide(sums[:, 1], sums[:, 0], out=np.zeros(len(sums)), where=sums[:, 0] > 0)

    def _sum(self, bodies, size, meets, add, vectors, sizes, number) -> Array:  # type: ignore[no-untyped-def]
        """Sum a function of point and node over points, ``(n_nodes, size)`` (collective)."""
        result = la.vector(self._scalars.dofmap.index_map, size)
        result.array[:] = 0.0
        sums = result.array.reshape(-1, size)
        element = self._scalars.ufl_element().basix_element
        for body in bodies:
            stencil = stencil_of(body)
            add(
                body.x, body["mass"], body["V_0"], body["F"], stencil.order, stencil.offsets,
                stencil.positive_table(element), stencil.dofs(self._scalars), meets, self._x,
                vectors, sizes, number, sums,
            )  # fmt: skip
        result.scatter_reverse(la.InsertMode.add)
        result.scatter_forward()
        return sums


@njit
def _add_logistic(  # type: ignore[no-untyped-def]
    x, mass, V_0, F, order, offsets, table, dofs, meets, nodes, planes, sizes, sign, sums
):
    """Gradient and upper half of the Hessian of the regression, see ``Interfaces._regress``."""
    dim = x.shape[1]
    xi = np.ones(dim + 1)
    for group in range(len(offsets) - 1):
        for a in range(dofs.shape[1]):
            node = dofs[group, a]
            if not meets[node]:
                continue
            for k in range(offsets[group], offsets[group + 1]):
                p = order[k]
                s = planes[node, dim]
                for i in range(dim):
                    xi[i] = (x[p, i] - nodes[node, i]) / sizes[node]
                    s += planes[node, i] * xi[i]
                wrong = 1.0 / (1.0 + np.exp(sign * s))
                weight = table[k, a] * mass[p]
                column = dim + 1
                for i in range(dim + 1):
                    sums[node, i] -= sign * wrong * weight * xi[i]
                    for j in range(i, dim + 1):
                        sums[node, column] += wrong * (1.0 - wrong) * weight * xi[i] * xi[j]
                        column += 1


@njit
def _add_heights(  # type: ignore[no-untyped-def]
    x, mass, V_0, F, order, offsets, table, dofs, meets, nodes, directions, sizes, steepness, sums
):
    """Weights of the outermost points and weighted heights, see ``Interfaces._heights``."""
    dim = x.shape[1]
    for group in range(len(offsets) - 1):
        for a in range(dofs.shape[1]):
            node = dofs[group, a]
            if not meets[node]:
                continue
            for k in range(offsets[group], offsets[group + 1]):
                p = order[k]
                z, squared = 0.0, 0.0
                for i in range(dim):
                    z += (x[p, i] - nodes[node, i]) * directions[node, i]
                    stretched = 0.0
                    for j in range(dim):
                        stretched += F[p, j, i] * directions[node, j]
                    squared += stretched * stretched
                z += 0.5 * V_0[p] ** (1.0 / dim) * np.sqrt(squared)
                weight = table[k, a] * mass[p] * np.exp(steepness * z)
                sums[node, 0] += weight
                sums[node, 1] += weight * z


class Pair(NamedTuple):
    """Two fields in contact.

    Attributes:
        first: number of the first field.
        second: of the second.
        friction: Coulomb's coefficient.
        meeting: where they meet.
    """

    first: int
    second: int
    friction: float
    meeting: Meeting


def contact_impulses(
    pairs: Sequence[Pair],
    masses: Sequence[Array],
    velocities: Sequence[Array],
    fixed: npt.NDArray[np.bool_],
    dt: float,
) -> list[Array]:
    """Let no field enter another one, with friction, by equal and opposite impulses at the nodes.

    The trial velocities of a step decide. The normal impulse stops what would close more than the
    gap in the step, and never pulls. The tangential one stops the slip, or is the friction times
    the normal one. Where several pairs meet at a node, they take turns.

    Args:
        pairs: of fields.
        masses: ``(n_nodes,)`` of each field [kg].
        velocities: ``(n_nodes, d)`` of each field, changed in place [m/s].
        fixed: ``(n_nodes, d)`` components that are prescribed, for all fields the same; there is
            no impulse along them.
        dt: step [s].

    Returns:
        ``(n, d)`` impulses on the second field at the nodes of each pair [N s].
    """
    impulses = []
    normals = []
    for pair in pairs:
        normal = np.where(fixed[pair.meeting.nodes], 0.0, pair.meeting.normal)
        length = np.linalg.norm(normal, axis=1, keepdims=True)
        normals.append(np.divide(normal, length, out=np.zeros_like(normal), where=length > 1e-6))
        impulses.append(np.zeros_like(normal))
    for _ in range(1 if len(pairs) == 1 else _ROUNDS):
        for pair, n, J in zip(pairs, normals, impulses, strict=True):
            nodes, gap = pair.meeting.nodes, pair.meeting.gap
            m_1, m_2 = masses[pair.first][nodes, None], masses[pair.second][nodes, None]
            v_1, v_2 = velocities[pair.first], velocities[pair.second]
            reduced = m_1 * m_2 / (m_1 + m_2)
            apart = reduced * (v_2[nodes] - v_1[nodes]) - J  # momentum without this contact
            opening = np.sum(apart * n, axis=1, keepdims=True)
            may_close = reduced * np.maximum(gap, 0.0)[:, None] / dt
            push = np.maximum(-opening - may_close, 0.0) * np.any(n != 0, axis=1, keepdims=True)
            slip = apart - opening * n
            speed = np.linalg.norm(slip, axis=1, keepdims=True)
            # an infinite friction without a push is none
            limit = np.where(push > 0, pair.friction, 0.0) * push
            share = np.divide(limit, speed, out=np.ones_like(speed), where=speed > limit)
            new = push * n - np.where(push > 0, share, 0.0) * slip
            v_1[nodes] -= (new - J) / m_1
            v_2[nodes] += (new - J) / m_2
            J[:] = new
    return impulses
