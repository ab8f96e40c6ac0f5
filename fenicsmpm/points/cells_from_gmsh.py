# SPDX-License-Identifier: MIT
"""Bodies from the cells of another mesh, such as a physical group of a Gmsh file.

All functions are collective.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from mpi4py import MPI

import basix
import basix.ufl
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx.mesh import Mesh, create_mesh, exterior_facet_indices

from fenicsmpm import _compat
from fenicsmpm.points.body_files import on_rank_0
from fenicsmpm.points.geometry import cell_geometry
from fenicsmpm.points.material_points import MaterialPoints
from fenicsmpm.points.seeding import fill
from fenicsmpm.shapes import Solid

# Cell types of Gmsh: the name in dolfinx, and the order of the vertices in dolfinx
_KINDS = {
    2: ("triangle", [0, 1, 2]),
    3: ("quadrilateral", [0, 1, 3, 2]),
    4: ("tetrahedron", [0, 1, 2, 3]),
    5: ("hexahedron", [0, 1, 3, 2, 4, 5, 7, 6]),
}


def read_cells(
    path: Path | str,
    group: str | int | Sequence[str | int],
    dim: int,
    comm: MPI.Intracomm = MPI.COMM_WORLD,
) -> Mesh:
    """Read the cells of physical groups from a Gmsh file into a mesh of their own. Collective.

    Rank 0 reads the file. To make a body of the mesh, `in_cells` puts points into its cells, and
    `boundary_of` returns the solid that they fill. `fill`, `quadrature` and `on_facets` also take
    the mesh; `from_mesh` then brings the points to the background mesh.

    Args:
        path: File .msh, or another file with a mesh that Gmsh opens.
        group: Name or number of a physical group of cells, or a sequence of these.
        dim: Dimension d of the cells and of space, 2 or 3.
        comm: Communicator of the ranks that share the cells.

    Returns:
        The mesh, with coordinates in the unit of the file.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: For files that Gmsh cannot read, groups that are missing or empty, cells that
            are curved or of several types, and in 2D nodes outside of the plane z = 0.
        ImportError: If the Python module of Gmsh is not installed.
    """
    groups = [group] if isinstance(group, str | int) else list(group)
    if dim not in (2, 3):
        raise ValueError(f"dim must be 2 or 3, not {dim}")
    read = on_rank_0(path, comm, lambda file: _read(file, groups, dim))
    kind, vertices = comm.bcast(None if read is None else (read[0], read[2].shape[1]))
    x, cells = (np.zeros((0, dim)), np.zeros((0, vertices), np.int64)) if read is None else read[1:]
    element = basix.ufl.element("Lagrange", kind, 1, shape=(dim,))
    return create_mesh(comm, cells=cells, x=x, e=ufl.Mesh(element))


def _read(
    file: Path, groups: Sequence[str | int], dim: int
) -> tuple[str, npt.NDArray[np.float64], npt.NDArray[np.int64]]:
    """Return the cell type, positions (m, dim) of the nodes, and node numbers (n, k) of cells."""
    import gmsh

    own = not gmsh.isInitialized()
    if own:
        gmsh.initialize(readConfigFiles=False, interruptible=False)
        gmsh.option.setNumber("General.Terminal", 0)
    before = gmsh.model.getCurrent()
    try:
        try:
            gmsh.open(str(file))
        except Exception as error:  # Gmsh has no exceptions of its own
            raise ValueError(f"{file}: Gmsh cannot read this file: {error}") from error
        found = _cells_of(gmsh.model, file, groups, dim)
        gmsh.model.remove()
    finally:
        if own:
            gmsh.finalize()
        else:
            gmsh.model.setCurrent(before)
    return found


def _cells_of(
    model: Any, file: Path, groups: Sequence[str | int], dim: int
) -> tuple[str, npt.NDArray[np.float64], npt.NDArray[np.int64]]:
    """Return the cells of physical groups in Gmsh's current model, in the form of `_read`."""
    known = {tag: model.getPhysicalName(dim, tag) for _, tag in model.getPhysicalGroups(dim)}
    entities: dict[int, None] = {}  # in the order of the groups, each entity once
    for group in groups:
        tags = [tag for tag, name in known.items() if group in (tag, name)]
        if not tags:
            listed = ", ".join(
                f"{tag} '{model.getPhysicalName(d, tag)}' (dimension {d})"
                for d, tag in model.getPhysicalGroups()
            )
            raise ValueError(
                f"{file}: no physical group {group!r} of dimension {dim}; available are: "
                f"{listed or 'none'}"
            )
        for tag in tags:
            entities.update(dict.fromkeys(model.getEntitiesForPhysicalGroup(dim, tag)))
    nodes: dict[int, list[npt.NDArray]] = {}
    for entity in entities:
        kinds, _, of_cells = model.mesh.getElements(dim, entity)
        for kind, numbers in zip(kinds, of_cells, strict=True):
            nodes.setdefault(int(kind), []).append(np.asarray(numbers, dtype=np.int64))
    if len(nodes) != 1 or not nodes.keys() <= _KINDS.keys():
        names = [model.mesh.getElementProperties(kind)[0] for kind in nodes]
        raise ValueError(
            f"{file}: all cells of {', '.join(map(repr, groups))} must be triangles, "
            "quadrilaterals, tetrahedra or hexahedra, of one type and with straight edges, not "
            f"{' and '.join(names) or 'none at all'}"
        )
    [(kind, parts)] = nodes.items()
    name, order = _KINDS[kind]
    used, cells = np.unique(np.concatenate(parts), return_inverse=True)
    tags, x, _ = model.mesh.getNodes()
    by_tag = np.argsort(tags)
    rows = by_tag[np.searchsorted(tags, used, sorter=by_tag)]
    positions = np.asarray(x, dtype=np.float64).reshape(-1, 3)[rows]
    if np.any(positions[:, dim:] != 0.0):
        raise ValueError(f"{file}: cells of dimension {dim} have nodes outside of the plane z = 0")
    return name, positions[:, :dim].copy(), cells.reshape(-1, len(order))[:, order]


