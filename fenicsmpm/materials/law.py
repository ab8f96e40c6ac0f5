# SPDX-License-Identifier: MIT
"""What a constitutive law at a material point is: one compiled function, parameters, state."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
from numba.core.dispatcher import Dispatcher

from fenicsmpm._njit import njit

# How functions of one point are compiled: division by zero gives infinity or NaN, as in C, because
# an exception in a loop over points would name no point; products and sums are fused (fma), which
# is faster and not less accurate. Sums are not reordered, small strains depend on that. Calls
# are inlined, because a call counts references to its arrays, which takes longer than most laws.
compiled = njit(error_model="numpy", fastmath={"contract"}, forceinline=True)


@dataclass(eq=False, repr=False)
class Law:
    """A constitutive law as functions of one point, compiled by numba.

    Loops over points compile them in. They must not raise, and ``update`` should not allocate; a
    deformation gradient with a determinant <= 0 must give NaN, which the loops look for.

    Args:
        update: ``update(F, L, parameters, state, sigma)``: from the deformation gradient F
            ``(3, 3)`` (with F-bar, the modified one; F33 = 1 in plane strain), the velocity
            gradient L ``(3, 3)`` [1/s] and the state before the step, ``(n_state,)``, it sets the
            Cauchy stress sigma ``(3, 3)`` [Pa] and the state after the step.
        parameters: ``(n_parameters,)``, what the functions get as theirs.
        wave_speed_modulus: modulus of the fastest elastic wave [Pa]: its speed is the root of
            modulus over density. For solids lambda + 2 mu.
        state: fields of the state by name: shape and initial value. At a point they stand one after
            the other in one row of ``n_state`` numbers.
        energy: ``energy(F, parameters, state)``: free energy per initial volume [J/m^3], of the
            state after the step.
        tangent: ``tangent(F, parameters, state, dPdF)``: sets the derivative
            ``dPdF[i, J, k, L] = dP[i, J] / dF[k, L]`` [Pa] of the first Piola-Kirchhoff stress
            after the step; state is that before the step and stays as it is.
        update_eight: ``update_eight(F, L, parameters, state, sigma) -> bool``: the same for eight
            points at once, if it is easy, such as small strains: F, L and sigma in ``lanes.Row``,
            ``state[k]`` the k-th number of each. If it returns False, the state is as it was, and
            ``update`` is called for each point. Not needed where ``update`` has no branches and no
            state.
        needs_rate: whether ``update`` reads L; if not, loops save the trouble and give zeros.
        is_fluid: whether of F only its determinant matters. Loops may then replace F by any tensor
            of the same determinant, before round-off spoils that of a tensor with large shears.

    Raises:
        TypeError: for a function that numba has not compiled.
        ValueError: for parameters, initial values or a modulus that are no finite numbers.
    """

    update: Callable[..., None]
    parameters: npt.NDArray[np.float64]
    wave_speed_modulus: float
    state: Mapping[str, tuple[tuple[int, ...], npt.ArrayLike]] = field(default_factory=dict)
    energy: Callable[..., float] | None = None
    tangent: Callable[..., None] | None = None
    update_eight: Callable[..., bool] | None = None
    needs_rate: bool = True
    is_fluid: bool = False

    def __post_init__(self) -> None:
        """Check, and lay out the state."""
        for name in ("update", "energy", "tangent", "update_eight"):
            function = getattr(self, name)
            if not (isinstance(function, Dispatcher) or (function is None and name != "update")):
                raise TypeError(
                    f"{name} of a law must be compiled by numba: {function!r}. "
                    "Decorate it with @fenicsmpm.materials.compiled."
                )
        self.parameters = np.array(self.parameters, dtype=np.float64).ravel()
        if not np.isfinite(self.parameters).all():
            raise ValueError(f"parameters of a law must be finite: {self.parameters!r}")
        positive(self.wave_speed_modulus, "wave_speed_modulus", "modulus of the fastest wave", "Pa")
        self.columns: dict[str, slice] = {}
        initial = [np.empty(0)]
        for name, (shape, value) in self.state.items():
            row = np.broadcast_to(np.asarray(value, dtype=np.float64), shape).ravel()
            if not np.isfinite(row).all():
                raise ValueError(f"initial value of state field {name!r} must be finite: {row}")
            start = sum(len(r) for r in initial)
            self.columns[name] = slice(start, start + len(row))
            initial.append(row)
        self._initial_row = np.concatenate(initial)

    @property
    def n_state(self) -> int:
        """How many numbers the state of a point has."""
        return len(self._initial_row)

    def initial_state(self, n_points: int) -> npt.NDArray[np.float64]:
        """State of points that have not been deformed, ``(n_points, n_state)``."""
        return np.tile(self._initial_row, (n_points, 1))

    def state_field(self, state: npt.NDArray[np.float64], name: str) -> npt.NDArray[np.float64]:
        """One field of the state, a view.

        Args:
            state: ``(n_points, n_state)``, C-contiguous.
            name: of the field.

        Returns:
            ``(n_points, *shape)``.
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


def positive(value: float, symbol: str, meaning: str, unit: str) -> float:
    """The value, if it is positive and finite.

    Raises:
        ValueError: that says which parameter it is.
    """
    if not (math.isfinite(value) and value > 0):
        raise ValueError(f"{meaning} must be positive and finite: {symbol} = {value} {unit}")
    return value


def elastic_moduli(E: float, nu: float) -> tuple[float, float]:
    """Shear and bulk modulus mu, kappa [Pa]; both are finite.

    Args:
        E: Young's modulus [Pa], positive.
        nu: Poisson's ratio [-], -1 < nu < 0.5.

    Raises:
        ValueError: for parameters out of range.
    """
    positive(E, "E", "Young's modulus", "Pa")
    if not -1 < nu < 0.5:
        raise ValueError(
            f"Poisson's ratio must lie in (-1, 0.5): nu = {nu}. A stress that follows from the "
            "deformation alone needs a finite bulk modulus: use 0.499, say, for a nearly "
            "incompressible material."
        )
    return E / (2 * (1 + nu)), E / (3 * (1 - 2 * nu))


def p_wave_modulus(mu: float, kappa: float) -> float:
    """Modulus lambda + 2 mu = kappa + 4/3 mu of pressure waves in an elastic solid [Pa]."""
    return kappa + 4 / 3 * mu
