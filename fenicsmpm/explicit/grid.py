# SPDX-License-Identifier: MIT
"""What happens at the nodes in an explicit step: momentum balance, light nodes, conditions.

Nodes have rows of eight numbers, tile by tile, ``(n_tiles, nodes of a tile, 8)``. Bodies have rows
of their own, because volumes and J of different bodies do not mix.
"""

# mypy: disallow_untyped_defs=False

from __future__ import annotations

import numba
import numpy as np

from fenicsmpm.explicit.stencils import empty_rows
from fenicsmpm.lanes import LANES

# Columns of a row, of which vectors have three: before the update of the nodes ...
MASS, MOMENTUM, VOLUME, FORCE = 0, 1, 4, 5
# ... and after it
VELOCITY, INCREMENT = MOMENTUM, FORCE

# Nodes with less mass than that of anything are empty
_NOTHING = 1e-290
# Share of the largest mass around a node below which it only goes along with its points
_ROUND_OFF = 1e-10


@numba.njit(cache=True)
def full_share(m, largest, threshold):
    """Share of a force that a node of mass m takes, by the largest mass around it, 0 to 1.

    An element whose mass is a share s of a full one is stable up to steps that are sqrt(s) times
    as long only, and points would follow a light node that is thrown ahead. So light nodes take
    less of forces, and others more.
    """
    return min(1.0, m / (threshold * largest)) if m > _ROUND_OFF * largest else 0.0


def tile_rows(tiles: int, per_tile: int, lanes: int = LANES) -> np.ndarray:
    """Zeros ``(tiles, per_tile, lanes)``, each row within a cache line."""
    rows = empty_rows(tiles * per_tile, lanes)
    rows[:] = 0.0
    return rows.reshape(tiles, per_tile, lanes)


@numba.njit(cache=True)
def merge(tiles, copies):
    """Add the copies of other threads, behind the tiles, to these, and clear them."""
    first = len(tiles) - len(copies)
    for c in range(len(copies)):
        tile = copies[c]
        for n in range(tiles.shape[1]):
            for i in range(tiles.shape[2]):
                tiles[tile, n, i] += tiles[first + c, n, i]
                tiles[first + c, n, i] = 0.0


@numba.njit(cache=True, parallel=True)
def add_body(rows, place, total):
    """Add the tiles of a body to those of all bodies."""
    for tile in numba.prange(len(place)):
        for n in range(rows.shape[1]):
            for i in range(LANES):
                total[place[tile], n, i] += rows[tile, n, i]


@numba.njit(cache=True, parallel=True)
def clear(rows):
    """Zeros in all tiles."""
    for tile in numba.prange(len(rows)):
        for n in range(rows.shape[1]):
            for i in range(rows.shape[2]):
                rows[tile, n, i] = 0.0


@numba.njit(cache=True, parallel=True)
def masses(rows, bounds):
    """Smallest and largest mass of the nodes in each tile that have some, into ``(n_tiles, 2)``."""
    for tile in numba.prange(len(rows)):
        low, high = np.inf, 0.0
        for n in range(rows.shape[1]):
            m = rows[tile, n, MASS]
            high = max(high, m)
            low = min(low, m if m > _NOTHING else np.inf)
        bounds[tile, 0], bounds[tile, 1] = low, high


@numba.njit(cache=True)
def _around(tile, n, side, neighbours, around):
    """Rows of the nodes around the n-th one of a tile, those of the tile before first; how many."""
    per_tile, count = side[0] * side[1] * side[2], 0
    x, y, z = n // (side[1] * side[2]), n // side[2] % side[1], n % side[2]
    reach_z = 1 if side[2] > 1 else 0
    for a in range(x - 1, x + 2):
        for b in range(y - 1, y + 2):
            for c in range(z - reach_z, z + reach_z + 1):
                if a == x and b == y and c == z:
                    continue
                i, j, k = a // side[0] + 1, b // side[1] + 1, c // side[2] + 1
                other = neighbours[tile, (i * 3 + j) * 3 + k]
                if other >= 0:
                    node = ((a % side[0]) * side[1] + b % side[1]) * side[2] + c % side[2]
                    around[count] = other * per_tile + node
                    count += 1
    return count


