# SPDX-License-Identifier: MIT
"""Contact of bodies with nodal velocities of their own (multi-field contact).

Where two bodies give mass to the same node, they may touch (S. Bardenhagen, J. Brackbill,
D. Sulsky, CMAME 187, 2000; S. Bardenhagen et al., CMES 2, 2001). The plane between them at a node
is found from the positions of their points by logistic regression (J. Nairn, C. Hammerquist,
G. Smith, CMAME 362, 2020), and so is their gap: they feel each other when the domains of their
points meet, not when their grid functions do.

Where domains overlap, they are pushed apart in proportion to this, and never pulled. The force of a
node acts on the outermost points, which are those whose overlap it is: then it does the work that
it has stored. To stop what closes at the nodes instead, as in the papers above, is an inelastic
collision of all that the nodes see, by which two discs of four cells' radius lose 5 to 8 percent
of their energy with linear functions.

Friction is Coulomb's, by impulses at the nodes that stop the slip of the trial velocities of the
step, as far as the normal force allows: what sticks does not creep.

All of this consists of sums over points at nodes, so points of other ranks take part.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

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
_RIDGE = 1e-8
# Newton's steps of the regression at most, their largest length, and when they are small enough
_ITERATIONS, _LONGEST, _SMALL = 30, 10.0, 1e-3
# Steepness of the weights that single out the outermost points, per spacing of points
_STEEPNESS = 5.0
# Rounds over the pairs of fields where more than two may meet at a node
_ROUNDS = 20


class Cloud(NamedTuple):
    """Points of a body with what nodes see of them, for compiled loops.

    Attributes:
        x: positions ``(n, d)`` [m].
        mass: ``(n,)`` [kg].
        radius: ``(n,)`` half the side of the square or cube that a point is at first [m].
        F: deformation gradients ``(n, 3, 3)``.
        order: storage indices of the points, group by group.
        offsets: range of each group in it.
        table: values of the grid functions, in the order of groups.
        dofs: nodes of each group.
        groups: those that see a node at which fields meet.
    """

    x: Any
    mass: Any
    radius: Any
    F: Any
    order: Any
    offsets: Any
    table: Any
    dofs: Any
    groups: Any


class Side(NamedTuple):
    """One of two fields that meet.

    Attributes:
        bodies: with velocities of the field.
        clouds: their points.
        sign: -1 for the first and 1 for the second field.
        mass: ``(n_nodes,)`` [kg].
        steepness: of the weights of outermost points [1/m].
    """

    bodies: Sequence[MaterialPoints]
    clouds: list[Cloud]
    sign: float
    mass: Array
    steepness: float


class Meeting(NamedTuple):
    """Nodes at which two fields meet; arrays have rows for all local nodes, ghosts included.

    Attributes:
        sides: the two fields.
        meets: ``(n_nodes,)`` whether both have mass.
        normal: ``(n_nodes, d)`` from the first to the second.
        gap: ``(n_nodes,)`` between their points' domains along the normal [m], infinite where they
            do not meet; negative if they overlap.
        weights: of the outermost points of each side, summed up ``(n_nodes,)``.
    """

    sides: tuple[Side, Side]
    meets: npt.NDArray[np.bool_]
    normal: Array
    gap: Array
    weights: tuple[Array, Array]


class Interfaces:
    """Finds where fields meet.

    Args:
        scalars: Lagrange space of degree 1 whose nodes are taken (collective).
    """

    def __init__(self, scalars: fem.FunctionSpace) -> None:
        """Measure the nodes' shares of the mesh."""
        self._scalars, self._comm = scalars, scalars.mesh.comm
        self._dim = scalars.mesh.geometry.dim
        share = fem.assemble_vector(fem.form(ufl.TestFunction(scalars) * ufl.dx))
        share.scatter_reverse(la.InsertMode.add)
        share.scatter_forward()
        self._sizes = share.array ** (1 / self._dim)
        self._x = scalars.tabulate_dof_coordinates()[:, : self._dim].copy()

    def between(
        self,
        bodies: tuple[Sequence[MaterialPoints], Sequence[MaterialPoints]],
        masses: tuple[Array, Array],
    ) -> Meeting | None:
        """The nodes at which two fields meet; None if there are none (collective).

        Args:
            bodies: of each field, with "mass", "V_0" and "F".
            masses: ``(n_nodes,)`` of each field at all local nodes, ghosts up to date [kg].
        """
        meets = (masses[0] > 0) & (masses[1] > 0)
        if not self._comm.allreduce(bool(meets.any()), MPI.LOR):
            return None
        first, second = (
            self._side(*one, meets) for one in zip(bodies, (-1.0, 1.0), masses, strict=True)
        )
        normal = self._normals((first, second), meets)
        gap, weights = np.full(len(meets), np.inf), []
        gap[meets] = 0.0
        for side in (first, second):
            sums = self._sum(side, 2, _add_heights, meets, self._x, -side.sign * normal)
            gap[meets] -= sums[meets, 1] / sums[meets, 0]
            weights.append(sums[:, 0])
        return Meeting((first, second), meets, normal, gap, (weights[0], weights[1]))

    def point_forces(self, meeting: Meeting, push: Array) -> list[tuple[MaterialPoints, Array]]:
        """Forces of nodes on the outermost points of both sides, ``(n_points, d)`` [N].

        Args:
            meeting: of two fields.
            push: ``(n_nodes,)`` by which each node pushes them apart [N].
        """
        result = []
        for side, weight in zip(meeting.sides, meeting.weights, strict=True):
            per_weight = np.divide(push, weight, out=np.zeros_like(push), where=push > 0)
            vectors = side.sign * per_weight[:, None] * meeting.normal
            directions = -side.sign * meeting.normal
            for body, cloud in zip(side.bodies, side.clouds, strict=True):
                forces = np.zeros_like(body.x)
                _add_forces(cloud, push > 0, self._x, directions, side.steepness, vectors, forces)
                result.append((body, forces))
        return result

    def _side(
        self,
        bodies: Sequence[MaterialPoints],
        sign: float,
        mass: Array,
        meets: npt.NDArray[np.bool_],
    ) -> Side:
        clouds, element = [], self._scalars.ufl_element().basix_element
        for body in bodies:
            stencil = stencil_of(body)
            dofs, radius = stencil.dofs(self._scalars), 0.5 * body["V_0"] ** (1 / self._dim)
            groups = np.flatnonzero(meets[dofs].any(axis=1) & (np.diff(stencil.offsets) > 0))
            clouds.append(
                Cloud(
                    body.x,
                    body["mass"],
                    radius,
                    body["F"],
                    stencil.order,
                    stencil.offsets,
                    stencil.positive_table(element),
                    dofs,
                    groups,
                )
            )
        radii = self._comm.allreduce(sum(float(cloud.radius.sum()) for cloud in clouds))
        mean = radii / sum(body.size_global for body in bodies)
        return Side(bodies, clouds, sign, mass, _STEEPNESS / (2 * mean))

    def _normals(self, sides: tuple[Side, Side], meets: npt.NDArray[np.bool_]) -> Array:
        """Normals ``(n_nodes, d)`` of planes between points, by Newton's method at all nodes.

        Least ``-sum_p w_p ln P_p + r |n|^2 / 2``, ``P_p = 1 / (1 + exp(-c_p (n . xi_p + n_0)))``,
        with c_p = -1 and 1 on the two sides, ``xi = (x - x_I) / h`` and weights N_I m_p that have
        the same sum on both sides.
        """
        dim, size = self._dim, self._dim + 1
        rows, columns = np.triu_indices(size)
        planes, nodes = np.zeros((len(meets), size)), np.flatnonzero(meets)
        for _ in range(_ITERATIONS):
            sums = np.zeros((len(nodes), size + len(rows)))
            for side in sides:
                total = self._sum(
                    side, size + len(rows), _add_logistic, meets, self._x, self._sizes, planes
                )
                sums += 0.5 * total[nodes] / side.mass[nodes, None]
            gradient, H = sums[:, :size], np.zeros((len(nodes), size, size))
            H[:, rows, columns] = H[:, columns, rows] = sums[:, size:]
            gradient[:, :dim] += _RIDGE * planes[nodes, :dim]
            H[:, range(dim), range(dim)] += _RIDGE
            step = np.linalg.solve(H, gradient[:, :, None])[:, :, 0]
            length = np.linalg.norm(step, axis=1, keepdims=True)
            planes[nodes] -= step * np.minimum(1.0, _LONGEST / np.maximum(length, _SMALL))
            if self._comm.allreduce(float(length.max(initial=0.0)), MPI.MAX) < _SMALL:
                break
        normal = planes[:, :dim].copy()
        length = np.linalg.norm(normal, axis=1, keepdims=True)
        return np.divide(normal, length, out=normal, where=length > 0)

    def _sum(self, side: Side, size: int, add: Any, *arrays: npt.NDArray[Any]) -> Array:
        """Sum a function of point and node over points, ``(n_nodes, size)`` (collective)."""
        result = la.vector(self._scalars.dofmap.index_map, size)
        result.array[:] = 0.0
        sums = result.array.reshape(-1, size)
        number = side.sign if add is _add_logistic else side.steepness
        for cloud in side.clouds:
            add(cloud, *arrays, number, sums)
        result.scatter_reverse(la.InsertMode.add)
        result.scatter_forward()
        return sums


