# SPDX-License-Identifier: MIT
"""Forces of explicit steps in UFL, as integrals over the points at their current positions.

Stresses and volumes at the start of an explicit step are known. Therefore the internal force is a
form of rank 1 whose integrand is linear in the test function w, and no system needs to be solved:
``m_I a_I = -R(N_I)``. References are to Y. Zhao, C. Jiang, J. Choo, "Circumventing volumetric
locking in explicit material point methods" (F-bar).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, TypeAlias

import ufl

from fenicsmpm.formulations.fbar import FBar, default_fbar
from fenicsmpm.formulations.initial_state import require_initial_state
from fenicsmpm.formulations.kinematics import embed
from fenicsmpm.formulations.time_scheme import density, force_per_mass
from fenicsmpm.materials import Law, NeoHookean, state_of, stress
from fenicsmpm.points import MaterialPoints
from fenicsmpm.points.point_field import PointField

Averages: TypeAlias = FBar | Literal["default"] | None


class AveragedJ(PointField):
    """Field "J_bar" of a body [-], which an explicit step updates by averages of J.

    Args:
        points: The body, with the field "J". The fields "J_bar" and its initial value "J_0" are
            added with the values of J if missing.
        averages: How J is averaged. None for J itself.
    """

    def __init__(self, points: MaterialPoints, averages: FBar | None) -> None:
        """Add missing fields."""
        for name in ("J_bar", "J_0"):
            if name not in points:
                points.add_field(name, (), points["J"])
        super().__init__(points, "J_bar")
        self.averages = averages


class CauchyStress(PointField):
    """Field "sigma" of a body ``(3, 3)`` [Pa], which an explicit step updates by a law at points.

    Args:
        points: The body, with the fields of ``set_initial_state``. The fields "sigma", "J_bar" and
            those of the law's state are added if missing. The stress is then that of the current
            "F" and state.
        law: Constitutive law, of which only the parameters may change later.
        averages: How J is averaged. None for J itself.

    Attributes:
        law: Constitutive law.
        averages: How J is averaged, or None.

    Raises:
        ValueError: If the body lacks the fields of ``set_initial_state``, or has a field with the
            name of a state field but another shape.
    """

    def __init__(self, points: MaterialPoints, law: Law, averages: FBar | None) -> None:
        """Add missing fields."""
        require_initial_state(points, "stress")
        for name, (shape, value) in law.state.items():
            if name not in points:
                points.add_field(name, shape, value)
            elif points.field_shape(name) != shape:
                raise ValueError(
                    f"the state of {law!r} needs a field {name!r} of shape {shape}, but the "
                    f"body has one of shape {points.field_shape(name)}"
                )
        if "sigma" not in points:
            points.add_field("sigma", (3, 3), stress(law, points["F"], None, state_of(law, points)))
        super().__init__(points, "sigma")
        self.law, self.averages = law, averages
        if averages is not None:
            AveragedJ(points, averages)


def internal_force(
    w: Any,
    points: MaterialPoints,
    material: Law | NeoHookean | Callable[[Any], Any],
    *,
    fbar: Averages = "default",
) -> ufl.Form:
    """Return the internal force of an explicit step, the integral of sigma : grad w.

    This is equation 8 of F-bar. With averages of J, stresses are those of
    ``F_bar = (J_bar / J)^(1/d) F`` (equation 18).

    Args:
        w: Test function of the velocity ``(d,)``.
        points: The body, with the fields of ``set_initial_state`` and its current volumes as
            weights [m^d].
        material: Law at points; ``NeoHookean``, which is converted to a law at points; or a UFL
            energy per initial volume ``psi(F)`` [J/m^3], without state.
        fbar: How J is averaged. None for no averages (standard MPM). By default, laws use
            ``default_fbar``, and a UFL energy uses no averages.

    Returns:
        UFL form of rank 1 over the points [N], for ``ExplicitMPM``. It contains the field "sigma"
        for a law at points, and the derivative of the energy otherwise.

    Raises:
        TypeError: If the material is neither a law nor an energy.
        ValueError: If the body lacks the fields of ``set_initial_state``, for the other reasons of
            ``CauchyStress``, and for ``NeoHookean`` with nu = 0.5, which has no stress at a point.
    """
    if isinstance(material, type) or not (
        isinstance(material, Law | NeoHookean) or callable(material)
    ):
        raise TypeError(
            "a material is a law such as materials.Hencky(E, nu), or a function that returns the "
            f"energy psi(F) in UFL, not {material!r}"
        )
    if isinstance(material, NeoHookean):
        material = material.pointwise()
    if isinstance(material, Law):
        averages = default_fbar(material) if fbar == "default" else fbar
        sigma = CauchyStress(points, material, averages)
        return stress_work(sigma, w) * points.dx
    require_initial_state(points, "stress")
    F = points.field("F")
    if isinstance(fbar, FBar):
        dim = points.mesh.geometry.dim
        F = stretched(F, AveragedJ(points, fbar) / ufl.det(F), dim)
    F = ufl.variable(F)
    sigma = ufl.diff(material(F), F) * F.T / ufl.det(F)
    return stress_work(sigma, w) * points.dx


def stress_work(sigma: Any, w: Any) -> Any:
    """Return the integrand of the internal force, sigma : grad w [Pa/m].

    Args:
        sigma: Cauchy stress ``(3, 3)`` [Pa], UFL.
        w: Test function of the velocity ``(d,)``.
    """
    return ufl.inner(sigma, embed(ufl.grad(w)))


def body_force(w: Any, points: MaterialPoints, b: Any) -> ufl.Form:
    """Return the load -(rho b, w) of a force per mass, such as gravity, over the current volumes.

    Args:
        w: Test function of the velocity ``(d,)``.
        points: The body, with the field "mass" [kg].
        b: Force per mass ``(d,)`` [m/s^2]: numbers, a ``fem.Constant``, or a UFL vector.

    Returns:
        UFL form of rank 1 over the points [N], to be added to the residual.

    Raises:
        ValueError: If there are no masses, the numbers are not finite, or the shape is wrong.
    """
    return force_work(points, force_per_mass(points, b), w) * points.dx


def force_work(points: MaterialPoints, b: Any, w: Any) -> Any:
    """Return the integrand of a force per mass, -rho b . w [N/m^d per velocity].

    Args:
        points: The body, with the field "mass" [kg].
        b: Force per mass ``(d,)`` [m/s^2], UFL.
        w: Test function of the velocity ``(d,)``.
    """
    return -density(points) * ufl.inner(b, w)


def stretched(F: Any, ratio: Any, dim: int) -> Any:
    """Return F scaled to a determinant that is larger by a ratio; plane strain keeps F33.

    Args:
        F: Deformation gradient ``(3, 3)``, UFL.
        ratio: Ratio of the determinants [-].
        dim: Space dimension, 2 or 3.
    """
    stretch = ratio ** (1 / dim)
    return ufl.as_tensor(
        [[(stretch if i < dim else 1) * F[i, j] for j in range(3)] for i in range(3)]
    )


def drawn_J(points: MaterialPoints, f: Any, averages: FBar | None) -> Any:
    """Return J before a step, pulled towards its average by the strain of the step [-].

    See ``FBar`` for the formula.

    Args:
        points: The body, with the fields "F" and "J_bar".
        f: Incremental deformation gradient, I + dt grad v, ``(d, d)``, UFL.
        averages: How J is averaged, or None.
    """
    J = ufl.det(points.field("F"))
    if averages is None or averages.s == 0:
        return J
    strain = ufl.sym(f) - ufl.Identity(f.ufl_shape[0])
    share = ufl.min_value(averages.s * ufl.sqrt(ufl.inner(strain, strain)), 1.0)
    return J + share * (points.field("J_bar") - J)


def averaged_J(points: MaterialPoints, f: Any, averages: FBar) -> Any:
    """Return the quantity that is averaged over the grid (F-bar, equations 19 to 21) [-].

    Args:
        points: The body, with the fields "F", "J_bar" and "J_0".
        f: Incremental deformation gradient, I + dt grad v, ``(d, d)``, UFL.
        averages: How J is averaged.

    Returns:
        Quantity per volume before the step, relative to "J_0" as the averages of ``FBar``, UFL.
    """
    mixed = (1 - averages.r) * points.field("J_bar") + averages.r * drawn_J(points, f, averages)
    return mixed / points.field("J_0") * ufl.det(f)


def moved_F(points: MaterialPoints, f: Any, averages: FBar | None, is_fluid: bool) -> Any:
    """Return the deformation gradient after a step ``(3, 3)`` (F-bar, equation 14).

    Args:
        points: The body, with the fields "F" and "J_bar".
        f: Incremental deformation gradient, I + dt grad v, ``(d, d)``, UFL.
        averages: How J is averaged, or None.
        is_fluid: Whether only the determinant of F is kept.
    """
    F, dim = points.field("F"), f.ufl_shape[0]
    J = drawn_J(points, f, averages)
    if is_fluid:
        return stretched(ufl.Identity(3), ufl.det(f) * J, dim)
    F = (ufl.Identity(3) + embed(f - ufl.Identity(dim))) * F
    return (
        F
        if averages is None or averages.s == 0
        else stretched(F, J / ufl.det(points.field("F")), dim)
    )
