# SPDX-License-Identifier: MIT
"""Contact between bodies in explicit steps, and groups of bodies that share nodal velocities."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
import numpy.typing as npt

from fenicsmpm._numbers import number
from fenicsmpm.cells.weight_correction import filled_fractions
from fenicsmpm.points import MaterialPoints
from fenicsmpm.points.agreement import raise_together

# Volumes of points of both bodies per volume of a cell in which they overlap
_BOTH = 1.75


class Contact:
    """Contact of two bodies in explicit steps: they touch, slide and separate instead of sticking.

    Each of them has nodal velocities of its own. They interact when the domains of their points
    meet: they are pushed apart in proportion to their overlap, and never pulled together. Coulomb
    friction acts against slip. The bodies stick as long as that needs less than the limit of
    friction.

    Args:
        first: A body.
        second: Another body.
        friction: Coulomb's friction coefficient; infinite for no slip while bodies are pressed
            together.
        stiffness: Stiffness of the contact at a node, in units of the reduced mass of both bodies
            there over the square of the time that a wave takes through a cell. It is lowered if
            the step is too long for it. With the default, a contact is about as stiff as a layer
            of the bodies that is 0.7 cells thick, and ``cfl`` may be up to 0.4.

    Attributes:
        force: Force on the second body in the last step in N, ``(d,)``; that on the first body is
            opposite.
        gap: Smallest gap in m at a node that both bodies reached in the last step, from the
            positions at its beginning; negative for an overlap, infinite without such a node.

    Raises:
        ValueError: For a friction that is negative or NaN, a stiffness that is not positive and
            finite, and for a contact of a body with itself.
    """

    def __init__(
        self,
        first: MaterialPoints,
        second: MaterialPoints,
        friction: float = 0.0,
        stiffness: float = 6.0,
    ) -> None:
        """Check the input."""
        if first is second:
            raise ValueError("a body cannot touch itself: its points share velocities")
        friction = number(friction, "friction", "a coefficient of friction", "-")
        stiffness = number(stiffness, "stiffness", "the stiffness of a contact", "-")
        if not friction >= 0:
            raise ValueError(f"friction must be a number that is not negative, not {friction}")
        if not 0 < stiffness < np.inf:
            raise ValueError(f"stiffness must be positive and finite, not {stiffness}")
        self.first, self.second = first, second
        self.friction, self.stiffness = float(friction), float(stiffness)
        self.force: npt.NDArray[np.float64] = np.zeros(first.mesh.geometry.dim)
        self.gap = np.inf

    def __repr__(self) -> str:
        """Return friction, last force and gap as text."""
        return f"Contact(friction={self.friction:g}; force {self.force} N, gap {self.gap:g} m)"


def share_velocities(
    bodies: Sequence[MaterialPoints], contacts: Sequence[Contact]
) -> list[list[MaterialPoints]]:
    """Return groups of bodies that share nodal velocities: those without a contact between them.

    Args:
        bodies: Bodies of the simulation.
        contacts: Contacts between them.

    Raises:
        ValueError: For contacts of point sets that are no body, two contacts of one pair, bodies in
            contact that both share velocities with a third one, and different frictions between
            the same groups.
    """
    number = {id(body): k for k, body in enumerate(bodies)}
    frictions: dict[tuple[int, int], float] = {}
    for contact in contacts:
        ends = [number.get(id(body)) for body in (contact.first, contact.second)]
        if None in ends:
            raise ValueError(
                "a contact needs bodies of this simulation: pass both as bodies, since carried "
                "points have no mass and move with the grid"
            )
        pair = (min(ends), max(ends))  # type: ignore[type-var]
        if pair in frictions:
            raise ValueError(f"the bodies {pair[0]} and {pair[1]} have two contacts: give one")
        frictions[pair] = contact.friction  # type: ignore[index]
    group = list(range(len(bodies)))
    for a, b in combinations(range(len(bodies)), 2):
        if (a, b) not in frictions:
            group = [group[a] if g == group[b] else g for g in group]
    between: dict[tuple[int, int], float] = {}
    for (a, b), friction in frictions.items():
        if group[a] == group[b]:
            others = [k for k in range(len(bodies)) if group[k] == group[a] and k not in (a, b)]
            raise ValueError(
                f"the bodies {a} and {b} are in contact, but share velocities with the bodies "
                f"{others}, which have no contact with them: give these contacts, too"
            )
        pair = (min(group[a], group[b]), max(group[a], group[b]))
        if between.setdefault(pair, friction) != friction:
            raise ValueError(
                f"frictions {between[pair]} and {friction} act between bodies that share "
                "velocities: use one value, or give contacts between the bodies on the same side, "
                "too"
            )
    return [[bodies[k] for k in range(len(bodies)) if group[k] == g] for g in sorted({*group})]


def require_apart(contacts: Sequence[Contact]) -> None:
    """Raise ValueError, on all ranks, for bodies in contact that are in each other. Collective.

    A cell that is nearly full of both shows that they overlap by about a cell or more. Less may be
    wanted, to begin with a pressure.

    Args:
        contacts: Between bodies.
    """
    for contact in contacts:
        first, second = filled_fractions(contact.first), filled_fractions(contact.second)
        full = np.flatnonzero((np.minimum(first, second) > 0.5) & (first + second > _BOTH))
        error = None
        if len(full):
            centre = contact.first.geometry.corners(full[:1].astype(np.int32))[0].mean(axis=0)
            error = ValueError(
                f"bodies in contact overlap by a cell or more: the one at {centre} is filled to "
                f"{first[full[0]]:.2f} and {second[full[0]]:.2f} by them; move them apart"
            )
        raise_together(contact.first.mesh.comm, error)
