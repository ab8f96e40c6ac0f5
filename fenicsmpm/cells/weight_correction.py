# SPDX-License-Identifier: MIT
"""Weights of the points in full cells that sum to the volume of the cell."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from fenicsmpm import _compat
from fenicsmpm.cells.active_cells import ActiveCells, nodes_of
from fenicsmpm.points import MaterialPoints

# Volume of points per volume of a full cell, beyond which there is a hole or a pile of points
_LEAST, _MOST = 0.5, 1.5


def correct_weights(body: MaterialPoints, cells: ActiveCells) -> None:
    """Scale the weights in full interior cells so that they sum to the cell's volume (collective).

    Points that cross cells leave one overfull and the other with a gap; the integrals then miss
    parts of the body that is there. Constant functions are integrated exactly afterwards. To be
    used as ``ImplicitMPM(..., observers=[lambda sim, step: correct_weights(body, cells)])``; masses
    stay.

    With smooth functions, corrected weights keep more of the energy of long runs, but pressures at
    points see how weights jump from cell to cell (docs/explanation/smooth_functions.md).

    A cell is interior if no vertex of it belongs to a cell without points. Left as they are: cells
    filled to less than 0.5 or more than 1.5 of their volume, and cells shared with another body.

    Args:
        body: material points with their volumes as weights [m^d], which are changed.
        cells: active cells of the body, of others that it touches, and of loads.

    Raises:
        ValueError: if the body is not one of the point sets of the cells.
    """
    if body not in cells.points:
        raise ValueError("weights of a body that is not in the active cells: ActiveCells(body, ..)")
    mesh = cells.mesh
    fill = filled_fractions(body)
    empty = np.ones(len(fill), dtype=np.bool_)
    for points in cells.points:
        if points not in cells.touching:
            empty[points.cell] = False
    at_gap = nodes_of(mesh, np.flatnonzero(empty))[_compat.geometry_dofmap(mesh)[: len(fill)]].any(
        axis=1
    )
    full = ~at_gap & (fill >= _LEAST) & (fill <= _MOST)
    for other in cells.points:
        if other is not body and "V_0" in other:
            full[other.cell] = False
    factor = np.divide(1.0, fill, out=np.ones(len(fill)), where=full)
    body["weight"] = body.weight * factor[body.cell]


def filled_fractions(body: MaterialPoints) -> npt.NDArray[np.float64]:
    """``(n_owned_cells,)`` volume of the points in each cell per volume of the cell [-].

    Args:
        body: material points with volumes as weights [m^d].
    """
    geometry = body.geometry
    filled = np.bincount(body.cell, body.weight, minlength=geometry.num_owned)
    return filled / geometry.owned_volumes
