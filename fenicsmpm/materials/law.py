# SPDX-License-Identifier: MIT
"""What a constitutive law at a material point is: one compiled function, parameters, state."""

from __future__ import annotations

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
            ``(3, 3)`` (with F-bar, the modified one; F33 stays in plane strain), the velocity
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
        work_gradient: ``work_gradient(F, parameters, state, G)``: sets the derivative
            ``G[i, J]`` [Pa] of energy and dissipation after the step with respect to F, where it
            is not P, as in plastic flow that is not associated; state as for ``tangent``.
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
    work_gradient: Callable[..., None] | None = None
    update_eight: Callable[..., bool] | None = None
    needs_rate: bool = True
    is_fluid: bool = False

    def __post_init__(self) -> None:
        """Check, and lay out the state."""
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


def finite(values: npt.ArrayLike, what: str) -> npt.NDArray[np.float64]:
    """A copy of finite real numbers, of any shape.

    Args:
        values: to be checked.
        what: they are, plural.

    Raises:
        ValueError: for anything else, such as text.
    """
    array = _real(values)
    if array is None:
        raise ValueError(f"{what} must be numbers, not {values!r}")
    if not np.isfinite(array).all():
        raise ValueError(f"{what} must be finite: {values!r}")
    return array


def number(value: float, symbol: str, meaning: str, unit: str) -> float:
    """The value, if it is one real number.

    Args:
        value: to be checked.
        symbol: name of the parameter.
        meaning: what it is.
        unit: of the value.

    Raises:
        ValueError: that says which parameter it is, and its value.
    """
    array = _real(value)
    if array is None or array.shape != ():
        raise ValueError(f"{meaning} must be one number [{unit}]: {symbol} = {value!r}")
    return float(array)


def _real(values: npt.ArrayLike) -> npt.NDArray[np.float64] | None:
    """A copy of the values as float64, None unless all are real numbers."""
    try:
        array = np.array(values)
    except ValueError:  # rows of different lengths
        return None
    return array.astype(np.float64) if array.dtype.kind in "biuf" else None


def positive(value: float, symbol: str, meaning: str, unit: str) -> float:
    """As ``number``, which must be positive and finite."""
    result = number(value, symbol, meaning, unit)
    if not 0 < result < np.inf:
        raise ValueError(f"{meaning} must be positive and finite: {symbol} = {result} {unit}")
    return result


def not_negative(value: float, symbol: str, meaning: str, unit: str) -> float:
    """As ``number``, which must be finite and not negative."""
    result = number(value, symbol, meaning, unit)
    if not 0 <= result < np.inf:
        raise ValueError(f"{meaning} must be finite and not negative: {symbol} = {result} {unit}")
    return result


def poissons_ratio(nu: float, *, incompressible: bool) -> float:
    """Poisson's ratio [-], if it is one: more than -1, and less than 0.5 or not more.

    Args:
        nu: Poisson's ratio.
        incompressible: whether 0.5 is one.

    Raises:
        ValueError: for what is none.
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
    """Shear and bulk modulus mu, kappa [Pa]; both are finite.

    Args:
        E: Young's modulus [Pa], positive.
        nu: Poisson's ratio [-], -1 < nu < 0.5.

    Raises:
        ValueError: for parameters out of range.
    """
    E = positive(E, "E", "Young's modulus", "Pa")
    nu = poissons_ratio(nu, incompressible=False)
    return E / (2 * (1 + nu)), E / (3 * (1 - 2 * nu))


def p_wave_modulus(mu: float, kappa: float) -> float:
    """Modulus lambda + 2 mu = kappa + 4/3 mu of pressure waves in an elastic solid [Pa]."""
    return kappa + 4 / 3 * mu
