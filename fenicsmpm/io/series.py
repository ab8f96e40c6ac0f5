# SPDX-License-Identifier: MIT
"""Time series for ParaView: one file for each time, and one that lists them."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

from dolfinx import fem

from fenicsmpm.io.atomic import replacing
from fenicsmpm.io.results import gather_functions, gather_points, write
from fenicsmpm.points import MaterialPoints
from fenicsmpm.points.agreement import do_there


class Series:
    """Points with all their fields, or grid functions, at several times.

    "cook.pvd" lists the files "cook/cook_00000.vtp" and so on; it is complete after each
    ``write``, so that ParaView can open it while the program runs or after it was killed. Files of
    an earlier series of the same name are removed by the first ``write``.

    Args:
        path: the list, such as "cook.pvd"; missing directories are made.
        data: the point set, or P1 functions on one mesh.
        parameters: numbers and texts stored in each file, such as ``{"E [Pa]": 70.0}``.
        append_after: keep what an earlier series wrote up to this time [s] and go on from there;
            None for a new series.

    Attributes:
        times: written so far [s].

    Raises:
        ValueError: on all ranks, for names that do not end in .pvd, and for earlier series that
            are not of this kind.
        OSError: on all ranks, if an earlier series cannot be read.
    """

    def __init__(
        self,
        path: str | Path,
        data: MaterialPoints | Sequence[fem.Function],
        parameters: Mapping[str, Any] | None = None,
        *,
        append_after: float | None = None,
    ) -> None:
        """Read what is there; nothing is written before the first time (collective)."""
        self._path, self._parameters = Path(path), dict(parameters or {})
        self._data = data if isinstance(data, MaterialPoints) else list(data)
        self._suffix = "vtp" if isinstance(data, MaterialPoints) else "vtu"
        self._comm = _mesh(self._data).comm
        self._is_clean = False
        earlier = self._on_root(lambda: self._earlier(append_after))
        self.times: list[float] = self._comm.bcast(earlier)

    def write(self, time: float) -> None:
        """Write the data as they are now (collective).

        Args:
            time: [s], later than those written so far.

        Raises:
            OSError: on all ranks, if a file cannot be written.
            ValueError: on all ranks, for times that do not grow, and see ``gather_functions``.
        """
        if self.times and not time > self.times[-1]:
            raise ValueError(
                f"times of a series must grow: {time} s after {self.times[-1]} s; to go on after "
                "a restart, give the series append_after"
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

    def __enter__(self) -> Series:
        """The series itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Nothing is left to be done: each ``write`` leaves complete files."""

    def _on_root(self, action: Callable[[], Any]) -> Any:
        return do_there(self._comm, self._comm.rank == 0, action)

    def _file(self, number: int) -> str:
        """Name of a file as it stands in the list."""
        return f"{self._path.stem}/{self._path.stem}_{number:05d}.{self._suffix}"

    def _earlier(self, append_after: float | None) -> list[float]:
        """Times of an earlier series that are to be kept."""
        if self._path.suffix != ".pvd":
            raise ValueError(f"{self._path}: the name of a series ends in .pvd")
        if append_after is None or not self._path.exists():
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
        return [time for time in times if is_until(time, append_after)]

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
