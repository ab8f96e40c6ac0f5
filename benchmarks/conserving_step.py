# SPDX-License-Identifier: MIT
"""Time of an energy-conserving step compared with Newmark's method.

The problems are the cantilever (2D) and the Taylor bar (3D) of `studies/conserving.py`, on the same
points and mesh. Steps of both methods alternate; times are medians. The time per iteration is
compared as well, since the methods may need different numbers of iterations.
"""

import argparse
import sys
import time
from pathlib import Path

import machine
import numba
import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent / "studies"))
import conserving

METHODS = ("energy-momentum", "newmark")


def steps(sims, first, n):
    """Return seconds and Newton iterations of n steps after the first ones, by method."""
    found = {method: [] for method in sims}
    for k in range(first + n):
        for method, sim in sims.items():
            begin = time.perf_counter()
            step = sim.step()
            if k >= first:
                found[method].append((time.perf_counter() - begin, step.newton.iterations))
    return {method: np.array(rows) for method, rows in found.items()}


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--steps", type=int, default=15, help="number of measured steps")
    parser.add_argument("--threads", type=int, default=2)
    options = parser.parse_args()
    numba.set_num_threads(options.threads)
    print(machine.describe())
    print(f"{'':<14}{'points':>8}{'method':>18}{'s per step':>11}{'iterations':>12}{'s each':>9}")
    # the cantilever after its release, the bar after its foot has spread a little
    bar = {"cells": 25, "dt": 7.5e-7, "tying": 0.5}
    builders = {
        "cantilever A": (lambda m: conserving.build("cantilever-A", m)[0], 45),
        "Taylor bar": (lambda m: conserving.build("taylor-bar", m, **bar)[0], 5),
    }
    for name, (build, first) in builders.items():
        sims = {method: build(method) for method in METHODS}
        measured = steps(sims, first, options.steps)
        medians = {}
        for method, rows in measured.items():
            seconds, iterations = np.median(rows, axis=0)
            each = np.median(rows[:, 0] / rows[:, 1])
            medians[method] = seconds, each
            points = len(sims[method].bodies[0])
            print(f"{name:<14}{points:8d}{method:>18}{seconds:11.3f}{iterations:12.1f}{each:9.3f}")
        ratios = np.divide(*(medians[method] for method in METHODS))
        print(f"{name:<14}{'ratio':>26}{ratios[0]:11.2f}{'':>12}{ratios[1]:9.2f}")


if __name__ == "__main__":
    main()