@njit
def _add_logistic(cloud, meets, nodes, sizes, planes, sign, sums):  # type: ignore[no-untyped-def]
    """Gradient and upper half of the Hessian of the regression, see ``Interfaces._normals``."""
    dim = nodes.shape[1]
    xi = np.ones(dim + 1)
    for group in cloud.groups:
        for a in range(cloud.dofs.shape[1]):
            node = cloud.dofs[group, a]
            if not meets[node]:
                continue
            for k in range(cloud.offsets[group], cloud.offsets[group + 1]):
                p = cloud.order[k]
                s = planes[node, dim]
                for i in range(dim):
                    xi[i] = (cloud.x[p, i] - nodes[node, i]) / sizes[node]
                    s += planes[node, i] * xi[i]
                wrong = 1.0 / (1.0 + np.exp(sign * s))
                weight = cloud.table[k, a] * cloud.mass[p]
                column = dim + 1
                for i in range(dim + 1):
                    sums[node, i] -= sign * wrong * weight * xi[i]
                    for j in range(i, dim + 1):
                        sums[node, column] += wrong * (1.0 - wrong) * weight * xi[i] * xi[j]
                        column += 1


@njit
def _height(cloud, p, node, direction):  # type: ignore[no-untyped-def]
    """How far a point's domain, a ball deformed by F, reaches beyond a node in a direction [m]."""
    z, squared = 0.0, 0.0
    for i in range(len(node)):
        z += (cloud.x[p, i] - node[i]) * direction[i]
        stretch = 0.0
        for j in range(len(node)):
            stretch += cloud.F[p, j, i] * direction[j]
        squared += stretch * stretch
    return z + cloud.radius[p] * np.sqrt(squared)


