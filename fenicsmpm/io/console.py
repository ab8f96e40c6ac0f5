# SPDX-License-Identifier: MIT
"""Log, tables and progress bars in the terminal, on rank 0 only."""

from __future__ import annotations

import html
import io
import logging
import sys
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from mpi4py import MPI

from tqdm import tqdm


class _BesideBars(logging.Handler):
    """Handler that writes log lines to standard output without breaking a progress bar."""

    def emit(self, record: logging.LogRecord) -> None:
        """Write one line."""
        tqdm.write(self.format(record))


def show_log(level: int | str = logging.INFO) -> None:
    """Print the package's log on standard output, on rank 0 only.

    Args:
        level: logging.INFO for one line per iteration, logging.WARNING for problems only.
    """
    logger = logging.getLogger("fenicsmpm")
    logger.setLevel(level)
    logger.propagate = False
    if not logger.handlers:
        # without any handler, Python itself would print warnings of the other ranks
        on_root = MPI.COMM_WORLD.rank == 0
        logger.addHandler(_BesideBars() if on_root else logging.NullHandler())


def say(text: str = "") -> None:
    """Print a text on rank 0, without breaking a progress bar.

    Args:
        text: Text to print.
    """
    if MPI.COMM_WORLD.rank == 0:
        tqdm.write(text)


def progress(items: Iterable[Any], label: str, total: int | None = None) -> Iterator[Any]:
    """Iterate over items behind a progress bar, if a terminal or notebook can show it.

    The environment variable TQDM_DISABLE=1 switches all bars off.

    Args:
        items: Items to iterate over.
        label: Text before the bar.
        total: Number of items, if they have no length.

    Returns:
        An iterator over the items.
    """
    with _bar(iterable=items, desc=label, total=total) as bar:
        yield from bar


def watch(steps: Iterable[Any], until: float, label: str) -> Iterator[Any]:
    """Iterate over time steps behind a progress bar with the time and the remaining duration.

    If steps have Newton iterations, their number is shown, too. Bars appear as for ``progress``.

    Args:
        steps: Iterator of steps, such as ``sim.run(until)``.
        until: End in s.
        label: Text before the bar.

    Returns:
        An iterator over the steps.
    """
    layout = (
        "{desc}: {percentage:3.0f}% |{bar}| {n:.4g}/{total:.4g} s [{elapsed}<{remaining}{postfix}]"
    )
    with _bar(desc=label, total=until, bar_format=layout) as bar:
        for step in steps:
            newton = getattr(step, "newton", None)
            iterations = f", {newton.iterations} Newton iterations" if newton else ""
            bar.set_postfix_str(f"step {step.number}{iterations}", refresh=False)
            bar.update(step.time - bar.n)
            yield step


class _NotebookBar(tqdm):
    """Progress bar in the output of a notebook cell, which it leaves empty at the end.

    The bar of tqdm needs ipywidgets and leaves a widget without a model in the saved notebook.
    """

    def __init__(self, **options: Any) -> None:
        """Create the bar without writing to a stream."""
        self._output: Any = None
        super().__init__(file=io.StringIO(), **options)

    def display(self, msg: str | None = None, pos: int | None = None) -> None:
        """Show the state, or nothing if the message is empty."""
        from IPython.display import HTML, display

        content = HTML(self._state() if msg is None else msg)
        if self._output is None:
            self._output = display(content, display_id=True)
        else:
            self._output.update(content)

    def _state(self) -> str:
        values = self.format_dict
        layout = (values["bar_format"] or "{l_bar}{bar}{r_bar}").replace("{bar}", "\n")
        text = self.format_meter(**{**values, "bar_format": layout})
        before, _, after = (html.escape(part.strip("| ")) for part in text.rpartition("\n"))
        share = "" if not self.total else f' value="{self.n / self.total:.4f}"'
        return f"<code>{before}</code> <progress{share}></progress> <code>{after}</code>"

    def clear(self, nolock: bool = False) -> None:
        """Do nothing: printed text does not collide with this bar."""


def _bar(**options: Any) -> Any:
    """Return a progress bar that vanishes at its end, on rank 0, if somebody can see it."""
    if MPI.COMM_WORLD.rank == 0 and _in_notebook():
        return _NotebookBar(leave=False, **options)
    if MPI.COMM_WORLD.rank > 0 or not sys.stderr.isatty():
        options["disable"] = True
    return tqdm(leave=False, **options)


def _in_notebook() -> bool:
    """Return whether a Jupyter kernel runs this."""
    ipython = sys.modules.get("IPython")
    return ipython is not None and hasattr(ipython.get_ipython(), "kernel")


class Table:
    """Table that is printed row by row on rank 0, with aligned columns.

    Args:
        columns: Title of each column, with the unit, and format of its numbers, such as
            ``{"tip [m]": ".4f"}``.
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
            *values: One value for each column; None for a dash, texts are printed as they are.

        Raises:
            ValueError: If there are more or fewer values than columns.
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
