# SPDX-License-Identifier: MIT
"""Finite differences of laws: tangents for laws without one, and checks of given tangents."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import numpy.typing as npt

from fenicsmpm._numbers import positive
from fenicsmpm.materials.evaluate import stress, tangent
from fenicsmpm.materials.law import Law, compiled

Array = npt.NDArray[np.float64]

# Step of central differences. The truncation error is proportional to its square, the round-off
# error to its inverse. Therefore the best step is about the cube root of the machine precision.
_STEP = 6e-6


@compiled
def first_piola_kirchhoff(F, sigma, P):  # type: ignore[no-untyped-def]
    """Set the first Piola-Kirchhoff stress P = sigma cof F.

    Args:
        F: Deformation gradient ``(3, 3)`` [-].
        sigma: Cauchy stress ``(3, 3)`` [Pa].
        P: Result ``(3, 3)`` [Pa].
    """
    for j in range(3):
        a, b = (j + 1) % 3, (j + 2) % 3
        for k in range(3):
            c, d = (k + 1) % 3, (k + 2) % 3
            cofactor = F[a, c] * F[b, d] - F[a, d] * F[b, c]
            for i in range(3):
                P[i, k] = (P[i, k] if j else 0.0) + sigma[i, j] * cofactor


@functools.cache
def tangent_by_differences(update: Any) -> Any:
    """Return a tangent of a law by central differences of its stress; see ``Law``.

    Each evaluation of the tangent calls the law 18 times. Relative to the moduli, the tangent is
    accurate to about 1e-10. Within a strain of 1e-5 of a kink of the law, such as first yield, it
    is an average of the tangents on both sides.

    Args:
        update: Compiled function of a law that does not use velocity gradients.

    Returns:
        Compiled function ``tangent(F, parameters, state, dPdF)``.
    """

    @compiled
    def tangent(F, parameters, state, dPdF):  # type: ignore[no-untyped-def]
        work = np.zeros((5, 3, 3))
        f, L, sigma, P, before = work[0], work[1], work[2], work[3], work[4]
        new = state.copy()
        size = 1.0
        for i in range(3):
            for j in range(3):
                f[i, j] = F[i, j]
                size = max(size, abs(F[i, j]))
        for k in range(3):
            for m in range(3):
                for sign in (-1.0, 1.0):
                    f[k, m] = F[k, m] + sign * _STEP * size
                    for i in range(len(state)):
                        new[i] = state[i]
                    update(f, L, parameters, new, sigma)
                    first_piola_kirchhoff(f, sigma, P)
                    if sign < 0:
                        before[:, :] = P
                        low = f[k, m]
                step = f[k, m] - low
                f[k, m] = F[k, m]
                for i in range(3):
                    for j in range(3):
                        dPdF[i, j, k, m] = (P[i, j] - before[i, j]) / step

    return tangent


def check_tangent(
    law: Law, F: npt.ArrayLike | None = None, state: Array | None = None, *, rtol: float = 1e-6
) -> float:
    """Compare the tangent of a law with finite differences of its stress.

    The function uses central differences of fourth order and one-sided differences of second order.
    Only the differences closest to the tangent count, because the tangent of either side is correct
    at a kink, such as first yield.

    Args:
        law: Constitutive law with a tangent.
        F: Deformation gradients after a step, ``(n, 3, 3)`` [-]. None for 100 random ones with
            strains of 1e-3 to 0.2.
        state: State before the step, ``(n, law.n_state)``, not changed. None for undeformed points.
            With random deformations, None stands for the state after a first random step, in which
            a plastic law yields.
        rtol: Largest accepted error [-], relative to the largest entry of the tangent at a point or
            to the ``wave_speed_modulus`` of the law, whichever is larger.

    Returns:
        The largest relative error [-].

    Raises:
        ValueError: If the law has no tangent, an array has a wrong shape, or the tangent is wrong.
            In the last case the message says where, and what the value should be.
    """
    rtol = positive(rtol, "rtol", "relative tolerance", "-")
    if F is None:
        if state is not None:
            raise ValueError("a state was given without deformation gradients F: give both")
        F, state = _random_step(law)
    F = np.asarray(F, dtype=np.float64)
    found = tangent(law, F, state)
    state = law.initial_state(len(F)) if state is None else state

    def P(change: Array) -> Array:
        f, sigma = F + change, stress(law, F + change, state=state.copy())
        return np.linalg.det(f)[:, None, None] * sigma @ np.swapaxes(np.linalg.inv(f), 1, 2)

    size = np.maximum(np.abs(F).max(axis=(1, 2), initial=0.0), 1.0)[:, None, None]
    P_0, expected = P(0 * F), np.empty_like(found)
    for k, m in np.ndindex(3, 3):
        d = np.zeros_like(F)
        d[:, k, m] = _STEP * size[:, 0, 0]
        a, b, c, e = P(-2 * d), P(-d), P(d), P(2 * d)
        h = _STEP * size
        slopes = np.stack(
            [
                (8 * (c - b) - (e - a)) / (12 * h),
                (4 * c - e - 3 * P_0) / (2 * h),
                (3 * P_0 - 4 * b + a) / (2 * h),
            ]
        )
        error = np.abs(slopes - found[..., k, m]).max(axis=(2, 3))
        # NaN counts as the largest error
        best = np.argmin(np.where(np.isnan(error), np.inf, error), axis=0)
        expected[..., k, m] = slopes[best, np.arange(len(F))]
    scale = np.maximum(np.abs(expected).max(axis=(1, 2, 3, 4)), law.wave_speed_modulus)
    errors = np.abs(found - expected) / scale[:, None, None, None, None]
    if not len(F):
        raise ValueError("F has no deformation gradients: give at least one to check a tangent")
    worst = np.unravel_index(np.argmax(np.where(np.isnan(errors), np.inf, errors)), errors.shape)
    largest = float(errors[worst])
    if not largest <= rtol:
        p, i, j, k, m = (int(index) for index in worst)
        raise ValueError(
            f"the tangent is not the derivative of the stress: at point {p}, dP[{i}, {j}] / "
            f"dF[{k}, {m}] = {found[worst]:.9g} Pa, by differences {expected[worst]:.9g} Pa; "
            f"relative error {largest:.1e}, {rtol:.1e} allowed. F = {F[p].tolist()}, state = "
            f"{state[p].tolist()}, of {law!r}"
        )
    return largest


def _random_step(law: Law) -> tuple[Array, Array]:
    """Return random deformations of different size, and the states before them."""
    generator = np.random.default_rng(0)
    strains = np.repeat([1e-3, 1e-2, 5e-2, 0.1], 25)[:, None, None] / 3
    first = np.eye(3) + strains * generator.standard_normal((100, 3, 3))
    state = law.initial_state(100)
    stress(law, first, state=state)
    return first + strains * generator.standard_normal((100, 3, 3)), state
