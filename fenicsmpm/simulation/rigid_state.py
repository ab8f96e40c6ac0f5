# SPDX-License-Identifier: MIT
"""Rigid bodies of a simulation: which there are, and what checkpoints keep of them."""

from __future__ import annotations

from collections.abc import Sequence

import ufl

from fenicsmpm.formulations.lumped_projection import all_coefficients
from fenicsmpm.points.point_field import ComputedField
from fenicsmpm.rigid import RigidBody


def slip_on(number: int) -> str:
    """Field ``(n, 2, d)`` [m]: spring of friction on a rigid body, and way in the last step.

    Both are in the frame in which the body's shape was given.

    Args:
        number: of the body in ``ExplicitMPM.rigid``.
    """
    return f"slip on rigid body {number}"


def rigid_bodies_in(form: ufl.Form) -> list[RigidBody]:
    """Rigid bodies that points touch by terms of a form, in the order in which they were made.

    Args:
        form: residual of a loop.
    """
    fields = [c for c in all_coefficients(form) if isinstance(c, ComputedField)]
    sources = [field.source for field in sorted(fields, key=lambda field: field.count())]
    return list(dict.fromkeys(source for source in sources if isinstance(source, RigidBody)))


def memory_of(bodies: Sequence[RigidBody]) -> dict[str, float]:
    """States of rigid bodies as numbers with names."""
    return {
        f"rigid body {k}: {name}": value
        for k, body in enumerate(bodies)
        for name, value in body.state.items()
    }


def remember(bodies: Sequence[RigidBody], values: dict[str, float]) -> None:
    """Bring rigid bodies to states that ``memory_of`` gave, and take these from the values."""
    for k, body in enumerate(bodies):
        body.state = {name: values.pop(f"rigid body {k}: {name}") for name in body.state}
