# SPDX-License-Identifier: MIT
"""Coulomb friction that is elastic up to its limit, in UFL."""

from __future__ import annotations

from typing import Any

import numpy as np
import ufl

from fenicsmpm._numbers import number
from fenicsmpm.formulations.stabilization_parameters import element_size
from fenicsmpm.points.point_field import PointField

_SMALL = 1e-12  # share of the cell size that is added to lengths, so that they have a derivative


def checked_friction(friction: float) -> float:
    """Return a coefficient of friction if it is finite and not negative.

    Args:
        friction: Coefficient of Coulomb friction [-].

    Raises:
        ValueError: If it is no number, negative or not finite.
    """
    value = number(friction, "friction", "a coefficient of friction", "-")
    if not 0 <= value < np.inf:
        raise ValueError(f"a coefficient of friction must be finite and not negative: {value}")
    return value


def elastic_slip(spring: PointField, way: Any, normal: Any, limit: Any) -> Any:
    """Return the spring that a point drags along a surface ``(d,)`` [m], UFL.

    See P. Wriggers, Computational Contact Mechanics, 2006, section 5.2.

    Args:
        spring: Spring before the step ``(d,)`` [m].
        way: Relative displacement of the point in the step ``(d,)`` [m]; its normal part is
            ignored.
        normal: Normal of the surface ``(d,)`` [-].
        limit: Largest length of the spring that friction allows [m].
    """
    trial = spring + way
    trial -= ufl.dot(trial, normal) * normal
    small = _SMALL * element_size(spring.points)
    length = ufl.sqrt(ufl.inner(trial, trial) + small**2)
    return ufl.conditional(length < limit, 1.0, limit / length) * trial
