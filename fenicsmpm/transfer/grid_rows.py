# SPDX-License-Identifier: MIT
"""Nodal part of an explicit step: momentum balance, light nodes, boundary conditions.

Nodes have rows of eight numbers, tile by tile, ``(n_tiles, nodes of a tile, 8)``. Each body has
rows of its own, because volumes and J of different bodies must not mix.
"""

# mypy: disallow_untyped_defs=False

from __future__ import annotations

import numba
import numpy as np

from fenicsmpm._njit import njit
from fenicsmpm.basis.blocks import empty_rows

# Columns of a row, three for vectors: before the update of the nodes ...
MASS, MOMENTUM, VOLUME, FORCE = 0, 1, 4, 5
# ... and after it
VELOCITY, INCREMENT = MOMENTUM, FORCE
COLUMNS = 8

# Nodes with less mass than anything real are empty.
_NOTHING = 1e-290


def tile_rows(tiles: int, per_tile: int) -> np.ndarray:
    """Return zeros ``(tiles, per_tile, 8)``, each row within a cache line."""
    rows = empty_rows(tiles * per_tile, COLUMNS)
    rows[:] = 0.0
    return rows.reshape(tiles, per_tile, COLUMNS)


@njit
def merge(tiles, copies):
    """Add the copies of other threads, stored behind the tiles, to the tiles, and clear them."""
    first = len(tiles) - len(copies)
    for c in range(len(copies)):
        tile = copies[c]
        for n in range(tiles.shape[1]):
            for i in range(tiles.shape[2]):
                tiles[tile, n, i] += tiles[first + c, n, i]
                tiles[first + c, n, i] = 0.0


@njit(parallel=True)
def add_body(rows, place, total):
    """Add the tiles of a body to those of all bodies."""
    for tile in numba.prange(len(place)):
        for n in range(rows.shape[1]):
            for i in range(COLUMNS):
                total[place[tile], n, i] += rows[tile, n, i]


@njit(parallel=True)
def add_weight(rows, gravity):
    """Add mass times a force per mass ``(3,)`` to the forces."""
    for tile in numba.prange(len(rows)):
        for n in range(rows.shape[1]):
            for k in range(3):
                rows[tile, n, FORCE + k] += rows[tile, n, MASS] * gravity[k]


@njit(parallel=True)
def clear(rows):
    """Set all tiles to zero."""
    for tile in numba.prange(len(rows)):
        for n in range(rows.shape[1]):
            for i in range(rows.shape[2]):
                rows[tile, n, i] = 0.0


@njit(parallel=True)
def masses(rows, bounds):
    """Store the smallest and largest positive nodal mass of each tile in ``(n_tiles, 2)``."""
    for tile in numba.prange(len(rows)):
        low, high = np.inf, 0.0
        for n in range(rows.shape[1]):
            m = rows[tile, n, MASS]
            high = max(high, m)
            low = min(low, m if m > _NOTHING else np.inf)
        bounds[tile, 0], bounds[tile, 1] = low, high