@numba.njit(cache=True)
def spare_light_nodes(rows, bounds, neighbours, side, threshold):
    """Give a part of the forces on light nodes to those around them.

    A node takes ``full_share`` of its force; the rest goes to the nodes around it in proportion to
    their masses, so that momentum is kept.

    Args:
        rows: ``(n_tiles, nodes, 8)``.
        bounds: of the masses in each tile, see ``masses``.
        neighbours: ``(n_tiles, 27)`` tiles around each.
        side: ``(3,)`` nodes of a tile.
        threshold: share of the largest mass around a node from which on it is not light.
    """
    flat = rows.reshape(-1, LANES)
    per_tile = rows.shape[1]
    around = np.empty(27, np.int64)
    light, rests = [np.int64(0) for _ in range(0)], [np.zeros(3) for _ in range(0)]
    for tile in range(len(rows)):
        largest = 0.0
        for other in neighbours[tile]:
            if other >= 0:
                largest = max(largest, bounds[other, 1])
        if not bounds[tile, 0] < threshold * largest:
            continue
        for n in range(per_tile):
            m = rows[tile, n, MASS]
            if not _NOTHING < m < threshold * largest:
                continue
            count, near = _around(tile, n, side, neighbours, around), m
            for i in range(count):
                near = max(near, flat[around[i], MASS])
            share = full_share(m, near, threshold)
            if share < 1.0:
                light.append(tile * per_tile + n)
                rests.append((1.0 - share) * rows[tile, n, FORCE:].copy())
    for i in range(len(light)):
        tile, n = light[i] // per_tile, light[i] % per_tile
        count, total = _around(tile, n, side, neighbours, around), 0.0
        for j in range(count):
            total += flat[around[j], MASS]
        for k in range(3):
            rest = rests[i][k]
            flat[light[i], FORCE + k] -= rest
            for j in range(count):
                flat[around[j], FORCE + k] += flat[around[j], MASS] / total * rest


@numba.njit(cache=True, parallel=True)
def update_nodes(rows, bounds, dt, gravity, damping):
    """New velocities of the nodes, eq. 9 (F-bar), with local damping.

    The damping force is that share of the unbalanced force, against the motion (Al-Kafaji,
    *Formulation of a dynamic material point method for geomechanical problems*, 2013).
    """
    for tile in numba.prange(len(rows)):
        if bounds[tile, 1] == 0.0:
            continue
        for n in range(rows.shape[1]):
            m = rows[tile, n, MASS]
            if m > _NOTHING:
                per_mass = 1.0 / m
                for k in range(3):
                    v = rows[tile, n, MOMENTUM + k] * per_mass
                    f = rows[tile, n, FORCE + k] + m * gravity[k]
                    dv = dt * (f - damping * abs(f) * np.sign(v)) * per_mass
                    rows[tile, n, VELOCITY + k] = v + dv
                    rows[tile, n, INCREMENT + k] = dv
            else:
                for k in range(3):
                    rows[tile, n, VELOCITY + k] = 0.0
                    rows[tile, n, INCREMENT + k] = 0.0


@numba.njit(cache=True)
def reactions(rows, dt, gravity, places, components, values, counted):
    """Sum of the forces that prescribed velocities will need, ``(3,)`` [N], before the update.

    Supported nodes are not damped: the reaction to a body at rest is its weight.

    Args:
        rows: ``(n_tiles, nodes, 8)``.
        dt: time step [s].
        gravity: ``(3,)`` [m/s^2].
        places: ``(n,)`` rows of the nodes, counted through.
        components: ``(n,)`` 0, 1 or 2.
        values: ``(n,)`` [m/s].
        counted: ``(n_tiles,)`` whether this rank is the one that counts a tile.
    """
    total, flat = np.zeros(3), rows.reshape(-1, LANES)
    for i in range(len(places)):
        n, k = places[i], components[i]
        if counted[n // rows.shape[1]]:
            m = flat[n, MASS]
            force = (m * values[i] - flat[n, MOMENTUM + k]) / dt - flat[n, FORCE + k]
            total[k] += force - m * gravity[k]
    return total


@numba.njit(cache=True)
def constrain(rows, places, components, values):
    """Prescribe velocities of updated nodes."""
    flat = rows.reshape(-1, LANES)
    for i in range(len(places)):
        n, k = places[i], components[i]
        flat[n, INCREMENT + k] += values[i] - flat[n, VELOCITY + k]
        flat[n, VELOCITY + k] = values[i]


@numba.njit(cache=True, parallel=True)
def average_nodes(rows, sums):
    """Volume-averaged J at the nodes (F-bar, eq. 19) in place of its sums ``(n_tiles, nodes, 1)``.

    The rows ``(n_tiles, nodes, 8)`` are cleared for the next step.
    """
    for tile in numba.prange(len(rows)):
        for n in range(rows.shape[1]):
            volume = rows[tile, n, VOLUME]
            # nodes at the edge of a point's support may have neither volume nor J
            sums[tile, n, 0] = sums[tile, n, 0] / volume if volume > 0.0 else 0.0
            for i in range(LANES):
                rows[tile, n, i] = 0.0
