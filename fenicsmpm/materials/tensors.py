# SPDX-License-Identifier: MIT
"""Strains and eigenvalues of 3x3 tensors at a point, in scalar arithmetic for numba.

Symmetric tensors are tuples (11, 22, 33, 12, 13, 23). Other tensors are tuples of 9, by rows. Small
strains keep all their digits, because differences from the identity are computed from F - I.
"""

from __future__ import annotations

import math

from fenicsmpm.lanes import choose, rough_inverse_cube_root
from fenicsmpm.materials.law import compiled

__all__ = [
    "SMALL",
    "compose",
    "congruence",
    "cube_root",
    "deviator",
    "eigen",
    "exponential",
    "exprel",
    "exprel_small",
    "inverse",
    "inverse_cube_root",
    "log_of_one_plus",
    "log_of_one_plus_small",
    "logarithm",
    "metric_change",
    "norm_squared",
    "rows",
    "small_exponential",
    "small_logarithm",
    "volume_change",
]

SQRT_3 = math.sqrt(3)

# Below this norm, logarithms and exponentials are computed by series
SMALL = 0.1


@compiled
def _dot(a, b):  # type: ignore[no-untyped-def]
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@compiled
def _cross(a, b):  # type: ignore[no-untyped-def]
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@compiled
def _combine(s, a, t, b):  # type: ignore[no-untyped-def]
    """Return the vector s a + t b."""
    return s * a[0] + t * b[0], s * a[1] + t * b[1], s * a[2] + t * b[2]


@compiled
def inverse_cube_root(x):  # type: ignore[no-untyped-def]
    """Return x^(-1/3) to round-off, or NaN unless x is positive.

    The iterations start from a rough guess and need no division. The first ones triple the number
    of correct digits, the last one doubles it.

    Args:
        x: Number, or ``lanes.Row``.
    """
    z = rough_inverse_cube_root(x)
    for _ in range(2):
        h = 1 - x * z * z * z
        z += z * h * (1 / 3 + 2 / 9 * h)
    z += z * (1 - x * z * z * z) / 3
    return choose(x, z, math.nan)


@compiled
def cube_root(x):  # type: ignore[no-untyped-def]
    """Return the cube root to round-off, or NaN unless x is positive.

    Args:
        x: Number, or ``lanes.Row``.
    """
    z = inverse_cube_root(x)
    y = x * z * z
    return y + (x - y * y * y) * z * z / 3


@compiled
def log_of_one_plus(x):  # type: ignore[no-untyped-def]
    """Return ln(1 + x) to round-off, for small x by a series in a quarter of the time of log1p.

    Args:
        x: Number.
    """
    return log_of_one_plus_small(x) if abs(x) < SMALL else math.log1p(x)


@compiled
def log_of_one_plus_small(x):  # type: ignore[no-untyped-def]
    """Return ln(1 + x) to round-off for ``|x| < SMALL``, without a branch.

    Args:
        x: Number, or ``lanes.Row``.
    """
    y = x / (2 + x)
    z = y * y
    series = 1 / 9 + z * (1 / 11 + z * (1 / 13 + z / 15))
    return 2 * y * (1 + z * (1 / 3 + z * (1 / 5 + z * (1 / 7 + z * series))))


@compiled
def exprel(x):  # type: ignore[no-untyped-def]
    """Return the relative exponential (exp(x) - 1) / x.

    Args:
        x: Number.
    """
    return math.expm1(x) / x if x != 0 else 1.0


@compiled
def exprel_small(x):  # type: ignore[no-untyped-def]
    """Return ``exprel`` to round-off for ``|x| < SMALL``, without a branch.

    Args:
        x: Number, or ``lanes.Row``.
    """
    y = 1 + x / 10
    for k in range(9, 1, -1):
        y = 1 + x * y / k
    return y


