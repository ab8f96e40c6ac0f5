# SPDX-License-Identifier: MIT
"""Draws the pictures of this directory: ``./run python docs/explanation/figures.py``."""

from itertools import pairwise
from pathlib import Path

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np
from dolfinx import fem, mesh
from matplotlib.collections import LineCollection, PolyCollection

from fenicsmpm import points
from fenicsmpm.basis import lines
from fenicsmpm.cells import ActiveCells, Tying

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


def draw_cut_cells():
    """Facets of the ghost penalty, and the cells whose functions tied nodes continue."""
    kind = mesh.CellType.quadrilateral
    domain = mesh.create_rectangle(MPI.COMM_SELF, [(0, 0), (6, 4)], [6, 4], kind)
    body = points.lattice(domain, 1 / 6, inside=lambda x: x[1] + 0.35 * x[0] < 3.2)
    cells = ActiveCells(body)
    space = fem.functionspace(domain, ("Lagrange", 1))
    tying = Tying(space, body, cells)
    corners = domain.geometry.x[domain.geometry.dofmap[:, [0, 1, 3, 2]], :2]
    facets = mesh.entities_to_geometry(domain, 1, cells.facets())
    x = space.tabulate_dof_coordinates()[:, :2]
    rows = {dof: tying.matrix.getRow(dof)[0] for dof in tying.tied_dofs}
    ill = {dof: row for dof, row in rows.items() if len(row) > 1}  # others are far from the body

    figure, panels = plt.subplots(1, 2, figsize=(11, 4.2), dpi=150)
    for axis in panels:
        axis.add_collection(PolyCollection(corners, facecolors="none", edgecolors="0.8"))
        cut = corners[cells.cut_cells()]
        axis.add_collection(PolyCollection(cut, facecolors="#dbe9f6", edgecolors="0.8"))
        axis.plot(*body.x.T, ".", ms=2.5, color="0.45")
        axis.set(xlim=(-0.2, 6.2), ylim=(-0.2, 4.2), aspect="equal", xlabel="x / h", ylabel="y / h")
        axis.set_yticks(range(5))
    left, right = panels
    lines_of_facets = domain.geometry.x[facets][:, :, :2]
    left.add_collection(LineCollection(lines_of_facets, colors="tab:red", lw=2))
    left.set_title("ghost penalty: cut cells (blue), penalized facets (red)", fontsize=10)
    for dof, row in ill.items():
        arrow = {"arrowstyle": "->", "color": "tab:red"}
        right.annotate("", x[row].mean(axis=0), x[dof], arrowprops=arrow)
    right.plot(*x[list(ill)].T, "o", color="tab:red", ms=5)
    right.set_title("tying: ill nodes, and the cells whose functions they continue", fontsize=10)
    figure.tight_layout()
    figure.savefig(HERE / "cut_cells.png")


if __name__ == "__main__":
    draw_functions()
    draw_errors()
    draw_cut_cells()
