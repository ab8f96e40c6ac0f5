# SPDX-License-Identifier: MIT
"""Orders of convergence: a table that grows, fits and a plot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from mpi4py import MPI

import numpy as np

from fenicsmpm.io import Table


class Convergence:
    """Errors over sizes of cells, printed row by row with the orders between them.

    Args:
        errors: titles of the errors, such as "displacement".
        size: title of the sizes.
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
        """Print a row.

        Args:
            size: of the cells.
            errors: by their titles.

        Raises:
            ValueError: for other titles than those of the table.
        """
        if set(errors) != set(self._titles):
            raise ValueError(f"errors of {', '.join(errors)} for {', '.join(self._titles)}")
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
        """Slopes of the regression lines of log(error) over log(size), by title.

        Args:
            last: how many of the last rows to take; None for all.
        """
        h, e = np.log(self.sizes), np.log(self.errors)
        first = 0 if last is None else len(h) - last
        slopes = np.polyfit(h[first:], e[first:], 1)[0]
        return dict(zip(self._titles, map(float, slopes), strict=True))

    def plot(self, path: str | Path, slope: float = 2.0) -> None:
        """Draw errors over sizes with a line of a slope, on rank 0.

        Args:
            path: of the picture; missing directories are made.
            slope: of the dotted line.
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
