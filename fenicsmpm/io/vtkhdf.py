# SPDX-License-Identifier: MIT
"""Grids with values at several times in one file: VTK's format on HDF5, written by all ranks.

The format is VTKHDF 2.0 with an UnstructuredGrid and the group Steps
(https://docs.vtk.org/en/latest/vtk_file_formats/vtkhdf_file_format). All values of a field form one
array, and tables tell where the values of each time begin. Each time has one part, so that readers
of all versions return one grid, and the data do not depend on the number of ranks. Points are cells
with one vertex. VTK's PolyData is no alternative: VTK 9.7 misreads it after a time without points.

A time is written in three stages: arrays are extended, ranks write their rows there, and finally
the tables and the number of times are updated. Readers rely on the tables. If the program is killed
or the disk becomes full at any stage, earlier times can still be read.
"""

from __future__ import annotations

import io
import os
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, TypeAlias

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import fenicsmpm
from fenicsmpm.io.growing import add_array, edit, extend
from fenicsmpm.io.times import is_until
from fenicsmpm.points.agreement import do_there

ROOT, FIELDS, STEPS = "VTKHDF", "VTKHDF/PointData", "VTKHDF/Steps"
FIELD_OFFSETS, PARAMETER_OFFSETS = f"{STEPS}/PointDataOffsets", f"{STEPS}/FieldDataOffsets"
POINTS, TYPES = f"{ROOT}/Points", f"{ROOT}/Types"
OFFSETS, CONNECTIVITY = f"{ROOT}/Offsets", f"{ROOT}/Connectivity"
PARTS = tuple(f"{ROOT}/NumberOf{name}" for name in ("Points", "Cells", "ConnectivityIds"))

Rows: TypeAlias = Mapping[str, npt.NDArray]


@dataclass
class Cells:
    """Cells that a rank contributes to a grid.

    Attributes:
        nodes: Points of the cells, numbered over all ranks, shape (n_cells, n_nodes).
        kind: VTK's number of the cell type.
    """

    nodes: npt.NDArray[np.int64]
    kind: int


@dataclass
class _Step:
    """Starts and lengths of the arrays of a time in the file."""

    part: int = -1
    point: int = 0
    cell: int = 0
    connectivity: int = 0
    value: int = 0
    n_points: int = 0
    n_cells: int = 0
    n_connectivity: int = 0


