# SPDX-License-Identifier: MIT
"""Nodal fields of bodies that share velocities, in explicit steps by forms."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
from dolfinx import fem

from fenicsmpm.points import MaterialPoints
from fenicsmpm.simulation.contact import Contact
from fenicsmpm.transfer import p2g
from fenicsmpm.transfer.light_nodes import LIGHT, LightNodes
from fenicsmpm.transfer.multi_field import Grip, Interfaces, rub

Array = npt.NDArray[np.float64]


class NodalField:
    """Mass, velocity and force of bodies at all local nodes.

    Args:
        bodies: Updates of the bodies' points, ``BodyByForms``.
        form: The residual's integrals over these points; None for none.
        shape: Shape ``(n_nodes, d)`` of nodal vectors.

    Attributes:
        mass: Mass in kg, ``(n_nodes,)``.
        velocity: Velocity in m/s, ``(n_nodes, d)``.
        force: Force in N, ``(n_nodes, d)``.
        increment: Change of the velocity in a step in m/s, ``(n_nodes, d)``.
        straining: Velocity in m/s whose gradient deforms the points, ``(n_nodes, d)``.
    """

    def __init__(self, bodies: Sequence[Any], form: Any, shape: tuple[int, int]) -> None:
        """Create fields without mass."""
        self.bodies, self.form = list(bodies), form
        self.mass: Array = np.zeros(shape[0])
        self.velocity: Array = np.zeros(shape)
        self.force: Array = np.zeros(shape)
        self.increment: Array = np.zeros(shape)
        self.straining: Array = self.velocity


def share_out(total: Array, fields: Sequence[NodalField]) -> None:
    """Distribute forces at nodes ``(n_nodes, d)`` to the fields there, by their masses."""
    mass = np.sum([field.mass for field in fields], axis=0)
    for field in fields:
        share = np.divide(field.mass, mass, out=np.ones_like(mass), where=mass > 0)
        field.force += share[:, None] * total


def mean(name: str, fields: Sequence[NodalField]) -> Array:
    """Return the mass-weighted mean of an attribute of the fields, ``(n_nodes, d)``."""
    first: Array = getattr(fields[0], name)
    if len(fields) == 1:
        return first
    mass = np.sum([field.mass for field in fields], axis=0)[:, None]
    total = np.sum([field.mass[:, None] * getattr(field, name) for field in fields], axis=0)
    return np.divide(total, mass, out=first.copy(), where=mass > 0)


class ContactsOfFields:
    """Contacts between fields.

    Args:
        contacts: Contacts between bodies.
        fields: Fields; bodies in contact belong to different ones.
        space: Space of velocities. Collective.
        scalars: Space of a scalar on the same nodes.
        light_nodes: Redistribution of forces for the same space.
    """

    def __init__(
        self,
        contacts: Sequence[Contact],
        fields: Sequence[NodalField],
        space: fem.FunctionSpace,
        scalars: fem.FunctionSpace,
        light_nodes: LightNodes,
    ) -> None:
        """Find the pairs of fields in contact."""
        self._fields, self._space, self._light_nodes = fields, space, light_nodes
        self._of_pairs: dict[tuple[int, int], list[Contact]] = {}
        for contact in contacts:
            pair = (self._number(contact.first), self._number(contact.second))
            self._of_pairs.setdefault(pair, []).append(contact)
        self._interfaces = Interfaces(scalars) if contacts else None
        self._grips: list[Grip] = []
        self._forces: dict[tuple[int, int], Array] = {}

    def _number(self, points: MaterialPoints) -> int:
        """Return the number of the field of a body."""
        return next(
            k for k, f in enumerate(self._fields) if any(b.points is points for b in f.bodies)
        )

    def push(self, rate: float, dt: float) -> None:
        """Add normal forces to the forces of the fields. Collective.

        Args:
            rate: Square of the frequency in 1/s^2 that the stiffness of a ``Contact`` refers to.
            dt: Length of the step in s; no contact may push back faster than once per step.
        """
        self._grips = []
        if self._interfaces is None:
            return
        masses = [field.mass for field in self._fields]
        for (a, b), contacts in self._of_pairs.items():
            bodies = [[body.points for body in self._fields[k].bodies] for k in (a, b)]
            meeting = self._interfaces.between((bodies[0], bodies[1]), (masses[a], masses[b]))
            self._forces[a, b] = np.zeros_like(self._fields[a].velocity)
            for contact in contacts:
                contact.force, contact.gap = np.zeros(self._forces[a, b].shape[1]), np.inf
            if meeting is None:
                continue
            nodes = np.flatnonzero(meeting.gap < 0)
            m_a, m_b = masses[a][nodes], masses[b][nodes]
            stiffness = min(contacts[0].stiffness * rate, 1 / dt**2) * m_a * m_b / (m_a + m_b)
            push = np.zeros_like(meeting.gap)
            push[nodes] = -stiffness * meeting.gap[nodes]
            for points, forces in self._interfaces.point_forces(meeting, push):
                number = self._number(points)
                total = p2g(points, forces, self._space, positive=True).array
                total = total.reshape(-1, forces.shape[1])
                self._light_nodes.relieve(masses[number], total, LIGHT, False)
                self._fields[number].force += total
                if number == b:
                    self._forces[a, b] += total
            normal, friction = meeting.normal[nodes], contacts[0].friction
            limit = friction * push[nodes, None] * dt
            self._grips.append(Grip((a, b), nodes, normal, limit))
            least = float(meeting.gap.min(initial=np.inf))
            for contact in contacts:
                contact.gap = self._space.mesh.comm.allreduce(least, MPI.MIN)

    def rub(self, fixed: npt.NDArray[np.bool_], dt: float) -> None:
        """Change the velocities of all fields by friction. Collective.

        Args:
            fixed: Mask of prescribed components, ``(n_nodes, d)``.
            dt: Length of the step in s.
        """
        masses = [field.mass for field in self._fields]
        impulses = rub(self._grips, masses, [field.velocity for field in self._fields], fixed)
        owned = self._space.dofmap.index_map.size_local
        for grip, impulse in zip(self._grips, impulses, strict=True):
            forces = self._forces[grip.fields]
            forces[grip.nodes] += impulse / dt
            total = self._space.mesh.comm.allreduce(forces[:owned].sum(axis=0))
            for contact in self._of_pairs[grip.fields]:
                contact.force = total

    def nodal_forces(self, contact: Contact) -> Array:
        """Return forces in N of a contact on its second body in the last step, ``(n_nodes, d)``."""
        pair = (self._number(contact.first), self._number(contact.second))
        return self._forces.get(pair, np.zeros_like(self._fields[0].velocity))
