# SPDX-License-Identifier: MIT
"""Evaluation of constitutive laws at many points."""

from __future__ import annotations

import functools
from typing import Any

import numba
import numpy as np
import numpy.typing as npt

from fenicsmpm._njit import njit
from fenicsmpm.materials.law import Law
from fenicsmpm.points import MaterialPoints

Array = npt.NDArray[np.float64]


def stress(
    law: Law, F: npt.ArrayLike, L: npt.ArrayLike | None = None, state: Array | None = None
) -> Array:
    """Return the Cauchy stress at points, and update their state.

    Args:
        law: Constitutive law.
        F: Deformation gradients ``(n, 3, 3)`` [-].
        L: Velocity gradients ``(n, 3, 3)`` [1/s]. None for zero.
        state: State ``(n, law.n_state)``, float64, changed in place. None for undeformed points.

    Returns:
        Cauchy stresses ``(n, 3, 3)`` [Pa].

    Raises:
        ValueError: If an array has a wrong shape.
    """
    F, state = _checked(law, F, state)
    L = np.zeros_like(F) if L is None else np.asarray(L, dtype=np.float64)
    if L.shape != F.shape:
        raise ValueError(f"velocity gradients must have the shape of F, {F.shape}, not {L.shape}")
    sigma = np.empty_like(F)
    _stresses(law.update)(F, L, law.parameters, state, sigma)
    return sigma


def bulk_to_shear(law: Law) -> float:
    """Return the ratio of bulk modulus to shear modulus at small strains [-].

    The ratio is infinite for fluids, for laws that yield immediately and for laws that do not
    resist compression. Shear is applied together with compression, since sand has no shear
    stiffness without it.

    Args:
        law: Constitutive law.
    """
    h = 1e-5
    F = np.array([np.eye(3), (1 - h) * np.eye(3), (1 - h) * np.eye(3)])
    F[2, 0, 1] = 0.1 * h  # small enough for friction to hold
    undeformed, compressed, sheared = stress(law, F)
    with np.errstate(invalid="ignore"):  # for laws that give NaN
        kappa = -np.trace(compressed - undeformed) / (9 * h)
    mu = sheared[0, 1] / (0.1 * h)
    return float(kappa / mu) if 0 < kappa < np.inf and 0 < mu < np.inf else np.inf


def energy(law: Law, F: npt.ArrayLike, state: Array | None = None) -> Array:
    """Return the free energy per initial volume at points, ``(n,)`` [J/m^3].

    Args:
        law: Constitutive law with an energy.
        F: Deformation gradients ``(n, 3, 3)`` [-].
        state: State ``(n, law.n_state)``. None for undeformed points.

    Raises:
        ValueError: If the law has no energy, or an array has a wrong shape.
    """
    if law.energy is None:
        raise ValueError(f"this law has no energy: {law}")
    F, state = _checked(law, F, state)
    result = np.empty(len(F))
    _energies(law.energy)(F, law.parameters, state, result)
    return result


def tangent(law: Law, F: npt.ArrayLike, state: Array | None = None) -> Array:
    """Return the derivative dP/dF of the first Piola-Kirchhoff stress, ``(n, 3, 3, 3, 3)`` [Pa].

    Args:
        law: Constitutive law with a tangent.
        F: Deformation gradients after the step, ``(n, 3, 3)`` [-].
        state: State before the step, ``(n, law.n_state)``, not changed. None for undeformed points.

    Raises:
        ValueError: If the law has no tangent, or an array has a wrong shape.
    """
    if law.tangent is None:
        raise ValueError(f"this law has no tangent: {law}")
    F, state = _checked(law, F, state)
    result = np.empty((len(F), 3, 3, 3, 3))
    _tangents(law.tangent)(F, law.parameters, state, result)
    return result


def state_of(law: Law, points: MaterialPoints) -> Array:
    """Return the state of material points, ``(n_points, law.n_state)``, from their fields.

    Args:
        law: Constitutive law.
        points: The body, with the fields of the law's state.
    """
    state = law.initial_state(len(points))
    for name in law.columns:
        law.state_field(state, name)[...] = points[name]
    return state


def _checked(law: Law, F: npt.ArrayLike, state: Array | None) -> tuple[Array, Array]:
    F = np.asarray(F, dtype=np.float64)
    if F.ndim != 3 or F.shape[1:] != (3, 3):
        raise ValueError(f"deformation gradients must have shape (n, 3, 3), not {F.shape}")
    if state is None:
        state = law.initial_state(len(F))
    if state.shape != (len(F), law.n_state) or state.dtype != np.float64:
        raise ValueError(
            f"the state must be float64 of shape {(len(F), law.n_state)}, as from "
            f"law.initial_state, not {state.dtype} of shape {state.shape}"
        )
    return F, state


@functools.cache
def _stresses(update: Any) -> Any:
    """Compile a loop over points that calls ``update`` of a law."""

    @njit(parallel=True)
    def loop(F: Any, L: Any, parameters: Any, state: Any, sigma: Any) -> None:
        for p in numba.prange(len(F)):
            update(F[p], L[p], parameters, state[p], sigma[p])

    return loop


@functools.cache
def _energies(energy: Any) -> Any:
    """Compile a loop over points that calls ``energy`` of a law."""

    @njit(parallel=True)
    def loop(F: Any, parameters: Any, state: Any, result: Any) -> None:
        for p in numba.prange(len(F)):
            result[p] = energy(F[p], parameters, state[p])

    return loop


@functools.cache
def _tangents(tangent: Any) -> Any:
    """Compile a loop over points that calls ``tangent`` of a law."""

    @njit(parallel=True)
    def loop(F: Any, parameters: Any, state: Any, result: Any) -> None:
        for p in numba.prange(len(F)):
            tangent(F[p], parameters, state[p], result[p])

    return loop
