# SPDX-License-Identifier: MIT
"""Files that are replaced completely or not at all."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from mpi4py import MPI

from fenicsmpm.points.agreement import do_there


def replace(path: Path, content: bytes | memoryview) -> None:
    """Replace a file by one with this content, completely or not at all; see ``replacing``.

    Args:
        path: File to replace or create.
        content: Content of the new file.

    Raises:
        OSError: If the file cannot be written. The error names the file, which stays as it was.
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
    """Write a temporary file beside another one, and replace that one at the end.

    Readers of ``path`` find either the old file or the new one, even if the program is killed or
    the disk is full. After an error the temporary file is removed. If a killed program leaves one,
    the next write overwrites it.

    Args:
        path: File to replace or create; missing directories are created.

    Yields:
        The temporary file, open for writing.

    Raises:
        OSError: If it cannot be written; ``path`` stays as it was.
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
    """Let all ranks write a temporary file that replaces another one at the end. Collective.

    As for ``replacing``, but the ranks need a common file system. They must agree on errors before
    they leave the block, for example by ``do_there``.

    Args:
        comm: Communicator of the ranks.
        path: File to replace or create; missing directories are created.

    Yields:
        Path of the temporary file, which rank 0 must create.

    Raises:
        OSError: On all ranks, if the file cannot be created; ``path`` stays as it was.
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
