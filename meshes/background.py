# SPDX-License-Identifier: MIT
"""Background meshes that have the body as a region: what column.py and rectangle.py share."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
from dolfinx.mesh import GhostMode, Mesh, MeshTags

from fenicsmpm._compat import cell_partitioner

BODY = 1
SURROUNDING = 2
GROWTH = 0.5  # of the cell size per distance from the body, where the mesh coarsens


def build(
    geometry: Callable[[Any], tuple[int, int]],
    distance: Callable[[float, float, float], float],
    dim: int,
    h: float,
    far: float | None = None,
    output: Path | str | None = None,
    comm: MPI.Comm = MPI.COMM_WORLD,
) -> tuple[Mesh, MeshTags]:
    """Mesh a body and the rest of a box around it, with nodes on the body's boundary.

    Gmsh works on rank 0 with one thread, so that the same arguments give the same mesh.

    Args:
        geometry: is given ``gmsh.model.occ`` and returns the tags of the body and of the box.
        distance: from the body in m (or less) at a point (x, y, z); not positive in the body.
        dim: 2 or 3.
        h: size of cells in m.
        far: size in m up to which cells grow away from the body; None for ``h`` everywhere.
        output: file ``.msh`` to be written too.
        comm: communicator of the mesh.

    Returns:
        The mesh, and its cells' tags: 1 in the body, 2 in its surrounding.
    """
    if not h > 0:
        raise ValueError(f"size of cells {h} m: must be positive")
    if far is not None and not far >= h:
        raise ValueError(f"size of far cells {far} m: must be {h} m, as near the body, or more")

    def make(gmsh: Any) -> None:
        gmsh.option.setNumber("Mesh.MeshSizeExtendFromBoundary", 0)
        gmsh.option.setNumber("Mesh.MeshSizeMax", h if far is None else far)
        model = gmsh.model
        body, box = geometry(model.occ)
        _, (inner, outer) = model.occ.fragment([(dim, body)], [(dim, box)])
        model.occ.synchronize()
        for tag, name, pieces in (
            (BODY, "body", inner),
            (SURROUNDING, "surrounding", sorted(set(outer) - set(inner))),
        ):
            model.addPhysicalGroup(dim, [piece for _, piece in pieces], tag, name)

        def size(_dim: int, _tag: int, x: float, y: float, z: float, _size: float) -> float:
            return h if far is None else min(far, h + GROWTH * max(0.0, distance(x, y, z)))

        model.mesh.setSizeCallback(size)
        model.mesh.generate(dim)
        if output is not None:
            gmsh.write(str(output))

    return _convert(make, dim, comm)


def read(path: Path | str, dim: int, comm: MPI.Comm = MPI.COMM_WORLD) -> tuple[Mesh, MeshTags]:
    """Read a ``.msh`` file of this directory.

    Args:
        path: the file.
        dim: 2 or 3.
        comm: communicator of the mesh.

    Returns:
        The mesh, and its cells' tags: 1 in the body, 2 in its surrounding.
    """
    return _convert(lambda gmsh: gmsh.open(str(path)), dim, comm)


def main(
    make: Callable[..., tuple[Mesh, MeshTags]],
    lower: Sequence[float],
    upper: Sequence[float],
    description: str,
) -> None:
    """Command line of a mesh.

    Args:
        make: the function that makes it.
        lower: default of the lower corner, ``(dim,)`` in m.
        upper: default of the upper corner, ``(dim,)`` in m.
        description: one line for the help.
    """
    parser = argparse.ArgumentParser(
        description=description, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    add, corner = parser.add_argument, {"type": float, "nargs": len(lower), "metavar": "X"}
    add("--h", type=float, default=0.25, help="size of cells in m")
    add("--far", type=float, help="size in m up to which cells grow away from the body")
    add("--lower", **corner, default=lower, help="lower corner of the box in m")
    add("--upper", **corner, default=upper, help="upper corner of the box in m")
    add("--output", type=Path, required=True, help="file .msh")
    options = parser.parse_args()
    domain, tags = make(**vars(options))

    comm, n = domain.comm, domain.topology.index_map(domain.topology.dim).size_local
    values = tags.values[tags.indices < n]
    body, surrounding = (comm.allreduce(int(np.sum(values == t))) for t in (BODY, SURROUNDING))
    if comm.rank == 0:
        print(f"{options.output}: {body} cells in the body, {surrounding} in its surrounding")


def _convert(make: Callable[[Any], None], dim: int, comm: MPI.Comm) -> tuple[Mesh, MeshTags]:
    """Let ``make`` fill the model of Gmsh on rank 0, and distribute its mesh."""
    if comm.rank != 0:
        return _interface().model_to_mesh(None, comm, 0, gdim=dim, partitioner=_partitioner())[:2]

    import gmsh

    gmsh.initialize(readConfigFiles=False, interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        make(gmsh)
        return _interface().model_to_mesh(gmsh.model, comm, 0, dim, _partitioner())[:2]
    finally:
        gmsh.finalize()


def _partitioner() -> Any:
    """Ranks see their neighbours' cells, which integrals over interior facets need."""
    return cell_partitioner(GhostMode.shared_facet)


def _interface() -> Any:
    """The module of dolfinx that talks to Gmsh: ``io.gmshio`` in 0.9, ``io.gmsh`` from 0.10 on."""
    try:
        from dolfinx.io import gmsh as interface
    except ImportError:
        from dolfinx.io import gmshio as interface
    return interface
