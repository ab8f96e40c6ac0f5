# SPDX-License-Identifier: MIT
"""Neo-Hookean law, in UFL with deviatoric and volumetric parts, and as a law at points."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl

from fenicsmpm._numbers import positive
from fenicsmpm.materials.law import (
    Law,
    compiled,
    elastic_moduli,
    p_wave_modulus,
    poissons_ratio,
)
from fenicsmpm.materials.tensors import inverse_cube_root, metric_change, volume_change

# Volumetric laws of the papers, g(J) = U'(J) / kappa [-]
VOLUMETRIC_LAWS: dict[str, Callable[[Any], Any]] = {
    "quadratic": lambda J: J - 1,
    "miehe": lambda J: 1 - 1 / J,
    "simo-taylor": lambda J: (J - 1 / J) / 2,
}

_quadratic, _miehe, _simo_taylor = (compiled(law) for law in VOLUMETRIC_LAWS.values())


@compiled
def _volumetric_strain(J, law):  # type: ignore[no-untyped-def]
    """Return g(J) for the number of a law in VOLUMETRIC_LAWS."""
    if law == 0:
        return _quadratic(J)
    if law == 1:
        return _miehe(J)
    return _simo_taylor(J)


@compiled
def _volumetric_energy(J, law):  # type: ignore[no-untyped-def]
    """Return U(J) / kappa, the integral of g from 1 to J."""
    if law == 0:
        return 0.5 * (J - 1) ** 2
    if law == 1:
        return J - 1 - math.log(J)
    return 0.25 * (J - 1) * (J + 1) - 0.5 * math.log(J)


@compiled
def _update(F, L, parameters, state, sigma):  # type: ignore[no-untyped-def]
    mu, kappa = parameters[0], parameters[1]
    J = 1 + volume_change(F)
    mean = kappa * _volumetric_strain(J, parameters[2])
    b = metric_change(F)
    third = (b[0] + b[1] + b[2]) / 3
    root = inverse_cube_root(J)
    shear = mu * (root * root * root) * (root * root)
    sigma[0, 0] = shear * (b[0] - third) + mean
    sigma[1, 1] = shear * (b[1] - third) + mean
    sigma[2, 2] = shear * (b[2] - third) + mean
    sigma[0, 1] = sigma[1, 0] = shear * b[3]
    sigma[0, 2] = sigma[2, 0] = shear * b[4]
    sigma[1, 2] = sigma[2, 1] = shear * b[5]


@compiled
def _energy(F, parameters, state):  # type: ignore[no-untyped-def]
    J = 1 + volume_change(F)
    b = metric_change(F)
    # I1_bar - 3 without cancellation: J^(-2/3) (tr(b) - 3) + 3 (J^(-2/3) - 1)
    power = math.expm1(-2 / 3 * math.log(J))
    deviatoric = (1 + power) * (b[0] + b[1] + b[2]) + 3 * power
    return 0.5 * parameters[0] * deviatoric + parameters[1] * _volumetric_energy(J, parameters[2])


class NeoHookean:
    """Neo-Hookean law with the deviatoric energy mu/2 (I1_bar - 3) (VMS, section 2.2).

    Args:
        E: Young's modulus [Pa], positive.
        nu: Poisson's ratio [-], -1 < nu <= 0.5. The value 0.5 means an incompressible material.
        volumetric: Volumetric law U'(J) / kappa: "quadratic" for J - 1 (VMS), "miehe" for 1 - 1/J
            (CMN) or "simo-taylor" for (J - 1/J) / 2.

    Attributes:
        E: Young's modulus [Pa].
        nu: Poisson's ratio [-].
        mu: Shear modulus [Pa].
        kappa: Bulk modulus [Pa], infinite for nu = 0.5.
        inverse_kappa: Inverse of the bulk modulus [1/Pa], zero for nu = 0.5.
        volumetric: Name of the volumetric law.

    Raises:
        ValueError: If a parameter is out of range, or the volumetric law is unknown.
    """

    def __init__(self, E: float, nu: float, volumetric: str = "quadratic") -> None:
        """Check and store the parameters."""
        self.E = E = positive(E, "E", "Young's modulus", "Pa")
        self.nu = nu = poissons_ratio(nu, incompressible=True)
        if volumetric not in VOLUMETRIC_LAWS:
            raise ValueError(
                f"unknown volumetric law {volumetric!r}: use one of {', '.join(VOLUMETRIC_LAWS)}"
            )
        self.mu = E / (2 * (1 + nu))
        self.inverse_kappa = 3 * (1 - 2 * nu) / E
        self.kappa = math.inf if self.inverse_kappa == 0 else 1 / self.inverse_kappa
        self.volumetric = volumetric

    def deviatoric_stress(self, F: Any) -> Any:
        """Return the deviatoric Cauchy stress mu J^(-5/3) dev(F F^T) [Pa] (VMS, section 2.2).

        Args:
            F: Deformation gradient ``(3, 3)``, UFL.
        """
        return self.mu * ufl.det(F) ** (-5 / 3) * ufl.dev(F * F.T)

    def volumetric_strain(self, J: Any) -> Any:
        """Return g(J) = U'(J) / kappa [-]; the pressure of a compressible material is kappa g(J).

        Args:
            J: Determinant of the deformation gradient [-].
        """
        return VOLUMETRIC_LAWS[self.volumetric](J)

    def energy(self, F: Any, J: Any) -> Any:
        """Return the deviatoric strain energy per initial volume [J/m^3] (VMS, section 2.2).

        Args:
            F: Deformation gradient ``(3, 3)``, UFL.
            J: Its determinant [-].
        """
        return self.mu / 2 * (J ** (-2 / 3) * ufl.inner(F, F) - 3)

    def deviatoric_power(self, k: Any, U: Any, V: Any) -> Any:
        """Return the virtual work of the deviatoric stress per volume V_n [J/m^3], for ``mixed``.

        Args:
            k: ``Kinematics`` of the step.
            U: Function of the whole unknown.
            V: Its variation.
        """
        return ufl.derivative(self.energy(k.F, k.J) / k.J_n, U, V)

    def volumetric_residual(self, p: Any, k: Any) -> Any:
        """Return U'(J)/kappa - p/kappa [-] (VMS, equation 2), for ``mixed``.

        Args:
            p: Pressure [Pa], positive in tension.
            k: ``Kinematics`` of the step.
        """
        residual = self.volumetric_strain(k.J)
        if self.inverse_kappa > 0:
            residual -= self.inverse_kappa * p
        return residual

    def modulus(self, h_squared: Any) -> Any:
        """Return the shear modulus for stabilization [Pa], which is mu for cells of any size.

        Args:
            h_squared: Square of the cell size [m^2].
        """
        return self.mu

    def subscale_modulus(self, points: Any, h_squared: Any) -> Any:
        """Return the shear modulus mu [Pa] for the volumetric subscales.

        Args:
            points: Material points.
            h_squared: Square of the cell size [m^2].
        """
        return self.mu

    def stretch_of(
        self, sigma: npt.ArrayLike
    ) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.bool_]]:
        """Return stretches for given stresses as ``materials.stretch_of`` does, for any nu.

        The pressure tr(sigma) / 3 determines J. Then F F^T = J^(5/3) / mu dev(sigma) + beta I,
        where beta follows from det F = J.

        Args:
            sigma: Cauchy stresses ``(n, 3, 3)`` [Pa], symmetric.

        Returns:
            Symmetric deformation gradients ``(n, 3, 3)`` [-], and a mask ``(n,)`` of the points
            where such a deformation exists.
        """
        values, axes = np.linalg.eigh(np.asarray(sigma, dtype=np.float64))
        p = values.mean(axis=1)
        J = self._volume_of(self.inverse_kappa * p)
        reached = np.isfinite(J) & (J > 0)
        J = np.where(reached, J, 1.0)
        s = (values - p[:, None]) * (J ** (5 / 3) / self.mu)[:, None]
        # The largest of the three roots of det = J^2. Newton's method starts to the right of all
        # roots, where the cubic is convex.
        beta = J ** (2 / 3) + np.abs(s).max(axis=1, initial=0.0)
        for _ in range(100):
            b = s + beta[:, None]
            product = b.prod(axis=1)
            slope = b[:, 0] * b[:, 1] + b[:, 0] * b[:, 2] + b[:, 1] * b[:, 2]
            change = (J**2 - product) / slope
            beta += change
            if np.all(np.abs(change) <= 1e-15 * beta):
                break
        stretches = np.sqrt(s + beta[:, None])
        return np.einsum("nij,nj,nkj->nik", axes, stretches, axes), reached

    def _volume_of(self, g: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Return J for a volumetric strain g(J); not positive or not finite if no such J exists."""
        with np.errstate(divide="ignore"):
            if self.volumetric == "quadratic":
                return 1 + g
            if self.volumetric == "miehe":
                return 1 / (1 - g)
            return g + np.sqrt(g**2 + 1)

    def pointwise(self) -> Law:
        """Return the law at a point, with stresses from the deformation alone, for explicit steps.

        Raises:
            ValueError: If nu = 0.5.
        """
        mu, kappa = elastic_moduli(self.E, self.nu)
        number = list(VOLUMETRIC_LAWS).index(self.volumetric)
        return Law(
            _update,
            np.array([mu, kappa, number]),
            p_wave_modulus(mu, kappa),
            energy=_energy,
            needs_rate=False,
        )

    def __repr__(self) -> str:
        """Parameters with units."""
        return (
            f"NeoHookean(E={self.E:g} Pa, nu={self.nu:g}, mu={self.mu:g} Pa, "
            f"kappa={self.kappa:g} Pa, volumetric={self.volumetric!r})"
        )
