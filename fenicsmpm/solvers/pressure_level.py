# SPDX-License-Identifier: MIT
"""Check that something fixes the level of the pressure."""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
from dolfinx import fem

_ROUND_OFF = 1e-9  # relative to products that do not vanish


def require_pressure_level(
    A: PETSc.Mat,
    V: fem.FunctionSpace,
    parts: list[npt.NDArray[np.int64]],
    inactive: npt.NDArray[np.int32],
) -> None:
    """Raise ValueError if the tangent times a constant pressure is zero. Collective.

    This happens if incompressible material fills a box with walls that are all fixed. The system is
    then singular, and round-off determines the level of the pressure.

    Args:
        A: Tangent.
        V: Function space of the tangent. Nothing is checked unless its parts are displacement and
            pressure.
        parts: Local dofs of the parts of V.
        inactive: Local dofs without material.

    Raises:
        ValueError: On all ranks, if nothing fixes the level.
    """
    shapes = [V.sub(i).ufl_element().reference_value_shape for i in range(V.num_sub_spaces)]
    if [len(shape) for shape in shapes[:2]] != [1, 0]:
        return
    n = V.dofmap.index_map.size_local
    dofs = [np.setdiff1d(part[part < n], inactive) for part in parts[:2]]
    constant, changing = A.createVecs()
    product = constant.duplicate()
    constant.array_w[dofs[1]] = 1.0
    changing.array_w[dofs[1]] = np.where(np.arange(len(dofs[1])) % 2 == 0, 1.0, -1.0)
    squares = np.zeros((2, 2))
    for square, vector in zip(squares, (constant, changing), strict=True):
        A.mult(vector, product)
        square[:] = [np.sum(product.array_r[rows] ** 2) for rows in dofs[:2]]
    for vector in (constant, changing, product):
        vector.destroy()
    seen, scale = np.sqrt(V.mesh.comm.allreduce(squares))
    if np.all(seen <= _ROUND_OFF * scale):
        raise ValueError(
            "nothing holds the level of the pressure: incompressible material fills the mesh, and "
            "its whole boundary is fixed. Fix the pressure at one node, by a dirichletbc on "
            "W.sub(1), or leave a free surface"
        )
