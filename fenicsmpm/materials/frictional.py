# SPDX-License-Identifier: MIT
"""Common parts of frictional laws: softening, opening in tension, stress, energy and tangent.

The return map of a law gives the principal stresses for a given strength. This module does
everything else. The strength is (friction, k, tension): a coefficient of friction [-], a parameter
k [Pa] from the cohesion, and a limit of tension [Pa]. It decreases linearly with the accumulated
plastic strain eps_p. A step uses the strength at its end.

Material that opens in tension closes without resistance. The return to the tip of the yield surface
follows G. Klar et al., "Drucker-Prager elastoplasticity for sand animation", ACM TOG 35, 2016. The
correction of volume follows A. P. Tampubolon et al., "Multi-species simulation of porous sand and
water mixtures", ACM TOG 36, 2017, section 4.3.4. The state field "opening" stores the volumetric
plastic strain that the limit of tension causes, at the tip or in cracks. As long as it is positive,
the mean stress is not compressive, or not more compressive than at the end of the previous step
(state field "open_stress"). The latter is for cracks with compression along them, which remain able
to carry what they carry. Openings close by isotropic plastic strain.
"""

from __future__ import annotations

import functools
import logging
import math
from typing import Any

import numpy as np
import numpy.typing as npt

from fenicsmpm._numbers import not_negative, number, positive
from fenicsmpm.materials.hencky import stored_energy
from fenicsmpm.materials.law import Law, compiled, elastic_moduli, p_wave_modulus
from fenicsmpm.materials.principal_stress import (
    elastic_deformation,
    principal_strains,
    quotients,
    set_cauchy_stress,
    set_gradient,
    set_plastic_deformation,
    set_tangent,
    transposed_times,
    work_derivatives,
)
from fenicsmpm.materials.tensors import volume_change

logger = logging.getLogger(__name__)

# Columns of the state, in the order of Frictional.state
_EPS_P, _OPENING, _DISSIPATION, _OPEN_STRESS = 9, 10, 11, 12

# Limit of tension for laws without one [Pa]
NO_LIMIT = 1e300


@compiled
def _strength(eps_p, parameters):  # type: ignore[no-untyped-def]
    """Return friction, k, tension, their derivatives with respect to eps_p, and dilatancy."""
    rate = parameters[2]
    share = rate * eps_p
    if share >= 1:
        share, rate = 1.0, 0.0
    d_friction, d_k = parameters[7] - parameters[3], parameters[8] - parameters[4]
    friction, k = parameters[3] + share * d_friction, parameters[4] + share * d_k
    dilatancy = parameters[5] + share * (parameters[9] - parameters[5])
    d_friction, d_k = rate * d_friction, rate * d_k
    tension, d_tension = parameters[6], 0.0
    if friction * tension > k:  # the tip
        tension = k / friction
        d_tension = (d_k - tension * d_friction) / friction
    return (friction, k, tension), (d_friction, d_k, d_tension), dilatancy


@compiled
def _square(a):  # type: ignore[no-untyped-def]
    return a[0] * a[0] + a[1] * a[1] + a[2] * a[2]


@compiled
def _mean(tau):  # type: ignore[no-untyped-def]
    return (tau[0] + tau[1] + tau[2]) / 3


@compiled
def _times_ones(D):  # type: ignore[no-untyped-def]
    """Return the sums of the rows: derivatives with respect to equal strains."""
    return D[0] + D[1] + D[2], D[3] + D[4] + D[5], D[6] + D[7] + D[8]


@compiled
def _sum(D):  # type: ignore[no-untyped-def]
    x, y, z = _times_ones(D)
    return x + y + z


@compiled
def _elastic_strain(tau, mu, kappa):  # type: ignore[no-untyped-def]
    mean = _mean(tau)
    third, r = mean / (3 * kappa), 0.5 / mu
    return (
        third + r * (tau[0] - mean),
        third + r * (tau[1] - mean),
        third + r * (tau[2] - mean),
    )