@compiled
def volume_change(F):  # type: ignore[no-untyped-def]
    """Return J - 1 with J = det F, as the sum of the principal invariants of F - I.

    Args:
        F: Deformation gradient ``(3, 3)`` [-].
    """
    a, b, c = F[0, 0] - 1, F[0, 1], F[0, 2]
    d, e, f = F[1, 0], F[1, 1] - 1, F[1, 2]
    g, h, i = F[2, 0], F[2, 1], F[2, 2] - 1
    second = (a * e - b * d) + (a * i - c * g) + (e * i - f * h)
    third = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)
    return (a + e + i) + second + third


@compiled
def metric_change(F):  # type: ignore[no-untyped-def]
    """Return F F^T - I, a symmetric tensor.

    Args:
        F: Deformation gradient ``(3, 3)`` [-].
    """
    a, b, c = F[0, 0] - 1, F[0, 1], F[0, 2]
    d, e, f = F[1, 0], F[1, 1] - 1, F[1, 2]
    g, h, i = F[2, 0], F[2, 1], F[2, 2] - 1
    return (
        2 * a + (a * a + b * b + c * c),
        2 * e + (d * d + e * e + f * f),
        2 * i + (g * g + h * h + i * i),
        b + d + (a * d + b * e + c * f),
        c + g + (a * g + b * h + c * i),
        f + h + (d * g + e * h + f * i),
    )


@compiled
def congruence(A, S):  # type: ignore[no-untyped-def]
    """Return A S A^T, a symmetric tensor.

    Args:
        A: Tuple of 9.
        S: Symmetric tensor.
    """
    a, b, c = A[0:3], A[3:6], A[6:9]
    x, y, z = (S[0], S[3], S[4]), (S[3], S[1], S[5]), (S[4], S[5], S[2])
    p = _dot(a, x), _dot(a, y), _dot(a, z)
    q = _dot(b, x), _dot(b, y), _dot(b, z)
    r = _dot(c, x), _dot(c, y), _dot(c, z)
    return _dot(p, a), _dot(q, b), _dot(r, c), _dot(p, b), _dot(p, c), _dot(q, c)


@compiled
def rows(F):  # type: ignore[no-untyped-def]
    """Return an array (3, 3) as a tuple of 9.

    Args:
        F: Array ``(3, 3)``.
    """
    return (
        F[0, 0], F[0, 1], F[0, 2],
        F[1, 0], F[1, 1], F[1, 2],
        F[2, 0], F[2, 1], F[2, 2],
    )  # fmt: skip


@compiled
def inverse(A):  # type: ignore[no-untyped-def]
    """Return the inverse of a tensor as a tuple of 9.

    Args:
        A: Tuple of 9.
    """
    a, b, c, d, e, f, g, h, i = A
    p, q, r = e * i - f * h, f * g - d * i, d * h - e * g
    s = 1 / (a * p + b * q + c * r)
    return (
        s * p, s * (c * h - b * i), s * (b * f - c * e),
        s * q, s * (a * i - c * g), s * (c * d - a * f),
        s * r, s * (b * g - a * h), s * (a * e - b * d),
    )  # fmt: skip


@compiled
def compose(w, n):  # type: ignore[no-untyped-def]
    """Return the symmetric tensor with given eigenvalues and eigenvectors.

    Args:
        w: Three eigenvalues.
        n: Tuple of 9 with the eigenvectors in its columns.
    """
    return congruence(n, (w[0], w[1], w[2], 0.0, 0.0, 0.0))


@compiled
def _normal(a, b, c):  # type: ignore[no-untyped-def]
    """Return the unit normal of the plane of three vectors, from their longest cross product."""
    n, p, q = _cross(a, b), _cross(a, c), _cross(b, c)
    nn, pp, qq = _dot(n, n), _dot(p, p), _dot(q, q)
    if pp > nn:
        n, nn = p, pp
    if qq > nn:
        n, nn = q, qq
    s = 1 / math.sqrt(nn)
    return s * n[0], s * n[1], s * n[2]


