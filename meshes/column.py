# SPDX-License-Identifier: MIT
"""Unstructured tetrahedra for a column of 1 m x 1 m x 6 m that bends or twists on its base.

The column is a region of the mesh (tag 1): at the start, material points in its cells fill the body
exactly.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from mpi4py import MPI

import background
import numpy as np
from dolfinx.mesh import Mesh, MeshTags

COLUMN = ((-0.5, -0.5, 0.0), (0.5, 0.5, 6.0))  # m
LOWER = (-4.5, -1.5, 0.0)  # m
UPPER = (4.5, 1.5, 7.5)  # m


def column(
    h: float,
    lower: Sequence[float] = LOWER,
    upper: Sequence[float] = UPPER,
    far: float | None = None,
    output: Path | str | None = None,
    comm: MPI.Comm = MPI.COMM_WORLD,
) -> tuple[Mesh, MeshTags]:
    """Mesh the column and the rest of a box around it.

    Args:
        h: size of cells in m.
        lower: lower corner of the box, ``(3,)`` in m.
        upper: upper corner of the box, ``(3,)`` in m.
        far: size in m up to which cells grow away from the column; None for ``h`` everywhere.
        output: file ``.msh`` to be written too.
        comm: communicator of the mesh.

    Returns:
        The mesh, and its cells' tags: 1 in the column, 2 in its surrounding.
    """
    if np.any(np.greater(lower, COLUMN[0])) or np.any(np.less(upper, COLUMN[1])):
        raise ValueError(f"box from {lower} to {upper} m: must contain the column {COLUMN}")

    def geometry(occ: Any) -> tuple[int, int]:
        boxes = (COLUMN, (lower, upper))
        body, box = (occ.addBox(*a, *np.subtract(b, a)) for a, b in boxes)
        return body, box

    def distance(x: float, y: float, z: float) -> float:
        return max(abs(x) - 0.5, abs(y) - 0.5, z - 6.0)

    return background.build(geometry, distance, 3, h, far, output, comm)


if __name__ == "__main__":
    background.main(column, LOWER, UPPER, "Tetrahedra for the bending beam and twisting column")
