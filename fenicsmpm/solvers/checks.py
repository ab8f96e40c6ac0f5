# SPDX-License-Identifier: MIT
"""What the parts of an implicit simulation must have, so that it does what they say."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from typing import Any

from dolfinx import fem

from fenicsmpm import _compat
from fenicsmpm.forms import Form
from fenicsmpm.points import MaterialPoints

logger = logging.getLogger(__name__)


def check_bcs(bcs: Sequence[fem.DirichletBC], V: fem.FunctionSpace) -> None:
    """Raise ValueError for Dirichlet conditions that would not do what they say (collective).

    Args:
        bcs: the conditions.
        V: space of the unknown.
    """
    for bc in bcs:
        if not _compat.is_on(bc, V):
            raise ValueError(
                "Dirichlet condition on another function space than the unknown's: give "
                "dirichletbc the space of the unknown, or a part of it, W.sub(i)"
            )
        if V.mesh.comm.allreduce(len(_compat.bc_dofs(bc))) == 0:
            raise ValueError(
                "Dirichlet condition on no degrees of freedom: check the marker that should find "
                "them"
            )


def require_fields(body: MaterialPoints) -> None:
    """Raise ValueError for a body without the fields of ``set_initial_state``."""
    needed = ("mass", "V_0", "F", "J", "u", "v")
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
    share: float,
) -> None:
    """Raise ValueError for updates that cannot be made, are missing, or are of another time.

    Args:
        R: residual.
        bodies: of the simulation.
        moving: these, and what is carried along.
        updates: new fields at the end of a step.
        share: of the step, at whose end equations hold.
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
        history = set(getattr(field, "history", ())) if points in bodies else set()
        # a fluid renews F itself, at the end of the step
        if share != 1 and history and "F" not in history:
            raise ValueError(
                "a stress with a state or of two configurations is found where equations hold, and "
                "its state belongs to the end of the step: GeneralizedAlpha cannot be used with it"
            )
        missing = sorted(history - set(updates.get(points, ())))
        if missing:
            raise ValueError(
                f"a material needs the fields {', '.join(missing)}, which no update renews: "
                "pass updates={body: stress.updates}, or of a fluid {body: law.updates(body)}"
            )
