# SPDX-License-Identifier: MIT
"""The loops over nodes of explicit steps alone, in cache: a lower bound of the time of a step.

The nodes of a window and the functions at a block of eight points stay in the first-level cache.
With quadratic B-splines in 3D, each direction of transfer takes 132 fused multiply-adds of four
numbers per point, or 93 of eight. A processor that does two at once needs 66 or 47 cycles.
"""

import time

import numba
import numpy as np

from fenicsmpm.basis.blocks import OPTIONS
from fenicsmpm.basis.windows import window
from fenicsmpm.lanes import LANES, LINE_LANES
from fenicsmpm.transfer import fused_to_nodes, fused_to_points
from fenicsmpm.transfer.windows import scratch_rows

WIDTH = 3  # nodes per direction
BLOCKS = 5000


def loops(dim):
    """Compile both loops over blocks of points with the first nodes ``bases (n, 8)``."""
    places = window(dim, WIDTH).places
    interpolate = fused_to_points.to_points(dim, WIDTH, False, False, False).interpolate
    add = fused_to_nodes.to_nodes(dim, WIDTH).add

    @numba.njit(**OPTIONS)
    def to_points(bases, w, d):
        lines = scratch_rows(fused_to_points.LINES, LINE_LANES)
        rows = scratch_rows(places, (dim - 1) * LINE_LANES)
        for block in range(BLOCKS):
            interpolate(bases[block % len(bases)], w, d, rows, lines)
        return lines[0, 0]

    @numba.njit(**OPTIONS)
    def to_nodes(bases, w, d):
        lines = scratch_rows(fused_to_nodes.LINES, LINE_LANES)
        rows = scratch_rows(places, LANES)
        for block in range(BLOCKS):
            add(bases[block % len(bases)], w, d, lines, rows)
        return rows[0, 0]

    return {"nodes to points": to_points, "points to nodes": to_nodes}


@numba.njit
def additions(n, x):
    """Add numbers in sequence, which takes three cycles each."""
    for _ in range(n):
        x += 1e-9
    return x


def seconds(run, *arguments):
    """Return the time of the fastest of twenty runs in s."""
    best = np.inf
    for _ in range(21):
        begin = time.perf_counter()
        run(*arguments)
        best = min(best, time.perf_counter() - begin)
    return best


def main():
    rng = np.random.default_rng(0)
    per_cycle = seconds(additions, 1000000, 0.0) / 3e6
    print(f"{'':4}{'':17}{'nodes':10}{'ns per point':>13}{'cycles':>8}")
    for dim in (2, 3):
        shape, w = window(dim, WIDTH), rng.random((3 * WIDTH, LANES))
        first = np.array([a * shape.far + b * shape.near for a in range(4) for b in range(4)])
        same = np.repeat(first[:, None], LANES, axis=1)
        for name, run in loops(dim).items():
            for nodes, bases in (("the same", same), ("others", rng.choice(first, same.shape))):
                a_point = seconds(run, bases, w, w) / (BLOCKS * LANES)
                cycles = a_point / per_cycle
                print(f"{dim}D  {name:17}{nodes:10}{1e9 * a_point:13.1f}{cycles:8.0f}")


if __name__ == "__main__":
    main()
