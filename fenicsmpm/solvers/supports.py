# SPDX-License-Identifier: MIT
"""Check that supports or inertia hold a body."""

from __future__ import annotations

from collections.abc import Sequence

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
from dolfinx import fem

Array = npt.NDArray[np.float64]

_ROUND_OFF = 1e-9  # relative to products that do not vanish; stresses resist turns a little
_CLEAR = 1e-6  # relative size of what is not round-off in a motion


def require_supports(
    A: PETSc.Mat, V: fem.FunctionSpace, x: Array, inactive: npt.NDArray[np.int32]
) -> str | None:
    """Return an error message if the tangent times a rigid motion is zero. Collective.

    A direct solver may find round-off instead of a zero pivot, and iterations find some solution or
    none.

    Args:
        A: Tangent.
        V: Function space of the tangent. Its parts with a component for each direction are checked.
        x: Positions of the local degrees of freedom ``(n_dofs, d)`` [m].
        inactive: Local dofs without material.

    Returns:
        A sentence, or None if the body is held.
    """
    dim = V.mesh.geometry.dim
    is_mixed = V.num_sub_spaces > 0 and V.dofmap.index_map_bs == 1
    parts = [V.sub(i) for i in range(V.num_sub_spaces)] if is_mixed else [V]
    free = []
    for part in parts:
        if dim > 1 and part.num_sub_spaces == dim:
            owned = A.getLocalSize()[0]
            found = [np.unique(part.sub(c).dofmap.list) for c in range(dim)]
            dofs = [np.setdiff1d(some[some < owned], inactive) for some in found]
            free += _free_motions(A, dofs, x, V.mesh.comm)
    if not free:
        return None
    return (
        f"nothing holds the body, which can {', '.join(free)}: the matrix is singular; check the "
        "Dirichlet conditions, or give the body inertia by a time scheme"
    )


def _free_motions(
    A: PETSc.Mat, dofs: list[npt.NDArray[np.int32]], x: Array, comm: MPI.Comm
) -> list[str]:
    """Return descriptions of the rigid motions whose product with the tangent is zero."""
    dim = len(dofs)
    turns = [(0, 1)] if dim == 2 else [(1, 2), (2, 0), (0, 1)]
    positions = [x[rows] for rows in dofs]
    total = comm.allreduce(np.array([len(x), *x.sum(axis=0)], dtype=np.float64))
    centre = total[1:] / max(total[0], 1.0)
    reach = comm.allreduce(float(np.abs(x - centre).max(initial=0.0)), MPI.MAX) or 1.0
    mode, product = A.createVecs()

    def times(values: Sequence[Array]) -> Array:
        mode.set(0.0)
        for rows, numbers in zip(dofs, values, strict=True):
            mode.array_w[rows] = numbers
        A.mult(mode, product)
        return product.array_r.copy()

    alternating = times([np.where(np.arange(len(rows)) % 2 == 0, 1.0, -1.0) for rows in dofs])
    scale = np.sqrt(comm.allreduce(float(alternating @ alternating)))
    columns = [
        times([np.full(len(rows), float(c == k)) for c, rows in enumerate(dofs)])
        for k in range(dim)
    ]
    for i, j in turns:
        turned = [np.zeros(len(rows)) for rows in dofs]
        turned[i] = -(positions[i][:, j] - centre[j]) / reach
        turned[j] = (positions[j][:, i] - centre[i]) / reach
        columns.append(times(turned))
    mode.destroy()
    product.destroy()
    # R of a QR decomposition over all ranks has the singular values of the columns
    triangles = comm.allgather(np.linalg.qr(np.column_stack(columns), mode="r"))
    R = np.vstack(triangles)
    if not (np.isfinite(R).all() and 0 < scale < np.inf):
        return []
    _, sizes, motions = np.linalg.svd(R)
    null = motions[: len(columns)][sizes <= _ROUND_OFF * scale]
    pure = np.flatnonzero(np.linalg.norm(R, axis=0) <= _ROUND_OFF * scale)
    names = [f"move along {axis}" for axis in "xyz"[:dim]]
    names += [f"turn about {axis}" for axis in ("z" if dim == 2 else "xyz")]
    said = [names[k] for k in pure]
    null[:, pure] = 0.0
    _, sizes, others = np.linalg.svd(null, full_matrices=False)
    return said + [_described(m, centre, reach) for m in others[sizes > _CLEAR]]


def _described(motion: Array, centre: Array, reach: float) -> str:
    """Describe a rigid motion by its velocities along axes, and those of turns about axes."""
    dim = len(centre)
    w = np.zeros(3)
    w[3 - len(motion[dim:]) :] = motion[dim:] / reach
    v = np.zeros(3)
    v[:dim] = motion[:dim]
    if np.linalg.norm(w) * reach < _CLEAR:
        return f"move along {_tuple(v[:dim] / np.linalg.norm(v))}"
    place = centre + (np.cross(w, v) / (w @ w))[:dim]
    if dim == 2:
        return f"turn about {_tuple(place)}"
    return f"turn about an axis along {_tuple(w / np.linalg.norm(w))} through {_tuple(place)}"


def _tuple(values: Array) -> str:
    return "(" + ", ".join(f"{round(value, 6) + 0.0:g}" for value in values) + ")"
