# SPDX-License-Identifier: MIT
"""Windows: the nodes around the points of a tile, in an array that stays in the first cache."""

from __future__ import annotations

from typing import NamedTuple

# Nodes of a tile in each direction
SIDE = {2: 8, 3: 4}
# Cells that a point may drift until tiles are laid anew; tiles around a point's own one suffice
MARGIN = {2: 1, 3: 1}
# Points that are as near to a wall, in cells, are on it
ON_WALL = 1e-9


class Window(NamedTuple):
    """Shape of a window: a tile and its rim.

    Attributes:
        side: nodes of a tile in each direction.
        margin: nodes before a tile's first one.
        far: distance in memory of nodes next to each other in the first direction.
        near: the same in the second direction.
        places: in memory, of which some are not used.
    """

    side: int
    margin: int
    far: int
    near: int
    places: int


def window(dim: int, width: int) -> Window:
    """Window for functions of some nodes a direction."""
    side, margin = SIDE[dim], MARGIN[dim]
    size = side + width - 1 + 2 * margin
    # an odd distance, since caches dislike powers of two
    near = size if dim == 3 else 1
    far = size * near
    far += 1 - far % 2
    return Window(side, margin, far, near, size * far)