@njit
def _around(tile, n, ids, nodes, neighbours, around, cells):
    """List the rows of the n-th node of a tile and of those around it, with their shared cells.

    Returns:
        Number of nodes.
    """
    side, shape = nodes.side, nodes.shape
    per_tile, count = side[0] * side[1] * side[2], 0
    at = (n // (side[1] * side[2]), n // side[2] % side[1], n % side[2])
    number = ids[tile]
    first = (
        number // (nodes.tiles[1] * nodes.tiles[2]) * side[0],
        number // nodes.tiles[2] % nodes.tiles[1] * side[1],
        number % nodes.tiles[2] * side[2],
    )
    for i in range(-1, 2):
        for j in range(-1, 2):
            for k in range(-1, 2):
                shared, inside = 1, True
                for m, step in enumerate((i, j, k)):
                    index = first[m] + at[m] + step
                    inside &= 0 <= index < shape[m]
                    if step == 0 and shape[m] > 1 and 0 < index < shape[m] - 1:
                        shared *= 2
                if not inside:
                    continue
                a, b, c = at[0] + i, at[1] + j, at[2] + k
                near = ((a // side[0] + 1) * 3 + b // side[1] + 1) * 3 + c // side[2] + 1
                other = neighbours[tile, near]
                if other >= 0:
                    node = ((a % side[0]) * side[1] + b % side[1]) * side[2] + c % side[2]
                    around[count], cells[count] = other * per_tile + node, shared
                    count += 1
    return count


@njit
def relieve(rows, bounds, forces, column, of_loads, neighbours, ids, nodes, threshold):
    """Move forces from light nodes to those around them, as ``light_nodes.LightNodes`` does.

    Args:
        rows: Rows with the masses, ``(n_tiles, nodes, 8)``.
        bounds: Bounds of the masses in each tile, see ``masses``.
        forces: Array ``(n_tiles, nodes, n)``, changed in place.
        column: First of the three columns with the forces.
        of_loads: Whether forces may act where there is no mass, and light nodes take a share.
        neighbours: Tiles around each tile, ``(n_tiles, 27)``.
        ids: Numbers of the tiles, ``(n_tiles,)``.
        nodes: Nodes of the lattice.
        threshold: Fraction of the mean mass around a node, below which it is light.
    """
    flat, f = rows.reshape(-1, COLUMNS), forces.reshape(-1, forces.shape[2])
    per_tile = rows.shape[1]
    around, cells = np.empty(27, np.int64), np.empty(27, np.int64)
    # lists whose types numba knows
    light, totals = [np.int64(0) for _ in range(0)], [0.0 for _ in range(0)]
    given = [np.zeros(3) for _ in range(0)]
    for tile in range(len(rows)):
        largest = 0.0
        for other in neighbours[tile]:
            if other >= 0:
                largest = max(largest, bounds[other, 1])
        if not of_loads and not bounds[tile, 0] < threshold * largest:
            continue
        for n in range(per_tile):
            m, place = rows[tile, n, MASS], tile * per_tile + n
            if not m < threshold * largest or not f[place, column : column + 3].any():
                continue
            total, count = 0.0, 0
            for i in range(_around(tile, n, ids, nodes, neighbours, around, cells)):
                total += cells[i] * flat[around[i], MASS]
                count += cells[i]
            if m * count < threshold * total:
                light.append(place)
                share = 1.0 - m * count / (threshold * total) if of_loads else 1.0
                given.append(share * f[place, column : column + 3])
                totals.append(total)
    for i in range(len(light)):
        f[light[i], column : column + 3] -= given[i]
    for i in range(len(light)):
        count = _around(
            light[i] // per_tile, light[i] % per_tile, ids, nodes, neighbours, around, cells
        )
        for j in range(count):
            share = cells[j] * flat[around[j], MASS] / totals[i]
            for k in range(3):
                f[around[j], column + k] += share * given[i][k]


@njit(parallel=True)
def update_nodes(rows, bounds, dt, damping):
    """Compute new velocities of the nodes, eq. 9 (F-bar), with local damping.

    The damping force is a fraction of the unbalanced force, opposite to the velocity (Al-Kafaji,
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
                    f = rows[tile, n, FORCE + k]
                    dv = dt * (f - damping * abs(f) * np.sign(v)) * per_mass
                    rows[tile, n, VELOCITY + k] = v + dv
                    rows[tile, n, INCREMENT + k] = dv
            else:
                for k in range(3):
                    rows[tile, n, VELOCITY + k] = 0.0
                    rows[tile, n, INCREMENT + k] = 0.0


@njit(parallel=True)
def to_velocities(rows):
    """Replace momenta by velocities."""
    for tile in numba.prange(len(rows)):
        for n in range(rows.shape[1]):
            m = rows[tile, n, MASS]
            for k in range(3):
                rows[tile, n, VELOCITY + k] = (
                    rows[tile, n, MOMENTUM + k] / m if m > _NOTHING else 0.0
                )


@njit
def reactions(rows, dt, places, components, values, counted):
    """Return the forces that prescribed velocities will need in the update, ``(n,)`` in N.

    Supported nodes are not damped: the reaction to a body at rest is its weight.

    Args:
        rows: Rows before the update, ``(n_tiles, nodes, 8)``.
        dt: Time step in s.
        places: Rows of the nodes in all tiles, ``(n,)``.
        components: Components 0, 1 or 2, ``(n,)``.
        values: Prescribed velocities in m/s, ``(n,)``.
        counted: Whether this rank counts a node, ``(n_tiles, nodes)``.
    """
    forces, flat, counts = np.zeros(len(places)), rows.reshape(-1, COLUMNS), counted.reshape(-1)
    for i in range(len(places)):
        n, k = places[i], components[i]
        if counts[n]:
            m = flat[n, MASS]
            forces[i] = (m * values[i] - flat[n, MOMENTUM + k]) / dt - flat[n, FORCE + k]
    return forces


@njit
def constrain(rows, places, components, values):
    """Prescribe velocities of updated nodes."""
    flat = rows.reshape(-1, COLUMNS)
    for i in range(len(places)):
        n, k = places[i], components[i]
        flat[n, INCREMENT + k] += values[i] - flat[n, VELOCITY + k]
        flat[n, VELOCITY + k] = values[i]


@njit(parallel=True)
def average_nodes(rows, sums, volumes):
    """Replace sums of J at the nodes by the volume average (F-bar, eq. 19), and set volumes.

    Both are ``(n_tiles, nodes, 1)``. The rows ``(n_tiles, nodes, 8)`` are cleared for the next
    step.
    """
    for tile in numba.prange(len(rows)):
        for n in range(rows.shape[1]):
            volume = rows[tile, n, VOLUME]
            # nodes at the edge of a point's support may have neither volume nor J
            sums[tile, n, 0] = sums[tile, n, 0] / volume if volume > 0.0 else 0.0
            volumes[tile, n, 0] = volume
            for i in range(COLUMNS):
                rows[tile, n, i] = 0.0