class GridFile:
    """A file to which ranks append their parts of a grid, time by time.

    Args:
        path: Name of the file; missing directories are created.
        parameters: Numbers and texts to be stored in it, beside the version of the package.

    Attributes:
        times: Times in s that are in the file, or are kept of an earlier one.
        names: Names of the fields of an earlier file of which times are kept.
    """

    def __init__(self, path: Path, parameters: Mapping[str, Any]) -> None:
        """Set up the file; nothing is written before the first time."""
        self._path, self._parameters = path, {"fenicsmpm version": fenicsmpm.__version__}
        self._parameters.update(parameters)
        self._is_there, self._must_cut = False, False
        self._last = _Step()
        self.times: list[float] = []
        self.names: list[str] = []

    def resume(self, comm: MPI.Intracomm, end: float) -> None:
        """Continue an earlier file. It does not change until the next time is written. Collective.

        Args:
            comm: Communicator of the ranks.
            end: Times up to this one, in s, are kept.

        Raises:
            OSError: On all ranks, if the file cannot be read.
            ValueError: On all ranks, if it was not written by this class.
        """
        found = do_there(comm, comm.rank == 0, lambda: self._read(end))
        self.times, self.names, self._last, self._must_cut = comm.bcast(found)
        self._is_there = bool(self.times)

    def append(
        self,
        comm: MPI.Intracomm,
        time: float,
        x: npt.NDArray[np.float64] | None,
        cells: Cells | None,
        fields: Rows,
    ) -> None:
        """Append the data of all ranks at a time. Collective.

        Args:
            comm: Communicator of the ranks.
            time: Time in s, later than the last one.
            x: Positions of this rank's points in m, shape (n, 3); None on all ranks for those of
                the previous time.
            cells: Cells of this rank; None on all ranks for those of the previous time.
            fields: Values at this rank's points by name, shape (n,) or (n, width).

        Raises:
            OSError: On all ranks, if the file cannot be written; earlier times stay as they were.
            ValueError: On all ranks, if the file has other fields.
        """
        # a new file, and one that loses times, takes its place when it is complete
        in_place = self._is_there and not self._must_cut
        target = self._path if in_place else self._path.with_name(self._path.name + ".tmp")
        try:
            step = self._append(comm, target, time, x, cells, fields)
        except OSError as failure:
            raise OSError(
                failure.errno,
                f"t = {time:g} s could not be written, earlier times are as they were: "
                f"{failure.strerror or failure}; make room or choose another path",
                str(self._path),
            ) from failure
        finally:
            if comm.rank == 0 and target != self._path:
                target.unlink(missing_ok=True)
        self._is_there, self._must_cut, self._last = True, False, step
        self.times.append(time)

    def _append(
        self,
        comm: MPI.Intracomm,
        target: Path,
        time: float,
        x: npt.NDArray[np.float64] | None,
        cells: Cells | None,
        fields: Rows,
    ) -> _Step:
        own = {f"{FIELDS}/{plain(name)}": values for name, values in fields.items()}
        if x is not None:
            own[POINTS] = x
        if cells is not None:
            own |= _topology(comm, cells)
        counts = np.array(comm.allgather([len(rows) for rows in own.values()]))
        totals = dict(zip(own, counts.sum(axis=0).tolist(), strict=True))
        before = dict(zip(own, counts[: comm.rank].sum(axis=0).tolist(), strict=True))
        step = self._next(totals)
        begins = {name: _begin(name, step) for name in own}

        def make_room() -> Any:
            if self._is_there:
                self._check(own)
            else:
                self._create(target, own, totals)
            if self._must_cut:
                shutil.copy(self._path, target)
                self._cut(target)
            ends = {name: begins[name] + totals[name] for name in own}
            return extend(target, begins, ends)

        places = comm.bcast(do_there(comm, comm.rank == 0, make_room))

        def put() -> None:
            descriptor = os.open(target, os.O_WRONLY)
            try:
                for name, rows in own.items():
                    places[name].write(descriptor, begins[name] + before[name], rows)
            finally:
                os.close(descriptor)

        do_there(comm, True, put)
        do_there(comm, comm.rank == 0, lambda: self._commit(target, time, step))
        return step

    def _next(self, totals: Mapping[str, int]) -> _Step:
        """Return the starts of a new time that appends so many rows."""
        last = self._last
        step = _Step(**vars(last))
        step.value += last.n_points
        if POINTS in totals:
            step.point += last.n_points
            step.n_points = totals[POINTS]
        if TYPES in totals:
            step.part += 1
            step.cell += last.n_cells
            step.connectivity += last.n_connectivity
            step.n_cells = totals[TYPES]
            step.n_connectivity = totals[CONNECTIVITY]
        return step

    def _create(self, path: Path, own: Rows, totals: Mapping[str, int]) -> None:
        """Create a file without times."""
        import h5py

        path.parent.mkdir(parents=True, exist_ok=True)
        content = io.BytesIO()
        with h5py.File(content, "w") as file:
            root = file.create_group(ROOT)
            root.attrs["Version"] = np.array([2, 0])
            root.attrs.create("Type", np.bytes_("UnstructuredGrid"))
            file.create_group(STEPS).attrs["NSteps"] = 0
            add_array(file, f"{STEPS}/Values", np.float64, None, 0)
            for name in PARTS:
                add_array(file, name, np.int64, None, 0)
            names = [name.removeprefix(f"{FIELDS}/") for name in own if name.startswith(FIELDS)]
            for group, linked in (
                (FIELD_OFFSETS, names),
                (PARAMETER_OFFSETS, [plain(name) for name in self._parameters]),
            ):
                first, *others = linked
                add_array(file, f"{group}/{first}", np.int64, None, 0)
                for name in others:  # one table under many names
                    file[group][name] = file[group][first]
            for name in ("PartOffsets", "NumberOfParts", "PointOffsets"):
                add_array(file, f"{STEPS}/{name}", np.int64, None, 0)
            for name in ("CellOffsets", "ConnectivityIdOffsets"):
                add_array(file, f"{STEPS}/{name}", np.int64, 1, 0)
            for name, value in self._parameters.items():
                _add_parameter(file, plain(name), value)
            for name, rows in own.items():
                width = rows.shape[1] if rows.ndim > 1 else None
                add_array(file, name, rows.dtype, width, totals[name])
        path.write_bytes(content.getvalue())

    def _check(self, own: Rows) -> None:
        """Raise ValueError unless the fields are those of the file."""
        import h5py

        with open(self._path, "rb") as stream, h5py.File(stream) as file:
            there = {name: (data.dtype, data.shape[1:]) for name, data in file[FIELDS].items()}
        prefix = f"{FIELDS}/"
        here = {
            name.removeprefix(prefix): (rows.dtype, rows.shape[1:])
            for name, rows in own.items()
            if name.startswith(prefix)
        }
        if there != here:
            raise ValueError(
                f"{self._path} has the fields {_said(there)}, not {_said(here)}: choose another "
                "name for the series"
            )

    def _commit(self, target: Path, time: float, step: _Step) -> None:
        """Make the new time visible to readers."""
        number = len(self.times)
        with edit(target, downwards=True) as file:
            sizes = (step.n_points, step.n_cells, step.n_connectivity)
            for name, size in zip(PARTS, sizes, strict=True):
                _put(file[name], step.part, size)
            _put(_any(file[FIELD_OFFSETS]), number, step.value)
            _put(_any(file[PARAMETER_OFFSETS]), number, 0)
            steps = file[STEPS]
            _put(steps["PartOffsets"], number, step.part)
            _put(steps["NumberOfParts"], number, 1)
            _put(steps["PointOffsets"], number, step.point)
            _put(steps["CellOffsets"], number, step.cell)
            _put(steps["ConnectivityIdOffsets"], number, step.connectivity)
            steps.attrs.modify("NSteps", number + 1)
            _put(steps["Values"], number, time)
        os.replace(target, self._path)

    def _read(self, end: float) -> tuple[list[float], list[str], _Step, bool]:
        """Return kept times, names of fields, the start of the last one, and if others follow."""
        if not self._path.exists():
            return [], [], _Step(), False
        with open(self._path, "rb") as stream:
            try:
                return self._find(stream, end)
            except (OSError, KeyError, IndexError, RuntimeError, TypeError, ValueError) as failure:
                raise ValueError(f"{self._path} is no series: {failure}") from failure

    @staticmethod
    def _find(stream: BinaryIO, end: float) -> tuple[list[float], list[str], _Step, bool]:
        import h5py

        with h5py.File(stream) as file:
            steps = file[STEPS]
            times = steps["Values"][: steps.attrs["NSteps"]].tolist()
            kept = sum(is_until(time, end) for time in times)
            if kept == 0:
                return [], [], _Step(), False
            last = _Step(
                part=int(steps["PartOffsets"][kept - 1]),
                point=int(steps["PointOffsets"][kept - 1]),
                cell=int(steps["CellOffsets"][kept - 1, 0]),
                connectivity=int(steps["ConnectivityIdOffsets"][kept - 1, 0]),
                value=int(_any(file[FIELD_OFFSETS])[kept - 1]),
            )
            sizes = [int(file[name][last.part]) for name in PARTS]
            last.n_points, last.n_cells, last.n_connectivity = sizes
            return times[:kept], list(file[FIELDS]), last, kept < len(times)

    def _cut(self, path: Path) -> None:
        """Remove later times from the tables."""
        with edit(path) as file:
            file[STEPS].attrs.modify("NSteps", len(self.times))
            tables = [data for data in file[STEPS].values() if hasattr(data, "resize")]
            for table in (*tables, _any(file[FIELD_OFFSETS]), _any(file[PARAMETER_OFFSETS])):
                table.resize(len(self.times), axis=0)
            for name in PARTS:
                file[name].resize(self._last.part + 1, axis=0)


