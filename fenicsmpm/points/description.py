# SPDX-License-Identifier: MIT
"""What printing material points says."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from fenicsmpm.points.material_points import MaterialPoints


def describe(points: MaterialPoints) -> str:
    """Numbers of points and cells, weight, bounds and fields, of this rank.

    Args:
        points: Point set.
    """
    comm = points.mesh.comm
    where = f" on rank {comm.rank} of {comm.size}" if comm.size > 1 else ""
    text = f"MaterialPoints: {len(points)} of {points.size_global} points{where}"
    if len(points) == 0:
        return text
    topology = points.mesh.topology
    n_cells = topology.index_map(topology.dim).size_local
    count = np.diff(points.cell_offsets)
    count = count[count > 0]
    x, fields = points.x, ", ".join(points.field_names) or "none"
    lower, upper = (np.array2string(b, precision=6) for b in (x.min(0), x.max(0)))
    return (
        f"{text} in {len(count)} of {n_cells} cells, a filled cell has "
        f"{count.min()} to {count.max()}, {count.mean():.3g} on average\n"
        f"  total weight {points.weight.sum():.6g}, bounds {lower} to {upper}, fields: {fields}"
    )
