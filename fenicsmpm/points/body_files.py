# SPDX-License-Identifier: MIT
"""Bodies from files: surfaces, images, point clouds.

All functions are collective. Rank 0 reads the file and sends its content to the other ranks, so
the file is needed on one machine only, and errors are raised on all ranks. pyvista reads files of
VTK and similar formats; it is imported only when needed.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
from dolfinx.mesh import Mesh

from fenicsmpm.points.agreement import do_there
from fenicsmpm.points.material_points import MaterialPoints
from fenicsmpm.shapes import Solid, surface

if TYPE_CHECKING:  # the import takes a second
    import pyvista

T = TypeVar("T")

_SURFACES = (".stl", ".ply", ".vtk", ".vtp", ".vtu", ".obj")
_VTK_IMAGES = (".vti", ".vtk", ".mha", ".mhd", ".nrrd")
_PICTURES = (".png", ".tif", ".tiff", ".bmp", ".jpg", ".jpeg")
_VTK_CLOUDS = (".vtp", ".vtk", ".vtu", ".ply")

# Vertices closer than this fraction of the surface's size are merged: STL files have float32.
_SAME = 1e-7


class Image(NamedTuple):
    """Gray values of an image file, for `fenicsmpm.shapes.mask` and `contour`.

    Attributes:
        values: Gray values, first coordinate first, shape (nx, ny) or (nx, ny, nz).
        spacing: Size of a voxel in the unit of the file, shape (d,); 1 if the file has none.
        origin: Lower corner of the first voxel, shape (d,); 0 if the file has none.
    """

    values: npt.NDArray[Any]
    spacing: npt.NDArray[np.float64]
    origin: npt.NDArray[np.float64]


def on_rank_0(path: Path | str, comm: MPI.Intracomm, read: Callable[[Path], T]) -> T | None:
    """Call a function that reads a file on rank 0 and return its result there. Collective.

    Args:
        path: The file.
        comm: Communicator of the ranks that hear of errors.
        read: Function that reads the file.

    Returns:
        What the function returned on rank 0, None on the other ranks.

    Raises:
        FileNotFoundError: On all ranks, if there is no such file. Errors of the function are
            raised on all ranks, too.
    """
    file = Path(path)

    def action() -> T:
        if not file.is_file():
            raise FileNotFoundError(f"no file {file} (in {Path.cwd()})")
        return read(file)

    return do_there(comm, comm.rank == 0, action)


def read_solid(path: Path | str, comm: MPI.Intracomm = MPI.COMM_WORLD) -> Solid:
    """Read a closed surface from a .stl, .ply, .vtk, .vtp, .vtu or .obj file and return its solid.

    Polygons are cut into triangles. Of a mesh of volumes in a .vtu or .vtk file, the surface is
    taken. Vertices closer than 1e-7 of the size of the surface are merged. Lengths keep the unit of
    the file; `Solid.transformed` scales them.

    Args:
        path: The file.
        comm: Communicator of the ranks that get the solid.

    Returns:
        The solid, on all ranks.

    Raises:
        OpenSurfaceError: If the surface has holes.
        FileNotFoundError: If there is no such file.
        ValueError: For other types of files, files without triangles, and surfaces that
            `fenicsmpm.shapes.surface` refuses.
        ImportError: If pyvista is not installed.
    """
    vertices, triangles = comm.bcast(on_rank_0(path, comm, _triangles))
    return surface(vertices, triangles)


def _triangles(file: Path) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.int64]]:
    """Return vertices (m, 3) and triangles (n, 3)."""
    data: Any = _vtk_data(file, _SURFACES, "a surface")
    if not hasattr(data, "extract_surface"):
        raise ValueError(f"{file}: holds {type(data).__name__} instead of a surface")
    if not hasattr(data, "faces"):  # volumes
        data = data.extract_surface()
    vertices = np.asarray(data.points, dtype=np.float64)
    if data.n_cells:
        data = data.triangulate().clean(tolerance=_SAME)
        vertices = np.asarray(data.points, dtype=np.float64)
    triangles = np.asarray(data.faces, dtype=np.int64).reshape(-1, 4)[:, 1:]
    if not len(triangles):
        raise ValueError(f"{file}: contains no triangles, or the file is damaged")
    return vertices, triangles


def read_image(path: Path | str, comm: MPI.Intracomm = MPI.COMM_WORLD) -> Image:
    """Read gray values from an image file: .npy, .png and the like, .vti, .vtk, .mha or .nrrd.

    In pictures the first coordinate points to the right and the second one upwards. Colours are
    averaged. NumPy arrays have the first coordinate first. In files of VTK the active scalar field
    of cells or points is read, where a point is the centre of a voxel.

    Args:
        path: The file.
        comm: Communicator of the ranks that get the image.

    Returns:
        The image, on all ranks.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: For other types of files, and arrays that are no image in 2 or 3 dimensions.
        ImportError: For files of VTK, if pyvista is not installed.
    """
    image: Image = comm.bcast(on_rank_0(path, comm, _image))
    return image


def _image(file: Path) -> Image:
    kind = file.suffix.lower()
    if kind == ".npy":
        values = np.load(file)
    elif kind in _PICTURES:
        from matplotlib.image import imread

        rows = np.asarray(imread(file))  # from top to bottom, with 1 to 4 channels
        if rows.ndim == 3:
            rows = rows[..., :3].mean(axis=2) if rows.shape[2] > 2 else rows[..., 0]
        values = np.ascontiguousarray(rows[::-1].T)
    else:
        return _vtk_image(_vtk_data(file, _VTK_IMAGES, "an image", ".npy", *_PICTURES), file)
    if values.ndim not in (2, 3):
        raise ValueError(f"{file}: an image must have 2 or 3 dimensions, not shape {values.shape}")
    return Image(values, np.ones(values.ndim), np.zeros(values.ndim))


def _vtk_image(data: Any, file: Path) -> Image:
    """Return VTK's image data, as a 2D image if there is one layer only."""
    if not hasattr(data, "spacing") or not hasattr(data, "dimensions"):
        raise ValueError(f"{file}: holds {type(data).__name__} instead of an image")
    spacing, origin = np.array(data.spacing), np.array(data.origin)
    # Of several arrays, take the active one.
    name = data.active_scalars_name
    arrays = data.cell_data if len(data.cell_data) else data.point_data
    if name not in arrays or arrays[name].ndim != 1:
        raise ValueError(
            f"{file}: an image needs one active array of scalars, but has {list(arrays.keys())}"
        )
    of_cells = len(data.cell_data) > 0
    shape = np.array(data.dimensions)
    if of_cells:
        shape = np.maximum(shape - 1, 1)
    else:
        origin = origin - 0.5 * spacing
    values = np.asarray(arrays[name]).reshape(shape, order="F")
    if shape[2] == 1:
        return Image(np.ascontiguousarray(values[:, :, 0]), spacing[:2], origin[:2])
    return Image(np.ascontiguousarray(values), spacing, origin)