@functools.cache
def functions(return_map: Any) -> tuple[Any, Any, Any, Any]:
    """Compile update, energy, tangent and work gradient of a law.

    Args:
        return_map: ``return_map(strain, mu, kappa, strength, slopes, dilatancy)`` returns whether
            there is plastic flow, the principal stresses, d tau_a / d eps_b (a tuple of 9, by
            rows), d tau_a / d eps_p, and the volumetric plastic strain at the limit of tension.
            Strains are sorted, with the largest one first.

    Returns:
        The four functions; see ``Law``.
    """

    @compiled
    def returned(strain, eps_p, dilatancy, parameters):  # type: ignore[no-untyped-def]
        """Return flow, stresses, their derivatives, and openings for strains after closing."""
        mu, kappa = parameters[0], parameters[1]
        size = abs(strain[0]) + abs(strain[2])
        low, high = eps_p, math.inf
        x = eps_p
        flow, increment, slope = (0.0, 0.0, 0.0), 0.0, 0.0
        flows, tau, D, softening, opened = False, strain, (0.0,) * 9, strain, 0.0
        for _ in range(100):
            strength, slopes, _dilatancy = _strength(x, parameters)
            flows, tau, D, softening, opened = return_map(
                strain, mu, kappa, strength, slopes, dilatancy
            )
            if not flows:
                break
            e = _elastic_strain(tau, mu, kappa)
            flow = strain[0] - e[0], strain[1] - e[1], strain[2] - e[2]
            increment = math.sqrt(2 / 3 * _square(flow))
            if parameters[2] == 0:
                break
            # Solve x = eps_p + increment(x) by Newton's method, with bisection if it leaves the
            # bracket.
            excess = x - eps_p - increment
            r = _elastic_strain(softening, mu, kappa)
            slope = -2 / 3 * (flow[0] * r[0] + flow[1] * r[1] + flow[2] * r[2]) / increment
            if not abs(excess) > 1e-15 * (x + size):
                break
            if excess < 0:
                low = x
            else:
                high = x
            x -= excess / (1 - slope)
            if not low < x < high:
                x = 0.5 * (low + high) if high < math.inf else 2 * low - eps_p + increment
                if not low < x < high:
                    break
        if flows and parameters[2] > 0 and increment > 0:
            # d eps_p = d|flow| / (1 - slope), flow = strain - C^-1 tau
            f = _elastic_strain(flow, mu, kappa)
            p = transposed_times(D, f)
            r = 2 / 3 / increment / (1 - slope)
            g = r * (flow[0] - p[0]), r * (flow[1] - p[1]), r * (flow[2] - p[2])
            D = (
                D[0] + softening[0] * g[0], D[1] + softening[0] * g[1], D[2] + softening[0] * g[2],
                D[3] + softening[1] * g[0], D[4] + softening[1] * g[1], D[5] + softening[1] * g[2],
                D[6] + softening[2] * g[0], D[7] + softening[2] * g[1], D[8] + softening[2] * g[2],
            )  # fmt: skip
        return flows, tau, D, opened, flow, increment

    @compiled
    def solve(strain, state, parameters):  # type: ignore[no-untyped-def]
        """Compute all quantities of a step in principal axes."""
        kappa, eps_p, opening, carried = (
            parameters[1], state[_EPS_P], state[_OPENING], state[_OPEN_STRESS],
        )  # fmt: skip
        # Material that is open does not dilate.
        dilatancy = _strength(eps_p, parameters)[2] if opening == 0 else 0.0
        volume = strain[0] + strain[1] + strain[2]
        # Openings close before there is more compression than the open material carries. When all
        # is closed, the mean stress is that of the volume that is left.
        closed = min(max(carried / kappa - volume, 0.0), opening)
        least = min(carried, kappa * (volume + opening))
        round_off = 1e-14 * kappa * (abs(strain[0]) + abs(strain[2]) + closed)
        trial = strain
        low, high = closed, math.inf
        flows, tau, D, opened, flow, increment = False, strain, (0.0,) * 9, 0.0, strain, 0.0
        for _ in range(100):
            third = closed / 3
            strain = trial[0] + third, trial[1] + third, trial[2] + third
            flows, tau, D, opened, flow, increment = returned(strain, eps_p, dilatancy, parameters)
            missing = least - _mean(tau)
            # Tension that is cut off lowers the mean stress; then more must close. Newton's method,
            # with bisection if it leaves the bracket.
            if opening == 0 or abs(missing) <= round_off or (missing < 0 and closed == low):
                break
            if missing > 0:
                low = closed
            else:
                high = closed
            slope = _sum(D) / 9
            closed += missing / slope if slope > 1e-10 * kappa else math.inf
            if not low < closed < high:
                closed = 0.5 * (low + high) if high < math.inf else 2 * low + abs(trial[2])
                if not low < closed < high:
                    break
        is_closed = closed > 0 and kappa * (volume + opening) <= carried
        opening = 0.0 if is_closed else max(opening + opened - closed, 0.0)
        return closed, opening, strain, flows, tau, D, flow, increment

    @compiled
    def update(F, L, parameters, state, sigma):  # type: ignore[no-untyped-def]
        strain, n = principal_strains(elastic_deformation(F, state))
        closed, opening, strain, flows, tau, _D, flow, increment = solve(strain, state, parameters)
        if flows or closed > 0:
            elastic = strain[0] - flow[0], strain[1] - flow[1], strain[2] - flow[2]
            set_plastic_deformation(F, elastic, n, state)
            state[_EPS_P] += increment
            state[_OPENING] = opening
            state[_DISSIPATION] -= state[_OPEN_STRESS] * closed
            state[_DISSIPATION] += tau[0] * flow[0] + tau[1] * flow[1] + tau[2] * flow[2]
        state[_OPEN_STRESS] = min(_mean(tau), 0.0) if state[_OPENING] > 0 else 0.0
        set_cauchy_stress(sigma, tau, n, 1 + volume_change(F))

    @compiled
    def energy(F, parameters, state):  # type: ignore[no-untyped-def]
        (x, y, z), _n = principal_strains(elastic_deformation(F, state))
        volume = x + y + z
        third = volume / 3
        deviator = x - third, y - third, z - third, 0.0, 0.0, 0.0
        return stored_energy(parameters[0], parameters[1], volume, deviator)

    @compiled
    def linearize(strain, state, parameters):  # type: ignore[no-untyped-def]
        """Return stresses, d tau_a / d eps_b, and the derivatives of energy plus dissipation."""
        kappa, volume = parameters[1], strain[0] + strain[1] + strain[2]
        closed, _opening, _strain, _flows, tau, D, flow, _increment = solve(
            strain, state, parameters
        )
        w = work_derivatives(tau, D, flow)
        # Closing sets the mean stress: it is constant, or linear in the volume.
        along, stiffness = _times_ones(D), _sum(D)
        if closed > 0 and stiffness > 1e-10 * kappa:
            d_mean = kappa if kappa * (volume + state[_OPENING]) < state[_OPEN_STRESS] else 0.0
            g = (
                (3 * d_mean - D[0] - D[3] - D[6]) / stiffness,
                (3 * d_mean - D[1] - D[4] - D[7]) / stiffness,
                (3 * d_mean - D[2] - D[5] - D[8]) / stiffness,
            )
            x, y, z = along
            D = (
                D[0] + x * g[0], D[1] + x * g[1], D[2] + x * g[2],
                D[3] + y * g[0], D[4] + y * g[1], D[5] + y * g[2],
                D[6] + z * g[0], D[7] + z * g[1], D[8] + z * g[2],
            )  # fmt: skip
            total = w[0] + w[1] + w[2] - 3 * state[_OPEN_STRESS]
            w = w[0] + total * g[0], w[1] + total * g[1], w[2] + total * g[2]
        return tau, D, w

    @compiled
    def tangent(F, parameters, state, dPdF):  # type: ignore[no-untyped-def]
        strain, n = principal_strains(elastic_deformation(F, state))
        tau, D, _w = linearize(strain, state, parameters)
        set_tangent(F, strain, n, tau, D, quotients(strain, tau, D), dPdF)

    @compiled
    def work_gradient(F, parameters, state, G):  # type: ignore[no-untyped-def]
        strain, n = principal_strains(elastic_deformation(F, state))
        _tau, _D, w = linearize(strain, state, parameters)
        set_gradient(F, n, w, G)

    return update, energy, tangent, work_gradient


