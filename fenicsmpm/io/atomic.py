# SPDX-License-Identifier: MIT
"""Files that are replaced as a whole or not at all."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from mpi4py import MPI

from fenicsmpm.points.agreement import do_there


def replace(path: Path, content: bytes | memoryview) -> None:
    """Let a file with this content take the place of another one, or nothing; see ``replacing``.

    Args:
        path: file to be replaced or made.
        content: of the new file.

    Raises:
        OSError: names the file; it is as it was.
    """
    try:
        with replacing(path) as stream:
            stream.write(content)
    except OSError as failure:
        raise OSError(
            failure.errno,
            f"it could not be written, an older one is as it was: {failure.strerror}; make room "
            "or choose another path",
            str(path),
        ) from failure


@contextmanager
def replacing(path: Path) -> Iterator[BinaryIO]:
    """Write a file beside another one and let it take its place at the end.

    Whoever reads ``path`` finds the old file or the new one, also if the program is killed or the
    disk is full. After an error the unfinished file is removed; one that a killed program left is
    overwritten by the next.

    Args:
        path: file to be replaced or made; missing directories are made.

    Yields:
        The unfinished file, open for writing.

    Raises:
        OSError: if it cannot be written; ``path`` is as it was.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_name(path.name + ".tmp")
    try:
        with open(unfinished, "wb") as stream:
            yield stream
            stream.flush()
            os.fsync(stream.fileno())
        os.replace(unfinished, path)
    except BaseException:
        unfinished.unlink(missing_ok=True)
        raise


@contextmanager
def replacing_together(comm: MPI.Intracomm, path: Path) -> Iterator[Path]:
    """Have all ranks write a file beside another one that takes its place at the end (collective).

    As ``replacing``; ranks may see the same file only. They agree on errors before they leave the
    block, as after ``do_there``.

    Args:
        comm: communicator of the ranks.
        path: file to be replaced or made; missing directories are made.

    Yields:
        The unfinished file, which rank 0 is to make.

    Raises:
        OSError: on all ranks, if the file cannot be made; ``path`` is as it was.
    """
    unfinished = path.with_name(path.name + ".tmp")

    def make() -> None:
        path.parent.mkdir(parents=True, exist_ok=True)

    def finish() -> None:
        os.replace(unfinished, path)

    try:
        do_there(comm, comm.rank == 0, make)
        yield unfinished
        do_there(comm, comm.rank == 0, finish)
    except BaseException:
        if comm.rank == 0:
            with suppress(OSError):
                unfinished.unlink()
        raise
