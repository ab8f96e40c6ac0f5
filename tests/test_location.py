# SPDX-License-Identifier: MIT
"""The cell found for a point against a search through all cells."""

from mpi4py import MPI

import basix.ufl
import numpy as np
import pytest
import ufl
from dolfinx import mesh as dmesh
from dolfinx.mesh import CellType

from fenicsmpm._compat import geometry_dofmap
from fenicsmpm.points import MaterialPoints, quadrature
from fenicsmpm.points.geometry import cell_geometry
from fenicsmpm.points.location import Locator, locator

pytestmark = pytest.mark.ranks

SERIAL = MPI.COMM_SELF


def box(kind, n=4, lower=(0.0, 0.0, 0.0), upper=(1.0, 1.0, 1.0)):
    if kind in (CellType.triangle, CellType.quadrilateral):
        return dmesh.create_rectangle(SERIAL, [lower[:2], upper[:2]], [n, n + 1], kind)
    return dmesh.create_box(SERIAL, [lower, upper], [n, n + 1, n], kind)


def distort(mesh, amount=0.06, seed=3):
    """Move all vertices inside the unit square or cube at random: cells become non-affine."""
    x = mesh.geometry.x
    d = mesh.geometry.dim
    inner = np.all((x[:, :d] > 1e-9) & (x[:, :d] < 1 - 1e-9), axis=1)
    shift = np.random.default_rng(seed).uniform(-amount, amount, (len(x), d))
    x[inner, :d] += shift[inner]
    return mesh


def part(mesh, keep):
    """The mesh of the cells whose midpoints satisfy a predicate."""
    d = mesh.topology.dim
    cells = np.arange(mesh.topology.index_map(d).size_local, dtype=np.int32)
    mid = dmesh.compute_midpoints(mesh, d, cells)
    return dmesh.create_submesh(mesh, d, cells[keep(mid)])[0]


def brute_force(mesh, x, tolerance=1e-10):
    """All cells that contain each point, by dolfinx's own pull-back."""
    d = mesh.geometry.dim
    corners = mesh.geometry.x[geometry_dofmap(mesh)]
    simplex = corners.shape[1] == d + 1
    lower, upper = corners.min(axis=1)[:, :d] - 1e-9, corners.max(axis=1)[:, :d] + 1e-9
    found = []
    for point in x:
        cells = []
        for c in np.flatnonzero(np.all((point >= lower) & (point <= upper), axis=1)):
            try:
                xi = mesh.geometry.cmap.pull_back(point[None], corners[c][:, :d].copy())[0]
            except RuntimeError:
                continue  # Newton's method did not converge
            highest = xi.sum() if simplex else xi.max()
            if xi.min() >= -tolerance and highest <= 1.0 + tolerance:
                cells.append(int(c))
        found.append(cells)
    return found


def check(mesh, x, hint=None):
    """Locate and compare: any containing cell inside, the lowest one on facets, -1 outside."""
    finder = Locator(mesh)
    cell, xi = finder.locate(x, hint)
    key = finder.geometry.key
    for p, candidates in enumerate(brute_force(mesh, x)):
        expected = min(candidates, key=lambda c: key[c], default=-1)
        assert cell[p] == expected, (p, x[p], cell[p], candidates)
    assert cell.dtype == np.int32
    found = cell >= 0
    back = np.array(
        [
            mesh.geometry.cmap.push_forward(
                xi[p : p + 1], mesh.geometry.x[geometry_dofmap(mesh)[cell[p]]][:, : x.shape[1]]
            )[0]
            for p in np.flatnonzero(found)
        ]
    ).reshape(-1, x.shape[1])
    np.testing.assert_allclose(back, x[found], rtol=0, atol=2e-15 * max(1.0, np.abs(x).max()))
    return cell


KINDS = [CellType.triangle, CellType.tetrahedron, CellType.quadrilateral, CellType.hexahedron]


@pytest.mark.parametrize("kind", KINDS, ids=lambda k: k.name)
@pytest.mark.parametrize("distorted", [False, True], ids=["regular", "distorted"])
def test_random_points_against_brute_force(kind, distorted):
    mesh = box(kind)
    if distorted:
        distort(mesh)
    x = np.random.default_rng(0).uniform(-0.1, 1.1, (300, mesh.geometry.dim))
    cell = check(mesh, x)
    np.testing.assert_array_equal(cell < 0, np.any((x < 0) | (x > 1), axis=1))
    hint = np.random.default_rng(1).integers(-1, len(geometry_dofmap(mesh)), len(x))
    np.testing.assert_array_equal(check(mesh, x, hint.astype(np.int32)), cell)


