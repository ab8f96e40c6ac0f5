# SPDX-License-Identifier: MIT
"""Arrays in an HDF5 file that all ranks append to, without parallel HDF5.

Rank 0 extends the arrays and tells where their new rows are in the file. Each rank writes its own
rows there by plain file operations. HDF5 itself never writes to the disk, for two reasons: it
crashes if a write fails, and it does not define the order in which changes reach the disk.
"""

from __future__ import annotations

import io
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt

from fenicsmpm.io.skeleton import write_at

LEAST_CHUNK, LARGEST_CHUNK = 1024, 2**22  # rows; HDF5 does not allow chunks of 4 GB


@dataclass(frozen=True)
class Place:
    """Place of the rows of an array in the file.

    Attributes:
        dtype: Type of the numbers in the file.
        chunk: Number of rows in a chunk.
        first: Number of the first chunk in `addresses`.
        addresses: Start of the chunks in the file in bytes.
    """

    dtype: np.dtype
    chunk: int
    first: int
    addresses: list[int]

    def write(self, descriptor: int, begin: int, rows: npt.NDArray) -> None:
        """Write rows to their place.

        Args:
            descriptor: Descriptor of the file, open for writing.
            begin: Row of the array to which the first of these rows belongs.
            rows: Rows, shape (n,) or (n, width).

        Raises:
            OSError: If they cannot be written.
        """
        rows = np.ascontiguousarray(rows, self.dtype)
        done = 0
        while done < len(rows):
            number, offset = divmod(begin + done, self.chunk)
            part = rows[done : done + self.chunk - offset]
            address = self.addresses[number - self.first] + offset * rows[:1].nbytes
            write_at(descriptor, address, part)
            done += len(part)


def add_array(group: Any, name: str, dtype: npt.DTypeLike, width: int | None, rows: int) -> None:
    """Create an array without rows.

    Args:
        group: Group of h5py for the array.
        name: Name of the array.
        dtype: Type of its numbers.
        width: Numbers in a row; None for an array of one dimension.
        rows: Approximate number of rows that are appended at a time.
    """
    import h5py

    own = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    own.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)  # a chunk has its place before it is written
    own.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
    row = () if width is None else (width,)
    chunk = min(max(rows, LEAST_CHUNK), LARGEST_CHUNK)
    group.create_dataset(
        name, (0, *row), dtype, chunks=(chunk, *row), maxshape=(None, *row), dcpl=own
    )


def extend(path: Path, begins: Mapping[str, int], ends: Mapping[str, int]) -> dict[str, Place]:
    """Extend arrays to new lengths. Not collective.

    Args:
        path: The file.
        begins: Number of rows to keep, for each array.
        ends: New number of rows, for each array.

    Returns:
        Places of the new rows.

    Raises:
        OSError: If there is no room; the file stays as it was.
    """
    places = {}
    with edit(path) as file:
        for name, end in ends.items():
            array = file[name]
            array.resize(end, axis=0)
            chunk, *_ = array.chunks
            first = begins[name] // chunk
            corners = [(k * chunk, *[0] * (array.ndim - 1)) for k in range(first, -(-end // chunk))]
            addresses = [array.id.get_chunk_info_by_coord(c).byte_offset for c in corners]
            places[name] = Place(array.dtype, chunk, first, addresses)
    return places


@contextmanager
def edit(path: Path, downwards: bool = False) -> Iterator[Any]:
    """Open a file with h5py; changes reach the disk at the end.

    Args:
        path: The file.
        downwards: Whether changes at low addresses are written last. By default they are written
            first, which is right if arrays get new chunks. HDF5 keeps the chunks of an array in a
            tree. If a node is full, half of its entries move to a new node. The node above must
            point there before the entries are removed from the old node. It has a lower address
            as long as there are two levels (2000 chunks).

    Yields:
        The file of h5py. After an exception nothing is changed.

    Raises:
        OSError: If there is no room; the file stays as it was.
    """
    import h5py

    with open(path, "r+b", buffering=0) as disk:
        changes = _Changes(disk)
        with h5py.File(changes, "r+") as file:
            yield file
        changes.save(downwards)


class _Changes(io.RawIOBase):
    """A file as HDF5 sees it: the content of the disk, overlaid with the changes.

    Additions at the end are saved first, as nothing points to them yet. Changes that are close to
    each other are one write, so that either all or none of them reach the disk.
    """

    PAGE = 4096

    def __init__(self, disk: BinaryIO) -> None:
        self._disk, self._at = disk, 0
        self._size = self._size_on_disk = os.fstat(disk.fileno()).st_size
        self._pages: dict[int, bytearray] = {}
        self._changed: list[tuple[int, int]] = []

    def readable(self) -> bool:
        return True

    def writable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        self._at = offset + {os.SEEK_SET: 0, os.SEEK_CUR: self._at, os.SEEK_END: self._size}[whence]
        return self._at

    def tell(self) -> int:
        return self._at

    def readinto(self, buffer: Any) -> int:
        view = memoryview(buffer).cast("B")
        for part, page, offset in self._parts(len(view)):
            view[part] = page[offset : offset + part.stop - part.start]
        return len(view)

    def write(self, data: Any) -> int:
        view = memoryview(data).cast("B")
        begin = self._at
        for part, page, offset in self._parts(len(view)):
            page[offset : offset + part.stop - part.start] = view[part]
        self._changed.append((begin, self._at))
        self._size = max(self._size, self._at)
        return len(view)

    def truncate(self, size: int | None = None) -> int:
        self._size = self._at if size is None else size
        return self._size

    def save(self, downwards: bool) -> None:
        """Write the changes to the disk; see ``edit``."""
        descriptor = self._disk.fileno()
        more = self._size - self._size_on_disk
        if more > 0:
            try:
                os.posix_fallocate(descriptor, self._size_on_disk, more)
            except OSError:
                os.ftruncate(descriptor, self._size_on_disk)
                raise
        old: list[tuple[int, int]] = []
        new: list[tuple[int, int]] = []
        for begin, end in sorted(self._changed):
            some = new if begin >= self._size_on_disk else old
            if some and begin <= some[-1][1] + self.PAGE:
                begin, end = some[-1][0], max(end, some.pop()[1])
            some.append((begin, end))
        for begin, end in (*new, *(reversed(old) if downwards else old)):
            self._at, content = begin, bytearray(end - begin)
            self.readinto(content)
            write_at(descriptor, begin, content)

    def _parts(self, size: int) -> Iterator[tuple[slice, bytearray, int]]:
        """Return parts of the next `size` bytes in one page each: slice, page, offset."""
        done = 0
        while done < size:
            number, offset = divmod(self._at, self.PAGE)
            if number not in self._pages:
                found = os.pread(self._disk.fileno(), self.PAGE, number * self.PAGE)
                self._pages[number] = bytearray(found.ljust(self.PAGE, b"\0"))
            n = min(size - done, self.PAGE - offset)
            yield slice(done, done + n), self._pages[number], offset
            done, self._at = done + n, self._at + n
