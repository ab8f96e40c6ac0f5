# SPDX-License-Identifier: MIT
"""Windows: nodes around the points of a tile, in an array that fits into the first-level cache."""

from __future__ import annotations

from typing import NamedTuple

# Number of nodes of a tile in each direction
SIDE = {2: 8, 3: 4}
# Number of cells that a point may drift until tiles are built anew. It then stays within the
# neighbouring tiles of its own one.
MARGIN = {2: 1, 3: 1}
# Points closer to a wall than this, in cells, are on it.
ON_WALL = 1e-9


class Window(NamedTuple):
    """Shape of a window: a tile and its rim.

    Attributes:
        side: Number of nodes of a tile in each direction.
        margin: Number of nodes before a tile's first one.
        far: Distance in memory of neighbouring nodes in the first direction.
        near: Distance in memory of neighbouring nodes in the second direction.
        places: Number of places in memory, of which some are not used.
    """

    side: int
    margin: int
    far: int
    near: int
    places: int


def window(dim: int, width: int) -> Window:
    """Return the window for functions of `width` nodes per direction."""
    side, margin = SIDE[dim], MARGIN[dim]
    size = side + width - 1 + 2 * margin
    # an odd distance, since powers of two collide in caches
    near = size if dim == 3 else 1
    far = size * near
    far += 1 - far % 2
    return Window(side, margin, far, near, size * far)
