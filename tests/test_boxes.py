# SPDX-License-Identifier: MIT
"""Lattices, whose cells are not stored: the same as from the mesh's own arrays, at no memory."""

import itertools
import tracemalloc

from mpi4py import MPI

import basix.ufl
import numpy as np
import pytest
from dolfinx import mesh as dmesh
from dolfinx.mesh import CellType
from test_location import check

from fenicsmpm import basis, points
from fenicsmpm._compat import geometry_dofmap
from fenicsmpm.basis.lattice import lattice_of
from fenicsmpm.points.geometry import cell_geometry
from fenicsmpm.points.location import Locator, locator

pytestmark = pytest.mark.ranks

COMM, SERIAL = MPI.COMM_WORLD, MPI.COMM_SELF
LOWER, UPPER = np.array([-1.0, 2.0, 0.5]), np.array([1.1, 2.7, 4.0])
BOTH = pytest.mark.parametrize("d", [2, 3])
KIND = {2: CellType.quadrilateral, 3: CellType.hexahedron}


def box(d, n=5, comm=SERIAL):
    corners, cells = [LOWER[:d], UPPER[:d]], [n, n + 1, n - 1][:d]
    if d == 2:
        return dmesh.create_rectangle(comm, corners, cells, KIND[2])
    return dmesh.create_box(comm, corners, cells, KIND[3])


def turned(d, keep=lambda mid: np.full(len(mid), True)):
    """Cells of a lattice whose reference axes point in any directions."""
    straight = box(d)
    x, nodes = straight.geometry.x[:, :d], geometry_dofmap(straight)
    nodes = nodes[keep(x[nodes].mean(axis=1))]
    rng = np.random.default_rng(2)
    bits = np.arange(2**d)[:, None] >> np.arange(d) & 1
    cells = []
    for cell in nodes:
        mine = (bits ^ rng.integers(0, 2, d))[:, rng.permutation(d)] @ (1 << np.arange(d))
        cells.append(cell[mine])
    used, cells = np.unique(cells, return_inverse=True)
    element = basix.ufl.element("Lagrange", KIND[d].name, 1, shape=(d,))
    cells = cells.reshape(nodes.shape).astype(np.int64)
    return dmesh.create_mesh(SERIAL, cells=cells, x=x[used].copy(), e=element)


def holes(mid):
    return (np.abs(mid - mid.mean(axis=0)) > 0.2).any(axis=1)


@BOTH
@pytest.mark.parametrize("make", [box, turned, lambda d: turned(d, holes)])
def test_shapes_of_cells_are_those_of_the_mesh(d, make):
    mesh = make(d)
    geometry = cell_geometry(mesh)
    assert geometry.boxes is not None and geometry.stored is None
    corners = mesh.geometry.x[geometry_dofmap(mesh)][:, :, :d]
    cells = np.arange(len(corners), dtype=np.int32)
    np.testing.assert_allclose(geometry.corners(cells), corners, rtol=0, atol=2e-15)
    xi = np.random.default_rng(0).random((len(cells), d))
    x = [mesh.geometry.cmap.push_forward(xi[c : c + 1], corners[c])[0] for c in cells]
    np.testing.assert_allclose(geometry.push_forward(cells, xi), x, rtol=0, atol=4e-15)
    first = 1 << np.arange(d)
    jacobian = np.swapaxes(corners[:, first] - corners[:, :1], 1, 2)
    np.testing.assert_allclose(geometry.jacobian(cells, xi), jacobian, rtol=0, atol=4e-15)
    inverse = geometry.inverse_jacobian(cells, xi)
    np.testing.assert_allclose(
        inverse @ jacobian, np.tile(np.eye(d), (len(cells), 1, 1)), atol=1e-13
    )
    volume = np.abs(np.linalg.det(jacobian))
    np.testing.assert_allclose(geometry.volume(cells), volume, rtol=1e-13)
    np.testing.assert_allclose(geometry.owned_volumes, volume, rtol=1e-13)
    np.testing.assert_allclose(geometry.determinant(cells, xi), volume, rtol=1e-13)
    np.testing.assert_allclose(
        np.einsum("ckd->cd", geometry.coefficients(cells)), corners[:, -1], rtol=0, atol=4e-15
    )


@BOTH
@pytest.mark.parametrize("make", [box, turned, lambda d: turned(d, holes)])
def test_points_inside_on_facets_and_outside(d, make):
    mesh = make(d)
    corners = mesh.geometry.x[geometry_dofmap(mesh)][:, :, :d]
    size = (UPPER - LOWER)[:d]
    x = np.random.default_rng(1).uniform(LOWER[:d] - 0.1 * size, UPPER[:d] + 0.1 * size, (300, d))
    facets = np.concatenate([0.5 * (corners[:, 0] + corners[:, i]) for i in range(2**d)])
    cell = check(mesh, np.concatenate([x, facets, x[:1] + 1e300]))
    np.testing.assert_array_equal(cell[len(x) : -1] >= 0, True)
    found = cell[: len(x)] >= 0
    place = locator(mesh)
    xi = place.locate(x)[1]
    np.testing.assert_allclose(
        place.pull_back(x[found], cell[: len(x)][found]), xi[found], atol=1e-14
    )
    assert place.agrees(x[found], xi[found], cell[: len(x)][found]).all()
    assert not place.agrees(x[found] + 1e-6, xi[found], cell[: len(x)][found]).any()