@njit
def _add_heights(cloud, meets, nodes, directions, steepness, sums):  # type: ignore[no-untyped-def]
    """Weights ``w = N_I m exp(s z)`` of points by their heights z, and w z: their mean is z."""
    for group in cloud.groups:
        for a in range(cloud.dofs.shape[1]):
            node = cloud.dofs[group, a]
            if not meets[node]:
                continue
            for k in range(cloud.offsets[group], cloud.offsets[group + 1]):
                p = cloud.order[k]
                z = _height(cloud, p, nodes[node], directions[node])
                weight = cloud.table[k, a] * cloud.mass[p] * np.exp(steepness * z)
                sums[node, 0] += weight
                sums[node, 1] += weight * z


@njit
def _add_forces(  # type: ignore[no-untyped-def]
    cloud, pushes, nodes, directions, steepness, vectors, forces
):
    """Share out forces of nodes, given per weight, with the weights of ``_add_heights``."""
    for group in cloud.groups:
        for a in range(cloud.dofs.shape[1]):
            node = cloud.dofs[group, a]
            if not pushes[node]:
                continue
            for k in range(cloud.offsets[group], cloud.offsets[group + 1]):
                p = cloud.order[k]
                z = _height(cloud, p, nodes[node], directions[node])
                weight = cloud.table[k, a] * cloud.mass[p] * np.exp(steepness * z)
                for i in range(nodes.shape[1]):
                    forces[p, i] += weight * vectors[node, i]


class Grip(NamedTuple):
    """What rubs where two fields meet.

    Attributes:
        fields: numbers of the first and the second one.
        nodes: ``(n,)`` at which they push each other.
        normal: ``(n, d)`` from the first to the second.
        limit: ``(n, 1)`` largest impulse of friction [N s].
    """

    fields: tuple[int, int]
    nodes: npt.NDArray[np.int64]
    normal: Array
    limit: Array


def rub(
    grips: Sequence[Grip],
    masses: Sequence[Array],
    velocities: Sequence[Array],
    fixed: npt.NDArray[np.bool_],
) -> list[Array]:
    """Stop slip by equal and opposite impulses at the nodes, as far as friction goes.

    Where several pairs meet at a node, they take turns.

    Args:
        grips: of pairs of fields.
        masses: ``(n_nodes,)`` of each field [kg].
        velocities: ``(n_nodes, d)`` of each field at the end of the step, changed in place [m/s].
        fixed: ``(n_nodes, d)`` components that are prescribed, the same for all fields.

    Returns:
        ``(n, d)`` impulses on the second field at the nodes of each pair [N s].
    """
    impulses = [np.zeros_like(grip.normal) for grip in grips]
    for _ in range(1 if len(grips) == 1 else _ROUNDS):
        for grip, impulse in zip(grips, impulses, strict=True):
            nodes, n, (a, b) = grip.nodes, grip.normal, grip.fields
            m_a, m_b = masses[a][nodes, None], masses[b][nodes, None]
            # momentum that there would be without this pair's impulse
            apart = m_a * m_b / (m_a + m_b) * (velocities[b][nodes] - velocities[a][nodes])
            apart -= impulse
            slip = apart - np.sum(apart * n, axis=1, keepdims=True) * n
            slip[fixed[nodes]] = 0.0
            size = np.linalg.norm(slip, axis=1, keepdims=True)
            share = np.divide(grip.limit, size, out=np.ones_like(size), where=size > grip.limit)
            change = -share * slip - impulse
            velocities[a][nodes] -= change / m_a
            velocities[b][nodes] += change / m_b
            impulse += change
    return impulses
