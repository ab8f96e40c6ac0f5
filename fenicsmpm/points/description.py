# SPDX-License-Identifier: MIT
"""The text that is printed for material points."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from fenicsmpm._display import Facts

if TYPE_CHECKING:
    from fenicsmpm.points.material_points import MaterialPoints


def facts_of(points: MaterialPoints) -> Facts:
    """Return numbers of points and cells, weight, bounds and fields on this rank.

    Args:
        points: The point set.
    """
    comm = points.mesh.comm
    where = f" on rank {comm.rank} of {comm.size}" if comm.size > 1 else ""
    facts = [("number", f"{len(points)} of {points.size_global} points{where}")]
    if len(points) > 0:
        topology = points.mesh.topology
        n_cells = topology.index_map(topology.dim).size_local
        count = np.diff(points.cell_offsets)
        count = count[count > 0]
        a, b = count.min(), count.max()
        each = str(a) if a == b else f"{a} to {b}, {count.mean():.3g} on average"
        x = points.x
        lower, upper = (np.array2string(b, precision=6) for b in (x.min(0), x.max(0)))
        # do not mark the field as possibly changed
        weight = points._data["weight"].sum()
        facts += [
            ("in cells", f"{len(count)} of {n_cells}"),
            ("points in a cell", each),
            ("bounds", f"{lower} to {upper} m"),
            ("total weight", f"{weight:.6g}"),
        ]
    shapes = {name: " x ".join(map(str, points.field_shape(name))) for name in points.field_names}
    fields = [name + (f" ({shape})" if shape else "") for name, shape in shapes.items()]
    return [*facts, ("fields", ", ".join(fields) or "none")]
