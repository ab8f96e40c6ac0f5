# SPDX-License-Identifier: MIT
"""Plots of histories and other curves."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import cycle
from pathlib import Path

from mpi4py import MPI

import numpy.typing as npt

from fenicsmpm._display import Picture
from fenicsmpm.io.history import History
from fenicsmpm.points.agreement import do_there

Curve = tuple[npt.ArrayLike, npt.ArrayLike]


def plot(
    path: str | Path,
    curves: History | Mapping[str, Curve | History],
    xlabel: str | None = None,
    ylabel: str | None = None,
    *,
    reference: Mapping[str, Curve | float] | None = None,
    comm: MPI.Comm = MPI.COMM_WORLD,
) -> Picture:
    """Draw curves in one diagram and write it to a file. Collective; rank 0 draws.

    A notebook shows the diagram if the call is the last line of a cell.

    Args:
        path: File to write, such as "tip.png"; missing directories are created.
        curves: A history, each column of which is drawn over time; or a mapping from the label of
            each curve to its values ``x (n,)`` and ``y (n,)``, or to a history of one column.
        xlabel: Text at the x axis, with the unit; None for that of histories.
        ylabel: Text at the y axis, with the unit; None for the title of a history's one column.
        reference: Reference results, drawn as dashed lines: curves, or one value for all x.
        comm: Communicator of the mesh.

    Returns:
        The diagram, which is printed as its path.

    Raises:
        OSError: On all ranks, if the file cannot be written.
        ValueError: On all ranks, if the x and y of a curve differ in number, a history has several
            columns where one is needed, or an axis has no text.
    """
    if isinstance(curves, History):
        time, *titles = curves.titles
        lines: dict[str, Curve] = {title: (curves[time], curves[title]) for title in titles}
        xlabel, ylabel = xlabel or time, ylabel or (titles[0] if len(titles) == 1 else None)
    else:
        lines = {}
        for label, curve in curves.items():
            if isinstance(curve, History):
                time, title = _one_column(label, curve)
                xlabel, ylabel = xlabel or time, ylabel or title
                curve = curve[time], curve[title]
            lines[label] = curve
    if xlabel is None or ylabel is None:
        raise ValueError(f"{path}: the axes need a text, such as xlabel='t [s]', ylabel='u [m]'")
    texts, known = (xlabel, ylabel), reference or {}
    do_there(comm, comm.rank == 0, lambda: _draw(Path(path), lines, *texts, known))
    return Picture(path)


def _one_column(label: str, history: History) -> tuple[str, str]:
    """Return the titles of the time and of the only column."""
    time, title, *more = history.titles
    if more:
        raise ValueError(
            f"{label!r} is a history of several columns: choose one, as in "
            f"{{{label!r}: (history[{time!r}], history[{title!r}])}}"
        )
    return time, title


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
    if len(curves) + len(reference) > 1:
        figure.legend(loc="outside upper center", ncols=2)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=160)