@pytest.mark.parametrize("kind", KINDS, ids=lambda k: k.name)
@pytest.mark.parametrize("distorted", [False, True], ids=["regular", "distorted"])
def test_vertices_edges_and_faces_go_to_the_lowest_cell(kind, distorted):
    mesh = box(kind, n=3)
    if distorted:
        distort(mesh)
    d = mesh.geometry.dim
    corners = mesh.geometry.x[geometry_dofmap(mesh)][:, :, :d]
    vertices = mesh.geometry.x[:, :d]
    edges = 0.5 * (corners[:, 0] + corners[:, 1])
    facets = (
        corners[:, :d].mean(axis=1) if len(corners[0]) == d + 1 else corners[:, :2].mean(axis=1)
    )
    x = np.concatenate([vertices, edges, facets])
    first = check(mesh, x)
    assert np.all(first >= 0)
    for seed in range(3):
        hint = np.random.default_rng(seed).integers(0, len(corners), len(x)).astype(np.int32)
        np.testing.assert_array_equal(Locator(mesh).locate(x, hint)[0], first)


def test_lattices_are_recognised():
    assert Locator(box(CellType.quadrilateral, lower=(-3, 1, 0), upper=(5, 1.3, 0))).is_lattice
    assert Locator(box(CellType.hexahedron, lower=(-3, 1, 7), upper=(5, 1.3, 8.1))).is_lattice
    assert Locator(part(box(CellType.quadrilateral), lambda x: x[:, 0] + x[:, 1] < 1)).is_lattice
    assert not Locator(distort(box(CellType.quadrilateral))).is_lattice
    assert not Locator(box(CellType.triangle)).is_lattice
    graded = box(CellType.quadrilateral)
    graded.geometry.x[:, 0] **= 2
    assert not Locator(graded).is_lattice


@pytest.mark.parametrize("kind", KINDS, ids=lambda k: k.name)
def test_any_origin_and_spacing(kind):
    lower, upper = np.array([-1e3, 5.0, 1e-3]), np.array([-1e3 + 0.7, 8.0, 0.3])
    mesh = box(kind, lower=lower, upper=upper)
    d = mesh.geometry.dim
    x = np.random.default_rng(2).uniform(lower[:d], upper[:d], (200, d))
    assert np.all(check(mesh, x) >= 0)
    # All vertices are found from all cells, although their round-off is large for the cells.
    vertices = np.unique(mesh.geometry.x[:, :d], axis=0)
    first = Locator(mesh).locate(vertices)[0]
    assert np.all(first >= 0)
    last = np.full(len(vertices), len(geometry_dofmap(mesh)) - 1, dtype=np.int32)
    np.testing.assert_array_equal(Locator(mesh).locate(vertices, last)[0], first)


@pytest.mark.parametrize("kind", KINDS, ids=lambda k: k.name)
def test_a_walk_across_a_notch(kind):
    """The straight way between the legs of a U leaves the mesh."""
    mesh = part(box(kind, n=6), lambda x: (np.abs(x[:, 0] - 0.5) > 0.17) | (x[:, 1] < 0.3))
    x = np.random.default_rng(4).uniform(0, 1, (300, mesh.geometry.dim))
    cell = check(mesh, x)
    assert 0 < np.sum(cell < 0) < len(x)
    hint = np.random.default_rng(5).integers(0, len(geometry_dofmap(mesh)), len(x))
    np.testing.assert_array_equal(check(mesh, x, hint.astype(np.int32)), cell)


@pytest.mark.parametrize("kind", [CellType.triangle, CellType.quadrilateral], ids=lambda k: k.name)
def test_two_squares_apart(kind):
    mesh = part(box(kind, n=6), lambda x: np.abs(x[:, 0] - 0.5) > 0.17)
    x = np.array([[0.1, 0.5], [0.9, 0.5], [0.5, 0.5], [1.0, 1.0], [1.0 / 3.0, 0.2]])
    expected = check(mesh, x)
    assert list(expected >= 0) == [True, True, False, True, True]
    for start in range(len(geometry_dofmap(mesh))):
        hint = np.full(len(x), start, dtype=np.int32)
        np.testing.assert_array_equal(Locator(mesh).locate(x, hint)[0], expected)


