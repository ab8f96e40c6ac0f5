# SPDX-License-Identifier: MIT
"""Constitutive law at a material point: compiled functions, parameters and state."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
from numba.core.dispatcher import Dispatcher

from fenicsmpm._njit import njit
from fenicsmpm._numbers import finite, number, positive

# How functions of one point are compiled:
# - Division by zero gives infinity or NaN, as in C. An exception in a loop over points could not
#   name the point.
# - Products and sums are fused (fma), which is faster and at least as accurate. Sums are not
#   reordered, because the accuracy of small strains depends on their order.
# - Calls are inlined, because a call counts the references to its arrays, which takes longer than
#   most laws.
compiled = njit(error_model="numpy", fastmath={"contract"}, forceinline=True)


@dataclass(eq=False, repr=False)
class Law:
    """Constitutive law, given by functions of one point that numba has compiled.

    Loops over points call these functions. The functions must not raise, and ``update`` should not
    allocate memory. For a deformation gradient with a determinant <= 0 they must give NaN, which
    the loops detect.

    Args:
        update: ``update(F, L, parameters, state, sigma)`` sets the Cauchy stress sigma ``(3, 3)``
            [Pa], all of it, and replaces the state before the step ``(n_state,)`` by that after it.
            Explicit steps read the upper triangle only. F is the deformation gradient ``(3, 3)``,
            with F-bar the modified one (F33 is kept in plane strain), and L the velocity gradient
            ``(3, 3)`` [1/s].
        parameters: Parameters ``(n_parameters,)``, which are passed to the functions.
        wave_speed_modulus: Modulus of the fastest elastic wave [Pa], whose speed is the square root
            of modulus over density. For solids it is lambda + 2 mu.
        state: Shape and initial value of each state field, by name. The state of a point is stored
            as one row of ``n_state`` numbers, with one field after the other.
        energy: ``energy(F, parameters, state)`` returns the free energy per initial volume [J/m^3]
            for the state after the step.
        tangent: ``tangent(F, parameters, state, dPdF)`` sets the derivative
            ``dPdF[i, J, k, L] = dP[i, J] / dF[k, L]`` [Pa] of the first Piola-Kirchhoff stress
            after the step. The state is that before the step and must not be changed.
        work_gradient: ``work_gradient(F, parameters, state, G)`` sets the derivative ``G[i, J]``
            [Pa] of energy plus dissipation after the step with respect to F. It is needed where
            this derivative differs from P, as with non-associated plastic flow. The state is
            treated as in ``tangent``.
        update_eight: ``update_eight(F, L, parameters, state, sigma) -> bool`` does the same as
            ``update`` for eight points at once in simple cases, such as small strains. F, L and
            sigma have entries of type ``lanes.Row``, and ``state[k]`` holds the k-th number of each
            point. If it returns False, it must leave the state unchanged, and ``update`` is called
            for each point. It is not needed if ``update`` has no branches and no state.
        needs_rate: Whether ``update`` uses L. If not, loops skip the computation of L and pass
            zeros.
        is_fluid: Whether the stress depends on F only through its determinant. Loops may then
            replace F by another tensor of the same determinant, before large shears spoil the
            determinant by round-off.

    Attributes:
        columns: Slice of each state field in a row of the state, by name.

    Raises:
        TypeError: If a function was not compiled by numba.
        ValueError: If parameters, initial values or the modulus are not finite numbers.
    """

    update: Callable[..., None]
    parameters: npt.NDArray[np.float64]
    wave_speed_modulus: float
    state: Mapping[str, tuple[tuple[int, ...], npt.ArrayLike]] = field(default_factory=dict)
    energy: Callable[..., float] | None = None
    tangent: Callable[..., None] | None = None
    work_gradient: Callable[..., None] | None = None
    update_eight: Callable[..., bool] | None = None
    needs_rate: bool = True
    is_fluid: bool = False

    def __post_init__(self) -> None:
        """Check the arguments, and lay out the state."""
        for name in ("update", "energy", "tangent", "work_gradient", "update_eight"):
            function = getattr(self, name)
            if not (isinstance(function, Dispatcher) or (function is None and name != "update")):
                raise TypeError(
                    f"{name} of a law must be compiled by numba: {function!r}. "
                    "Decorate it with @fenicsmpm.materials.compiled."
                )
        self.parameters = finite(self.parameters, "parameters of a law").ravel()
        positive(self.wave_speed_modulus, "wave_speed_modulus", "modulus of the fastest wave", "Pa")
        self.columns: dict[str, slice] = {}
        initial = [np.empty(0)]
        for name, (shape, value) in self.state.items():
            row = np.broadcast_to(
                finite(value, f"initial value of state field {name!r}"), shape
            ).ravel()
            start = sum(len(r) for r in initial)
            self.columns[name] = slice(start, start + len(row))
            initial.append(row)
        self._initial_row = np.concatenate(initial)

    @property
    def n_state(self) -> int:
        """Number of values in the state of a point."""
        return len(self._initial_row)

    def initial_state(self, n_points: int) -> npt.NDArray[np.float64]:
        """Return the state of undeformed points, ``(n_points, n_state)``.

        Args:
            n_points: Number of points.
        """
        return np.tile(self._initial_row, (n_points, 1))

    def state_field(self, state: npt.NDArray[np.float64], name: str) -> npt.NDArray[np.float64]:
        """Return one field of the state, as a view.

        Args:
            state: State ``(n_points, n_state)``, C-contiguous.
            name: Name of the field.

        Returns:
            View of shape ``(n_points, *shape)``.

        Raises:
            KeyError: If there is no such field.
        """
        if name not in self.columns:
            raise KeyError(f"no state field {name!r} in {self!r}: {list(self.columns)}")
        return state[:, self.columns[name]].reshape(len(state), *self.state[name][0])

    def __repr__(self) -> str:
        """Parameters and fields of the state."""
        return (
            f"{type(self).__name__}(parameters={self.parameters}, "
            f"wave_speed_modulus={self.wave_speed_modulus:g} Pa, state={list(self.state)})"
        )


def poissons_ratio(nu: float, *, incompressible: bool) -> float:
    """Return Poisson's ratio [-] if it lies in the valid range.

    Args:
        nu: Poisson's ratio [-].
        incompressible: Whether 0.5 is valid.

    Raises:
        ValueError: If it lies outside.
    """
    result = number(nu, "nu", "Poisson's ratio", "-")
    if -1 < result < 0.5 or (incompressible and result == 0.5):
        return result
    hint = ""
    if result <= -1:
        hint = ". At -1 the shear modulus is infinite"
    elif result > 0.5:
        hint = ". Use nu = 0.5 for an incompressible material"
    if result >= 0.5 and not incompressible:
        hint += (
            ". A stress that follows from the deformation alone needs a finite bulk modulus: use "
            "0.499, say, for a nearly incompressible material"
        )
    interval = "(-1, 0.5]" if incompressible else "(-1, 0.5)"
    raise ValueError(f"Poisson's ratio must lie in {interval}: nu = {result}{hint}")


def elastic_moduli(E: float, nu: float) -> tuple[float, float]:
    """Return shear modulus mu and bulk modulus kappa [Pa]; both are finite.

    Args:
        E: Young's modulus [Pa], positive.
        nu: Poisson's ratio [-], -1 < nu < 0.5.

    Raises:
        ValueError: If a parameter is out of range.
    """
    E = positive(E, "E", "Young's modulus", "Pa")
    nu = poissons_ratio(nu, incompressible=False)
    return E / (2 * (1 + nu)), E / (3 * (1 - 2 * nu))


def p_wave_modulus(mu: float, kappa: float) -> float:
    """Return the P-wave modulus lambda + 2 mu = kappa + 4/3 mu of an elastic solid [Pa].

    Args:
        mu: Shear modulus [Pa].
        kappa: Bulk modulus [Pa].
    """
    return kappa + 4 / 3 * mu
