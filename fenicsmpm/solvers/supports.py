# SPDX-License-Identifier: MIT
"""Check that supports or inertia hold a body."""

from __future__ import annotations

from collections.abc import Sequence

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
from dolfinx import fem

_ROUND_OFF = 1e-9  # relative to products that do not vanish


def require_supports(
    A: PETSc.Mat, V: fem.FunctionSpace, x: npt.NDArray[np.float64], inactive: npt.NDArray[np.int32]
) -> str | None:
    """Return an error message if the tangent times a rigid motion is zero in space (collective).

    A direct solver would find a zero pivot in such a system. Iterations, however, would find some
    solution or none.

    Args:
        A: tangent.
        V: function space of the tangent. Only its first part is checked, if it has three
            components.
        x: positions of the local degrees of freedom ``(n_dofs, 3)`` [m].
        inactive: local dofs without material.

    Returns:
        A sentence, or None if the body is held.
    """
    motion = V.sub(0) if V.num_sub_spaces > 0 and V.dofmap.index_map_bs == 1 else V
    if motion.num_sub_spaces != 3:
        return None
    comm, owned = V.mesh.comm, A.getLocalSize()[0]
    dofs = []
    for c in range(3):
        found = np.unique(motion.sub(c).dofmap.list)
        dofs.append(np.setdiff1d(found[found < owned], inactive))
    mode, product = A.createVecs()

    def size(values: Sequence[npt.NDArray[np.float64]]) -> float:
        mode.set(0.0)
        for rows, numbers in zip(dofs, values, strict=True):
            mode.array_w[rows] = numbers
        A.mult(mode, product)
        return float(product.norm())

    positions = [x[rows] for rows in dofs]
    total = comm.allreduce(np.array([len(x), *x.sum(axis=0)], dtype=np.float64))
    centre = total[1:] / max(total[0], 1.0)
    reach = comm.allreduce(float(np.abs(x - centre).max(initial=0.0)), MPI.MAX) or 1.0
    free = []
    for k in range(3):
        alternating: list[npt.NDArray[np.float64]] = [np.zeros(len(rows)) for rows in dofs]
        alternating[k] = np.where(np.arange(len(dofs[k])) % 2 == 0, 1.0, -1.0)
        scale = size(alternating)
        moved = [np.full(len(rows), float(c == k)) for c, rows in enumerate(dofs)]
        if size(moved) <= _ROUND_OFF * scale:
            free.append(f"move along {'xyz'[k]}")
        i, j = (k + 1) % 3, (k + 2) % 3
        turned = [np.zeros(len(rows)) for rows in dofs]
        turned[i] = -(positions[i][:, j] - centre[j]) / reach
        turned[j] = (positions[j][:, i] - centre[i]) / reach
        if size(turned) <= _ROUND_OFF * scale:
            free.append(f"turn about {'xyz'[k]}")
    for vector in (mode, product):
        vector.destroy()
    if not free:
        return None
    return (
        f"nothing holds the body, which can {', '.join(free)}: the matrix is singular; check the "
        "Dirichlet conditions, or give the body inertia by a time scheme"
    )
