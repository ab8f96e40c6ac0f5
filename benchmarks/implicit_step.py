# SPDX-License-Identifier: MIT
"""Time and memory of a step of the bending beam, stage by stage.

This is case 1 of the study `columns.py`: cells of 0.25 m, 12 points per cell, ASGS. Times are
medians of some steps after a few warm-up steps.
"""

import argparse
import sys
from pathlib import Path

import machine
import numba
import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent / "studies"))
import columns

STAGES = ("map", "predict", "matrix pattern", "assembly", "linear solver", "convect")


def bytes_per_point(points):
    """Return the memory of the arrays that each point carries."""
    names = ("x", "weight", "xi", "cell", "id", "tag", *points.field_names)
    return sum(points[name].nbytes for name in names) / len(points)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--size", type=float, default=0.25, help="cell size in m")
    parser.add_argument("--points", type=int, default=12, help="material points per cell")
    parser.add_argument("--steps", type=int, default=20, help="number of measured steps")
    parser.add_argument("--threads", type=int, default=2, help="number of threads of assembly")
    options = parser.parse_args()
    numba.set_num_threads(options.threads)
    print(machine.describe())
    sim, _ = columns.build("bending_beam", h=options.size, per_cell=options.points)
    body = sim.bodies[0]
    cells = len(np.unique(body.cell))
    for _ in range(3):
        sim.step()
    times = {name: [] for name in STAGES}
    iterations = []
    for _ in range(options.steps):
        before = dict(sim.seconds)
        iterations.append(sim.step().newton.iterations)
        for name in STAGES:
            times[name].append(sim.seconds[name] - before[name])
    median = {name: float(np.median(t)) for name, t in times.items()}
    total = float(np.median(np.sum(list(times.values()), axis=0)))
    print(
        f"{len(body)} points in {cells} cells, {options.threads} threads, "
        f"{np.mean(iterations):.2f} Newton iterations per step, median of {options.steps} steps"
    )
    print(f"{'stage':<34}{'s per step':>10}{'share':>9}")
    titles = {
        "map": "map to the grid and back",
        "predict": "predict, check volumes",
        "matrix pattern": "pattern of the matrix",
        "assembly": "assemble",
        "linear solver": "solve (MUMPS)",
        "convect": "convect: locate, move, new volumes",
    }
    for name in STAGES:
        print(f"{titles[name]:<34}{median[name]:10.3f}{median[name] / total:9.1%}")
    print(f"{'whole step':<34}{total:10.3f}")
    assembly = median["assembly"] / np.mean(iterations)
    around = (median["map"] + median["convect"]) / total
    print(f"assembly of one Newton iteration  {assembly:10.3f}")
    print(f"locate, map and convect           {around:10.1%} of the step")
    print(f"memory of the points' arrays      {bytes_per_point(body):10.0f} bytes per point")


if __name__ == "__main__":
    main()
