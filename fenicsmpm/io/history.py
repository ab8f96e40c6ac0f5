# SPDX-License-Identifier: MIT
"""Histories: numbers that are recorded at each step, in a CSV file."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import fenicsmpm
from fenicsmpm.io.atomic import replacing
from fenicsmpm.io.series import is_until
from fenicsmpm.points.agreement import do_there


class History:
    """A CSV file with a row for each ``write``; a program that is killed leaves its rows.

    Above the titles, lines that begin with # name the package's version and the parameters.

    Args:
        path: file to write, such as "cook.csv"; missing directories are made.
        columns: title of each column, with the unit, and the function that gives its number, such
            as ``{"t [s]": lambda: sim.time, "tip [m]": lambda: probe(tip, "u")[1]}``. The first
            column is the time.
        parameters: numbers and texts, such as ``{"E [Pa]": 70.0}``.
        append_after: keep rows of an earlier file up to this time [s]; None for a new file.
        comm: communicator of the mesh; rank 0 writes.

    Raises:
        OSError: on all ranks, if the file cannot be written or read.
        ValueError: on all ranks, if there are no columns, or an earlier file has others.
    """

    def __init__(
        self,
        path: str | Path,
        columns: Mapping[str, Callable[..., float]],
        parameters: Mapping[str, Any] | None = None,
        *,
        append_after: float | None = None,
        comm: MPI.Intracomm = MPI.COMM_WORLD,
    ) -> None:
        """Write the titles, and the rows that are kept (collective)."""
        self._path, self._columns, self._comm = Path(path).absolute(), dict(columns), comm

        def begin() -> None:
            kept = [] if append_after is None else self._earlier(append_after)
            lines = [f"# fenicsmpm {fenicsmpm.__version__}\n"]
            for name, value in (parameters or {}).items():
                lines.append(f"# {name} = {' '.join(str(value).split())}\n")
            lines.append(_line(self._titles()))
            with replacing(self._path) as stream:
                stream.write("".join(lines + kept).encode())

        do_there(comm, comm.rank == 0, begin)

    def write(self, *arguments: Any) -> None:
        """Append a row (collective).

        Args:
            arguments: passed on to the functions of all columns, for instance the step.

        Raises:
            OSError: on all ranks, if the file cannot be written.
            TypeError: on all ranks, if a function does not give one number.
        """
        values = {title: function(*arguments) for title, function in self._columns.items()}

        def append() -> None:
            row = [_number(title, value) for title, value in values.items()]
            with open(self._path, "a", encoding="utf-8", newline="") as stream:
                stream.write(_line(row))

        do_there(self._comm, self._comm.rank == 0, append)

    def _titles(self) -> list[str]:
        if not self._columns:
            raise ValueError("a history needs columns: {'t [s]': function, ...}")
        return list(self._columns)

    def _earlier(self, append_after: float) -> list[str]:
        """Lines of an earlier file up to a time."""
        if not self._path.exists():
            return []
        titles, rows = _parse(self._path)
        if titles != self._titles():
            raise ValueError(
                f"{self._path} has the columns {', '.join(titles)}, not "
                f"{', '.join(self._titles())}: choose another name for the history"
            )
        return [_line(row) for row in rows if is_until(float(row[0]), append_after)]


def read_history(path: str | Path) -> dict[str, npt.NDArray[np.float64]]:
    """Read what a ``History`` wrote, also while it is being written.

    Args:
        path: the CSV file.

    Returns:
        For each title the numbers of its column, shape (n_rows,).

    Raises:
        OSError: if the file cannot be read.
        ValueError: if it is not such a file.
    """
    titles, rows = _parse(Path(path))
    values = np.array([[float(text) for text in row] for row in rows]).reshape(-1, len(titles))
    return dict(zip(titles, values.T.copy(), strict=True))


def _parse(path: Path) -> tuple[list[str], list[list[str]]]:
    """Titles and rows; a last line that was cut short does not count."""
    with open(path, encoding="utf-8", newline="") as stream:
        lines = [line for line in stream if line.endswith("\n")]
    first = next((k for k, line in enumerate(lines) if not line.startswith("#")), None)
    if first is None:
        raise ValueError(f"{path} is no history: it has no line of titles")
    titles, *rows = csv.reader(lines[first:])
    for k, row in enumerate(rows, start=first + 2):
        if len(row) != len(titles):
            raise ValueError(f"{path}, line {k}: {len(row)} values for {len(titles)} columns")
    return titles, rows


def _line(values: list[str]) -> str:
    stream = io.StringIO()
    csv.writer(stream, lineterminator="\n").writerow(values)
    return stream.getvalue()


def _number(title: str, value: Any) -> str:
    """The shortest text that gives the same number again."""
    if np.ndim(value) == 0:
        try:
            return repr(float(value)).removesuffix(".0")
        except (TypeError, ValueError):
            pass
    raise TypeError(f"column {title!r} needs one number, not {value!r}")
