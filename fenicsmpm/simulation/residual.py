# SPDX-License-Identifier: MIT
"""Decomposition of the residual of explicit steps."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import ufl
from dolfinx import fem
from ufl.algorithms import extract_arguments, extract_coefficients, replace
from ufl.algorithms.analysis import extract_constants
from ufl.classes import Derivative, GeometricQuantity, Sum
from ufl.corealg.traversal import unique_pre_traversal

from fenicsmpm.formulations.fbar import FBar
from fenicsmpm.formulations.internal_force import (
    AveragedJ,
    CauchyStress,
    force_work,
    stress_work,
)
from fenicsmpm.points import MaterialPoints
from fenicsmpm.points.point_field import PointField

# Fields of carried points that change as the points move
_CHANGING = ("x", "u")


class Residual:
    """Residual of rank 1, split into terms that the package knows and all others.

    Args:
        R: The form.
        velocity: Grid function on whose space it is tested.
        bodies: Material points whose motion it describes.
        carried: Points that move along.

    Attributes:
        form: The whole form.
        stresses: Stress by a law at points, for each body that has one.
        averages: Averages of J, for each body that has them.
        internal: Bodies whose internal force in the form comes from a law at points.
        gravity: Force per mass in m/s^2, for bodies with such a term.
        loads: Force per weight of carried points as UFL over them, for points with such a term
            that needs no function on the grid.
        elsewhere: All integrals except those over points of bodies; None for none.
        rest_at_bodies: Terms over points of bodies that are neither internal force nor gravity;
            None for none.
        rest_elsewhere: Terms elsewhere that are no load; None for none.

    Raises:
        TypeError: If R is no form.
        ValueError: For a form of another rank or on another space, two laws at the points of a
            body, and stresses of points that are no body.
    """

    def __init__(
        self,
        R: ufl.Form,
        velocity: fem.Function,
        bodies: Sequence[MaterialPoints],
        carried: Sequence[MaterialPoints],
    ) -> None:
        """Split the form."""
        self.form = R
        w = _test_function(R, velocity)
        self.stresses: dict[MaterialPoints, CauchyStress] = {}
        self.averages: dict[MaterialPoints, FBar | None] = {}
        self._find_fields(bodies)
        self.internal: set[MaterialPoints] = set()
        self.gravity: dict[MaterialPoints, fem.Constant] = {}
        self.loads: dict[MaterialPoints, Any] = {}
        rest_at_bodies: list[ufl.Integral] = []
        rest_elsewhere: list[ufl.Integral] = []
        for integral, term in _terms(R):
            points = _set_of(integral, bodies)
            if points is not None:
                sigma = self.stresses.get(points)
                if sigma and points not in self.internal and term == stress_work(sigma, w):
                    self.internal.add(points)
                    continue
                b = _force_per_mass(term, points, w)
                if b is not None and points not in self.gravity:
                    self.gravity[points] = b
                    continue
            points = _set_of(integral, carried)
            if points is not None and _is_dead(term, w):
                self.loads[points] = self.loads.get(points, 0) + _per_weight(term, w)
                continue
            rest = rest_at_bodies if _is_over(integral, bodies) else rest_elsewhere
            rest.append(integral.reconstruct(integrand=term))
        self.elsewhere = _form([i for i in R.integrals() if not _is_over(i, bodies)])
        self.rest_at_bodies, self.rest_elsewhere = _form(rest_at_bodies), _form(rest_elsewhere)

    def at(self, bodies: Sequence[MaterialPoints]) -> ufl.Form | None:
        """Return all integrals over points of some bodies; None for none."""
        return _form([i for i in self.form.integrals() if _is_over(i, bodies)])

    def _find_fields(self, bodies: Sequence[MaterialPoints]) -> None:
        """Find stresses and averages of the bodies."""
        for field in self.form.coefficients():
            if not isinstance(field, CauchyStress | AveragedJ):
                continue
            points = field.points
            if points not in bodies:
                raise ValueError(
                    f"the residual has the field {field.name!r} of points that are no body of this "
                    "simulation, so it would not be renewed: pass these points as a body"
                )
            if isinstance(field, CauchyStress):
                if points in self.stresses:
                    raise ValueError(
                        "a body has two laws at its points, but only one internal_force per body "
                        "is possible: write further stresses in UFL"
                    )
                self.stresses[points] = field
            if self.averages.setdefault(points, field.averages) != field.averages:
                raise ValueError("a body has two kinds of averages of J: use one")


def _test_function(R: Any, velocity: fem.Function) -> ufl.Argument:
    if not isinstance(R, ufl.Form):
        raise TypeError(f"a residual must be a UFL form, not {type(R).__name__}: {R}")
    arguments = R.arguments()
    if len(arguments) != 1:
        raise ValueError(
            f"the residual of explicit steps must be of rank 1, not {len(arguments)}: it needs "
            "one test function, and no trial function"
        )
    space = arguments[0].ufl_function_space()
    if space != velocity.function_space:
        raise ValueError(
            "the residual must be tested on the function space of the velocity: use the "
            "unknown's test function, unknown.test.v"
        )
    return arguments[0]


def _terms(R: ufl.Form) -> Iterator[tuple[ufl.Integral, Any]]:
    """Yield integrals with the terms of their integrands."""
    for integral in R.integrals():
        pending = [integral.integrand()]
        while pending:
            term = pending.pop()
            if isinstance(term, Sum):
                pending.extend(reversed(term.ufl_operands))
            else:
                yield integral, term


def _form(integrals: list[ufl.Integral]) -> ufl.Form | None:
    return ufl.Form(integrals) if integrals else None


def _is_over(integral: ufl.Integral, bodies: Sequence[MaterialPoints]) -> bool:
    return any(integral.subdomain_data() is body for body in bodies)


def _set_of(integral: ufl.Integral, sets: Sequence[MaterialPoints]) -> MaterialPoints | None:
    """Return the point set over all of which an integral is taken; None for others."""
    points = integral.subdomain_data()
    whole = integral.subdomain_id() == "everywhere" and not integral.metadata()
    return points if whole and any(points is known for known in sets) else None


def _is_dead(term: Any, w: ufl.Argument) -> bool:
    """Return whether a term is a force at the points that the motion does not change."""
    fields = extract_coefficients(term)
    kinds = {type(node) for node in unique_pre_traversal(term)}
    return (
        all(isinstance(f, PointField) and f.name not in _CHANGING for f in fields)
        and not any(issubclass(kind, GeometricQuantity | Derivative) for kind in kinds)
        and w in extract_arguments(term)
    )


def _per_weight(term: Any, w: ufl.Argument) -> Any:
    """Return the force per weight t of a term -t . w."""
    dim = w.ufl_shape[0]
    units = [ufl.as_vector([float(i == k) for i in range(dim)]) for k in range(dim)]
    return ufl.as_vector([-replace(term, {w: unit}) for unit in units])


def _force_per_mass(term: Any, points: MaterialPoints, w: ufl.Argument) -> fem.Constant | None:
    """Return the constant b of a term -rho b . w; None for another term."""
    constants = extract_constants(term)
    if len(constants) != 1 or len(extract_coefficients(term)) != 2:
        return None
    b = constants[0]
    is_vector = isinstance(b, fem.Constant) and b.ufl_shape == w.ufl_shape
    return b if is_vector and term == force_work(points, b, w) else None
