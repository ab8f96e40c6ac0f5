# SPDX-License-Identifier: MIT
"""What the parts of an implicit simulation must have, so that it does what they say."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from typing import Any

from fenicsmpm.forms import Form
from fenicsmpm.points import MaterialPoints

logger = logging.getLogger(__name__)


def require_fields(body: MaterialPoints) -> None:
    """Raise ValueError for a body without the fields of ``set_initial_state``."""
    needed = ("mass", "V_0", "F", "J", "u", "v", "grad_v")
    missing = [name for name in needed if name not in body]
    if missing:
        raise ValueError(
            f"a body without the fields {', '.join(missing)} cannot move: call "
            "set_initial_state(points, density) before its formulation is written down"
        )


def warn_of_points_that_stay(R: Form, moving: Sequence[MaterialPoints]) -> None:
    """Log a warning for integrals over points that do not move."""
    for integral in R.point_integrals:
        if integral.points not in moving:
            logger.warning(
                "%d points of an integral are neither bodies nor carried: they stay where they "
                "are", integral.points.size_global,
            )  # fmt: skip


def check_updates(
    R: Form,
    bodies: Sequence[MaterialPoints],
    moving: Sequence[MaterialPoints],
    updates: Mapping[MaterialPoints, Mapping[str, Any]],
) -> None:
    """Raise ValueError for updates that cannot be made, or are missing.

    Args:
        R: residual.
        bodies: of the simulation.
        moving: these, and what is carried along.
        updates: new fields at the end of a step.
    """
    for points, fields in updates.items():
        unknown = sorted(name for name in fields if name not in points)
        if points not in moving or unknown:
            raise ValueError(
                f"updates of the fields {unknown} that the points do not have"
                if unknown
                else "updates of points that are neither bodies nor carried: they do not move"
            )
    used = [
        (integral.points, source.item)
        for integral in R.point_integrals
        for source in integral.lowered.inputs
    ]
    used += [(body, body.field(name)) for body in bodies for name in body.field_names]
    for points, field in used:
        missing = sorted(set(getattr(field, "history", ())) - set(updates.get(points, ())))
        if points in bodies and missing:
            raise ValueError(
                f"a material needs the fields {', '.join(missing)}, which no update renews: "
                "pass updates={body: stress.updates}, or of a fluid {body: law.updates(body)}"
            )
