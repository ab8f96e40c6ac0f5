# SPDX-License-Identifier: MIT
"""HDF5 files without their numbers, which ranks then write in parallel by plain POSIX calls.

HDF5 itself thus needs no MPI, no rank holds the data of others, and a full disk gives an error of
the operating system. HDF5 could not close a file that it failed to write, and would crash later.
"""

from __future__ import annotations

import io
import os
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

_PAGE = 4096
# A system call writes 2 GB at most
_AT_ONCE = 1 << 30


class Pages(io.RawIOBase):
    """A file in memory that stores only the pages that are written.

    HDF5 writes its tables to it, before, between and behind the places of the datasets.
    """

    def __init__(self) -> None:
        """Create an empty file."""
        self._pages: dict[int, bytearray] = {}
        self._size = self._at = 0

    def seekable(self) -> bool:
        """Return True."""
        return True

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Go to a position, counted from the beginning, from here or from the end."""
        self._at = (0, self._at, self._size)[whence] + offset
        return self._at

    def readinto(self, buffer: Any) -> int:
        """Read as much as fits into the buffer, up to the end."""
        view = memoryview(buffer).cast("B")
        count = max(0, min(len(view), self._size - self._at))
        for place, number, within, length in self._runs(count):
            page = self._pages.get(number, bytes(_PAGE))
            view[place : place + length] = page[within : within + length]
        self._at += count
        return count

    def write(self, data: Any) -> int:
        """Write all of the data."""
        view = memoryview(data).cast("B")
        for place, number, within, length in self._runs(len(view)):
            page = self._pages.setdefault(number, bytearray(_PAGE))
            page[within : within + length] = view[place : place + length]
        self._at += len(view)
        self._size = max(self._size, self._at)
        return len(view)

    def truncate(self, size: int | None = None) -> int:
        """Set the length of the file."""
        self._size = self._at if size is None else size
        return self._size

    def copy_to(self, path: Path) -> None:
        """Write the pages to a file of the same length, with holes elsewhere.

        Raises:
            OSError: If it cannot be written.
        """
        with open(path, "wb") as stream:
            stream.truncate(self._size)
            for number, page in sorted(self._pages.items()):
                start = number * _PAGE
                write_at(stream.fileno(), start, page[: max(0, self._size - start)])

    def _runs(self, count: int) -> list[tuple[int, int, int, int]]:
        """Return the next bytes page by page: position among them, page, position in it, number."""
        runs, at = [], self._at
        while at < self._at + count:
            number, within = divmod(at, _PAGE)
            length = min(_PAGE - within, self._at + count - at)
            runs.append((at - self._at, number, within, length))
            at += length
        return runs


def add_dataset(group: Any, name: str, shape: tuple[int, ...], dtype: npt.DTypeLike) -> int:
    """Add a dataset whose numbers are written elsewhere, row by row.

    Args:
        group: Group of h5py.
        name: Name of the dataset.
        shape: Shape of the dataset.
        dtype: Type of its numbers.

    Returns:
        Start of the numbers in the file in bytes; 0 if there are none.
    """
    import h5py

    layout = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    layout.set_layout(h5py.h5d.CONTIGUOUS)
    layout.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
    layout.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
    space, kind = h5py.h5s.create_simple(shape), h5py.h5t.py_create(np.dtype(dtype))
    dataset = h5py.h5d.create(group.id, name.encode(), kind, space, dcpl=layout)
    return dataset.get_offset() or 0


def write_at(descriptor: int, start: int, data: Any) -> None:
    """Write bytes or an array completely, to a position of an open file.

    Raises:
        OSError: If they cannot be written.
    """
    view = memoryview(data)
    view = view.cast("B") if view.nbytes else memoryview(b"")
    while len(view):
        written = os.pwrite(descriptor, view[:_AT_ONCE], start)
        view, start = view[written:], start + written
