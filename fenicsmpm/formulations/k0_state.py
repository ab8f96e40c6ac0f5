# SPDX-License-Identifier: MIT
"""At-rest (K0) stress in horizontal layers of soil."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from fenicsmpm._numbers import finite, number
from fenicsmpm.points.of_position import OfPosition

Array = npt.NDArray[np.float64]


def k0_state(
    tops: float | Sequence[float],
    densities: float | Sequence[float],
    K0: float | Sequence[float],
    *,
    gravity: float = 9.81,
    water_table: float | None = None,
    water_density: float = 1000.0,
    axis: int = 1,
) -> OfPosition:
    """Return the stress at rest in horizontal layers, for ``initial_stress``.

    The vertical stress is the weight of the layers above. The horizontal stress is K0 times the
    effective vertical stress, minus the pore pressure u: sigma_h = K0 (sigma_v + u) - u. These are
    total stresses. They suit a body of one phase whose density includes the pore water. For
    effective stresses, give the layers and the body their buoyant densities.

    Args:
        tops: Height of the top of each layer [m], from the surface downwards.
        densities: Density of each layer [kg/m^3]. Below the water table it includes the pore water.
        K0: Coefficient of earth pressure at rest of each layer [-]. A number applies to all layers.
        gravity: Gravitational acceleration [m/s^2], which acts downwards.
        water_table: Height of the water table [m], at or below the surface. None if there is no
            water.
        water_density: Density of the water [kg/m^3].
        axis: Vertical axis, 1 for y (in plane problems) or 2 for z.

    Returns:
        Function from positions ``(3, n)`` [m] to stresses ``(3, 3, n)`` [Pa]. It raises ValueError
        for positions above the surface.

    Raises:
        ValueError: If the layers are not ordered from the surface downwards, the numbers of values
            differ, densities are not positive and finite, or K0 is negative or not finite.
    """
    top = np.atleast_1d(finite(tops, "tops of layers"))
    density = np.atleast_1d(finite(densities, "densities of layers"))
    ratio = np.atleast_1d(finite(K0, "K0 of layers"))
    ratio = np.broadcast_to(ratio, density.shape) if ratio.size == 1 else ratio
    if not (top.ndim == 1 and top.shape == density.shape == ratio.shape):
        raise ValueError(
            f"each layer needs a top, a density and a K0, but {top.size}, {density.size} and "
            f"{ratio.size} values were given"
        )
    if np.any(np.diff(top) >= 0):
        raise ValueError(
            f"the tops of layers must decrease, from the surface downwards: {top.tolist()} m"
        )
    if np.any(density <= 0) or np.any(ratio < 0):
        raise ValueError(
            f"densities must be positive and K0 not negative: densities = {density.tolist()} "
            f"kg/m^3, K0 = {ratio.tolist()}"
        )
    if axis not in (1, 2):
        raise ValueError(f"the vertical axis is 1 for y or 2 for z, not {axis}")
    g = number(gravity, "gravity", "gravity", "m/s^2")
    of_water = number(water_density, "water_density", "density of the water", "kg/m^3")
    if water_table is not None and not water_table <= top[0]:
        raise ValueError(
            f"the water table must not be above the surface: {water_table} m > {top[0]} m. Give "
            "open water as a layer with K0 = 1"
        )
    above = np.concatenate([[0.0], np.cumsum(density[:-1] * -np.diff(top))])  # mass per area

    def at_rest(x: Array) -> Array:
        y = x[axis]
        highest = float(y.max())
        if highest > top[0] + 1e-9 * max(abs(top[0]), 1.0):
            raise ValueError(f"a point at {highest} m is above the surface at {top[0]} m")
        layer = np.maximum(np.searchsorted(-top, -y, side="right") - 1, 0)
        vertical = -g * (above[layer] + density[layer] * (top[layer] - y))
        u = 0.0 if water_table is None else of_water * g * np.maximum(water_table - y, 0.0)
        sigma = np.zeros((3, 3, len(y)))
        for k in range(3):
            sigma[k, k] = vertical if k == axis else ratio[layer] * (vertical + u) - u
        return sigma

    return at_rest
