# SPDX-License-Identifier: MIT
"""Cell size and stabilization parameters at the points (VMS, equation 21)."""

from __future__ import annotations

from typing import Any

import ufl

from fenicsmpm.formulations.mixed import MixedLaw
from fenicsmpm.formulations.time_scheme import TimeScheme, density
from fenicsmpm.points import MaterialPoints


def element_size(points: MaterialPoints) -> Any:
    """Return the size ``h = |K|^(1/d)`` [m] of the cell around each point.

    See VMS, below equation 21.

    Args:
        points: Material points.
    """
    return _cell_volume(points) ** (1 / points.mesh.geometry.dim)


def _cell_volume(points: MaterialPoints) -> Any:
    return ufl.CellVolume(points.mesh.ufl_domain())


def tau(
    points: MaterialPoints,
    law: MixedLaw,
    c1: float = 1.0,
    c2: float = 1.0,
    scheme: TimeScheme | None = None,
) -> Any:
    """Return the stabilization parameters tau_1 and tau_2 (VMS, equation 21).

    If steps are much shorter than h sqrt(rho / mu), subscales without inertia make Newton's method
    fail. With inertia, 1 / tau_1 = 2 mu / (c1 h^2) + rho r_a (R. Codina, CMAME 191, 2002), where
    r_a u is the change of acceleration in a step.

    Args:
        points: Material points.
        law: Constitutive law.
        c1: Algorithmic constant of tau_1 [-].
        c2: Algorithmic constant of tau_2 [-].
        scheme: Time scheme, for subscales with inertia. None for subscales without inertia as in
            VMS, and for a law that includes inertia itself (``NewtonianFlow``).

    Returns:
        tau_1 = c1 h^2 / (2 mu) [m^2/Pa], with inertia as above, and tau_2 = 2 c2 mu [Pa]. Here mu
        is the respective modulus of the law.

    Raises:
        ValueError: If a scheme is given for a law that includes inertia itself.
    """
    h_squared = squared_size(points)
    mu = modulus(law, h_squared, scheme, density(points) if scheme is not None else None, c1)
    return c1 * h_squared / (2 * mu), 2 * c2 * law.subscale_modulus(points, h_squared)


def modulus(
    law: MixedLaw, h_squared: Any, scheme: TimeScheme | None, rho: Any, c1: float = 1.0
) -> Any:
    """Return the shear modulus mu [Pa] of tau_1 = c1 h^2 / (2 mu), optionally with inertia.

    Args:
        law: Constitutive law.
        h_squared: Square of the cell size [m^2].
        scheme: Time scheme, for a modulus with inertia. None for subscales without inertia.
        rho: Density [kg/m^d]. Needed with a scheme only.
        c1: Constant of tau_1 [-].

    Raises:
        ValueError: If a scheme is given for a law that includes inertia itself.
    """
    mu = law.modulus(h_squared)
    if scheme is None:
        return mu
    if hasattr(law, "scheme"):
        raise ValueError(f"the subscales of {law!r} already have inertia: leave out the scheme")
    return mu + c1 * rho * scheme.rates[1] * h_squared / 2


def squared_size(points: MaterialPoints) -> Any:
    """Return the square of the cell size h^2 [m^2].

    Args:
        points: Material points.
    """
    return _cell_volume(points) ** (2 / points.mesh.geometry.dim)
