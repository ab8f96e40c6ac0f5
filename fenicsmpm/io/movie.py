# SPDX-License-Identifier: MIT
"""Animations from pictures."""

from __future__ import annotations

from collections.abc import Sequence
from os import PathLike
from pathlib import Path

from mpi4py import MPI

from fenicsmpm._display import Picture
from fenicsmpm.points.agreement import do_there


def animate(
    path: str | Path,
    frames: Sequence[str | PathLike[str]],
    *,
    comm: MPI.Comm = MPI.COMM_WORLD,
) -> Picture:
    """Put pictures together to an animation, 10 a second, for ever (collective, rank 0 works).

    A notebook shows the animation if the call is the last line of a cell.

    Args:
        path: file to write, ``.gif``.
        frames: files of pictures of the same size, in order, or what `io.picture` returned.
        comm: communicator of the mesh.

    Returns:
        The animation, which is printed as its path.

    Raises:
        ValueError: on all ranks, without any frames, or for a file that is not ``.gif``.
        OSError: on all ranks, for frames that cannot be read or a file that cannot be written.
    """
    do_there(comm, comm.rank == 0, lambda: _write(Path(path), frames))
    return Picture(path)


def _write(path: Path, frames: Sequence[str | PathLike[str]]) -> None:
    from PIL import Image

    if not frames or path.suffix != ".gif":
        raise ValueError(f"{len(frames)} frames for {path}: a .gif needs at least one")
    images = [Image.open(frame).convert("P", palette=Image.Palette.ADAPTIVE) for frame in frames]
    size = images[0].size
    if any(image.size != size for image in images):
        raise ValueError("the frames differ in size: give all pictures the same bounds")
    path.parent.mkdir(parents=True, exist_ok=True)
    images[0].save(
        path,
        save_all=True,
        append_images=images[1:],
        duration=100,  # ms a frame
        loop=0,
    )
