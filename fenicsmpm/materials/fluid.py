# SPDX-License-Identifier: MIT
"""Weakly compressible Newtonian fluid."""

from __future__ import annotations

import math

import numpy as np

from fenicsmpm._numbers import not_negative, positive
from fenicsmpm.lanes import choose
from fenicsmpm.materials.law import Law, compiled
from fenicsmpm.materials.tensors import volume_change


@compiled
def _update(F, L, parameters, state, sigma):  # type: ignore[no-untyped-def]
    kappa, mu = parameters[0], parameters[1]
    change = volume_change(F)
    mean = choose(1 + change, kappa * change, math.nan)
    mean -= 2 * mu * (L[0, 0] + L[1, 1] + L[2, 2]) / 3
    sigma[0, 0] = mean + 2 * mu * L[0, 0]
    sigma[1, 1] = mean + 2 * mu * L[1, 1]
    sigma[2, 2] = mean + 2 * mu * L[2, 2]
    sigma[0, 1] = sigma[1, 0] = mu * (L[0, 1] + L[1, 0])
    sigma[0, 2] = sigma[2, 0] = mu * (L[0, 2] + L[2, 0])
    sigma[1, 2] = sigma[2, 1] = mu * (L[1, 2] + L[2, 1])


@compiled
def _energy(F, parameters, state):  # type: ignore[no-untyped-def]
    return 0.5 * parameters[0] * volume_change(F) ** 2


class NewtonianFluid(Law):
    """Weakly compressible Newtonian fluid with a bulk modulus (F-bar paper, section 4.3).

    The Cauchy stress is sigma = kappa (J - 1) I + 2 mu dev(sym L). The energy per initial volume is
    kappa/2 (J - 1)^2. The paper gives a bulk modulus but no equation of state. For nearly
    incompressible fluids, all equations of state agree.

    Args:
        kappa: Bulk modulus [Pa], positive.
        mu: Dynamic viscosity [Pa s], not negative. The wave speed does not include it: explicit
            steps of a very viscous fluid are also limited by density h^2 / (2 mu).

    Attributes:
        kappa: Bulk modulus [Pa].
        mu: Dynamic viscosity [Pa s].

    Raises:
        ValueError: If a parameter is out of range.
    """

    def __init__(self, kappa: float, mu: float = 0.0) -> None:
        """Check and store the parameters."""
        self.kappa = positive(kappa, "kappa", "bulk modulus", "Pa")
        self.mu = not_negative(mu, "mu", "viscosity", "Pa s")
        super().__init__(
            _update, np.array([self.kappa, self.mu]), self.kappa, energy=_energy, is_fluid=True
        )

    def __repr__(self) -> str:
        """Parameters with units."""
        return f"NewtonianFluid(kappa={self.kappa:g} Pa, mu={self.mu:g} Pa s)"
