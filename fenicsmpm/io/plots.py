# SPDX-License-Identifier: MIT
"""Plots of histories and of other curves."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import cycle
from pathlib import Path

from mpi4py import MPI

import numpy.typing as npt

from fenicsmpm.points.agreement import do_there

Curve = tuple[npt.ArrayLike, npt.ArrayLike]


def plot(
    path: str | Path,
    curves: Mapping[str, Curve],
    xlabel: str,
    ylabel: str,
    *,
    reference: Mapping[str, Curve | float] | None = None,
    comm: MPI.Comm = MPI.COMM_WORLD,
) -> None:
    """Draw curves into one diagram and write it to a file (collective, rank 0 draws).

    Args:
        path: file to write, such as "tip.png"; missing directories are made.
        curves: label of each curve, and its ``x (n,)`` and ``y (n,)``.
        xlabel: text at the axis of x, with the unit.
        ylabel: text at the axis of y, with the unit.
        reference: what to compare with, drawn in broken lines: curves, or one value for all x.
        comm: communicator of the mesh.

    Raises:
        OSError: on all ranks, if the file cannot be written.
        ValueError: on all ranks, if the x and y of a curve differ in number.
    """
    known = reference or {}
    do_there(comm, comm.rank == 0, lambda: _draw(Path(path), curves, xlabel, ylabel, known))


def _draw(
    path: Path,
    curves: Mapping[str, Curve],
    xlabel: str,
    ylabel: str,
    reference: Mapping[str, Curve | float],
) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7, 4.5), layout="constrained")
    ax = figure.subplots()
    for (label, known), style in zip(reference.items(), cycle(["--", ":", "-."])):
        if isinstance(known, tuple):
            ax.plot(*known, color="k", ls=style, lw=1, label=label)
        else:
            ax.axhline(known, color="k", ls=style, lw=1, label=label)
    for label, (x, y) in curves.items():
        ax.plot(x, y, label=label)
    ax.set_xlabel(xlabel)
    ax.set_ylabel(ylabel)
    ax.grid(alpha=0.3)
    figure.legend(loc="outside upper center", ncols=2)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=160)