def _topology(comm: MPI.Intracomm, cells: Cells) -> dict[str, npt.NDArray]:
    """Return VTK's arrays of cells for this rank. Collective."""
    n, n_nodes = cells.nodes.shape
    counts = comm.allgather(n)
    begin = sum(counts[: comm.rank])
    is_last = comm.rank == comm.size - 1
    offsets = n_nodes * np.arange(begin, begin + n + is_last, dtype=np.int64)
    return {
        CONNECTIVITY: cells.nodes.ravel(),
        OFFSETS: offsets,
        TYPES: np.full(n, cells.kind, np.uint8),
    }


def _begin(name: str, step: _Step) -> int:
    """Return the row of an array at which a time begins."""
    return {
        POINTS: step.point,
        CONNECTIVITY: step.connectivity,
        OFFSETS: step.cell + step.part,  # each part has one more offset than cells
        TYPES: step.cell,
    }.get(name, step.value)


def _put(table: Any, number: int, value: float) -> None:
    """Make a row the last one of a table."""
    table.resize(number + 1, axis=0)
    table[number] = value


def _any(group: Any) -> Any:
    """Return the table for which all names of a group stand."""
    return next(iter(group.values()))


def _add_parameter(file: Any, name: str, value: Any) -> None:
    import h5py

    if isinstance(value, bool | int | float):
        file[f"{ROOT}/FieldData/{name}"] = [
            float(value) if isinstance(value, float) else int(value)
        ]
    else:  # VTK cannot read texts marked as UTF-8, but shows unmarked ones correctly
        text = h5py.string_dtype("ascii")
        file.create_dataset(f"{ROOT}/FieldData/{name}", data=[str(value).encode()], dtype=text)


def plain(name: str) -> str:
    """Replace characters that HDF5 and VTK take for paths, as VTK's own writer does."""
    return name.replace("/", "_").replace(".", "_")


def _said(fields: Mapping[str, tuple[np.dtype, tuple[int, ...]]]) -> str:
    shapes = {name: shape for name, (_, shape) in fields.items()}
    return ", ".join(f"{name} {list(shape)}" if shape else name for name, shape in shapes.items())
