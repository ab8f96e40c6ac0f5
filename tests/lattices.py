# SPDX-License-Identifier: MIT
"""Meshes of boxes and points in them that see splines or uGIMP functions."""

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem, mesh

from fenicsmpm import MaterialPoints, basis, forms

COMM = MPI.COMM_WORLD
LOWER, UPPER = np.array([1.0, -2.0, 0.5]), np.array([2.5, -0.8, 1.3])
SHAPE = (6, 5, 4)
NAMES = ("linear", "quadratic", "cubic", "gimp")
HALF = np.array([0.06, 0.05, 0.03])
EVERYWHERE = pytest.mark.parametrize("dim", [2, 3])
EACH = pytest.mark.parametrize("name", NAMES)


def lattice(dim, comm=COMM, shape=SHAPE):
    partitioner = basis.shared_vertex_partitioner
    corners = [LOWER[:dim], UPPER[:dim]]
    if dim == 2:
        kind = mesh.CellType.quadrilateral
        return mesh.create_rectangle(comm, corners, shape[:2], kind, partitioner=partitioner)
    kind = mesh.CellType.hexahedron
    return mesh.create_box(comm, corners, shape, kind, partitioner=partitioner)


def use(body, name):
    basis.use(body, name, half_size=HALF[: body.x.shape[1]] if name == "gimp" else None)
    return body


def cloud(dim, name, comm=COMM, n=400, shape=SHAPE):
    """Random points, some of them on walls, nodes and knots; the same on any number of ranks."""
    domain = lattice(dim, comm, shape)
    rng = np.random.default_rng(3)
    cells = np.array(shape[:dim])
    t = rng.random((n, dim)) * cells
    t[: n // 2] = np.rint(2 * t[: n // 2]) / 2
    x = LOWER[:dim] + t / cells * (UPPER - LOWER)[:dim]
    weight = rng.uniform(0.5, 1.5, n) / n
    here = slice(None) if comm.rank == 0 else slice(0)
    return use(MaterialPoints(domain, x[here], weight[here]), name)


def inner_cloud(dim, name, n=100):
    """Random points away from the walls."""
    domain = lattice(dim)
    x = np.random.default_rng(5).uniform(0.01, 0.99, (n, dim)) * (UPPER - LOWER)[:dim]
    here = slice(None) if COMM.rank == 0 else slice(0)
    return use(MaterialPoints(domain, (LOWER[:dim] + x)[here], 1.0 / n), name)


def space(domain, *shape):
    return fem.functionspace(domain, ("Lagrange", 1, shape) if shape else ("Lagrange", 1))


def noise(V, seed=0):
    """A function that is the same on any number of ranks."""
    phase = np.random.default_rng(seed).uniform(5.0, 15.0, (V.dofmap.index_map_bs, 3))
    f = fem.Function(V)
    f.interpolate(lambda x: np.sin(phase @ x) if len(phase) > 1 else np.sin(phase @ x)[0])
    return f


def by_id(body, values):
    order = np.argsort(np.concatenate(COMM.allgather(body.id)))
    return np.concatenate(COMM.allgather(values))[order]


def owned(vector):
    return vector.array[: vector.index_map.size_local * vector.block_size]


def product(a, f):
    """Owned entries of the matrix times a function, zero rows left zero."""
    A = forms.assemble_matrix(a)
    # rows of the identity of unseen nodes are not part of the operator
    rows = A.to_scipy().tocsr()
    n = A.index_map(0).size_local
    columns = A.index_map(1).local_to_global(np.arange(rows.shape[1], dtype=np.int32))
    V = f.function_space
    bs, blocks = V.dofmap.index_map_bs, V.dofmap.index_map
    values = np.zeros(blocks.size_global * bs)
    first = blocks.local_range[0] * bs
    values[first : first + blocks.size_local * bs] = f.x.array[: blocks.size_local * bs]
    COMM.Allreduce(MPI.IN_PLACE, values)
    result = rows[:n] @ values[columns]
    result[forms.inactive_dofs(a)] = 0.0
    return result
