# SPDX-License-Identifier: MIT
"""Common functions of laws in principal Hencky strains, for numba.

The elastic part of the deformation is ``b_e = F C_p^-1 F^T``. The first nine numbers of the state
are C_p^-1. The trial strains of a step are ``eps_a = 1/2 ln b_a``, where b_a are the eigenvalues of
``F C_p^-1 F^T`` for the state before the step. A law maps them to principal Kirchhoff stresses
tau_a without changing the principal directions (E. A. de Souza Neto, D. Peric, D. R. J. Owen,
"Computational Methods for Plasticity", section 14.4).
"""

from __future__ import annotations

import math

import numpy as np

from fenicsmpm.materials.law import compiled
from fenicsmpm.materials.tensors import (
    compose,
    congruence,
    eigen,
    inverse,
    log_of_one_plus,
    metric_change,
    rows,
)


@compiled
def elastic_deformation(F, state):  # type: ignore[no-untyped-def]
    """Return b_e - I with b_e = F C_p^-1 F^T, a symmetric tensor.

    Args:
        F: Deformation gradient ``(3, 3)`` [-].
        state: State of the point, which starts with C_p^-1.
    """
    b = metric_change(F)
    # plus F (C_p^-1 - I) F^T
    p = congruence(
        rows(F), (state[0] - 1, state[4] - 1, state[8] - 1, state[1], state[2], state[5])
    )
    return b[0] + p[0], b[1] + p[1], b[2] + p[2], b[3] + p[3], b[4] + p[4], b[5] + p[5]


@compiled
def principal_strains(b):  # type: ignore[no-untyped-def]
    """Return the logarithmic strains, largest first, and the directions in columns.

    Args:
        b: Symmetric tensor b - I, as in ``tensors``.
    """
    w, n = eigen(b)
    x, y, z = w
    i, j, k = 0, 1, 2
    if x < y:
        x, y, i, j = y, x, j, i
    if y < z:
        y, z, j, k = z, y, k, j
    if x < y:
        x, y, i, j = y, x, j, i
    directions = (
        n[i], n[j], n[k],
        n[3 + i], n[3 + j], n[3 + k],
        n[6 + i], n[6 + j], n[6 + k],
    )  # fmt: skip
    logarithms = log_of_one_plus(x), log_of_one_plus(y), log_of_one_plus(z)
    return (0.5 * logarithms[0], 0.5 * logarithms[1], 0.5 * logarithms[2]), directions


@compiled
def set_cauchy_stress(sigma, tau, n, jacobian):  # type: ignore[no-untyped-def]
    """Set sigma to tau / J; NaN unless J is positive.

    Args:
        sigma: Result ``(3, 3)`` [Pa].
        tau: Principal Kirchhoff stresses [Pa].
        n: Tuple of 9 with the principal directions in its columns.
        jacobian: J [-].
    """
    r = 1 / jacobian if jacobian > 0 else math.nan
    s = compose((r * tau[0], r * tau[1], r * tau[2]), n)
    sigma[0, 0], sigma[1, 1], sigma[2, 2] = s[0], s[1], s[2]
    sigma[0, 1] = sigma[1, 0] = s[3]
    sigma[0, 2] = sigma[2, 0] = s[4]
    sigma[1, 2] = sigma[2, 1] = s[5]


@compiled
def set_plastic_deformation(F, strain, n, state):  # type: ignore[no-untyped-def]
    """Set C_p^-1 = F^-1 b_e F^-T in the state.

    Args:
        F: Deformation gradient ``(3, 3)`` [-].
        strain: Principal elastic strains [-].
        n: Tuple of 9 with the principal directions in its columns.
        state: State of the point, which starts with C_p^-1.
    """
    b = compose((math.exp(2 * strain[0]), math.exp(2 * strain[1]), math.exp(2 * strain[2])), n)
    c = congruence(inverse(rows(F)), b)
    state[0], state[4], state[8] = c[0], c[1], c[2]
    state[1] = state[3] = c[3]
    state[2] = state[6] = c[4]
    state[5] = state[7] = c[5]


@compiled
def transposed_times(A, b):  # type: ignore[no-untyped-def]
    """Return A^T b.

    Args:
        A: Tuple of 9, by rows.
        b: Tuple of 3.
    """
    return (
        A[0] * b[0] + A[3] * b[1] + A[6] * b[2],
        A[1] * b[0] + A[4] * b[1] + A[7] * b[2],
        A[2] * b[0] + A[5] * b[1] + A[8] * b[2],
    )


@compiled
def work_derivatives(tau, D, flow):  # type: ignore[no-untyped-def]
    """Return the derivatives of energy plus dissipation by principal trial strains [J/m^3].

    The energy changes by tau : d strain - tau : d flow, the dissipation by tau : d flow + d tau :
    flow.

    Args:
        tau: Principal Kirchhoff stresses [Pa].
        D: D tau_a / d eps_b, a tuple of 9, by rows [Pa].
        flow: Principal plastic strains of the step [-].
    """
    w = transposed_times(D, flow)
    return tau[0] + w[0], tau[1] + w[1], tau[2] + w[2]


