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
    """Combine pictures into an animation of 10 frames per second that repeats forever.

    Collective; rank 0 does the work. A notebook shows the animation if the call is the last line
    of a cell.

    Args:
        path: File to write, ``.gif``.
        frames: Files of pictures of the same size, in order, or results of `io.picture`.
        comm: Communicator of the mesh.

    Returns:
        The animation, which is printed as its path.

    Raises:
        ValueError: On all ranks, without frames, for frames that differ in size, or for a file
            that is not ``.gif``.
        OSError: On all ranks, for frames that cannot be read or a file that cannot be written.
    """
    do_there(comm, comm.rank == 0, lambda: _write(Path(path), frames))
    return Picture(path)


def _write(path: Path, frames: Sequence[str | PathLike[str]]) -> None:
    from PIL import Image

    if not frames or path.suffix != ".gif":
        raise ValueError(f"{path} needs the suffix .gif and at least one frame, not {len(frames)}")
    images = [Image.open(frame).convert("P", palette=Image.Palette.ADAPTIVE) for frame in frames]
    size = images[0].size
    if any(image.size != size for image in images):
        raise ValueError("all frames must have the same size: give all pictures the same bounds")
    path.parent.mkdir(parents=True, exist_ok=True)
    images[0].save(
        path,
        save_all=True,
        append_images=images[1:],
        duration=100,  # ms per frame
        loop=0,
    )
