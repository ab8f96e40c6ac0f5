# SPDX-License-Identifier: MIT
"""Orders of convergence: a growing table, regression and a plot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from mpi4py import MPI

import numpy as np

from fenicsmpm.io import Table


class Convergence:
    """Table of errors for decreasing cell sizes, printed row by row with convergence orders.

    Args:
        errors: Titles of the errors, such as "displacement".
        size: Title of the cell sizes.

    Attributes:
        sizes: Cell sizes so far.
        errors: Errors of each row so far, in the order of the titles.
    """

    def __init__(self, errors: Sequence[str], size: str = "h [m]") -> None:
        """Print the titles."""
        self._titles, self._size = list(errors), size
        self.sizes: list[float] = []
        self.errors: list[tuple[float, ...]] = []
        columns = {size: ".4g"}
        for title in errors:
            columns |= {title: ".3e", f"order of {title}": ".2f"}
        self._table = Table(columns)

    def add(self, size: float, **errors: float) -> None:
        """Add and print a row.

        Args:
            size: Cell size, in the unit of its title.
            errors: Errors by title.

        Raises:
            ValueError: If the titles differ from those of the table.
        """
        if set(errors) != set(self._titles):
            raise ValueError(
                f"the table needs errors of {', '.join(self._titles)}, not of {', '.join(errors)}"
            )
        self.sizes.append(size)
        self.errors.append(tuple(errors[title] for title in self._titles))
        row: list[float | None] = [size]
        for k, error in enumerate(self.errors[-1]):
            order = None
            if len(self.sizes) > 1:
                ratio = np.log(self.errors[-2][k] / error)
                order = float(ratio / np.log(self.sizes[-2] / size))
            row += [error, order]
        self._table.row(*row)

    def orders(self, last: int | None = None) -> Mapping[str, float]:
        """Return the slopes of regression lines of log(error) over log(size), by title [-].

        Args:
            last: Number of last rows to use. None for all rows.
        """
        h, e = np.log(self.sizes), np.log(self.errors)
        first = 0 if last is None else len(h) - last
        slopes = np.polyfit(h[first:], e[first:], 1)[0]
        return dict(zip(self._titles, map(float, slopes), strict=True))

    def plot(self, path: str | Path, slope: float = 2.0) -> None:
        """Plot errors over sizes together with a line of a given slope, on rank 0.

        Args:
            path: Path of the picture. Missing directories are created.
            slope: Slope of the dotted line [-].
        """
        if MPI.COMM_WORLD.rank != 0:
            return
        from matplotlib.figure import Figure

        figure = Figure(figsize=(5, 4), layout="constrained")
        axes = figure.subplots()
        h, e = np.array(self.sizes), np.array(self.errors)
        for title, column in zip(self._titles, e.T, strict=True):
            axes.loglog(h, column, "o-", ms=4, label=title)
        axes.loglog(h, 0.7 * e.min() * (h / h.min()) ** slope, "k:", label=f"order {slope:g}")
        axes.set_xlabel(self._size)
        axes.set_ylabel("relative error [-]")
        axes.set_xticks(h, [f"{size:.4g}" for size in h])
        axes.minorticks_off()
        axes.grid(alpha=0.3)
        axes.legend()
        Path(path).parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, dpi=160)
