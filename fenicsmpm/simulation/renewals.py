# SPDX-License-Identifier: MIT
"""How fields of points get their values at the end of a step."""

from __future__ import annotations

import inspect
from collections.abc import Mapping, Sequence
from typing import Any

import ufl
from ufl.algorithms import extract_coefficients
from ufl.core.expr import Expr

from fenicsmpm.formulations.kinematics import Kinematics
from fenicsmpm.formulations.lumped_projection import all_coefficients
from fenicsmpm.points import MaterialPoints
from fenicsmpm.points.point_field import ComputedField, PointField


def renewals(
    form: ufl.Form, increments: Mapping[MaterialPoints, Any]
) -> dict[MaterialPoints, dict[str, Any]]:
    """What the fields in a form say of how they are renewed, and the fields in that, and so on.

    Args:
        form: residual of a loop.
        increments: of displacement in a step [m], UFL, of the loop's bodies and carried points.

    Returns:
        For each of the moving points, new values by the names of their fields: UFL over the points,
        or functions that return arrays.

    Raises:
        ValueError: for a field that is renewed twice, or one of points that do not move.
    """
    found: dict[MaterialPoints, dict[str, Any]] = {points: {} for points in increments}
    said: dict[tuple[MaterialPoints, str], Any] = {}
    pending, seen = list(all_coefficients(form)), set()
    while pending:
        field = pending.pop()
        if not isinstance(field, PointField) or field in seen:
            continue
        seen.add(field)
        if isinstance(field, ComputedField):
            pending += field.inputs
        points = field.points
        if field.renewals and points not in found:
            raise ValueError(
                f"the field {field.name!r} changes in each step, but its points are neither bodies "
                "nor carried points of this simulation: nobody would renew it"
            )
        for name, value in field.renewals.items():
            if said.setdefault((points, name), value) is not value:
                raise ValueError(
                    f"the field {name!r} is renewed twice, in different ways: one stress or one "
                    "call of renew(..) is to say how"
                )
            if name in found[points]:
                continue
            if not isinstance(value, Expr) and inspect.signature(value).parameters:
                value = value(Kinematics(increments[points], points))
            found[points][name] = value
            if isinstance(value, Expr):
                pending += extract_coefficients(value)
    return found


def check_updates(
    updates: Mapping[MaterialPoints, Mapping[str, Any]], moving: Sequence[MaterialPoints]
) -> None:
    """Raise ValueError for a user's updates that cannot be made.

    Args:
        updates: new fields at the end of a step.
        moving: the loop's bodies and carried points.
    """
    for points, fields in updates.items():
        if points not in moving:
            raise ValueError(
                "updates of points that are neither bodies nor carried: they do not move"
            )
        unknown = sorted(name for name in fields if name not in points)
        if unknown:
            raise ValueError(f"updates of the fields {unknown} that the points do not have")
