# SPDX-License-Identifier: MIT
"""Bodies from files: surfaces, images, point clouds.

Rank 0 reads and sends what it has read to the others: a file is needed on one machine only, and
errors are raised on all ranks. The functions are collective. Files of VTK and the like are read by
pyvista, which is imported only then.
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

if TYPE_CHECKING:  # it takes a second to import: only where it is needed
    import pyvista

T = TypeVar("T")

_SURFACES = (".stl", ".ply", ".vtk", ".vtp", ".vtu", ".obj")
_VTK_IMAGES = (".vti", ".vtk", ".mha", ".mhd", ".nrrd")
_PICTURES = (".png", ".tif", ".tiff", ".bmp", ".jpg", ".jpeg")
_VTK_CLOUDS = (".vtp", ".vtk", ".vtu", ".ply")

# Vertices of a surface closer than this part of its size are one: STL files have float32.
_SAME = 1e-7


class Image(NamedTuple):
    """What is in a file of an image, for `fenicsmpm.shapes.mask` and `contour`.

    Attributes:
        values: Gray values, the first coordinate first, shape (nx, ny) or (nx, ny, nz).
        spacing: Sizes of a voxel, shape (d,); 1 if the file has none.
        origin: Lower corner of the first voxel, shape (d,); 0 if the file has none.
    """

    values: npt.NDArray[Any]
    spacing: npt.NDArray[np.float64]
    origin: npt.NDArray[np.float64]


def on_rank_0(path: Path | str, comm: MPI.Intracomm, read: Callable[[Path], T]) -> T | None:
    """What a function reads from a file on rank 0, None on the other ranks. Collective.

    Raises:
        FileNotFoundError: On all ranks, if there is no such file; also what the function raises.
    """
    file = Path(path)

    def action() -> T:
        if not file.is_file():
            raise FileNotFoundError(f"no file {file} (in {Path.cwd()})")
        return read(file)

    return do_there(comm, comm.rank == 0, action)


def read_solid(path: Path | str, comm: MPI.Intracomm = MPI.COMM_WORLD) -> Solid:
    """The solid in a closed surface: a file .stl, .ply, .vtk, .vtp, .vtu or .obj.

    Polygons are cut into triangles, of volumes in a .vtu or .vtk the surface is taken. Vertices
    closer than 1e-7 of the size are one. Lengths are as in the file: `Solid.transformed` scales.

    Args:
        path: The file.
        comm: Ranks that want the solid.

    Raises:
        OpenSurfaceError: If the surface has holes.
        FileNotFoundError: If there is no such file.
        ValueError: For other types of files, files without triangles, and surfaces that
            `fenicsmpm.shapes.surface` refuses.
        ImportError: Without pyvista.
    """
    vertices, triangles = comm.bcast(on_rank_0(path, comm, _triangles))
    return surface(vertices, triangles)


def _triangles(file: Path) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.int64]]:
    """Vertices (m, 3) and triangles (n, 3)."""
    data: Any = _vtk_data(file, _SURFACES, "a surface")
    if not hasattr(data, "extract_surface"):
        raise ValueError(f"{file}: {type(data).__name__} is no surface")
    if not hasattr(data, "faces"):  # volumes
        data = data.extract_surface()
    vertices = np.asarray(data.points, dtype=np.float64)
    if data.n_cells:
        data = data.triangulate().clean(tolerance=_SAME)
        vertices = np.asarray(data.points, dtype=np.float64)
    triangles = np.asarray(data.faces, dtype=np.int64).reshape(-1, 4)[:, 1:]
    if not len(triangles):
        raise ValueError(f"{file}: no triangles in it, or the file is damaged")
    return vertices, triangles


def read_image(path: Path | str, comm: MPI.Intracomm = MPI.COMM_WORLD) -> Image:
    """Gray values of an image: a file .npy, .png and the like, .vti, .vtk, .mha or .nrrd.

    In pictures the first coordinate goes to the right and the second one upwards; of colours the
    mean is taken. Arrays of numpy have the first coordinate first. In .vti files it is the active
    scalar field of cells or points, where a point is the centre of a voxel.

    Args:
        path: The file.
        comm: Ranks that want the image.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: For other types of files, and arrays that are no image in 2 or 3 dimensions.
        ImportError: For files of VTK without pyvista.
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
        raise ValueError(f"{file}: an image has 2 or 3 dimensions, not the shape {values.shape}")
    return Image(values, np.ones(values.ndim), np.zeros(values.ndim))


