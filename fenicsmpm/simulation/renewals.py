# SPDX-License-Identifier: MIT
"""New values of point fields at the end of a step."""

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
    """Collect how the fields in a form are renewed, the fields in these new values, and so on.

    Args:
        form: Residual of a loop.
        increments: Displacement increments of a step in m, UFL, by the loop's bodies and carried
            points.

    Returns:
        New values for each of the moving point sets by the names of its fields: UFL over the
        points, or functions that return arrays.

    Raises:
        ValueError: For a field that is renewed twice, or one of points that do not move.
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
                "nor carried points of this simulation: pass them to it"
            )
        for name, value in field.renewals.items():
            if said.setdefault((points, name), value) is not value:
                raise ValueError(
                    f"the field {name!r} is renewed twice, in different ways: use one stress or "
                    "one call of renew(..) for it"
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
    """Raise ValueError for updates of the user that are impossible.

    Args:
        updates: New fields at the end of a step.
        moving: The loop's bodies and carried points.
    """
    for points, fields in updates.items():
        if points not in moving:
            raise ValueError(
                "updates are given for points that are neither bodies nor carried: they do not move"
            )
        unknown = sorted(name for name in fields if name not in points)
        if unknown:
            raise ValueError(f"updates are given for fields that the points do not have: {unknown}")
