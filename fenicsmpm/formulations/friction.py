# SPDX-License-Identifier: MIT
"""Coulomb's friction that is elastic up to its limit, in UFL."""

from __future__ import annotations

from typing import Any

import numpy as np
import ufl

from fenicsmpm.formulations.stabilization_parameters import element_size
from fenicsmpm.points.point_field import PointField

_SMALL = 1e-12  # of a cell: a length that is never zero has a derivative


def checked_friction(friction: float) -> float:
    """A coefficient of friction; ValueError if it is negative or not finite.

    Args:
        friction: Coulomb's coefficient [-].
    """
    if not 0 <= friction < np.inf:
        raise ValueError(f"a coefficient of friction is finite and not negative: {friction}")
    return float(friction)


def elastic_slip(spring: PointField, way: Any, normal: Any, limit: Any) -> Any:
    """Spring that a point drags along a surface (P. Wriggers, 2006, section 5.2), UFL ``(d,)`` [m].

    Args:
        spring: what it was before the step [m].
        way: of the point along the surface in the step ``(d,)`` [m]; its normal part is left out.
        normal: of the surface ``(d,)`` [-].
        limit: length up to which friction lets it grow [m].
    """
    trial = spring + way
    trial -= ufl.dot(trial, normal) * normal
    small = _SMALL * element_size(spring.points)
    length = ufl.sqrt(ufl.inner(trial, trial) + small**2)
    return ufl.conditional(length < limit, 1.0, limit / length) * trial
