# SPDX-License-Identifier: MIT
"""Fields that a body carries through an explicit computation."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from fenicsmpm import formulations
from fenicsmpm.materials import Law
from fenicsmpm.points import MaterialPoints


def set_initial_state(
    points: MaterialPoints,
    law: Law,
    density: float,
    velocity: Callable[[npt.NDArray[np.float64]], npt.ArrayLike] | None = None,
) -> None:
    """Give undeformed points the fields of a body in explicit motion.

    These are "mass" [kg], "V_0" initial volume [m^d], "F" deformation gradient and "J" its
    determinant [-], "u" displacement [m], "v" velocity [m/s], "J_bar" averaged J [-], "sigma"
    Cauchy stress ``(3, 3)`` [Pa], and the fields of the law's state, such as "eps_p".

    Who gives another "F" after that has to give "J", "J_bar" and "sigma" that belong to it: the
    first step uses them.

    Args:
        points: the body, with its volumes as weights.
        law: its constitutive law.
        density: [kg/m^d].
        velocity: function of the positions ``(n, d)`` to initial velocities ``(n, d)``; None for
            a body at rest.

    Raises:
        ValueError: for a density that is not positive and finite.
    """
    formulations.set_initial_state(points, density, velocity)
    points.add_field("J_bar", (), 1.0)
    points.add_field("sigma", (3, 3))
    for name, (shape, value) in law.state.items():
        points.add_field(name, shape, value)