def test_graded_cells_over_five_decades():
    mesh = box(CellType.triangle, n=20)
    mesh.geometry.x[:, 0] = 10.0 ** (5.0 * (mesh.geometry.x[:, 0] - 1.0))
    x = np.random.default_rng(6).uniform(size=(200, 2))
    x[:, 0] = 10.0 ** (5.0 * (x[:, 0] - 1.0))
    assert np.all(check(mesh, x) >= 0)


@pytest.mark.parametrize("corner", [0.55, 0.8, 0.95])
def test_strongly_distorted_quadrilateral(corner):
    """One corner pulled in almost to the diagonal; the map is inverted all the same."""
    mesh = dmesh.create_unit_square(SERIAL, 1, 1, CellType.quadrilateral)
    x = mesh.geometry.x
    x[np.all(np.isclose(x[:, :2], 1.0), axis=1), :2] = corner
    xi = np.random.default_rng(7).uniform(size=(500, 2))
    finder = Locator(mesh)
    points = finder.geometry.push_forward(np.zeros(500, dtype=np.int32), xi)
    cell, found = finder.locate(points)
    assert np.all(cell == 0)
    np.testing.assert_allclose(found, xi, atol=1e-12)


def test_tolerance_at_the_boundary():
    mesh = box(CellType.triangle)
    inside = np.array([[-1e-14, 0.5], [1.0 + 1e-14, 0.5], [0.3, 1.0 + 1e-14]])
    outside = np.array([[-1e-9, 0.5], [1.0 + 1e-9, 0.5], [0.3, 1.0 + 1e-9], [1e300, -1e300]])
    for hint in (None, 0):
        start = None if hint is None else np.zeros(3, dtype=np.int32)
        assert np.all(Locator(mesh).locate(inside, start)[0] >= 0)
    assert np.all(Locator(mesh).locate(outside)[0] == -1)


def test_flat_cells_are_an_error():
    mesh = box(CellType.triangle)
    mesh.geometry.x[:, 1] = 0.0
    with pytest.raises(ValueError, match="40 cells of zero volume"):
        Locator(mesh)


def one_cell(kind, vertices):
    """A mesh of one cell with vertices in the order of dolfinx."""
    d = len(vertices[0])
    element = basix.ufl.element("Lagrange", kind, 1, shape=(d,))
    cells = np.arange(len(vertices))[None]
    return dmesh.create_mesh(SERIAL, cells=cells, x=np.array(vertices), e=ufl.Mesh(element))


FOLDED = {
    "quadrilateral": [[0, 0], [1, 0], [0, 1], [0.2, 0.2]],
    "quadrilateral, turned over": [[0, 0], [0, 1], [1, 0], [0.2, 0.2]],
    "quadrilateral, crossed": [[0, 0], [1, 0], [1, 1], [0, 1]],
    # det = 0.094 or more at the vertices, -0.15 in the middle of an edge
    "hexahedron, at an edge": [
        [-0.1, -0.2, -0.4],
        [1.0, 0.5, 0.0],
        [0.4, 0.7, -0.1],
        [0.7, 1.4, 0.6],
        [-0.3, 0.4, 0.7],
        [0.7, -0.5, 1.3],
        [0.6, 1.6, 0.6],
        [1.4, 0.4, 1.1],
    ],
    # det > 0 at all vertices and centres of edges, faces and the cell, and somewhere -0.063
    "hexahedron, elsewhere": [
        [-0.2, 0.0, -0.5],
        [1.5, 0.8, 0.4],
        [-0.3, 0.6, 0.6],
        [0.3, 1.3, -0.7],
        [-0.5, 0.4, 1.8],
        [0.5, 0.2, 0.9],
        [0.7, 1.7, 0.9],
        [1.2, 0.7, 0.9],
    ],
}