@compiled
def quotients(strain, tau, D):  # type: ignore[no-untyped-def]
    """Return (tau_a - tau_b) / (eps_a - eps_b) for ab = 12, 13, 23 [Pa].

    For equal strains the quotients are replaced by their limits.

    Args:
        strain: Principal trial strains [-].
        tau: Principal Kirchhoff stresses [Pa].
        D: D tau_a / d eps_b, a tuple of 9, by rows [Pa].
    """
    return (
        _quotient(strain[0] - strain[1], tau[0] - tau[1], D[0] - D[1] - D[3] + D[4]),
        _quotient(strain[0] - strain[2], tau[0] - tau[2], D[0] - D[2] - D[6] + D[8]),
        _quotient(strain[1] - strain[2], tau[1] - tau[2], D[4] - D[5] - D[7] + D[8]),
    )


@compiled
def _quotient(strain, tau, twice_slope):  # type: ignore[no-untyped-def]
    # For smaller differences of strains, the relative round-off would exceed 1e-8.
    return tau / strain if abs(strain) > 1e-8 else 0.5 * twice_slope


@compiled
def set_tangent(F, strain, n, tau, D, quotient, dPdF):  # type: ignore[no-untyped-def]
    """Set dPdF for principal Kirchhoff stresses that depend on principal logarithmic strains.

    In principal axes and with g = dF F^-1, the diagonal entries are d tau_aa = sum_b (d tau_a / d
    eps_b) g_bb. The other entries d tau_ab are (tau_a - tau_b) / (b_a - b_b) times those of b = F
    C_p^-1 F^T. Finally, dP = (d tau - tau g^T) F^-T.

    Args:
        F: Deformation gradient ``(3, 3)``.
        strain: Principal trial strains [-].
        n: Tuple of 9 with the principal directions in its columns.
        tau: Principal Kirchhoff stresses [Pa].
        D: D tau_a / d eps_b, a tuple of 9, by rows [Pa].
        quotient: See ``quotients`` [Pa].
        dPdF: Result ``(3, 3, 3, 3)`` [Pa].
    """
    work = np.empty((5, 3, 3))
    # directions in columns, the same pulled back, and the factors of g_cc, g_ac and g_ca
    N, W, direct, along, across = work[0], work[1], work[2], work[3], work[4]
    inverse_F = inverse(rows(F))
    for a in range(3):
        for i in range(3):
            N[i, a] = n[3 * i + a]
        for i in range(3):
            W[i, a] = (
                inverse_F[3 * i] * N[0, a]
                + inverse_F[3 * i + 1] * N[1, a]
                + inverse_F[3 * i + 2] * N[2, a]
            )
    for a in range(3):
        b_a = math.exp(2 * strain[a])
        for j in range(3):
            b_j = math.exp(2 * strain[j])
            y = 2 * (strain[a] - strain[j])  # ln(b_a / b_j)
            # The pairs are ordered 01, 02, 12. Entries with a = j are not used.
            of_pair = quotient[min(max(a + j - 1, 0), 2)]
            slope = 0.5 * of_pair * (y / math.expm1(y) if y != 0 else 1.0) / b_j
            direct[a, j] = D[3 * a + j]
            along[a, j] = slope * b_j
            across[a, j] = slope * b_a - tau[a]
        direct[a, a] -= tau[a]
        along[a, a] = across[a, a] = 0.0
    for i in range(3):
        for j in range(3):
            for k in range(3):
                for m in range(3):
                    total = 0.0
                    for a in range(3):
                        for b in range(3):
                            total += N[i, a] * (
                                direct[a, b] * W[j, a] * N[k, b] * W[m, b]
                                + along[a, b] * W[j, b] * N[k, a] * W[m, b]
                                + across[a, b] * W[j, b] * N[k, b] * W[m, a]
                            )
                    dPdF[i, j, k, m] = total


@compiled
def set_gradient(F, n, w, G):  # type: ignore[no-untyped-def]
    """Set G to the derivative with respect to F of a function of principal trial strains.

    Args:
        F: Deformation gradient ``(3, 3)``.
        n: Tuple of 9 with the principal directions in its columns.
        w: Derivatives with respect to the strains [J/m^3].
        G: Result ``(3, 3)`` [J/m^3], (sum_a w_a n_a n_a) F^-T.
    """
    W, f = compose(w, n), inverse(rows(F))
    W = W[0], W[3], W[4], W[3], W[1], W[5], W[4], W[5], W[2]
    for i in range(3):
        for j in range(3):
            G[i, j] = (
                W[3 * i] * f[3 * j] + W[3 * i + 1] * f[3 * j + 1] + W[3 * i + 2] * f[3 * j + 2]
            )
