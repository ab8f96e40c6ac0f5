# SPDX-License-Identifier: MIT
"""Checks that the parts of a simulation are consistent and complete."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Sequence
from typing import Any

from dolfinx import fem

from fenicsmpm import _compat
from fenicsmpm.points import MaterialPoints

logger = logging.getLogger(__name__)


def check_bcs(bcs: Sequence[fem.DirichletBC], V: fem.FunctionSpace) -> None:
    """Raise ValueError if Dirichlet conditions would have no or a wrong effect. Collective.

    Args:
        bcs: Dirichlet conditions.
        V: Function space of the unknown.

    Raises:
        ValueError: If a condition is defined on another space, or has no degrees of freedom.
    """
    for bc in bcs:
        if not _compat.is_on(bc, V):
            raise ValueError(
                "Dirichlet condition on another function space than the unknown's: give "
                "dirichletbc the space of the unknown, or a part of it, W.sub(i)"
            )
        if V.mesh.comm.allreduce(len(_compat.bc_dofs(bc))) == 0:
            raise ValueError(
                "Dirichlet condition on no degrees of freedom: check the marker that selects them"
            )


def require_fields(body: MaterialPoints) -> None:
    """Raise ValueError if a body lacks the fields of ``set_initial_state``.

    Args:
        body: The body.

    Raises:
        ValueError: If a field is missing.
    """
    needed = ("mass", "V_0", "F", "J", "u", "v")
    missing = [name for name in needed if name not in body]
    if missing:
        raise ValueError(
            f"a body without the fields {', '.join(missing)} cannot move: call "
            "set_initial_state(points, density) before you define its formulation"
        )


def require_points(bodies: Sequence[MaterialPoints]) -> None:
    """Raise ValueError, on all ranks, if no body has any points.

    Args:
        bodies: The bodies.

    Raises:
        ValueError: If all bodies are empty.
    """
    if sum(body.size_global for body in bodies) == 0:
        raise ValueError("all bodies are empty: there are no points to move")


def warn_of_points_that_stay(domains: Iterable[Any], moving: Sequence[MaterialPoints]) -> None:
    """Log a warning for integrals over points that do not move.

    Args:
        domains: Domains of integrals: point sets and others.
        moving: Point sets that the simulation moves.
    """
    for points in dict.fromkeys(p for p in domains if isinstance(p, MaterialPoints)):
        if points not in moving:
            logger.warning(
                "%d points of an integral are neither bodies nor carried: they stay where they "
                "are", points.size_global,
            )  # fmt: skip
