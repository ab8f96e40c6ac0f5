# SPDX-License-Identifier: MIT
"""Hyperelastic laws at points from a UFL energy, compiled by FFCx."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

from mpi4py import MPI

import basix.ufl
import numpy as np
import ufl

from fenicsmpm._numbers import finite
from fenicsmpm.forms.kernels import COORDINATES, Kernel, compile_kernel, kernel_of_nine
from fenicsmpm.forms.lowering import INTERVAL, ONE_POINT
from fenicsmpm.materials.law import Law, compiled
from fenicsmpm.materials.tensors import rows, volume_change


# The first two parameters are the addresses of the kernels for stress and energy. A float64 holds
# them exactly, as they have fewer than 53 bits. The parameters of the energy follow. Therefore the
# functions below, and the loops that call them, are compiled once for all energies.
@compiled
def _update(F, L, parameters, state, sigma):  # type: ignore[no-untyped-def]
    inputs = parameters.ctypes.data + 16
    values = kernel_of_nine(np.int64(parameters[0]), rows(F), inputs, COORDINATES.ctypes.data)
    valid = 0.0 if volume_change(F) > -1 else math.nan
    for i in range(3):
        for j in range(3):
            sigma[i, j] = values[3 * i + j] + valid


@compiled
def _energy(F, parameters, state):  # type: ignore[no-untyped-def]
    inputs = parameters.ctypes.data + 16
    return kernel_of_nine(np.int64(parameters[1]), rows(F), inputs, COORDINATES.ctypes.data)[0]


class EnergyLaw(Law):
    """Hyperelastic law created by ``from_energy``.

    Attributes:
        kernels: Compiled stress and energy.
    """

    def __init__(
        self, kernels: tuple[Kernel, Kernel], parameters: Sequence[float], modulus: float
    ) -> None:
        """Keep the kernels alive, because the law calls them by address."""
        self.kernels = kernels
        addresses = [float(kernel.address) for kernel in kernels]
        values = np.array([*addresses, *parameters])
        super().__init__(_update, values, modulus, energy=_energy, needs_rate=False)

    def __repr__(self) -> str:
        """Parameters of the energy."""
        return (
            f"EnergyLaw(parameters={self.parameters[2:]}, "
            f"wave_speed_modulus={self.wave_speed_modulus:g} Pa)"
        )


def from_energy(
    psi: Callable[..., Any],
    parameters: Sequence[float] = (),
    wave_speed_modulus: float | None = None,
    comm: MPI.Comm = MPI.COMM_WORLD,
    jit_options: dict[str, Any] | None = None,
) -> Law:
    """Return a law at points whose energy is given in UFL; no mesh is needed.

    The Cauchy stress is sigma = 1/J (d psi / d F) F^T. FFCx compiles it. Collective. Other values
    of the parameters need no new compilation.

    Args:
        psi: Energy per initial volume ``psi(F, *parameters)`` [J/m^3], a UFL expression of the
            deformation gradient F ``(3, 3)``.
        parameters: Numbers that psi receives as UFL constants.
        wave_speed_modulus: Modulus of the fastest elastic wave [Pa]. None for d P_11 / d F_11
            without deformation, which is correct for isotropic materials.
        comm: MPI communicator over which the compilation is shared.
        jit_options: Options of ``dolfinx.jit.ffcx_jit``, which override the default ones.

    Returns:
        A law with an energy and without a state. The accuracy of stresses at small strains is that
        of the expression for psi near F = I.

    Raises:
        ValueError: If psi is not scalar, a parameter is not a finite number, or the modulus without
            deformation is not positive.
    """
    if finite(parameters, "parameters of an energy").ndim != 1:
        raise ValueError(f"parameters of an energy must be a sequence of numbers: {parameters!r}")
    F = ufl.Coefficient(_vector_space(9))
    constants = ufl.Constant(INTERVAL, shape=(max(len(parameters), 1),))
    gradient = ufl.variable(ufl.as_tensor([[F[3 * i + j] for j in range(3)] for i in range(3)]))
    energy = ufl.as_ufl(psi(gradient, *(constants[k] for k in range(len(parameters)))))
    if energy.ufl_shape != ():
        raise ValueError(f"psi must be scalar: its shape is {energy.ufl_shape}")
    sigma = ufl.diff(energy, gradient) * gradient.T / ufl.det(gradient)
    test = ufl.TestFunction(_vector_space(9))
    measure = ufl.Measure("dx", domain=INTERVAL, metadata=ONE_POINT)
    power = sum(sigma[i, j] * test[3 * i + j] for i in range(3) for j in range(3))
    options = jit_options or {}
    kernels = (
        compile_kernel(comm, power * measure, (9,), options),
        compile_kernel(comm, energy * measure, (), options),
    )
    if wave_speed_modulus is None:
        wave_speed_modulus = _modulus_without_deformation(EnergyLaw(kernels, parameters, 1.0))
    return EnergyLaw(kernels, parameters, wave_speed_modulus)


def _vector_space(size: int) -> ufl.FunctionSpace:
    """Return a space of vectors of numbers without position."""
    return ufl.FunctionSpace(INTERVAL, basix.ufl.element("DG", "interval", 0, shape=(size,)))


def _modulus_without_deformation(law: Law) -> float:
    """Return d P_11 / d F_11 with P_11 = J sigma_11 / F_11 by differences, to about 9 digits."""
    h = 1e-4
    stresses = []
    for stretch in (1 - h, 1 + h):
        sigma = np.empty((3, 3))
        law.update(np.diag([stretch, 1, 1]), np.zeros((3, 3)), law.parameters, np.empty(0), sigma)
        stresses.append(sigma[0, 0])
    return float(stresses[1] - stresses[0]) / (2 * h)
