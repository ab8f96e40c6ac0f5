# SPDX-License-Identifier: MIT
"""Histories: numbers recorded at each step."""

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
from fenicsmpm.io.times import is_until
from fenicsmpm.points.agreement import do_there
from fenicsmpm.simulation.observer import Observer
from fenicsmpm.simulation.step import Step

TIME = "t [s]"


class History(Observer):
    """Numbers recorded at the beginning of a run and after each step, also in a CSV file.

    ``history["tip [m]"]`` returns the column of a title, shape (n_rows,); ``io.plot`` draws it.
    Rows reach the file at once, so a killed program loses none. Lines above the titles begin with #
    and name the version of the package and the parameters.

    Args:
        columns: Title of each column, with the unit, and the function of the simulation that
            returns its number, such as ``{"tip [m]": lambda sim: probe(tip, "u")[1]}``. A first
            column "t [s]" is added.
        path: File to write, such as "cook.csv"; missing directories are created. None for no file.
        parameters: Numbers and texts for the file, such as ``{"E [Pa]": 70.0}``.
        append: Whether to continue an earlier file, after a restart. Rows up to the time at which
            the run begins are kept.
        comm: Communicator of the mesh; rank 0 writes.

    Raises:
        ValueError: If there are no columns.
    """

    def __init__(
        self,
        columns: Mapping[str, Callable[[Any], float]],
        path: str | Path | None = None,
        parameters: Mapping[str, Any] | None = None,
        *,
        append: bool = False,
        comm: MPI.Intracomm = MPI.COMM_WORLD,
    ) -> None:
        """Set up the columns; nothing is written before a run begins."""
        if not columns:
            raise ValueError("a history needs columns: {'tip [m]': function of the simulation}")
        self._columns = {TIME: lambda sim: sim.time, **columns}
        self._path, self._comm = None if path is None else Path(path).absolute(), comm
        self._parameters, self._append = dict(parameters or {}), append
        self._rows: list[list[float]] = []
        self._is_open = False

    def _open(self, time: float) -> None:
        """Start the file, and read the rows of an earlier one that are kept. Collective."""
        rows = do_there(self._comm, self._comm.rank == 0, lambda: self._begin(time))
        self._rows = self._comm.bcast(rows)
        self._is_open = True

    def _begin(self, time: float) -> list[list[float]]:
        if self._path is None:
            return []
        kept = self._earlier(self._path, time) if self._append else []
        lines = [f"# fenicsmpm {fenicsmpm.__version__}\n"]
        for name, value in self._parameters.items():
            lines.append(f"# {name} = {' '.join(str(value).split())}\n")
        lines += [_line(self.titles), *(_line(row) for row in kept)]
        with replacing(self._path) as stream:
            stream.write("".join(lines).encode())
        return [[float(text) for text in row] for row in kept]

    @property
    def titles(self) -> list[str]:
        """Titles of all columns; the first one is the time."""
        return list(self._columns)

    def __getitem__(self, title: str) -> npt.NDArray[np.float64]:
        """Return the numbers recorded under a title, shape (n_rows,)."""
        if title not in self._columns:
            raise KeyError(f"no column {title!r}; there are {', '.join(self.titles)}")
        k = self.titles.index(title)
        return np.array([row[k] for row in self._rows], dtype=np.float64)

    def begin(self, sim: Any) -> None:
        """Record the state at the beginning of a run, unless it is recorded already. Collective.

        Args:
            sim: The simulation.

        Raises:
            OSError: On all ranks, if the file cannot be written or read.
            ValueError: On all ranks, if an earlier file has other columns.
        """
        if not self._is_open:
            self._open(sim.time)
        if not self._rows or not is_until(sim.time, self._rows[-1][0]):
            self.write(sim)

    def done(self, sim: Any, step: Step) -> None:
        """Record the state after a step. Collective.

        Args:
            sim: The simulation.
            step: The finished step.
        """
        self.write(sim)

    def write(self, sim: Any) -> None:
        """Append a row. Collective.

        Args:
            sim: Argument of the columns' functions; its ``time`` in s is recorded, too.

        Raises:
            OSError: On all ranks, if the file cannot be written.
            TypeError: On all ranks, if a function does not return one number.
        """
        if not self._is_open:
            self._open(sim.time)
        values = {title: function(sim) for title, function in self._columns.items()}
        row = do_there(self._comm, True, lambda: [_number(*item) for item in values.items()])
        assert row is not None

        def append() -> None:
            assert self._path is not None
            with open(self._path, "a", encoding="utf-8", newline="") as stream:
                stream.write(_line([repr(value).removesuffix(".0") for value in row]))

        do_there(self._comm, self._comm.rank == 0 and self._path is not None, append)
        self._rows.append(row)

    def _earlier(self, path: Path, time: float) -> list[list[str]]:
        """Return the rows of an earlier file up to a time."""
        if not path.exists():
            return []
        titles, rows = _parse(path)
        if titles != self.titles:
            raise ValueError(
                f"{path} has the columns {', '.join(titles)}, not {', '.join(self.titles)}: choose "
                "another name for the history"
            )
        return [row for row in rows if is_until(float(row[0]), time)]


def read_history(path: str | Path) -> dict[str, npt.NDArray[np.float64]]:
    """Read the file of a ``History``, even while it is being written.

    Args:
        path: The CSV file.

    Returns:
        Numbers of each column by title, shape (n_rows,).

    Raises:
        OSError: If the file cannot be read.
        ValueError: If it is not the file of a history.
    """
    titles, rows = _parse(Path(path))
    values = np.array([[float(text) for text in row] for row in rows]).reshape(-1, len(titles))
    return dict(zip(titles, values.T.copy(), strict=True))


def _parse(path: Path) -> tuple[list[str], list[list[str]]]:
    """Return titles and rows; an incomplete last line does not count."""
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


def _number(title: str, value: Any) -> float:
    if np.ndim(value) == 0:
        try:
            return float(value)
        except (TypeError, ValueError):
            pass
    raise TypeError(f"column {title!r} needs one number, not {value!r}")
