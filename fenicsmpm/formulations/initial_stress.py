# SPDX-License-Identifier: MIT
"""Initial stresses of a body."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from fenicsmpm._numbers import finite
from fenicsmpm.formulations.initial_state import require_initial_state
from fenicsmpm.formulations.newtonian_flow import NewtonianFlow
from fenicsmpm.materials import Law, NeoHookean, from_energy, state_of, stress, stretch_of
from fenicsmpm.points import MaterialPoints
from fenicsmpm.points.agreement import raise_together
from fenicsmpm.points.of_position import OfPosition, values_at

Array = npt.NDArray[np.float64]

_SYMMETRIC = 1e-12  # difference of sigma_ij and sigma_ji relative to the largest component


def initial_stress(
    points: MaterialPoints,
    material: Law | NeoHookean | NewtonianFlow | Callable[[Any], Any],
    sigma: npt.ArrayLike | OfPosition,
) -> None:
    """Give a body the deformation that corresponds to an initial stress. Collective.

    The current volumes and masses do not change. Each point gets the symmetric deformation gradient
    "F" with this Cauchy stress (including F33 in plane problems), its determinant "J", and V_0 =
    volume / J. If the pressure is an unknown of the material, the points get the mean stress "p".
    The fields "J_bar" and "sigma" are updated if they exist, and the state of a law is added or
    updated. Call this function after ``set_initial_state``, and before ``EnergyMomentum`` and
    similar classes store the stress of the first step.

    A body is in equilibrium if its stresses balance its weight when its points integrate both; see
    "Initial stress" in docs/howto/soil.md.

    Args:
        points: The body, with the fields of ``set_initial_state``. If it has the state of a law,
            such as a preconsolidation pressure, this is the initial state.
        material: Law at points; ``NeoHookean``, incompressible or not; ``NewtonianFlow``, which
            gets the pressure only; or a UFL energy per initial volume ``psi(F)`` [J/m^3].
        sigma: Cauchy stress [Pa], positive in tension. Either ``(3, 3)`` for all points, also in
            plane problems, as sigma_zz matters, or a function as in dolfinx, from positions
            ``(3, n)`` [m] to stresses ``(3, 3, n)``, such as ``k0_state``.

    Raises:
        ValueError: On all ranks, if the body lacks the fields of ``set_initial_state`` or already
            has an energy-conserving stress; if the stresses have a wrong shape, are not finite, are
            not symmetric, or have out-of-plane shear in two dimensions; or if the material cannot
            have them, for example outside the yield surface. The points are then unchanged.
    """
    require_initial_state(points, "initial stress")
    if "S" in points:
        raise ValueError(
            "the body already has the stress of an EnergyMomentum: call initial_stress before "
            "you create that"
        )
    comm = points.mesh.comm
    if not isinstance(material, Law | NeoHookean | NewtonianFlow):
        material = from_energy(material, comm=comm)
    error, values = _stresses(sigma, points)
    raise_together(comm, error)
    F, reached, state = _deformation(material, points, values)
    raise_together(comm, _unreachable(material, points, values, reached))
    if points.mesh.geometry.dim == 2:
        # remove out-of-plane round-off
        F[:, 2, :2] = F[:, :2, 2] = 0.0
    J = np.linalg.det(F)
    new = {"F": F, "J": J, "V_0": points.weight / J, **state}
    if isinstance(material, Law):
        known = {"sigma": stress(material, F, None, _row(material, state, len(F)))}
        known |= {"J_bar": J, "J_0": J}
        new |= {name: known[name] for name in known if name in points}
        for name, (shape, value) in material.state.items():
            if name not in points:
                points.add_field(name, shape, value)
    else:
        if "p" not in points:
            points.add_field("p")
        new["p"] = np.trace(values, axis1=1, axis2=2) / 3
    points.assign(new)


def _stresses(
    sigma: npt.ArrayLike | OfPosition, points: MaterialPoints
) -> tuple[Exception | None, Array]:
    """Return an error if stresses are invalid, and the stresses at the points ``(n, 3, 3)``."""
    if callable(sigma):
        error, values = values_at(sigma, points.x, (3, 3))
        if error is not None:
            return error, values
    else:
        try:
            given = finite(sigma, "stresses")
        except ValueError as wrong:
            return wrong, np.empty(0)
        if given.shape != (3, 3):
            return ValueError(
                f"a stress of all points needs the shape (3, 3), not {given.shape}, also in the "
                "plane; give a function of positions if stresses vary in space"
            ), given
        values = np.tile(given, (len(points), 1, 1))
    bad = np.flatnonzero(~np.isfinite(values).all(axis=(1, 2)))
    if len(bad):
        return _at(points, bad, values, "stresses must be finite"), values
    largest = np.abs(values).max(axis=(1, 2), initial=0.0)
    skew = np.abs(values - values.transpose(0, 2, 1)).max(axis=(1, 2), initial=0.0)
    bad = np.flatnonzero(skew > _SYMMETRIC * largest)
    if len(bad):
        return _at(points, bad, values, "stresses must be symmetric"), values
    if points.mesh.geometry.dim == 2:
        bad = np.flatnonzero(np.any(values[:, 2, :2] != 0, axis=1))
        if len(bad):
            return _at(
                points, bad, values, "plane strain has no shear out of the plane, sigma_xz = "
                "sigma_yz = 0"
            ), values  # fmt: skip
    return None, (values + values.transpose(0, 2, 1)) / 2


def _deformation(
    material: Law | NeoHookean | NewtonianFlow, points: MaterialPoints, sigma: Array
) -> tuple[Array, npt.NDArray[np.bool_], dict[str, Array]]:
    """Return F, whether the stress can be reached, and the fields of the state."""
    if isinstance(material, NeoHookean):
        return *material.stretch_of(sigma), {}
    if isinstance(material, NewtonianFlow):
        p = np.trace(sigma, axis1=1, axis2=2) / 3
        shear = np.abs(sigma - p[:, None, None] * np.eye(3)).max(axis=(1, 2), initial=0.0)
        return np.tile(np.eye(3), (len(p), 1, 1)), shear <= _SYMMETRIC * np.abs(p), {}
    has_state = all(name in points for name in material.state)
    state = state_of(material, points) if has_state else material.initial_state(len(points))
    F, reached = stretch_of(material, sigma, state)
    stress(material, F, None, state)  # updates the state
    return F, reached, {k: material.state_field(state, k).copy() for k in material.state}


def _row(law: Law, fields: dict[str, Array], n: int) -> Array:
    """Return the state of a law ``(n, n_state)`` from its fields."""
    state = law.initial_state(n)
    for name, values in fields.items():
        law.state_field(state, name)[...] = values
    return state


def _unreachable(
    material: Any, points: MaterialPoints, sigma: Array, reached: npt.NDArray[np.bool_]
) -> ValueError | None:
    bad = np.flatnonzero(~reached)
    if not len(bad):
        return None
    return _at(
        points, bad, sigma, f"{material!r} cannot have the stress: it lies outside the yield "
        "surface, or has a component that the material does not resist at rest"
    )  # fmt: skip


def _at(points: MaterialPoints, bad: npt.NDArray[np.intp], sigma: Array, what: str) -> ValueError:
    where = np.array2string(points.x[bad[0]], precision=6)
    return ValueError(
        f"{what}: {len(bad)} of {len(points)} points are wrong, first {where} with sigma = "
        f"{sigma[bad[0]].tolist()} Pa"
    )
