# SPDX-License-Identifier: MIT
"""Rigid bodies of a simulation and their states in checkpoints."""

from __future__ import annotations

from collections.abc import Sequence

import ufl

from fenicsmpm.formulations.lumped_projection import all_coefficients
from fenicsmpm.points.point_field import ComputedField
from fenicsmpm.rigid import RigidBody


def slip_on(number: int) -> str:
    """Return the name of the field ``(n, 2, d)`` in m of slip on a rigid body.

    It holds the friction spring and the path in the last step, both in the frame in which the shape
    of the body was given.

    Args:
        number: Number of the body in ``ExplicitMPM.rigid``.
    """
    return f"slip on rigid body {number}"


def rigid_bodies_in(form: ufl.Form) -> list[RigidBody]:
    """Return the rigid bodies that points touch by terms of a form, in order of creation.

    Args:
        form: Residual of a loop.
    """
    fields = [c for c in all_coefficients(form) if isinstance(c, ComputedField)]
    sources = [field.source for field in sorted(fields, key=lambda field: field.count())]
    return list(dict.fromkeys(source for source in sources if isinstance(source, RigidBody)))


def memory_of(bodies: Sequence[RigidBody]) -> dict[str, float]:
    """Return the states of rigid bodies as numbers with names."""
    return {
        f"rigid body {k}: {name}": value
        for k, body in enumerate(bodies)
        for name, value in body.state.items()
    }


def remember(bodies: Sequence[RigidBody], values: dict[str, float]) -> None:
    """Restore states that ``memory_of`` returned, and remove them from the values."""
    for k, body in enumerate(bodies):
        body.state = {name: values.pop(f"rigid body {k}: {name}") for name in body.state}