def _vtk_image(data: Any, file: Path) -> Image:
    """Values of VTK's image data, of one layer in the plane."""
    if not hasattr(data, "spacing") or not hasattr(data, "dimensions"):
        raise ValueError(f"{file}: {type(data).__name__} is no image")
    spacing, origin = np.array(data.spacing), np.array(data.origin)
    # several arrays: the active one
    name = data.active_scalars_name
    arrays = data.cell_data if len(data.cell_data) else data.point_data
    if name not in arrays or arrays[name].ndim != 1:
        raise ValueError(f"{file}: needs one active array of scalars, has {list(arrays.keys())}")
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
    """Points with their volumes from a file .csv, .npz, .vtp, .vtk, .vtu or .ply.

    The first line of a .csv names its columns: "x", "y", in space "z", the volume, and others. A
    .npz has positions "x", shape (n, d), and arrays (n, ...). Files of VTK have points and point
    data. Arrays other than positions and volumes become fields; "id" is left out, and "tag" is the
    tag of points, so that points written by `fenicsmpm.io.write` can be read (volume "weight").

    Args:
        mesh: Background mesh.
        path: The file.
        volume: Name of the volumes in m^d, in 2D per unit thickness.
        tag: Tag of the points, unless the file has tags.

    Returns:
        Points with ids in the order of the file.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: For other types of files, missing positions or volumes, arrays of other lengths,
            volumes that are not positive, and in the plane a third coordinate other than 0.
        PointsOutsideError: If some point is outside of the mesh.
        ImportError: For files of VTK without pyvista.
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
    """Arrays of a cloud: "x" with the shape (n, dim), the volume, fields."""
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
            f"{file}: a cloud needs positions 'x' and '{volume}', but has {', '.join(arrays)}"
        )
    x = np.asarray(arrays["x"], dtype=np.float64)
    if x.ndim != 2 or x.shape[1] < dim or np.any(x[:, dim:] != 0.0):
        raise ValueError(
            f"{file}: positions of the shape {x.shape} for a mesh of {dim} dimensions"
            + (", with a third coordinate that is not 0" if x.ndim == 2 else "")
        )
    return {name: np.asarray(a, dtype=np.float64) for name, a in arrays.items()} | {
        "x": x[:, :dim].copy()
    }


def _columns(file: Path) -> dict[str, npt.NDArray]:
    """Columns of a .csv file by their names, coordinates as "x"."""
    names = [name.strip() for name in file.read_text().partition("\n")[0].split(",")]
    table = np.loadtxt(file, delimiter=",", skiprows=1, ndmin=2)
    if table.shape[1] != len(names):
        raise ValueError(f"{file}: {len(names)} names in the first line, {table.shape[1]} columns")
    columns: dict[str, npt.NDArray] = {name: table[:, i] for i, name in enumerate(names)}
    places = [columns.pop(name) for name in ("x", "y", "z") if name in columns]
    return columns | {"x": np.stack(places, axis=1)} if places else columns


def _vtk_data(file: Path, kinds: tuple[str, ...], what: str, *others: str) -> pyvista.DataSet:
    """What pyvista reads, if the name of the file ends in one of some kinds."""
    if file.suffix.lower() not in kinds:
        raise ValueError(
            f"{file}: {what} is a file {', '.join([*others, *kinds])}, not '{file.suffix}'"
        )
    import pyvista

    return pyvista.read(file)