@pytest.mark.parametrize("n", [3, 49, 98, 107])
def test_points_on_walls_are_inside_for_any_number_of_cells(n):
    mesh = dmesh.create_rectangle(SERIAL, [(0, 0.1), (1, 0.7)], [n, n], KIND[2])
    walls = [(1.0, 0.3), (0.3, 0.7), (1.0, 0.7), (0.0, 0.1), (0.4, 0.1)]
    cell, xi = locator(mesh).locate(np.array(walls))
    assert np.all(cell >= 0)
    np.testing.assert_allclose(cell_geometry(mesh).push_forward(cell, xi), walls, atol=1e-15)


@pytest.mark.mpi
@BOTH
def test_numbers_cells_and_nodes_lead_to_each_other(d):
    mesh = box(d, comm=COMM)
    lattice = lattice_of(mesh)
    np.testing.assert_allclose(lattice.origin, LOWER[:d], rtol=0, atol=1e-15)
    np.testing.assert_allclose(lattice.spacing * lattice.shape, (UPPER - LOWER)[:d], rtol=1e-15)
    cells = np.arange(lattice.geometry.num_cells, dtype=np.int32)
    corners = mesh.geometry.x[geometry_dofmap(mesh)][:, :, :d]
    lower = lattice.origin + lattice.numbers(cells) * lattice.spacing
    np.testing.assert_allclose(lower, corners.min(axis=1, initial=np.inf), rtol=0, atol=2e-15)
    np.testing.assert_array_equal(lattice.cells(lattice.numbers(cells)), cells)
    everywhere = itertools.product(*(range(-1, n + 2) for n in lattice.shape))
    numbers = np.array(list(everywhere))
    nodes = lattice.nodes(numbers)
    here = nodes >= 0
    at = lattice.origin + numbers[here] * lattice.spacing
    np.testing.assert_allclose(mesh.geometry.x[nodes[here], :d], at, rtol=0, atol=2e-15)
    np.testing.assert_array_equal(np.sort(nodes[here]), np.arange(len(mesh.geometry.x)))


@BOTH
def test_nodes_of_turned_cells(d):
    mesh = turned(d)
    lattice = lattice_of(mesh)
    numbers = np.array(list(itertools.product(*(range(n + 1) for n in lattice.shape))))
    at = lattice.origin + numbers * lattice.spacing
    np.testing.assert_allclose(mesh.geometry.x[lattice.nodes(numbers), :d], at, atol=2e-15)


def test_nodes_off_their_places_by_more_than_round_off_count_where_they_are():
    mesh = box(2)
    off = np.random.default_rng(1).uniform(-1e-11, 1e-11, (len(mesh.geometry.x), 2))
    mesh.geometry.x[:, :2] += off
    geometry = cell_geometry(mesh)
    assert Locator(mesh).is_lattice and geometry.stored is not None
    check(mesh, mesh.geometry.x[:, :2].copy())
    body = points.fill(mesh, 2)
    basis.use(body, "quadratic")
    assert lattice_of(mesh).nodes(np.array([[0, 0], [5, 6]])).min() >= 0
    mesh.geometry.x[0, 0] += 1e-6
    assert not Locator(mesh).is_lattice


@BOTH
def test_the_smallest_change_of_a_node_is_noticed(d):
    mesh = box(d)
    geometry = cell_geometry(mesh)
    x = mesh.geometry.x
    assert not geometry.has_moved(mesh)
    for i, k in ((0, 0), (len(x) // 2, 1), (len(x) - 1, d - 1)):
        before = x[i, k]
        x[i, k] = np.nextafter(before, 10.0)
        assert geometry.has_moved(mesh)
        x[i, k] = before
        assert not geometry.has_moved(mesh)
    x[[3, 4]] = x[[4, 3]]  # the same numbers elsewhere
    assert geometry.has_moved(mesh)


def test_memory_of_a_large_room_with_a_small_body():
    """Two int32 tables, and one block of candidates at a time."""

    def build(n):
        mesh = dmesh.create_unit_cube(SERIAL, n, n, n, KIND[3])

        def corner(x):
            return x.max(axis=0) < 3.9 / n

        # newer ones give a copy, which is theirs
        of_dolfinx = 32 * n**3 * (geometry_dofmap(mesh).base is None)
        tracemalloc.start()
        lattice_of(mesh)
        kept = tracemalloc.get_traced_memory()[0] - of_dolfinx
        bodies = [
            points.lattice(mesh, 0.5 / n, inside=corner),
            points.fill(mesh, 2, inside=corner),
            points.random(mesh, 8, seed=1, inside=corner),
            points.quadrature(mesh, 3, inside=corner),
        ]
        peak = tracemalloc.get_traced_memory()[1] - of_dolfinx
        tracemalloc.stop()
        assert [b.size_global for b in bodies[:2]] == [512, 512]
        return kept, peak

    build(4)  # compiles
    n = 48  # 110592 cells, 900 thousand places for points, 44 MB as arrays
    kept, peak = build(n)
    assert kept <= 9 * n**3 + 1e5
    assert peak < 20e6
