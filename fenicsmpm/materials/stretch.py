# SPDX-License-Identifier: MIT
"""Deformation at which a law at points has a given stress."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from fenicsmpm.materials.evaluate import stress
from fenicsmpm.materials.law import Law

Array = npt.NDArray[np.float64]

# Symmetric changes of F: all six for solids, and the volumetric one for fluids, whose stress does
# not depend on the others
_OF_VOLUME = np.eye(3)[None]
_ALL = np.zeros((6, 3, 3))
for _k, (_i, _j) in enumerate(((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))):
    _ALL[_k, _i, _j] = _ALL[_k, _j, _i] = 1.0

_ITERATIONS = 60
_HALVINGS = 10
_LARGEST = 0.2  # largest change of F in an iteration, which keeps strains bounded [-]
_DIFFERENCE = 1e-6  # largest step of central differences, which gives nine digits of the tangent
_NEAR = 1e-2  # step of differences relative to stress / modulus: they stay off the yield surface
_SHORTEST = 1e-10  # shortest step of differences, which leaves few digits
_AT_ONCE = 20_000  # number of points whose tangents are in memory at a time
_CLOSE = 1e-9  # tolerance relative to the stress, or to small strains times the modulus
_PLASTIC = 1e-10  # dissipated work times modulus over squared stress, below which it is round-off


def stretch_of(
    law: Law, sigma: npt.ArrayLike, state: Array | None = None
) -> tuple[Array, npt.NDArray[np.bool_]]:
    """Return symmetric deformation gradients at which a law has given Cauchy stresses.

    Newton's method finds them to round-off, with the tangent by finite differences. It starts from
    a small isotropic deformation, in which sand resists. A rotation before the deformation does not
    change the stress of an isotropic law. Of all F with a given stress, this function returns the
    one without rotation, F = U. Fluids have F = J^(1/3) I.

    Args:
        law: Constitutive law, evaluated at rest with zero velocity gradients.
        sigma: Cauchy stresses ``(n, 3, 3)`` [Pa], symmetric.
        state: State ``(n, law.n_state)``, not changed. None for undeformed points.

    Returns:
        Deformation gradients ``(n, 3, 3)`` [-], and a mask ``(n,)`` of the points at which the law
        has the given stress. The mask is False if the stress lies outside the yield surface, or has
        components that the law does not resist. If the state of the law has a field "dissipation",
        the mask is also False where the law dissipates on the way.

    Raises:
        ValueError: If an array has a wrong shape.
    """
    sigma = np.asarray(sigma, dtype=np.float64)
    if sigma.ndim != 3 or sigma.shape[1:] != (3, 3):
        raise ValueError(f"stresses must have shape (n, 3, 3), not {sigma.shape}")
    state = law.initial_state(len(sigma)) if state is None else state
    F, reached = np.empty_like(sigma), np.empty(len(sigma), dtype=np.bool_)
    for start in range(0, len(sigma), _AT_ONCE):
        some = slice(start, start + _AT_ONCE)
        F[some], reached[some] = _solve(law, sigma[some], state[some])
    return F, reached


def _solve(law: Law, sigma: Array, state: Array) -> tuple[Array, npt.NDArray[np.bool_]]:
    changes = _OF_VOLUME if law.is_fluid else _ALL
    modulus = law.wave_speed_modulus
    # The second term is due to the round-off of F.
    close = _CLOSE * np.maximum(_largest(sigma), 1e-6 * modulus)
    # The modulus is larger than the bulk modulus, so this is not more than the mean stress needs.
    mean = np.trace(sigma, axis1=1, axis2=2) / (9 * modulus)
    F = (1 + np.clip(mean, -_LARGEST, _LARGEST))[:, None, None] * np.eye(3)
    half = np.clip(_NEAR * _largest(sigma) / modulus, _SHORTEST, _DIFFERENCE)
    excess, size = _excess(law, F, sigma, state)
    active = np.flatnonzero(size > 0)  # points at which the excess still decreases
    for _ in range(_ITERATIONS):
        if not len(active):
            break
        step = _newton_step(law, F[active], state[active], excess[active], changes, half[active])
        better = np.zeros(len(active), dtype=np.bool_)
        for _ in range(_HALVINGS):
            trying = np.flatnonzero(~better)
            at = active[trying]
            F_new = F[at] + step[trying]
            excess_new, size_new = _excess(law, F_new, sigma[at], state[at])
            good = size_new < size[at]  # False for the NaN of an inverted point
            better[trying[good]] = True
            at = at[good]
            F[at], excess[at], size[at] = F_new[good], excess_new[good], size_new[good]
            step[trying] /= 2
            if np.all(better | (size[active] <= close[active])):
                break  # a full step brings no improvement: round-off is reached
        active = active[better & (size[active] > 0)]
    return F, size <= close


def _excess(law: Law, F: Array, sigma: Array, state: Array) -> tuple[Array, Array]:
    """Return the stress minus a given one [Pa], and its size, infinite if the law has yielded."""
    after = state.copy()
    excess = stress(law, F, None, after) - sigma
    size = _largest(excess)
    if "dissipation" in law.columns:
        # Stresses on the yield surface are also reached by steps that end before yielding.
        work = law.state_field(after, "dissipation") - law.state_field(state, "dissipation")
        size[work * law.wave_speed_modulus > _PLASTIC * _largest(sigma) ** 2] = np.inf
    return excess, size


def _newton_step(
    law: Law, F: Array, state: Array, excess: Array, changes: Array, half: Array
) -> Array:
    """Return the change of F ``(n, 3, 3)`` that removes the excess stress, limited in length.

    Args:
        law: Constitutive law.
        F: Deformation gradients ``(n, 3, 3)`` at the start [-].
        state: State ``(n, law.n_state)`` at the start.
        excess: Excess stress ``(n, 3, 3)`` [Pa].
        changes: Symmetric directions ``(m, 3, 3)`` in which F may change.
        half: Steps of the central differences ``(n,)``.
    """
    rows = np.empty((len(F), len(changes), len(changes)))
    for k, change in enumerate(changes):
        by = half[:, None, None] * change
        ahead, behind = (stress(law, F + c, None, state.copy()) for c in (by, -by))
        rows[:, :, k] = np.einsum("nij,mij->nm", ahead - behind, changes) / (2 * half[:, None])
    rows[~np.isfinite(rows)] = 0.0
    # The matrix is singular if the law has no stiffness in some direction. A tiny fraction of the
    # modulus on the diagonal does not affect the result.
    rows += 1e-9 * law.wave_speed_modulus * np.eye(len(changes))
    right = -np.einsum("nij,mij->nm", excess, changes)
    step = np.einsum("nm,mij->nij", np.linalg.solve(rows, right[..., None])[..., 0], changes)
    length = np.maximum(_largest(step), 1e-300)
    return step * np.minimum(1, _LARGEST / length)[:, None, None]


def _largest(tensors: Array) -> Array:
    return np.abs(tensors).max(axis=(1, 2), initial=0.0)
