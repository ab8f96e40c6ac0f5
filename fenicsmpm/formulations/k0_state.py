# SPDX-License-Identifier: MIT
"""Stress at rest of horizontal layers of soil."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from fenicsmpm.materials.law import finite, number
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
    """Stress at rest of horizontal layers, for ``initial_stress``.

    The vertical stress is the weight of what is above; horizontal ones are K0 times the vertical
    effective one, less the pressure u of the water: sigma_h = K0 (sigma_v + u) - u. These are total
    stresses, as a body of one phase has them whose density includes the pore water. For effective
    stresses give layers their buoyant densities, and the body's weight the same.

    Args:
        tops: height of the top of each layer [m], from the surface downwards.
        densities: of each layer [kg/m^3], below the water table those with the pore water.
        K0: coefficient of earth pressure at rest of each layer [-]; one for all, if it is a number.
        gravity: [m/s^2], downwards.
        water_table: height of the water table [m], at or below the surface; None for none.
        water_density: [kg/m^3].
        axis: the vertical one, 1 for y (in the plane) or 2 for z.

    Returns:
        Function of positions ``(3, n)`` [m] to stresses ``(3, 3, n)`` [Pa]; it raises ValueError
        for positions above the surface.

    Raises:
        ValueError: for layers that are not from the surface downwards, numbers of values that
            differ, or values that are not positive (K0: negative) and finite.
    """
    top = np.atleast_1d(finite(tops, "tops of layers"))
    density = np.atleast_1d(finite(densities, "densities of layers"))
    ratio = np.atleast_1d(finite(K0, "K0 of layers"))
    ratio = np.broadcast_to(ratio, density.shape) if ratio.size == 1 else ratio
    if not (top.ndim == 1 and top.shape == density.shape == ratio.shape):
        raise ValueError(
            f"layers need a top, a density and a K0 each: {top.size}, {density.size} and "
            f"{ratio.size} were given"
        )
    if np.any(np.diff(top) >= 0):
        raise ValueError(f"layers go from the surface downwards: tops = {top.tolist()} m")
    if np.any(density <= 0) or np.any(ratio < 0):
        raise ValueError(
            f"densities must be positive and K0 not negative: {density.tolist()} kg/m^3, "
            f"{ratio.tolist()}"
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
    above = np.concatenate([[0.0], np.cumsum(density[:-1] * -np.diff(top))])  # mass by area

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