@compiled
def _perpendicular(n):  # type: ignore[no-untyped-def]
    """Return a unit vector normal to the unit vector n."""
    if abs(n[0]) > abs(n[1]):
        s = 1 / math.sqrt(n[0] * n[0] + n[2] * n[2])
        return -s * n[2], 0.0, s * n[0]
    s = 1 / math.sqrt(n[1] * n[1] + n[2] * n[2])
    return 0.0, s * n[2], -s * n[1]


@compiled
def eigen(A):  # type: ignore[no-untyped-def]
    """Return eigenvalues and eigenvectors of a symmetric tensor.

    The eigenvalue that is far from the other two, and its eigenvector, follow from the
    characteristic polynomial. The others follow from a rotation in the plane normal to this
    eigenvector. Therefore equal and nearly equal eigenvalues need no special treatment, errors are
    a few units of round-off of the largest eigenvalue, and eigenvectors are orthonormal.

    Args:
        A: Symmetric tensor.

    Returns:
        Eigenvalues in no particular order, and a tuple of 9 with the eigenvectors in its columns.
    """
    if A[4] == 0 and A[5] == 0:  # plane strain: the third direction is an eigenvector
        mean = 0.0
        d1, d2, d3, a12, a13, a23 = A
        w, n, u, v = d3, (0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)
    else:
        mean = (A[0] + A[1] + A[2]) / 3
        d1, d2, d3, a12, a13, a23 = A[0] - mean, A[1] - mean, A[2] - mean, A[3], A[4], A[5]
        p2 = (d1 * d1 + d2 * d2 + d3 * d3 + 2 * (a12 * a12 + a13 * a13 + a23 * a23)) / 6
        if not p2 > 1e-140:  # spherical; this also prevents underflow of p^4
            return (A[0], A[1], A[2]), (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
        p = math.sqrt(p2)
        # the deviator's eigenvalues are p x with x^3 - 3 x = 2 r
        r = _dot((d1, a12, a13), _cross((a12, d2, a23), (a13, a23, d3))) / (2 * p2 * p)
        half = min(abs(r), 1.0)
        x = SQRT_3 + (2 - SQRT_3) * half  # chord to the root in [sqrt(3), 2], then Newton's method
        for _ in range(3):
            x = (2 * x * x * x + 2 * half) / (3 * x * x - 3)
        w = math.copysign(p * x, r)
        n = _normal((d1 - w, a12, a13), (a12, d2 - w, a23), (a13, a23, d3 - w))
        u = _perpendicular(n)
        v = _cross(n, u)
    du = _dot((d1, a12, a13), u), _dot((a12, d2, a23), u), _dot((a13, a23, d3), u)
    dv = _dot((d1, a12, a13), v), _dot((a12, d2, a23), v), _dot((a13, a23, d3), v)
    uu, vv, uv = _dot(u, du), _dot(v, dv), _dot(u, dv)
    if uv != 0:  # Jacobi rotation of u and v
        theta = (vv - uu) / (2 * uv)
        t = math.copysign(1.0, theta) / (abs(theta) + math.sqrt(theta * theta + 1))
        c = 1 / math.sqrt(t * t + 1)
        u, v = _combine(c, u, -t * c, v), _combine(t * c, u, c, v)
        uu, vv = uu - t * uv, vv + t * uv
    return (
        (mean + w, mean + uu, mean + vv),
        (n[0], u[0], v[0], n[1], u[1], v[1], n[2], u[2], v[2]),
    )


# Coefficients of 2 artanh(y) / y in powers of y^2, and of exp, from the highest power down
_LOGARITHM = tuple(2 / k for k in range(15, 0, -2))
_EXPONENTIAL = tuple(1 / math.factorial(k) for k in range(11, -1, -1))


@compiled
def _times(A, B):  # type: ignore[no-untyped-def]
    """Return A B, a symmetric tensor, of symmetric tensors with the same principal axes."""
    return (
        A[0] * B[0] + A[3] * B[3] + A[4] * B[4],
        A[3] * B[3] + A[1] * B[1] + A[5] * B[5],
        A[4] * B[4] + A[5] * B[5] + A[2] * B[2],
        A[0] * B[3] + A[3] * B[1] + A[4] * B[5],
        A[0] * B[4] + A[3] * B[5] + A[4] * B[2],
        A[3] * B[4] + A[1] * B[5] + A[5] * B[2],
    )


@compiled
def _polynomial(A, coefficients):  # type: ignore[no-untyped-def]
    """Return a polynomial of a symmetric tensor, by Horner's rule.

    By the Cayley-Hamilton theorem, A^3 = I_1 A^2 - I_2 A + I_3, so any polynomial has the form a +
    b A + c A^2.
    """
    A2 = _times(A, A)
    first = A[0] + A[1] + A[2]
    second = (first * first - (A2[0] + A2[1] + A2[2])) / 2
    third = _dot((A[0], A[3], A[4]), _cross((A[3], A[1], A[5]), (A[4], A[5], A[2])))
    a = b = c = 0 * A[0]
    for coefficient in coefficients:
        a, b, c = coefficient + third * c, a - second * c, b + first * c
    return (
        a + b * A[0] + c * A2[0],
        a + b * A[1] + c * A2[1],
        a + b * A[2] + c * A2[2],
        b * A[3] + c * A2[3],
        b * A[4] + c * A2[4],
        b * A[5] + c * A2[5],
    )


@compiled
def norm_squared(A):  # type: ignore[no-untyped-def]
    """Return A : A for a symmetric tensor.

    Args:
        A: Symmetric tensor.
    """
    mixed = A[3] * A[3] + A[4] * A[4] + A[5] * A[5]
    return A[0] * A[0] + A[1] * A[1] + A[2] * A[2] + 2 * mixed


@compiled
def deviator(A):  # type: ignore[no-untyped-def]
    """Return A - tr(A) / 3 I for a symmetric tensor.

    Args:
        A: Symmetric tensor.
    """
    mean = (A[0] + A[1] + A[2]) / 3
    return A[0] - mean, A[1] - mean, A[2] - mean, A[3], A[4], A[5]


@compiled
def logarithm(A):  # type: ignore[no-untyped-def]
    """Return ln(I + A) of a symmetric tensor to round-off, without eigenvalues if A is small.

    Args:
        A: Symmetric tensor.
    """
    if norm_squared(A) < SMALL**2:
        return small_logarithm(A)
    w, n = eigen(A)
    return compose((log_of_one_plus(w[0]), log_of_one_plus(w[1]), log_of_one_plus(w[2])), n)


@compiled
def small_logarithm(A):  # type: ignore[no-untyped-def]
    """Return ln(I + A) = 2 artanh(Y) with Y = A (2 I + A)^-1, to round-off for ``|A| < SMALL``.

    Args:
        A: Symmetric tensor, of numbers or of ``lanes.Row``.
    """
    b = (2 + A[0], A[3], A[4], A[3], 2 + A[1], A[5], A[4], A[5], 2 + A[2])
    c = inverse(b)
    Y = _times(A, (c[0], c[4], c[8], c[1], c[2], c[5]))
    return _times(Y, _polynomial(_times(Y, Y), _LOGARITHM))


@compiled
def small_exponential(A):  # type: ignore[no-untyped-def]
    """Return exp(A) of a symmetric tensor, to round-off for ``|A| < 2 SMALL``.

    Args:
        A: Symmetric tensor, of numbers or of ``lanes.Row``.
    """
    return _polynomial(A, _EXPONENTIAL)


@compiled
def exponential(A):  # type: ignore[no-untyped-def]
    """Return exp(A) of a symmetric tensor to round-off, without eigenvalues if A is small.

    Args:
        A: Symmetric tensor.
    """
    if norm_squared(A) < SMALL**2:
        return small_exponential(A)
    w, n = eigen(A)
    return compose((math.exp(w[0]), math.exp(w[1]), math.exp(w[2])), n)
