# SPDX-License-Identifier: MIT
"""Layout and checksums of checkpoint files."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import fenicsmpm
from fenicsmpm.io.skeleton import Pages, add_dataset, write_at
from fenicsmpm.simulation.state import Arrays, PointSet

FORMAT = 3

# Number of rows per update of a checksum
_BLOCK = 1 << 14

Span = tuple[int, int]  # first row, and one past the last


class CheckpointError(ValueError):
    """Error for files that are no checkpoint, or one of another simulation."""


@dataclass
class Contents:
    """Content of a checkpoint, except the rows of points, which follow rank by rank.

    Attributes:
        header: Data that tell whether it fits a simulation, and the time.
        memory: Memory of the time scheme.
        parameters: Choices of the script as texts.
        next_ids: Next id of each point set.
        counts: Number of points on each rank, for each point set.
        fields: Type and shape of the values at one point by name, for each point set.
        digests: Checksum of the rows of each rank.
    """

    header: dict[str, Any]
    memory: dict[str, float]
    parameters: dict[str, str]
    next_ids: list[int]
    counts: list[list[int]]
    fields: list[dict[str, tuple[str, tuple[int, ...]]]]
    digests: list[str]

    def spans(self, rank: int) -> list[Span]:
        """Return the rows that a rank has saved, for each point set."""
        return [(sum(counts[:rank]), sum(counts[: rank + 1])) for counts in self.counts]

    @property
    def checksum(self) -> str:
        """Return the checksum of everything except the layout, which does not affect the state."""
        result = hashlib.sha256()
        header = {name: value for name, value in self.header.items() if name != "layout"}
        for named in (header, self.memory, self.parameters, *self.fields):
            result.update(repr(sorted(named.items())).encode())
        result.update(repr((self.next_ids, self.counts, self.digests)).encode())
        return result.hexdigest()


def digest(sets: Sequence[Mapping[str, Any]], spans: Sequence[Span]) -> str:
    """Return a checksum of some rows of the arrays of point sets, or of datasets in a file.

    Args:
        sets: Arrays by name, for each point set.
        spans: Rows, for each point set.
    """
    result = hashlib.sha256()
    for arrays, (first, end) in zip(sets, spans, strict=True):
        for name in sorted(arrays):
            result.update(f"{name} {end - first}".encode())
            for start in range(first, end, _BLOCK):
                result.update(np.ascontiguousarray(arrays[name][start : min(start + _BLOCK, end)]))
    return result.hexdigest()


def write_skeleton(path: Path, contents: Contents) -> list[dict[str, int]]:
    """Create the file with room for the rows of all points.

    Args:
        path: Path of the file.
        contents: Everything except the rows.

    Returns:
        Start of the rows of each array in bytes, for each point set.

    Raises:
        OSError: If the file cannot be written.
    """
    import h5py

    pages, places = Pages(), []
    with h5py.File(pages, "w") as file:
        file.attrs.update({**contents.header, "checksum": contents.checksum})
        file.attrs["digests"] = contents.digests
        file.create_group("memory").attrs.update(contents.memory)
        file.create_group("parameters").attrs.update(contents.parameters)
        for k, fields in enumerate(contents.fields):
            group, counts = file.create_group(f"points/{k}"), contents.counts[k]
            group.attrs.update(next_id=contents.next_ids[k], counts=counts)
            places.append(
                {
                    name: add_dataset(group, name, (sum(counts), *shape), kind)
                    for name, (kind, shape) in fields.items()
                }
            )
    pages.copy_to(path)
    return places


def write_rows(
    path: Path,
    places: Sequence[Mapping[str, int]],
    contents: Contents,
    sets: Sequence[PointSet],
    rank: int,
) -> None:
    """Write the rows of a rank to their places.

    Args:
        path: Path of the file made by ``write_skeleton``.
        places: Start of the rows of all ranks.
        contents: Everything except the rows.
        sets: Point sets of the rank.
        rank: Number of the rank.

    Raises:
        OSError: If the rows cannot be written.
    """
    with open(path, "r+b") as stream:
        for points, at, (first, _) in zip(sets, places, contents.spans(rank), strict=True):
            for name, array in points.arrays.items():
                size = array.dtype.itemsize * int(np.prod(array.shape[1:]))
                write_at(stream.fileno(), at[name] + first * size, np.ascontiguousarray(array))
        os.fsync(stream.fileno())


def read_contents(path: Path, names: Sequence[str]) -> Contents:
    """Read everything except the rows.

    Args:
        path: Path of the file.
        names: Names in the header.

    Raises:
        CheckpointError: If the file is no checkpoint of this format, or is damaged.
        OSError: If it cannot be read.
    """
    with _opened(path) as file:
        found = file.attrs.get("format")
        if found is None:
            raise CheckpointError(f"{path} is an HDF5 file, but no checkpoint of fenicsmpm")
        if found != FORMAT:
            raise CheckpointError(
                f"checkpoint {path} has format {found} (fenicsmpm {file.attrs['fenicsmpm']}), but "
                f"fenicsmpm {fenicsmpm.__version__} reads format {FORMAT}: restore it with the "
                "version that saved it"
            )
        groups = [file[f"points/{k}"] for k in range(len(file["points"]))]
        contents = Contents(
            {name: _plain(file.attrs[name]) for name in names},
            {name: float(value) for name, value in file["memory"].attrs.items()},
            {name: str(value) for name, value in file["parameters"].attrs.items()},
            [int(group.attrs["next_id"]) for group in groups],
            [_plain(group.attrs["counts"]) for group in groups],
            [{n: (data.dtype.str, data.shape[1:]) for n, data in g.items()} for g in groups],
            _plain(file.attrs["digests"]),
        )
        for group, counts in zip(groups, contents.counts, strict=True):
            for name, data in group.items():
                if len(data) != sum(counts):
                    raise CheckpointError(
                        f"checkpoint {path} is damaged: it has {len(data)} values of {name!r} for "
                        f"{sum(counts)} points; restore another one"
                    )
        if file.attrs["checksum"] != contents.checksum:
            raise _damaged(path)
    return contents


def read_rows(path: Path, contents: Contents, same: bool, rank: int, size: int) -> list[Arrays]:
    """Read the rows that a rank had, or an equal share of all rows, for each point set.

    All ranks together check the rows that each rank has saved.

    Args:
        path: Path of the file.
        contents: Everything else in the file.
        same: Whether this rank gets the rows of the rank with the same number.
        rank: Number of this rank.
        size: Number of ranks.

    Raises:
        CheckpointError: If the file is damaged.
        OSError: If it cannot be read.
    """
    with _opened(path) as file:
        groups = [file[f"points/{k}"] for k in range(len(contents.fields))]
        for saved in range(rank, len(contents.digests), size):
            if digest(groups, contents.spans(saved)) != contents.digests[saved]:
                raise _damaged(path)
        total = [sum(counts) for counts in contents.counts]
        shares = [(n * rank // size, n * (rank + 1) // size) for n in total]
        return [
            {name: data[first:end] for name, data in group.items()}
            for group, (first, end) in zip(
                groups, contents.spans(rank) if same else shares, strict=True
            )
        ]


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """Open a file for reading; a file that HDF5 cannot read is no checkpoint."""
    import h5py

    with open(path, "rb") as stream:
        try:
            with h5py.File(stream, "r") as file:
                yield file
        except CheckpointError:
            raise
        except (OSError, KeyError, RuntimeError, TypeError, ValueError) as error:
            raise CheckpointError(
                f"{path} is no checkpoint or is incomplete: {error}; restore another one"
            ) from error


def _damaged(path: Path) -> CheckpointError:
    return CheckpointError(
        f"checkpoint {path} is damaged: its checksum is wrong; restore another one"
    )


def _plain(value: Any) -> Any:
    """Convert numpy's numbers, texts and arrays to those of Python."""
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else value