@pytest.mark.parametrize("name", FOLDED)
def test_folded_cells_are_an_error(name):
    vertices = np.array(FOLDED[name])
    for scale, shift in ((1.0, 0.0), (1e-6, 0.0), (1.0, 1e3)):
        mesh = one_cell(name.split(",")[0], scale * (vertices + shift))
        with pytest.raises(ValueError, match="with 1 cells whose Jacobian changes its sign") as e:
            MaterialPoints(mesh, mesh.geometry.x[:1, : vertices.shape[1]], 1.0)
        assert f"first number 0 with vertices [[{scale * (vertices[0, 0] + shift)}," in str(e.value)


def test_cells_with_edges_in_line_are_none():
    """Their determinant is zero at a vertex, or along a whole edge of a wedge."""
    for vertices in (
        [[0, 0], [1, 0], [0, 1], [0.5, 0.5]],
        [[0, 0], [0, 1], [1, 0], [0.5, 0.5]],
        [[0, 0], [1, 0], [0, 1], [0, 1]],
        [[0.1, 0.1], [0.3, 0.1], [0.1, 0.3], [0.2, 0.2]],
        [[*x, z] for z in (0, 1) for x in ((0, 0), (1, 0), (0, 1), (0.5, 0.5))],
        [[*x, z] for z in (0, 1) for x in ((0, 0), (1, 0), (0, 1), (0, 1))],
    ):
        kind = "quadrilateral" if len(vertices) == 4 else "hexahedron"
        geometry = cell_geometry(one_cell(kind, vertices))
        half = 0.5 * (vertices[1][0] - vertices[0][0] + vertices[1][1] - vertices[0][1]) ** 2
        np.testing.assert_allclose(geometry.owned_volumes, half, rtol=1e-14)


def test_folded_hexahedra_are_those_found_by_looking_everywhere():
    """Random vertices; the determinant at 21^3 points of each cell, by basix."""
    unit = basix.geometry(basix.CellType.hexahedron)
    line = np.linspace(0.0, 1.0, 21)
    everywhere = np.stack(np.meshgrid(line, line, line), axis=-1).reshape(-1, 3)
    element = basix.create_element(basix.ElementFamily.P, basix.CellType.hexahedron, 1)
    table = element.tabulate(1, everywhere)[1:, :, :, 0]  # (axis, point, vertex)
    found = {True: 0, False: 0}
    rng = np.random.default_rng(7)
    for _ in range(60):
        vertices = unit + rng.uniform(-0.45, 0.45, unit.shape)
        det = np.linalg.det(np.einsum("jpv,vi->pij", table, vertices))
        if abs(det.min()) < 5e-3:
            continue  # 21 points are not enough to tell
        try:
            cell_geometry(one_cell("hexahedron", vertices))
            is_folded = False
        except ValueError:
            is_folded = True
        assert is_folded == (det.min() < 0)
        found[is_folded] += 1
    assert min(found.values()) > 10


@pytest.mark.mpi
@pytest.mark.parametrize(
    "kind", [CellType.quadrilateral, CellType.hexahedron], ids=lambda k: k.name
)
def test_one_folded_cell_of_a_mesh_is_named_on_all_ranks(kind):
    """A vertex next to a corner of the mesh goes beyond the diagonal of that corner's cell."""
    world = MPI.COMM_WORLD
    d = 2 if kind == CellType.quadrilateral else 3
    make = dmesh.create_unit_square if d == 2 else dmesh.create_unit_cube
    mesh = make(world, *d * [4], kind)
    mesh.topology.create_connectivity(d, d)
    geometry = cell_geometry(mesh)
    in_corner = np.all(geometry.corners(np.arange(geometry.num_owned)) < 0.3, axis=(1, 2))
    x = mesh.geometry.x
    x[np.all(np.abs(x[:, :d] - 0.25) < 1e-9, axis=1), :d] = 0.05
    (number,) = np.concatenate(world.allgather(geometry.key[: geometry.num_owned][in_corner]))
    with pytest.raises(ValueError, match=f"1 cells .* its sign, first number {number} with"):
        quadrature(mesh, 2)


def test_locator_is_built_once_and_does_not_keep_the_mesh():
    import gc
    import weakref

    mesh = box(CellType.triangle)
    assert locator(mesh) is locator(mesh)
    alive = weakref.ref(mesh)
    del mesh
    gc.collect()
    assert alive() is None
