# SPDX-License-Identifier: MIT
"""Hyperelastic laws in UFL, split into a deviatoric and a volumetric part."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import ufl

# g(J) = U'(J) / kappa [-], the volumetric laws that the papers use
VOLUMETRIC_LAWS: dict[str, Callable[[Any], Any]] = {
    "quadratic": lambda J: J - 1,
    "miehe": lambda J: 1 - 1 / J,
    "simo-taylor": lambda J: (J - 1 / J) / 2,
}


class NeoHookean:
    """Neo-Hookean law, deviatoric part mu/2 (I1_bar - 3) (VMS, section 2.2).

    Args:
        E: Young's modulus [Pa], positive.
        nu: Poisson's ratio [-], -1 < nu <= 0.5; exactly 0.5 is an incompressible material.
        volumetric: volumetric law U'(J) / kappa: "quadratic" J - 1 (VMS), "miehe" 1 - 1/J (CMN) or
            "simo-taylor" (J - 1/J) / 2.

    Attributes:
        E: Young's modulus [Pa].
        nu: Poisson's ratio [-].
        mu: shear modulus [Pa].
        kappa: bulk modulus [Pa], infinite for nu = 0.5.
        inverse_kappa: its inverse [1/Pa], zero for nu = 0.5.
        volumetric: name of the volumetric law.

    Raises:
        ValueError: for parameters out of range or an unknown law.
    """

    def __init__(self, E: float, nu: float, volumetric: str = "quadratic") -> None:
        """Check and store the parameters."""
        if not (math.isfinite(E) and E > 0):
            raise ValueError(f"Young's modulus must be positive and finite: E = {E}")
        if not -1 < nu <= 0.5:
            raise ValueError(
                f"Poisson's ratio must lie in (-1, 0.5]: nu = {nu}. "
                "Use nu = 0.5 for an incompressible material."
            )
        if volumetric not in VOLUMETRIC_LAWS:
            raise ValueError(
                f"unknown volumetric law {volumetric!r}: use one of {', '.join(VOLUMETRIC_LAWS)}"
            )
        self.E = E
        self.nu = nu
        self.mu = E / (2 * (1 + nu))
        self.inverse_kappa = 3 * (1 - 2 * nu) / E
        self.kappa = math.inf if self.inverse_kappa == 0 else 1 / self.inverse_kappa
        self.volumetric = volumetric

    def deviatoric_stress(self, F: Any) -> Any:
        """Deviatoric Cauchy stress mu J^(-5/3) dev(F F^T) [Pa] (VMS, section 2.2).

        Args:
            F: deformation gradient, 3x3 UFL tensor.
        """
        return self.mu * ufl.det(F) ** (-5 / 3) * ufl.dev(F * F.T)

    def volumetric_strain(self, J: Any) -> Any:
        """g(J) = U'(J) / kappa [-]; the pressure of a compressible material is kappa g(J).

        Args:
            J: determinant of the deformation gradient.
        """
        return VOLUMETRIC_LAWS[self.volumetric](J)

    def energy(self, F: Any, J: Any) -> Any:
        """Deviatoric strain energy per initial volume [J/m^3] (VMS, section 2.2).

        Args:
            F: deformation gradient, 3x3 UFL tensor.
            J: its determinant.
        """
        return self.mu / 2 * (J ** (-2 / 3) * ufl.inner(F, F) - 3)

    def __repr__(self) -> str:
        """Parameters with units."""
        return (
            f"NeoHookean(E={self.E:g} Pa, nu={self.nu:g}, mu={self.mu:g} Pa, "
            f"kappa={self.kappa:g} Pa, volumetric={self.volumetric!r})"
        )
