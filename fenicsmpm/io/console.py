# SPDX-License-Identifier: MIT
"""What a person reads while a program runs: log, tables and progress bars, on rank 0 only."""

from __future__ import annotations

import logging
import sys
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from mpi4py import MPI

from tqdm import tqdm


class _BesideBars(logging.Handler):
    """Writes log lines to standard output without tearing a progress bar."""

    def emit(self, record: logging.LogRecord) -> None:
        """Write one line."""
        tqdm.write(self.format(record))


def show_log(level: int | str = logging.INFO) -> None:
    """Print the package's log on standard output, on rank 0 only.

    Args:
        level: logging.INFO for a line an iteration, logging.WARNING for problems only.
    """
    logger = logging.getLogger("fenicsmpm")
    logger.setLevel(level)
    logger.propagate = False
    if not logger.handlers:
        # without any handler, Python itself would print warnings of the other ranks
        on_root = MPI.COMM_WORLD.rank == 0
        logger.addHandler(_BesideBars() if on_root else logging.NullHandler())


def say(text: str = "") -> None:
    """Print a text on rank 0, without tearing a progress bar.

    Args:
        text: what to print.
    """
    if MPI.COMM_WORLD.rank == 0:
        tqdm.write(text)


def progress(items: Iterable[Any], label: str, total: int | None = None) -> Iterator[Any]:
    """Go through items behind a progress bar, if there is a terminal that can show it.

    Args:
        items: what to go through.
        label: text before the bar.
        total: number of items, if they have no length.
    """
    with tqdm(items, desc=label, total=total, disable=not _has_terminal(), leave=False) as bar:
        yield from bar


def watch(steps: Iterable[Any], until: float, label: str) -> Iterator[Any]:
    """Go through time steps behind a progress bar with time and time left.

    Where steps have Newton iterations, they are shown, too.

    Args:
        steps: iterator of steps, such as ``sim.run(until)``.
        until: end [s].
        label: text before the bar.
    """
    layout = (
        "{desc}: {percentage:3.0f}% |{bar}| {n:.4g}/{total:.4g} s [{elapsed}<{remaining}{postfix}]"
    )
    options = {"desc": label, "total": until, "bar_format": layout, "leave": False}
    with tqdm(disable=not _has_terminal(), **options) as bar:
        for step in steps:
            newton = getattr(step, "newton", None)
            iterations = f", {newton.iterations} Newton iterations" if newton else ""
            bar.set_postfix_str(f"step {step.number}{iterations}", refresh=False)
            bar.update(step.time - bar.n)
            yield step


def _has_terminal() -> bool:
    return MPI.COMM_WORLD.rank == 0 and sys.stderr.isatty()


class Table:
    """A table that is printed row by row, on rank 0, with aligned columns.

    Args:
        columns: title of each column and format of its numbers, such as ``{"tip [m]": ".4f"}``;
            titles carry the units.
    """

    def __init__(self, columns: Mapping[str, str]) -> None:
        """Print the titles."""
        self._columns = dict(columns)
        line = "  ".join(title.rjust(self._width(title)) for title in self._columns)
        say(line)
        say("-" * len(line))

    def row(self, *values: Any) -> None:
        """Print a row.

        Args:
            values: one for each column; None for a dash, text as it is.

        Raises:
            ValueError: if there are more or fewer values than columns.
        """
        if len(values) != len(self._columns):
            raise ValueError(f"{len(values)} values for {len(self._columns)} columns: {values}")
        cells = []
        for value, (title, spec) in zip(values, self._columns.items(), strict=True):
            text = "-" if value is None else value if isinstance(value, str) else f"{value:{spec}}"
            cells.append(text.rjust(self._width(title)))
        say("  ".join(cells))

    @staticmethod
    def _width(title: str) -> int:
        return max(len(title), 9)
