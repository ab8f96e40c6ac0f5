# SPDX-License-Identifier: MIT
"""Time series for ParaView: points or grid functions at many times in one file."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias

from dolfinx import fem

from fenicsmpm.io.shares import FunctionShare, PointShare
from fenicsmpm.io.times import is_until
from fenicsmpm.io.vtkhdf import GridFile, plain
from fenicsmpm.points import MaterialPoints
from fenicsmpm.simulation.observer import Observer
from fenicsmpm.simulation.step import Step

Shown: TypeAlias = MaterialPoints | Sequence[MaterialPoints] | fem.Function | Sequence[fem.Function]


class Series(Observer):
    """Points with their fields, or grid functions, at several times of a run.

    All ranks write their own data into one file. ParaView (5.12 or newer) opens it, and so does
    pyvista, here at the last time::

        reader = pyvista.HDFReader("cook.vtkhdf").reader  # VTK's own
        reader.UpdateInformation()
        reader.SetStep(reader.GetNumberOfSteps() - 1)
        reader.Update()
        cloud = pyvista.wrap(reader.GetOutput())  # its time is cloud.field_data["Time"]

    Points are in the order of the ranks, which changes as they move; "id" identifies them. Vectors
    have three components, tensors nine (row by row). Slashes and dots in names become underscores,
    as in VTK's own files.

    The file is complete after each ``write``. ParaView can open it while the program runs, or after
    the program was killed, even in the middle of a ``write``. (After some 2000 writes, a kill
    within a few microseconds can damage it.) The first ``write`` replaces a file of the same name.

    Args:
        path: File to write, such as "cook.vtkhdf"; missing directories are created.
        data: One point set or several, of which the fields that all have are written; or P1
            functions on one mesh; or a function of the simulation that returns one of these, such
            as ``lambda sim: sim.bodies[0]``. With a function, the series can continue from one
            simulation to the next.
        parameters: Numbers and texts stored in the file, such as ``{"E [Pa]": 70.0}``.
        fields: Names of the fields to write, such as ``("u", "p")``. None for all that exist at
            the first ``write``, with "tag" and "weight", or for those of an earlier series. The
            "id" of points is always written.
        every: Time between two writes in s; None for the beginning and each step.
        append: Whether to continue an earlier series, after a restart. What it wrote up to the
            time at which the run begins is kept. If later times have to go, the first ``write``
            makes a copy without them, which then takes the place of the file.

    Raises:
        ValueError: For names that do not end in .vtkhdf, and without data.
    """

    def __init__(
        self,
        path: str | Path,
        data: Shown | Callable[[Any], Shown],
        parameters: Mapping[str, Any] | None = None,
        *,
        fields: Sequence[str] | None = None,
        every: float | None = None,
        append: bool = False,
    ) -> None:
        """Set up the series; nothing is written before the first time."""
        path = Path(path)
        if path.suffix != ".vtkhdf":
            raise ValueError(f"{path}: a series needs the suffix .vtkhdf")
        if isinstance(data, MaterialPoints | fem.Function | Sequence):
            shown = data
            _share(shown)
            self._data: Callable[[Any], Shown] = lambda sim: shown
        else:
            self._data = data
        self._fields = None if fields is None else list(fields)
        self._file = GridFile(path.absolute(), parameters or {})
        self._every, self._append = every or 0.0, append
        self._is_open, self._has_begun = False, False
        self._grid: Any = None

    @property
    def times(self) -> list[float]:
        """Times written so far, in s."""
        return self._file.times

    def write(self, time: float, sim: Any = None) -> None:
        """Write the current data. Collective.

        Args:
            time: Time in s, later than those written so far.
            sim: Argument of ``data``, if that is a function.

        Raises:
            OSError: On all ranks, if the file cannot be written; earlier times remain.
            ValueError: On all ranks, for times that do not grow, fields that do not exist, and an
                earlier file with other fields; see also ``gather_functions``.
        """
        share = _share(self._data(sim))
        if not self._is_open:
            self._open(share, time - 2e-9 * abs(time) - 1e-300)  # before this time
        if self.times and not time > self.times[-1]:
            raise ValueError(
                f"times of a series must grow: {time} s after {self.times[-1]} s; to go on after "
                "a restart, give the series append=True"
            )
        names = self._chosen(share)
        is_new = share.grid != self._grid
        x = share.x() if is_new or share.moves else None
        cells = share.cells() if is_new else None
        values = {name: share.values(name) for name in names}
        self._file.append(share.comm, float(time), x, cells, values)
        self._grid, self._fields = share.grid, names

    def begin(self, sim: Any) -> None:
        """Write the state at the beginning of a run, unless it is there already. Collective.

        Args:
            sim: The simulation.

        Raises:
            OSError: On all ranks, if the file cannot be written, or an earlier one cannot be read.
            ValueError: On all ranks, for an earlier file that is no series.
        """
        if self._has_begun:
            return
        if not self._is_open:
            self._open(_share(self._data(sim)), sim.time)
        if not (self.times and is_until(sim.time, self.times[-1])):
            self.write(sim.time, sim)
        self._has_begun = True

    def done(self, sim: Any, step: Step) -> None:
        """Write the state after a step, if it is due. Collective.

        Args:
            sim: The simulation.
            step: The finished step.
        """
        if is_until(self.times[-1] + self._every, step.time):
            self.write(step.time, sim)

    def _open(self, share: PointShare | FunctionShare, end: float) -> None:
        """Read which times of an earlier series are kept. Collective."""
        if self._append:
            self._file.resume(share.comm, end)
            there = [name for name in share.names if plain(name) in self._file.names]
            if self._fields is None and self.times and len(there) == len(self._file.names):
                self._fields = there
        self._is_open = True

    def _chosen(self, share: PointShare | FunctionShare) -> list[str]:
        """Return the names of the fields to write."""
        if self._fields is None:
            self._fields = share.names
        if missing := [name for name in self._fields if name not in share.names]:
            raise ValueError(
                f"fields {', '.join(missing)} do not exist; available are {', '.join(share.names)}"
            )
        names = [name for name in share.names if name == "id" or name in self._fields]
        if len({plain(name) for name in names}) < len(names):
            raise ValueError(f"names must differ in the file: {', '.join(names)}; rename fields")
        return names


def _share(shown: Shown) -> PointShare | FunctionShare:
    """Return this rank's part of the data."""
    every = [shown] if isinstance(shown, MaterialPoints | fem.Function) else list(shown)
    if not every:
        raise ValueError("a series needs a point set or one or more functions")
    bodies = [one for one in every if isinstance(one, MaterialPoints)]
    functions = [one for one in every if isinstance(one, fem.Function)]
    if len(every) not in (len(bodies), len(functions)):
        raise TypeError(f"a series needs point sets or functions, not {every}")
    return PointShare(bodies) if bodies else FunctionShare(functions)