def angle(value: float, symbol: str, meaning: str) -> float:
    """Return an angle in radians if it is at least 0 and less than 90 degrees.

    Args:
        value: Value to be checked [degrees].
        symbol: Name of the parameter.
        meaning: Meaning of the parameter.

    Raises:
        ValueError: If the value is not such an angle.
    """
    result = number(value, symbol, meaning, "degrees")
    if not 0 <= result < 90:
        raise ValueError(f"{meaning} must lie in [0, 90) degrees: {symbol} = {result}")
    return math.radians(result)


class Frictional(Law):
    """Base class of laws with Hencky elasticity and a pressure-dependent yield surface.

    Args:
        E: Young's modulus [Pa], positive.
        nu: Poisson's ratio [-], -1 < nu < 0.5.
        cohesion: Cohesion [Pa], not negative.
        friction: Friction angle [degrees], 0 <= friction < 90.
        dilatancy: Dilatancy angle [degrees], 0 <= dilatancy <= friction.
        tension: Limit of tension [Pa], not negative, at most the tip of the yield surface. None for
            the tip.
        softening_strain: Plastic strain at which the residual values are reached [-]. None for no
            softening.
        residual_cohesion: Residual cohesion [Pa]. None for the peak value.
        residual_friction: Residual friction angle [degrees]. None for the peak value.
        residual_dilatancy: Residual dilatancy angle [degrees]. None for the peak value.
        return_map: See ``functions``.
        coefficients: ``coefficients(cohesion, friction, dilatancy)``, with angles in radians,
            returns friction [-], k [Pa] and dilatancy [-] of the return map.

    Attributes:
        strength: Cohesion [Pa], friction and dilatancy angles [rad] at the peak and residual
            ``(2, 3)``.
        tension: Limit of tension before softening [Pa].

    Raises:
        ValueError: If a parameter is out of range, or the parameters are inconsistent.
    """

    def __init__(
        self,
        E: float,
        nu: float,
        cohesion: float,
        friction: float,
        dilatancy: float,
        tension: float | None,
        softening_strain: float | None,
        residual_cohesion: float | None,
        residual_friction: float | None,
        residual_dilatancy: float | None,
        *,
        return_map: Any,
        coefficients: Any,
    ) -> None:
        """Check and store the parameters."""
        self.mu, self.kappa = elastic_moduli(E, nu)
        self.E, self.nu = float(E), float(nu)
        peak = _checked(cohesion, friction, dilatancy, "")
        residual_given = {
            "residual_cohesion": residual_cohesion,
            "residual_friction": residual_friction,
            "residual_dilatancy": residual_dilatancy,
        }
        given = [name for name, value in residual_given.items() if value is not None]
        rate, residual = 0.0, peak
        if softening_strain is None:
            if given:
                raise ValueError(
                    f"{given[0]} = {residual_given[given[0]]} without softening_strain: give the "
                    "plastic strain at which it is reached"
                )
        else:
            rate = 1 / positive(softening_strain, "softening_strain", "strain of softening", "-")
            if not given:
                raise ValueError(
                    f"softening_strain = {softening_strain} without a residual value: give "
                    + " or ".join(residual_given)
                )
            residual = _checked(
                cohesion if residual_cohesion is None else residual_cohesion,
                friction if residual_friction is None else residual_friction,
                dilatancy if residual_dilatancy is None else residual_dilatancy,
                "residual_",
            )
            names = ("cohesion", "friction", "dilatancy")
            for name, low, high in zip(names, residual, peak, strict=True):
                if low > high:
                    unit, one = ("Pa", 1.0) if name == "cohesion" else ("degrees", math.pi / 180)
                    raise ValueError(
                        f"a residual value must not exceed its peak: residual_{name} = "
                        f"{low / one:g} {unit} is above {name} = {high / one:g} {unit}"
                    )
        strengths = [coefficients(*values) for values in (peak, residual)]
        (eta, k, _), (residual_eta, residual_k, _) = strengths
        tip = k / eta if eta > 0 else math.inf
        if tension is None:
            limit = NO_LIMIT
        else:
            limit = not_negative(tension, "tension", "limit of tension", "Pa")
            if limit > tip * (1 + 1e-12):
                raise ValueError(
                    f"the limit of tension is above the tip of the yield surface: tension = "
                    f"{limit:g} Pa, tip {tip:g} Pa. Leave out tension to use the tip"
                )
        steepest = rate * (k - residual_k)
        if steepest >= self.mu:
            raise ValueError(
                f"softening is steeper than the elastic unloading: the cohesive strength falls by "
                f"{k - residual_k:g} Pa over softening_strain = {softening_strain}, but must fall "
                f"by less than mu = {self.mu:g} Pa per strain"
            )
        if residual_k < k or residual_eta < eta:
            logger.warning(
                "softening without a length scale: the width of shear bands, and with it the "
                "dissipation, depends on the mesh"
            )
        update, energy, tangent, work_gradient = functions(return_map)
        super().__init__(
            update,
            np.array([self.mu, self.kappa, rate, *strengths[0], limit, *strengths[1]]),
            p_wave_modulus(self.mu, self.kappa),
            {
                "C_p_inverse": ((3, 3), np.eye(3)),
                "eps_p": ((), 0.0),
                "opening": ((), 0.0),
                "dissipation": ((), 0.0),
                "open_stress": ((), 0.0),
            },
            energy=energy,
            tangent=tangent,
            work_gradient=work_gradient,
            needs_rate=False,
        )
        self.strength: npt.NDArray[np.float64] = np.array([peak, residual])
        self.tension = min(limit, tip)

    def __repr__(self) -> str:
        """Parameters with units."""
        peak, residual = (
            f"{c:g} Pa, {math.degrees(phi):g} degrees, {math.degrees(psi):g} degrees"
            for c, phi, psi in self.strength
        )
        softens = f", residual: {residual}" if self.parameters[2] > 0 else ""
        return (
            f"{type(self).__name__}(E={self.E:g} Pa, nu={self.nu:g}, cohesion, friction, "
            f"dilatancy: {peak}{softens}, tension={self.tension:g} Pa)"
        )


def _checked(
    cohesion: float, friction: float, dilatancy: float, prefix: str
) -> tuple[float, float, float]:
    """Return cohesion [Pa] and angles [rad] after checks of their consistency."""
    c = not_negative(cohesion, f"{prefix}cohesion", "cohesion", "Pa")
    phi = angle(friction, f"{prefix}friction", "angle of friction")
    psi = angle(dilatancy, f"{prefix}dilatancy", "angle of dilatancy")
    if psi > phi:
        raise ValueError(
            f"a dilatancy above the friction would create energy: {prefix}dilatancy = {dilatancy} "
            f"degrees, {prefix}friction = {friction} degrees"
        )
    if c == 0 and phi == 0:
        raise ValueError(
            f"the material has no strength: {prefix}cohesion = {cohesion} Pa and {prefix}friction "
            f"= {friction} degrees; at least one must be positive"
        )
    return c, phi, psi
