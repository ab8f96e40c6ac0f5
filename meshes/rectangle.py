# SPDX-License-Identifier: MIT
"""Unstructured triangles on a rectangle in which Cook's membrane swings.

The membrane is a region of the mesh (tag 1): at the start, material points in its cells fill the
body exactly.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from mpi4py import MPI

import background
import numpy as np
from dolfinx.mesh import Mesh, MeshTags

MEMBRANE = ((0.0, 0.0), (4.8, 4.4), (4.8, 6.0), (0.0, 4.4))  # m
LOWER = (0.0, -1.0)  # m
UPPER = (6.0, 9.0)  # m


def rectangle(
    h: float,
    lower: Sequence[float] = LOWER,
    upper: Sequence[float] = UPPER,
    far: float | None = None,
    output: Path | str | None = None,
    comm: MPI.Comm = MPI.COMM_WORLD,
) -> tuple[Mesh, MeshTags]:
    """Mesh Cook's membrane (a tenth of its usual size) and the rest of a rectangle around it.

    Args:
        h: size of cells in m.
        lower: lower corner of the rectangle, ``(2,)`` in m.
        upper: upper corner of the rectangle, ``(2,)`` in m.
        far: size in m up to which cells grow away from the membrane; None for ``h`` everywhere.
        output: file ``.msh`` to be written too.
        comm: communicator of the mesh.

    Returns:
        The mesh, and its cells' tags: 1 in the membrane, 2 in its surrounding.
    """
    corners = np.array(MEMBRANE)
    if np.any(corners < lower) or np.any(corners > upper):
        raise ValueError(
            f"rectangle from {lower} to {upper} m: must contain the corners {MEMBRANE}"
        )

    edges = np.roll(corners, -1, axis=0) - corners
    normals = np.stack([edges[:, 1], -edges[:, 0]], axis=1)  # outwards
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    offsets = np.sum(normals * corners, axis=1)

    def geometry(occ: Any) -> tuple[int, int]:
        points = [occ.addPoint(x, y, 0) for x, y in MEMBRANE]
        lines = [occ.addLine(points[i - 1], points[i]) for i in range(len(points))]
        body = occ.addPlaneSurface([occ.addCurveLoop(lines)])
        return body, occ.addRectangle(*lower, 0, *np.subtract(upper, lower))

    def distance(x: float, y: float, z: float) -> float:
        return float(np.max(normals @ (x, y) - offsets))

    return background.build(geometry, distance, 2, h, far, output, comm)


if __name__ == "__main__":
    background.main(rectangle, LOWER, UPPER, "Triangles for the dynamic Cook's membrane")
