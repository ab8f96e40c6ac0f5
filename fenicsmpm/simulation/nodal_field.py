# SPDX-License-Identifier: MIT
"""What the nodes have of bodies that share velocities, in explicit steps by forms."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
from dolfinx import fem

from fenicsmpm.points import MaterialPoints
from fenicsmpm.simulation.contact import Contact
from fenicsmpm.transfer.multi_field import Interfaces, Pair, contact_impulses

Array = npt.NDArray[np.float64]


class NodalField:
    """Mass, velocity and force of bodies at all local nodes.

    Args:
        bodies: what happens at their points, ``BodyByForms``.
        form: of the residual's integrals over their points; None for none.
        shape: ``(n_nodes, d)``.

    Attributes:
        mass: ``(n_nodes,)`` [kg].
        velocity: ``(n_nodes, d)`` [m/s].
        force: ``(n_nodes, d)`` [N].
        increment: ``(n_nodes, d)`` by which the velocity changes in a step [m/s].
        straining: ``(n_nodes, d)`` velocity whose gradient deforms the points [m/s].
    """

    def __init__(self, bodies: Sequence[Any], form: Any, shape: tuple[int, int]) -> None:
        """Nothing has mass yet."""
        self.bodies, self.form = list(bodies), form
        self.mass: Array = np.zeros(shape[0])
        self.velocity: Array = np.zeros(shape)
        self.force: Array = np.zeros(shape)
        self.increment: Array = np.zeros(shape)
        self.straining: Array = self.velocity


def share_out(total: Array, fields: Sequence[NodalField]) -> None:
    """Give forces at nodes ``(n_nodes, d)`` to the fields there, by their masses."""
    mass = np.sum([field.mass for field in fields], axis=0)
    for field in fields:
        share = np.divide(field.mass, mass, out=np.ones_like(mass), where=mass > 0)
        field.force += share[:, None] * total


def mean(name: str, fields: Sequence[NodalField]) -> Array:
    """Mean by mass of what the fields have, ``(n_nodes, d)``."""
    first: Array = getattr(fields[0], name)
    if len(fields) == 1:
        return first
    mass = np.sum([field.mass for field in fields], axis=0)[:, None]
    total = np.sum([field.mass[:, None] * getattr(field, name) for field in fields], axis=0)
    return np.divide(total, mass, out=first.copy(), where=mass > 0)


class ContactsOfFields:
    """Contacts between fields.

    Args:
        contacts: between bodies.
        fields: such that bodies in contact are in different ones.
        scalars: space of a scalar on the nodes (collective).
    """

    def __init__(
        self, contacts: Sequence[Contact], fields: Sequence[NodalField], scalars: fem.FunctionSpace
    ) -> None:
        """Find the pairs of fields in contact."""
        self._fields, self._scalars = fields, scalars
        self._of_pairs: dict[tuple[int, int], list[Contact]] = {}
        for contact in contacts:
            pair = (self._number(contact.first), self._number(contact.second))
            self._of_pairs.setdefault(pair, []).append(contact)
        self._interfaces = Interfaces(scalars) if contacts else None
        self._forces: dict[int, tuple[npt.NDArray[np.int64], Array]] = {}

    def _number(self, points: MaterialPoints) -> int:
        """Of the field of a body."""
        return next(
            k for k, f in enumerate(self._fields) if any(b.points is points for b in f.bodies)
        )

    def act(self, fixed: npt.NDArray[np.bool_], dt: float) -> None:
        """Change the velocities of all fields by contact (collective).

        Args:
            fixed: ``(n_nodes, d)`` prescribed components.
            dt: step [s].
        """
        if self._interfaces is None:
            return
        fields, pairs = self._fields, []
        points = [[body.points for body in field.bodies] for field in fields]
        masses = [field.mass for field in fields]
        for (a, b), contacts in self._of_pairs.items():
            meeting = self._interfaces.between(points[a], points[b], (masses[a], masses[b]))
            pairs.append(Pair(a, b, contacts[0].friction, meeting))
        velocities = [field.velocity for field in fields]
        impulses = contact_impulses(pairs, masses, velocities, fixed, dt)
        comm, owned = self._scalars.mesh.comm, self._scalars.dofmap.index_map.size_local
        for pair, J, contacts in zip(pairs, impulses, self._of_pairs.values(), strict=True):
            nodes, gap = pair.meeting.nodes, pair.meeting.gap
            force = comm.allreduce(J[nodes < owned].sum(axis=0)) / dt
            least = comm.allreduce(float(gap.min(initial=np.inf)), MPI.MIN)
            for contact in contacts:
                contact.force, contact.gap = force, least
                self._forces[id(contact)] = nodes, J / dt

    def nodal_forces(self, contact: Contact) -> Array:
        """Of a contact on its second body in the last step, ``(n_nodes, d)`` [N]."""
        result = np.zeros_like(self._fields[0].velocity)
        if id(contact) in self._forces:
            nodes, forces = self._forces[id(contact)]
            result[nodes] = forces
        return result
