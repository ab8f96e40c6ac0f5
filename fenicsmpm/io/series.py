# SPDX-License-Identifier: MIT
"""Time series for ParaView: one file for each time, and one that lists them."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from dolfinx import fem

from fenicsmpm.io.atomic import replacing
from fenicsmpm.io.results import gather_functions, gather_points, write
from fenicsmpm.points import MaterialPoints
from fenicsmpm.points.agreement import do_there
from fenicsmpm.simulation.observer import Observer
from fenicsmpm.simulation.step import Step


class Series(Observer):
    """Points with all their fields, or grid functions, at several times of an observed run.

    "cook.pvd" lists the files "cook/cook_00000.vtp" and so on; it is complete after each
    ``write``, so that ParaView can open it while the program runs or after it was killed. Files of
    an earlier series of the same name are removed by the first ``write``.

    Args:
        path: the list, such as "cook.pvd"; missing directories are made.
        data: the point set, or P1 functions on one mesh.
        parameters: numbers and texts stored in each file, such as ``{"E [Pa]": 70.0}``.
        every: time between two files [s]; None for the beginning and each step.
        append: go on with an earlier series, after a restart: what it wrote up to the time at which
            the run begins is kept.

    Attributes:
        times: written so far [s].

    Raises:
        ValueError: for names that do not end in .pvd, and without data.
    """

    def __init__(
        self,
        path: str | Path,
        data: MaterialPoints | Sequence[fem.Function],
        parameters: Mapping[str, Any] | None = None,
        *,
        every: float | None = None,
        append: bool = False,
    ) -> None:
        """Nothing is written before the first time."""
        self._path, self._parameters = Path(path), dict(parameters or {})
        self._data = data if isinstance(data, MaterialPoints) else list(data)
        self._suffix = "vtp" if isinstance(data, MaterialPoints) else "vtu"
        self._comm = _mesh(self._data).comm
        if self._path.suffix != ".pvd":
            raise ValueError(f"{self._path}: the name of a series ends in .pvd")
        self._every, self._append = every or 0.0, append
        self._is_open, self._has_begun, self._is_clean = False, False, False
        self.times: list[float] = []

    def _open(self, time: float) -> None:
        """Take the times of an earlier series that are kept (collective)."""
        if self._append:
            self.times = self._comm.bcast(self._on_root(lambda: self._earlier(time)))
        self._is_open = True

    def write(self, time: float) -> None:
        """Write the data as they are now (collective).

        Args:
            time: [s], later than those written so far.

        Raises:
            OSError: on all ranks, if a file cannot be written.
            ValueError: on all ranks, for times that do not grow, and see ``gather_functions``.
        """
        if not self._is_open:
            self._open(time - 2e-9 * abs(time) - 1e-300)  # before this time
        if self.times and not time > self.times[-1]:
            raise ValueError(
                f"times of a series must grow: {time} s after {self.times[-1]} s; to go on after "
                "a restart, give the series append=True"
            )
        if isinstance(self._data, MaterialPoints):
            data: Any = gather_points(self._data)
        else:
            data = gather_functions(self._data)
        if not self._is_clean:
            self._on_root(self._clean)
            self._is_clean = True
        file = self._path.parent / self._file(len(self.times))
        # TimeValue is where VTK looks for the time of a single file
        write(file, data, {**self._parameters, "TimeValue": float(time)}, self._comm)
        self._on_root(lambda: self._list([*self.times, float(time)]))
        self.times.append(float(time))

    def begin(self, sim: Any) -> None:
        """Write the state that a run begins with, unless it is there (collective).

        Args:
            sim: the simulation.

        Raises:
            OSError: on all ranks, if files cannot be written, or an earlier series not be read.
            ValueError: on all ranks, for an earlier series that is not of this kind.
        """
        if not self._is_open:
            self._open(sim.time)
        if not self._has_begun and not (self.times and is_until(sim.time, self.times[-1])):
            self.write(sim.time)
        self._has_begun = True

    def done(self, sim: Any, step: Step) -> None:
        """Write the state after a step, if it is time."""
        if is_until(self.times[-1] + self._every, step.time):
            self.write(step.time)

    def _on_root(self, action: Callable[[], Any]) -> Any:
        return do_there(self._comm, self._comm.rank == 0, action)

    def _file(self, number: int) -> str:
        """Name of a file as it stands in the list."""
        return f"{self._path.stem}/{self._path.stem}_{number:05d}.{self._suffix}"

    def _earlier(self, end: float) -> list[float]:
        """Times of an earlier series until that at which this one goes on."""
        if not self._path.exists():
            return []
        try:
            entries = ElementTree.parse(self._path).getroot().findall("Collection/DataSet")
            times = [float(entry.attrib["timestep"]) for entry in entries]
            files = [entry.attrib["file"] for entry in entries]
        except (ElementTree.ParseError, KeyError, ValueError) as failure:
            raise ValueError(f"{self._path} is no series: {failure}") from failure
        if files != [self._file(number) for number in range(len(files))]:
            raise ValueError(
                f"{self._path} lists other files than {self._file(0)} and so on: choose another "
                "name for the series"
            )
        return [time for time in times if is_until(time, end)]

    def _clean(self) -> None:
        """Remove what an earlier series wrote, but for the times that are kept."""
        if self._path.exists():
            self._list(self.times)
        kept = {self._path.parent / self._file(number) for number in range(len(self.times))}
        directory = self._path.parent / self._path.stem
        for file in directory.glob(f"{self._path.stem}_[0-9][0-9][0-9][0-9][0-9].vt[pu]"):
            if file not in kept:
                file.unlink()

    def _list(self, times: Sequence[float]) -> None:
        """Write the list of files."""
        root = ElementTree.Element("VTKFile", type="Collection", version="0.1")
        collection = ElementTree.SubElement(root, "Collection")
        for number, time in enumerate(times):
            entry = {"timestep": repr(time), "part": "0", "file": self._file(number)}
            ElementTree.SubElement(collection, "DataSet", entry)
        ElementTree.indent(root)
        with replacing(self._path) as stream:
            stream.write(ElementTree.tostring(root, xml_declaration=True, encoding="utf-8"))


def is_until(time: float, end: float) -> bool:
    """Whether a time that was written belongs to a run that went on from ``end`` [s]."""
    return time <= end + 1e-9 * abs(end)


def _mesh(data: MaterialPoints | Sequence[fem.Function]) -> Any:
    if isinstance(data, MaterialPoints):
        return data.mesh
    if not data:
        raise ValueError("a series needs a point set or one or more functions")
    return data[0].function_space.mesh
