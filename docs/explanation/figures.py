# SPDX-License-Identifier: MIT
"""Draws grid_functions.png and quadrature.png: ``./run python docs/explanation/figures.py``."""

from itertools import pairwise
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from fenicsmpm.basis import lines

HERE = Path(__file__).parent
CELLS = 6
NAMES = {
    "linear": lines.LINEAR, "uGIMP, half a cell": lines.GIMP, "quadratic": lines.QUADRATIC,
    "cubic": lines.CUBIC,
}  # fmt: skip


def tabulate(kind, x, half=0.25):
    """Values and slopes of all functions on a line of cells of length one, ``(2, n, nodes)``."""
    result = np.zeros((2, len(x), CELLS + 1))
    row = np.empty((3, 4))
    for p, position in enumerate(x):
        cell = min(int(position), CELLS - 1)
        row[:] = 0.0
        first = lines.tabulate_line(kind, cell, position - cell, CELLS, half, row)
        for k in range(lines.WIDTH[kind]):
            if 0 <= first + k <= CELLS:
                result[:, p, first + k] = row[:2, k]
    return result


def draw_functions():
    """The functions of the lowest nodes, and the slopes of one inside."""
    x = np.linspace(0, CELLS, 1201)[:-1]
    figure, axes = plt.subplots(2, 4, figsize=(11, 4), sharex=True, sharey="row", dpi=150)
    for (name, kind), (above, below) in zip(NAMES.items(), axes.T, strict=True):
        values, slopes = tabulate(kind, x)
        assert np.allclose(values.sum(axis=1), 1) and np.allclose(values @ np.arange(CELLS + 1), x)
        for node in (1, 0, 3):
            colour = "tab:blue" if node == 3 else "0.6"
            above.plot(x, values[:, node], color=colour, lw=1.5 if node == 3 else 1)
        below.plot(x, slopes[:, 3], color="tab:blue")
        above.set_title(name, fontsize=10)
        below.set_xlabel("x / h")
        below.set_xticks(range(CELLS + 1))
        for axis in (above, below):
            axis.grid(alpha=0.3)
    axes[0, 0].set_ylabel("$N$")
    axes[1, 0].set_ylabel("$h\\, dN/dx$, node 3")
    figure.tight_layout()
    figure.savefig(HERE / "grid_functions.png")


def spurious_force(kind, per_cell, half):
    """Largest sum of V grad N at a node inside, in units of its parts; zero if integrals are exact.

    Args:
        kind: of the functions.
        per_cell: points to a cell, any number.
        half: half of the size of a point, as a function of the distance of points.
    """
    spacing, worst = 1 / per_cell, 0.0
    for offset in (np.arange(16) + 0.5) / 16:
        x = np.arange(offset * spacing, CELLS, spacing)
        slopes = tabulate(kind, x, half(spacing))[1, :, CELLS // 2]
        worst = max(worst, abs(spacing * slopes.sum()))
    return worst


def draw_errors():
    """What points at equal distances make of the force of a constant stress."""
    kinds = {
        "linear": (lines.LINEAR, lambda s: 0.25),
        "uGIMP, seeded with 2 points a cell": (lines.GIMP, lambda s: 0.25),
        "quadratic": (lines.QUADRATIC, lambda s: 0.25),
        "cubic": (lines.CUBIC, lambda s: 0.25),
    }
    edges = np.geomspace(1.5, 17, 13)
    figure, axis = plt.subplots(figsize=(6, 4), dpi=150)
    # points that cover the line without gaps integrate exactly
    assert all(spurious_force(lines.GIMP, n, lambda s: s / 2) < 1e-13 for n in edges)
    for name, (kind, half) in kinds.items():
        worst = [
            max(spurious_force(kind, n, half) for n in np.linspace(low, high, 40))
            for low, high in pairwise(edges)
        ]
        axis.loglog(np.sqrt(edges[:-1] * edges[1:]), worst, "o-", ms=3, label=name)
    axis.set_xlabel("points a cell, in each direction")
    axis.set_ylabel("spurious force / (stress $\\cdot$ area)")
    axis.set_xticks([2, 4, 8, 16], ["2", "4", "8", "16"])
    axis.minorticks_off()
    axis.grid(alpha=0.3)
    axis.legend(fontsize=8)
    figure.tight_layout()
    figure.savefig(HERE / "quadrature.png")


if __name__ == "__main__":
    draw_functions()
    draw_errors()
