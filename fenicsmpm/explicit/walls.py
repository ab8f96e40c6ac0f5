# SPDX-License-Identifier: MIT
"""Conditions at walls."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
from dolfinx import fem


def roller(
    V: fem.FunctionSpace, component: int, where: Callable[[npt.NDArray[np.float64]], Any]
) -> fem.DirichletBC:
    """Condition that one component of the velocity is zero: a roller, or a slip wall.

    Args:
        V: space of velocities, with d components.
        component: normal to the wall.
        where: function of positions ``(3, n)`` to marks ``(n,)`` of the nodes on the wall.

    Returns:
        The condition on that component of V.
    """
    part = V.sub(component)
    dofs = fem.locate_dofs_geometrical((part, part.collapse()[0]), where)[0]
    return fem.dirichletbc(fem.Constant(V.mesh, 0.0), dofs, part)
