# SPDX-License-Identifier: MIT
"""New values of point fields at the end of a step."""

from __future__ import annotations

import inspect
from collections.abc import Mapping, Sequence
from typing import Any

import ufl
from ufl.algorithms import extract_coefficients
from ufl.algorithms.renumbering import renumber_indices
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
            kinematics = Kinematics(increments[points], points)
            new = _of_step(value, kinematics)
            # once a loop has them, another one may renew the field in another way
            said = points.field(name).take_said() if name in points else []
            others = [_of_step(other, kinematics) for other in said if other is not value]
            if name in found[points]:
                others.append(found[points][name])
            if not all(_is_same(new, other) for other in others):
                raise ValueError(
                    f"the field {name!r} is renewed twice, in different ways: use one stress or "
                    "one call of renew(..) for it"
                )
            if name not in found[points]:
                found[points][name] = new
                if isinstance(new, Expr):
                    pending += extract_coefficients(new)
    return found


def _of_step(value: Any, kinematics: Kinematics) -> Any:
    """Return a new value in terms of a step: UFL, or a function that returns an array."""
    if not isinstance(value, Expr) and inspect.signature(value).parameters:
        return value(kinematics)
    return value


def _is_same(one: Any, other: Any) -> bool:
    """Return whether two new values are the same but for the numbers of free indices."""
    if isinstance(one, Expr) and isinstance(other, Expr):
        return bool(one == other or renumber_indices(one) == renumber_indices(other))
    return bool(one == other)


def check_updates(
    updates: Mapping[MaterialPoints, Mapping[str, Any]],
    moving: Sequence[MaterialPoints],
    renewed: Mapping[MaterialPoints, Mapping[str, Any]],
) -> None:
    """Raise ValueError for updates of the user that are impossible.

    Args:
        updates: New fields at the end of a step.
        moving: The loop's bodies and carried points.
        renewed: Fields that are renewed anyway, as ``renewals`` returns them.
    """
    for points, fields in updates.items():
        if points not in moving:
            raise ValueError(
                "updates are given for points that are neither bodies nor carried: they do not move"
            )
        unknown = sorted(name for name in fields if name not in points)
        if unknown:
            raise ValueError(f"updates are given for fields that the points do not have: {unknown}")
        for name in fields:
            if name in renewed[points] and not _is_same(fields[name], renewed[points][name]):
                raise ValueError(
                    f"the field {name!r} is renewed twice: its stress or renew(..) gives it a new "
                    "value already, so leave it out of updates"
                )
