# SPDX-License-Identifier: MIT
"""Correction of point weights, such that full cells have their exact volume."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from fenicsmpm import _compat
from fenicsmpm.cells.active_cells import ActiveCells, nodes_of
from fenicsmpm.points import MaterialPoints

# Volume of points per volume of a full cell, outside of which a cell has a gap or a pile of points
_LEAST, _MOST = 0.5, 1.5


def correct_weights(body: MaterialPoints, cells: ActiveCells) -> None:
    """Scale weights in full interior cells such that they add up to the cell's volume. Collective.

    When a point crosses cells, one cell is overfull and the other has a gap. Integrals then miss
    parts of the body. After the correction, constant functions are integrated exactly. Use it as
    ``ImplicitMPM(..., observers=[lambda sim, step: correct_weights(body, cells)])``. Masses do not
    change.

    With smooth functions, corrected weights keep more of the energy of long runs, but pressures at
    points show the jumps of the weights between cells (docs/explanation/smooth_functions.md).

    A cell is interior if none of its vertices belongs to a cell without points. Cells that are
    filled to less than 0.5 or more than 1.5 of their volume, and cells shared with another body,
    keep their weights.

    Args:
        body: Material points with volumes in m^d as weights, which are changed.
        cells: Active cells of the body, of others that it touches, and of loads.

    Raises:
        ValueError: If the body is not one of the point sets of the cells.
    """
    fill = filled_fractions(body)
    full = inner_cells(body, cells) & (fill >= _LEAST) & (fill <= _MOST)
    factor = np.divide(1.0, fill, out=np.ones(len(fill)), where=full)
    body["weight"] = body.weight * factor[body.cell]


def inner_cells(body: MaterialPoints, cells: ActiveCells) -> npt.NDArray[np.bool_]:
    """Return which owned cells are inside a body, without another one, ``(n_owned_cells,)``.

    None of their vertices belongs to a cell without points.

    Args:
        body: Material points.
        cells: Active cells of the body, of others that it touches, and of loads.

    Raises:
        ValueError: If the body is not one of the point sets of the cells.
    """
    if body not in cells.points:
        raise ValueError(
            "the body must be one of the point sets of the active cells: ActiveCells(body, ...)"
        )
    mesh = cells.mesh
    empty = np.ones(body.geometry.num_owned, dtype=np.bool_)
    for points in cells.points:
        if points not in cells.touching:
            empty[points.cell] = False
    corners = _compat.geometry_dofmap(mesh)[: len(empty)]
    at_gap = nodes_of(mesh, np.flatnonzero(empty))[corners]
    inner: npt.NDArray[np.bool_] = np.logical_not(at_gap.any(axis=1))
    for other in cells.points:
        if other is not body and "V_0" in other:
            inner[other.cell] = False
    return inner


def filled_fractions(body: MaterialPoints) -> npt.NDArray[np.float64]:
    """Return the volume of points in each owned cell per volume of the cell, ``(n_owned_cells,)``.

    Args:
        body: Material points with volumes in m^d as weights.
    """
    geometry = body.geometry
    filled = np.bincount(body.cell, body.weight, minlength=geometry.num_owned)
    return filled / geometry.owned_volumes
