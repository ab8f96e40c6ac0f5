# SPDX-License-Identifier: MIT
"""Points and grid functions as pyvista datasets on rank 0, and files of these.

``gather_points`` and ``gather_functions`` collect the data of all ranks in one dataset. ``write``
saves it for ParaView, ``picture`` draws it. A dataset does not depend on the number of ranks.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
from dolfinx import fem, plot
from dolfinx.mesh import Mesh

import fenicsmpm
from fenicsmpm import _compat
from fenicsmpm.basis import is_linear
from fenicsmpm.io.atomic import replace
from fenicsmpm.points import MaterialPoints
from fenicsmpm.points.agreement import do_there

if TYPE_CHECKING:  # the import takes a second
    import pyvista


def gather_points(
    points: MaterialPoints | Sequence[MaterialPoints],
) -> pyvista.PolyData | None:
    """Collect material points with all their fields. Collective.

    Args:
        points: One point set or several. Of several sets, the fields that all of them have are
            collected.

    Returns:
        On rank 0 the points in the order of their ids, with the point data "id", "tag", "weight"
        and all fields. Vectors have three components and tensors nine (row by row), as ParaView
        expects them. None on the other ranks.
    """
    if not isinstance(points, MaterialPoints):
        first, *others = [gather_points(one) for one in points]
        return first if first is None or not others else first.append_polydata(*others)
    names = ["x", *names_of_points([points])]
    comm = points.mesh.comm
    parts = comm.gather({name: np.asarray(points[name]) for name in names})
    return do_there(comm, parts is not None, lambda: _point_cloud(names, parts or []))


def names_of_points(bodies: Sequence[MaterialPoints]) -> list[str]:
    """Return the names of the arrays that all point sets have, except positions.

    Laws without state have a field without numbers, which VTK cannot handle.
    """
    first, *others = bodies
    fields = [
        name
        for name in first.field_names
        if all(name in body for body in others) and math.prod(first.field_shape(name)) > 0
    ]
    return ["id", "tag", "weight", *fields]


def _point_cloud(names: list[str], parts: list[dict[str, npt.NDArray]]) -> pyvista.PolyData:
    import pyvista

    data = {name: np.concatenate([part[name] for part in parts]) for name in names}
    order = np.argsort(data["id"])
    result = pyvista.PolyData(in_space(data.pop("x")[order]))
    for name, values in data.items():
        if values.size > 0:  # pyvista does not accept empty arrays
            result.point_data[name] = in_space(values[order])
    return result


def gather_functions(functions: Sequence[fem.Function]) -> pyvista.UnstructuredGrid | None:
    """Collect P1 functions and their mesh. Collective.

    Args:
        functions: Lagrange functions of degree 1 (or Q1) on one mesh of straight cells. Parts of
            a mixed function must be collapsed first.

    Returns:
        On rank 0 the mesh in its input order, with each function as point data under its name.
        Vectors have three components and tensors nine. None on the other ranks.

    Raises:
        ValueError: For other spaces, several meshes, or names that occur twice.
    """
    return _gather(check_functions(functions), functions)


def gather_cells(mesh: Mesh) -> pyvista.UnstructuredGrid | None:
    """Collect a mesh of straight cells without values, as ``gather_functions``. Collective."""
    return _gather(mesh, [])


def _gather(mesh: Mesh, functions: Sequence[fem.Function]) -> pyvista.UnstructuredGrid | None:
    nodes = mesh.geometry.input_global_indices
    cells, types, x = plot.vtk_mesh(mesh)
    cells = cells.reshape(len(types), -1).astype(np.int64)
    cells[:, 1:] = nodes[cells[:, 1:]]
    order = np.asarray(mesh.topology.original_cell_index)[: len(types)]
    values = {f.name: at_nodes(f) for f in functions}
    parts = mesh.comm.gather((nodes, x, order, cells, types, values))
    return do_there(mesh.comm, parts is not None, lambda: _grid(list(values), parts or []))


def _grid(names: list[str], parts: list[tuple[Any, ...]]) -> pyvista.UnstructuredGrid:
    import pyvista

    columns = list(zip(*parts, strict=True))
    nodes, x, order, cells, types = (np.concatenate(column) for column in columns[:5])
    nodes, first = np.unique(nodes, return_index=True)
    by_input = np.argsort(order)
    cells = cells[by_input]
    cells[:, 1:] = np.searchsorted(nodes, cells[:, 1:])
    result = pyvista.UnstructuredGrid(cells.ravel(), types[by_input], x[first])
    for name in names:
        result.point_data[name] = in_space(np.concatenate([v[name] for v in columns[5]])[first])
    return result


def write(
    path: str | Path,
    data: pyvista.DataSet | None,
    parameters: Mapping[str, Any] | None = None,
    comm: MPI.Comm = MPI.COMM_WORLD,
) -> None:
    """Write a gathered dataset for ParaView: ".vtp" for points, ".vtu" for a mesh. Collective.

    The version of the package and the parameters are stored in it as field data.

    Args:
        path: Name of the file; missing directories are created.
        data: Result of ``gather_points`` or ``gather_functions``.
        parameters: Numbers and texts that describe the run, such as ``{"E [Pa]": 70.0}``.
        comm: Communicator of the mesh.

    Raises:
        OSError: On all ranks, if the file cannot be written; an older one stays as it was.
        ValueError: On all ranks, if the suffix does not fit the data.
    """
    do_there(comm, data is not None, lambda: _save(Path(path), data, parameters or {}))


def _save(path: Path, data: pyvista.DataSet | None, parameters: Mapping[str, Any]) -> None:
    import pyvista

    assert data is not None
    suffix = ".vtp" if isinstance(data, pyvista.PolyData) else ".vtu"
    if path.suffix != suffix:
        raise ValueError(f"{path}: a file of {type(data).__name__} needs the suffix {suffix}")
    path.parent.mkdir(parents=True, exist_ok=True)
    file: Any = data.copy(deep=False)
    file.field_data["fenicsmpm version"] = [fenicsmpm.__version__]
    for name, value in parameters.items():
        file.field_data[name] = [value if isinstance(value, bool | int | float) else str(value)]
    replace(path, _bytes_of(file, suffix))


def _bytes_of(data: pyvista.DataSet, suffix: str) -> bytes:
    """Return what VTK would write to a file. VTK itself reports failures on standard error only."""
    from vtkmodules.vtkIOXML import vtkXMLPolyDataWriter, vtkXMLUnstructuredGridWriter

    writer: Any = vtkXMLPolyDataWriter() if suffix == ".vtp" else vtkXMLUnstructuredGridWriter()
    writer.SetInputData(data)
    writer.WriteToOutputStringOn()
    writer.Write()
    text = writer.GetOutputString()
    return text if isinstance(text, bytes) else text.encode("latin-1")


def check_functions(functions: Sequence[fem.Function]) -> Any:
    """Return the mesh of functions; raise ValueError as ``gather_functions`` does."""
    if not functions:
        raise ValueError("no functions to gather: pass at least one")
    mesh = functions[0].function_space.mesh
    names = [f.name for f in functions]
    if len(set(names)) != len(names):
        raise ValueError(f"functions need different names, not {', '.join(names)}: set f.name")
    for f in functions:
        element = f.function_space.ufl_element()
        if not is_linear(element):
            raise ValueError(
                f"function {f.name!r} is not continuous P1 but {element}: interpolate it to P1, or "
                "collapse the part of a mixed function"
            )
        if f.function_space.mesh is not mesh and f.function_space.mesh != mesh:
            raise ValueError(f"function {f.name!r} is on another mesh than {names[0]!r}")
    if mesh.ufl_domain().ufl_coordinate_element().degree != 1:
        raise ValueError("only meshes of straight cells can be gathered")
    return mesh


def at_nodes(f: fem.Function) -> npt.NDArray[np.float64]:
    """Return values at the local geometry nodes, (n_nodes, *shape)."""
    space = f.function_space
    nodes = _compat.geometry_dofmap(space.mesh)
    size = space.dofmap.index_map_bs
    values = np.zeros((len(space.mesh.geometry.x), size))
    values[nodes.ravel()] = f.x.array.reshape(-1, size)[space.dofmap.list.ravel()]
    return values.reshape(-1, *f.ufl_shape)


def in_space(values: npt.NDArray) -> npt.NDArray:
    """Return 2D vectors and tensors as 3D ones, (n, 3) and flattened (n, 9)."""
    for axis in range(1, values.ndim):
        if values.shape[axis] == 2:
            values = np.insert(values, 2, 0.0, axis=axis)
    return values if values.ndim == 1 else values.reshape(len(values), math.prod(values.shape[1:]))