def read_cloud(
    mesh: Mesh, path: Path | str, volume: str = "volume", tag: int = 0
) -> MaterialPoints:
    """Read points with volumes from a .csv, .npz, .vtp, .vtk, .vtu or .ply file.

    The first line of a .csv file names its columns: "x", "y", in 3D "z", the volume, and others. A
    .npz file has positions "x" of shape (n, d) and arrays of shape (n, ...). Files of VTK have
    points and point data. All other arrays become fields, but for "id", which is ignored, and
    "tag", which gives the tags. Points written by `fenicsmpm.io.write` can thus be read with
    ``volume="weight"``.

    Args:
        mesh: Background mesh.
        path: The file.
        volume: Name of the array of volumes in m^d, in 2D per unit thickness.
        tag: Tag of the points, unless the file has tags.

    Returns:
        Points with ids in the order of the file.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: For other types of files, missing positions or volumes, arrays of other lengths,
            volumes that are not positive, and in 2D third coordinates other than 0.
        PointsOutsideError: If some point is outside of the mesh.
        ImportError: For files of VTK, if pyvista is not installed.
    """
    dim, comm = mesh.geometry.dim, mesh.comm
    arrays = on_rank_0(path, comm, lambda file: _cloud(file, dim, volume)) or {}
    none = comm.bcast({name: array[:0] for name, array in arrays.items()})
    arrays = arrays or none
    x, weight = arrays.pop("x"), arrays.pop(volume)
    arrays.pop("id", None)
    tags = arrays.pop("tag", tag)
    return MaterialPoints(mesh, x, weight, tag=tags, fields=arrays)


def _cloud(file: Path, dim: int, volume: str) -> dict[str, npt.NDArray[np.float64]]:
    """Return the arrays of a cloud: "x" of shape (n, dim), the volume, fields."""
    kind = file.suffix.lower()
    if kind == ".npz":
        with np.load(file) as stored:
            arrays: dict[str, npt.NDArray] = dict(stored)
    elif kind == ".csv":
        arrays = _columns(file)
    else:
        data = _vtk_data(file, _VTK_CLOUDS, "a cloud", ".csv", ".npz")
        arrays = {name: np.asarray(data.point_data[name]) for name in data.point_data}
        arrays["x"] = np.asarray(data.points)
    if "x" not in arrays or volume not in arrays:
        raise ValueError(
            f"{file}: a cloud needs 'x' and '{volume}', but has {', '.join(arrays) or 'nothing'}"
        )
    x = np.asarray(arrays["x"], dtype=np.float64)
    if x.ndim != 2 or x.shape[1] < dim or np.any(x[:, dim:] != 0.0):
        raise ValueError(
            f"{file}: positions of shape {x.shape} do not fit a mesh of {dim} dimensions"
            + (", or their third coordinates are not 0" if x.ndim == 2 else "")
        )
    return {name: np.asarray(a, dtype=np.float64) for name, a in arrays.items()} | {
        "x": x[:, :dim].copy()
    }


def _columns(file: Path) -> dict[str, npt.NDArray]:
    """Return the columns of a .csv file by name, with the coordinates as "x"."""
    names = [name.strip() for name in file.read_text().partition("\n")[0].split(",")]
    table = np.loadtxt(file, delimiter=",", skiprows=1, ndmin=2)
    if table.shape[1] != len(names):
        raise ValueError(
            f"{file}: the first line has {len(names)} names for {table.shape[1]} columns of numbers"
        )
    columns: dict[str, npt.NDArray] = {name: table[:, i] for i, name in enumerate(names)}
    places = [columns.pop(name) for name in ("x", "y", "z") if name in columns]
    return columns | {"x": np.stack(places, axis=1)} if places else columns


def _vtk_data(file: Path, kinds: tuple[str, ...], what: str, *others: str) -> pyvista.DataSet:
    """Read a file with pyvista, if its name ends in one of the given kinds."""
    if file.suffix.lower() not in kinds:
        raise ValueError(
            f"{file}: {what} is read from {', '.join([*others, *kinds])} files, "
            f"not from '{file.suffix}'"
        )
    import pyvista

    return pyvista.read(file)