def in_cells(background: Mesh, part: Mesh, spacing: float, tag: int = 0) -> MaterialPoints:
    """Seed points in the cells of another mesh and put them on the background mesh.

    Each cell is cut into k^d equal parts as in `fill`, with the smallest k for which its longest
    edge is no longer than k spacings. The points of a cell share its volume.

    Args:
        background: Mesh to put the points on, on the same ranks.
        part: The other mesh.
        spacing: Approximate largest distance of points in m.
        tag: Tag of the points.

    Returns:
        The points; their weights are volumes in m^d, in 2D per unit thickness.

    Raises:
        TypeError: If the part is no mesh.
        ValueError: If the spacing is not positive.
        PointsOutsideError: If some point is outside of the background mesh.
    """
    if not isinstance(part, Mesh):
        raise TypeError(f"in_cells needs a mesh, such as read_cells returns, not {part!r}")
    if not 0.0 < spacing < np.inf:
        raise ValueError(f"the spacing of points in cells must be positive, not {spacing}")
    geometry = cell_geometry(part)
    owned = np.arange(geometry.num_owned, dtype=np.int32)
    count = np.ceil(_longest_edge(part, geometry.dim)[owned] / spacing * (1.0 - 1e-12))
    count = np.maximum(count, 1).astype(np.int64)
    numbers_of_cuts = sorted(set().union(*part.comm.allgather(set(count.tolist()))))
    parts = [fill(part, k, cells=owned[count == k]) for k in numbers_of_cuts]
    before = np.cumsum([0, *(some.size_global for some in parts)])
    points = MaterialPoints(
        background,
        np.concatenate([some.x for some in parts]),
        np.concatenate([some.weight for some in parts]),
        tag=tag,
        number=np.concatenate([n + some.id for n, some in zip(before[:-1], parts, strict=True)]),
    )
    points.sort()
    return points


def _longest_edge(mesh: Mesh, dim: int) -> npt.NDArray[np.float64]:
    """Return the longest edge of each cell in m, shape (n,)."""
    x = mesh.geometry.x[_compat.geometry_dofmap(mesh)]
    edges = np.array(basix.topology(getattr(basix.CellType, mesh.topology.cell_type.name))[1])
    lengths = np.linalg.norm(x[:, edges[:, 0]] - x[:, edges[:, 1]], axis=2)
    return lengths.max(axis=1, initial=0.0)


def boundary_of(part: Mesh) -> Solid:
    """Return the solid that the cells of a mesh fill, on all ranks.

    The boundary of the solid consists of the facets with one cell only, in the order of the cells
    in the input mesh. A facet of a hexahedron becomes two triangles.

    Args:
        part: Mesh of triangles, quadrilaterals, tetrahedra or hexahedra.

    Returns:
        The solid, with lengths in the unit of the mesh.
    """
    geometry = cell_geometry(part)
    d, topology = geometry.dim, part.topology
    topology.create_entities(d - 1)
    topology.create_connectivity(d - 1, d)
    topology.create_connectivity(d, d - 1)
    facets = exterior_facet_indices(topology)
    to_cells = topology.connectivity(d - 1, d)
    cell = to_cells.array[to_cells.offsets[facets]]
    of_cell = topology.connectivity(d, d - 1).array.reshape(geometry.num_cells, -1)
    side = np.argmax(of_cell[cell] == facets[:, None], axis=1)
    local = np.array(basix.topology(geometry.cell)[d - 1])
    vertices = part.geometry.x[
        np.take_along_axis(_compat.geometry_dofmap(part)[cell], local[side], axis=1)
    ][:, :, :d]
    middle = part.geometry.x[_compat.geometry_dofmap(part)[cell]].mean(axis=1)[:, :d]
    if vertices.shape[1] == 4:  # quadrilaterals: a tensor product of vertices in dolfinx
        vertices = vertices[:, [[0, 1, 3], [0, 3, 2]]].reshape(-1, 3, 3)
        middle = np.repeat(middle, 2, axis=0)
    inwards = np.linalg.det(vertices - middle[:, None]) < 0.0
    vertices[inwards] = vertices[inwards, ::-1]
    number = np.repeat(
        geometry.key[cell] * of_cell.shape[1] + side, len(vertices) // max(len(cell), 1)
    )
    both = part.comm.allgather((number, vertices))
    order = np.argsort(np.concatenate([n for n, _ in both]), kind="stable")
    return Solid(np.concatenate([v for _, v in both])[order])
