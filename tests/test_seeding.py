# SPDX-License-Identifier: MIT
"""Seeding: weights sum to volumes, rules are those of dolfinx, results do not depend on ranks."""

from mpi4py import MPI

import basix
import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx import mesh as dmesh
from dolfinx.mesh import CellType

from fenicsmpm.points import (
    MaterialPoints,
    PointsOutsideError,
    fill,
    from_mesh,
    lattice,
    on_curve,
    on_facets,
    quadrature,
    random,
)

WORLD = MPI.COMM_WORLD
KINDS = [CellType.triangle, CellType.tetrahedron, CellType.quadrilateral, CellType.hexahedron]

pytestmark = [pytest.mark.mpi, pytest.mark.ranks]


def bend(x):
    """A smooth map under which quadrilaterals and hexahedra become non-affine."""
    y = x.copy()
    y[:, 0] += 0.3 * x[:, 1] ** 2 + 0.2 * x[:, 0] * x[:, 2]
    y[:, 1] += 0.2 * np.sin(2 * x[:, 0]) - 0.1 * x[:, 2] ** 2
    return y


def box(kind, n=3, bent=False, comm=WORLD):
    if kind in (CellType.triangle, CellType.quadrilateral):
        mesh = dmesh.create_rectangle(comm, [(0, 0), (2, 1)], [n, n + 1], kind)
    else:
        mesh = dmesh.create_box(comm, [(0, 0, 0), (2, 1, 1)], [n, n + 1, n], kind)
    if bent:
        mesh.geometry.x[:] = bend(mesh.geometry.x)
    return mesh


def integral(mesh, f=1.0, measure=ufl.dx, degree=4):
    """dolfinx's integral of a function of x."""
    x = ufl.SpatialCoordinate(mesh)
    value = f(x) if callable(f) else fem.Constant(mesh, f)
    form = fem.form(value * measure(domain=mesh, metadata={"quadrature_degree": degree}))
    return mesh.comm.allreduce(fem.assemble_scalar(form))


def total(points, values):
    return points.mesh.comm.allreduce(float(np.sum(points.weight * values)))


def gathered(points, array):
    return np.concatenate(points.mesh.comm.allgather(array))


SEEDINGS = {
    "quadrature": lambda mesh: quadrature(mesh, 2),
    "fill": lambda mesh: fill(mesh, 3),
    "random": lambda mesh: random(mesh, 5, seed=1),
}


@pytest.mark.parametrize("kind", KINDS, ids=lambda k: k.name)
@pytest.mark.parametrize("bent", [False, True], ids=["regular", "bent"])
@pytest.mark.parametrize("seeding", SEEDINGS)
def test_weights_sum_to_the_volume(kind, bent, seeding):
    mesh = box(kind, bent=bent)
    points = SEEDINGS[seeding](mesh)
    np.testing.assert_allclose(points.volume(), integral(mesh), rtol=1e-13)
    # and they do so in every cell
    cells = np.arange(mesh.topology.index_map(mesh.topology.dim).size_local, dtype=np.int32)
    q0 = fem.functionspace(mesh, ("DG", 0))
    volume = fem.assemble_vector(
        fem.form(ufl.TestFunction(q0) * ufl.dx(metadata={"quadrature_degree": 4}))
    ).array[q0.dofmap.list[cells, 0]]
    by_cell = np.bincount(points.cell, points.weight, minlength=len(cells))
    np.testing.assert_allclose(by_cell, volume, rtol=1e-12)
    assert np.all(np.diff(points.cell) >= 0)
    np.testing.assert_array_equal(points.order, np.arange(len(points)))


@pytest.mark.parametrize("kind", KINDS, ids=lambda k: k.name)
@pytest.mark.parametrize("bent", [False, True], ids=["regular", "bent"])
@pytest.mark.parametrize("degree", [1, 2, 5])
def test_quadrature_is_that_of_dolfinx(kind, bent, degree):
    mesh = box(kind, bent=bent)
    points = quadrature(mesh, degree)

    def f(x):
        return ufl.sin(3 * x[0]) * ufl.exp(x[1])

    values = np.sin(3 * points.x[:, 0]) * np.exp(points.x[:, 1])
    np.testing.assert_allclose(
        total(points, values), integral(mesh, f, degree=degree), rtol=1e-13, atol=1e-14
    )


@pytest.mark.parametrize("kind", KINDS, ids=lambda k: k.name)
def test_seeds_are_where_they_are_located(kind):
    mesh = box(kind, bent=True)
    for seeding in SEEDINGS.values():
        points = seeding(mesh)
        again = MaterialPoints(mesh, points.x, points.weight)
        np.testing.assert_array_equal(again.cell, points.cell)
        np.testing.assert_allclose(again.xi, points.xi, atol=1e-13)


@pytest.mark.parametrize("kind", KINDS, ids=lambda k: k.name)
@pytest.mark.parametrize("k", [1, 2, 4])
def test_fill_cuts_cells_into_equal_parts(kind, k):
    mesh = box(kind, n=2)
    points = fill(mesh, k)
    d = mesh.geometry.dim
    cells = mesh.topology.index_map(d).size_global
    assert points.size_global == cells * k**d
    np.testing.assert_allclose(points.weight, integral(mesh) / points.size_global, rtol=1e-12)
    # The centroids of equal parts integrate linear functions exactly, so the mean is the centre.
    mean = [total(points, points.x[:, i]) / points.volume() for i in range(d)]
    np.testing.assert_allclose(mean, [1.0, 0.5, 0.5][:d], rtol=1e-13)


def test_fill_of_a_triangle():
    """Four equal parts: centroids at thirds of a half, the middle one in the middle."""
    mesh = dmesh.create_unit_square(MPI.COMM_SELF, 1, 1)
    xi = fill(mesh, 2).xi[:4]
    expected = np.array([[1, 1], [1, 4], [4, 1], [2, 2]]) / 6
    distance = np.linalg.norm(xi[:, None] - expected, axis=2)
    np.testing.assert_allclose(distance.min(axis=0), 0.0, atol=1e-15)


def test_cells_and_predicate():
    mesh = box(CellType.quadrilateral, n=4)
    left = dmesh.locate_entities(mesh, 2, lambda x: x[0] < 1 + 1e-9)
    np.testing.assert_allclose(quadrature(mesh, 2, cells=left).volume(), 1.0)
    np.testing.assert_allclose(fill(mesh, 2, inside=lambda x: x[1] < 0.5).volume(), 1.0)
    assert np.all(quadrature(mesh, 1, tag=7).tag == 7)


def test_random_does_not_depend_on_ranks():
    for kind in KINDS:
        parallel = random(box(kind), 3, seed=11)
        serial = random(box(kind, comm=MPI.COMM_SELF), 3, seed=11)
        x = gathered(parallel, parallel.x)
        np.testing.assert_allclose(
            x[np.lexsort(x.T)], serial.x[np.lexsort(serial.x.T)], rtol=0, atol=1e-14
        )
        other = random(box(kind, comm=MPI.COMM_SELF), 3, seed=12)
        assert abs(other.x.sum() - serial.x.sum()) > 1e-3


def in_disc(x):
    return np.hypot(x[0] - 0.9, x[1] - 0.4) < 0.55


NUMBERED = {
    "quadrature": lambda mesh: quadrature(mesh, 2, inside=in_disc),
    "fill": lambda mesh: fill(mesh, 2, inside=in_disc),
    "random": lambda mesh: random(mesh, 3, seed=4, inside=in_disc),
    "lattice": lambda mesh: lattice(mesh, 0.07, inside=in_disc),
    "lattice on facets": lambda mesh: lattice(mesh, 0.125),
    "boundary": lambda mesh: on_facets(mesh, lambda x: np.isclose(x[1], 0.0), degree=3),
    "line": lambda mesh: on_curve(
        mesh, (0.1,) * mesh.geometry.dim, (0.8,) * mesh.geometry.dim, 0.02
    ),
    "from a mesh": lambda mesh: from_mesh(
        box(mesh.topology.cell_type, n=5, comm=mesh.comm), fill(mesh, 2, inside=in_disc)
    ),
    "sum": lambda mesh: _sum(lattice(mesh, 0.1, inside=in_disc), fill(mesh, 1)),
}


def _sum(body, other):
    body.add(other)
    return body


@pytest.mark.parametrize("kind", KINDS, ids=lambda k: k.name)
@pytest.mark.parametrize("seeding", NUMBERED)
def test_ids_do_not_depend_on_ranks(kind, seeding):
    parallel = NUMBERED[seeding](box(kind, n=4))
    serial = NUMBERED[seeding](box(kind, n=4, comm=MPI.COMM_SELF))
    ids = gathered(parallel, parallel.id)
    order = np.argsort(ids)
    assert len(ids) == parallel.size_global == len(serial) == parallel.next_id == serial.next_id
    np.testing.assert_array_equal(ids[order], np.arange(len(ids)))
    for name in ("x", "weight"):
        expected = serial[name][np.argsort(serial.id)]
        found = gathered(parallel, parallel[name])[order]
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-14)


def test_numbers_of_points():
    mesh = box(CellType.triangle)
    n = 5 if WORLD.rank == 0 else 2
    x = np.tile((0.5, 0.5), (n, 1))
    total = WORLD.allreduce(n)
    start = WORLD.exscan(n) or 0
    number = 10 * (total - start - np.arange(n))  # from behind
    points = MaterialPoints(mesh, x, 1.0, number=number, fields={"number": number})
    np.testing.assert_array_equal(points.id, points["number"] / 10 - 1)
    assert points.next_id == total
    here = WORLD.rank == WORLD.size - 1
    for wrong, message in (
        (np.where(here & (np.arange(n) == 0), 50, number + 10**15), None),
        (
            np.where(here & (np.arange(n) == 0), -1, number),
            "must not be negative, but the lowest is -1",
        ),
        (number // 20, "distinct, but several points have"),
        (number[:1], "number of shape"),
    ):
        if message is None:
            first = MaterialPoints(mesh, x, 1.0, number=wrong, fields={"number": wrong})
            assert gathered(first, first["number"])[gathered(first, first.id) == 0] == 50
            continue
        with pytest.raises(ValueError, match=message):
            MaterialPoints(mesh, x, 1.0, number=wrong)
    if WORLD.size > 1:
        with pytest.raises(ValueError, match="the same on all ranks"):
            MaterialPoints(mesh, x, 1.0, number=number if here else None)


def test_random_is_uniform():
    """Mean and covariance of points in a triangle and a tetrahedron, within 5 standard errors."""
    for kind, d in ((CellType.triangle, 2), (CellType.tetrahedron, 3)):
        n = 40000
        points = random(box(kind, n=1, comm=MPI.COMM_SELF), n, seed=5)
        xi = points.xi[:n]
        variance = d / ((d + 1) ** 2 * (d + 2))
        np.testing.assert_allclose(xi.mean(axis=0), 1 / (d + 1), atol=5 * np.sqrt(variance / n))
        covariance = np.cov(xi.T)
        np.testing.assert_allclose(np.diag(covariance), variance, rtol=0.05)
        np.testing.assert_allclose(covariance[0, 1], -variance / d, rtol=0.1)


@pytest.mark.parametrize("kind", KINDS, ids=lambda k: k.name)
def test_lattice(kind):
    """Spacing 1/8 divides the box; many points lie on facets, also on those between ranks."""
    mesh = box(kind, n=4)
    d = mesh.geometry.dim
    points = lattice(mesh, 0.125)
    assert points.size_global == 16 * 8 ** (d - 1)
    np.testing.assert_allclose(points.volume(), 2.0, rtol=1e-14)
    assert len(np.unique(gathered(points, points.x), axis=0)) == points.size_global
    half = lattice(mesh, 0.125, inside=lambda x: x[0] < 1)
    assert half.size_global == 8**d


def test_lattice_on_facets_is_not_doubled():
    """All points are on the diagonals of the squares."""
    mesh = dmesh.create_unit_square(WORLD, 8, 8)
    points = lattice(mesh, 0.125)
    assert points.size_global == 64
    np.testing.assert_allclose(points.volume(), 1.0, rtol=1e-14)
    serial = lattice(dmesh.create_unit_square(MPI.COMM_SELF, 8, 8), 0.125)
    x = gathered(points, points.x)
    np.testing.assert_array_equal(x[np.lexsort(x.T)], serial.x[np.lexsort(serial.x.T)])


@pytest.mark.parametrize("kind", KINDS, ids=lambda k: k.name)
@pytest.mark.parametrize("ghosts", [dmesh.GhostMode.none, dmesh.GhostMode.shared_facet])
def test_points_on_facets_lie_in_the_same_cells_on_any_number_of_ranks(kind, ghosts):
    """Points on vertices, edges and facets: all cells at a vertex compete for it."""
    side = [4] * (3 if kind in (CellType.tetrahedron, CellType.hexahedron) else 2)
    make = dmesh.create_box if len(side) == 3 else dmesh.create_rectangle
    lower, upper = np.zeros(len(side)), np.ones(len(side))
    x = np.stack(np.meshgrid(*[np.linspace(0, 1, 9)] * len(side)), axis=-1).reshape(-1, len(side))

    def cells(comm):
        mesh = make(comm, [lower, upper], side, kind, ghost_mode=ghosts)
        points = MaterialPoints(mesh, x if comm.rank == 0 else x[:0], 1.0)
        key = np.array(mesh.topology.original_cell_index)[points.cell]
        return dict(zip(gathered(points, points.id), gathered(points, key), strict=True))

    assert cells(WORLD) == cells(MPI.COMM_SELF)


def test_lattice_of_a_bent_mesh_approaches_its_volume():
    mesh = box(CellType.quadrilateral, bent=True, n=6)
    volume = integral(mesh)
    np.testing.assert_allclose(lattice(mesh, 0.01).volume(), volume, rtol=3e-3)


def test_from_mesh():
    background = dmesh.create_rectangle(WORLD, [(-1, -1), (4, 4)], [9, 9], CellType.quadrilateral)
    body = quadrature(box(CellType.triangle, bent=True), 2, tag=3)
    body.add_field("s", (2,), body.x)
    points = from_mesh(background, body)
    assert points.mesh is background
    assert points.size_global == body.size_global
    np.testing.assert_allclose(points.volume(), integral(body.mesh), rtol=1e-13)
    np.testing.assert_array_equal(points["s"], points.x)
    assert np.all(points.tag == 3)
    small = dmesh.create_unit_square(WORLD, 2, 2)
    with pytest.raises(PointsOutsideError, match="outside the background mesh"):
        from_mesh(small, body)


@pytest.mark.parametrize("kind", KINDS, ids=lambda k: k.name)
@pytest.mark.parametrize("bent", [False, True], ids=["regular", "bent"])
def test_facets(kind, bent):
    mesh = box(kind, bent=bent)
    d = mesh.geometry.dim
    mesh.topology.create_connectivity(d - 1, d)
    everything = dmesh.exterior_facet_indices(mesh.topology)
    points = on_facets(mesh, everything, degree=4)
    np.testing.assert_allclose(
        points.volume(), integral(mesh, measure=ufl.ds, degree=4), rtol=1e-12
    )

    def f(x):
        return x[0] ** 2 + x[1]

    np.testing.assert_allclose(
        total(points, points.x[:, 0] ** 2 + points.x[:, 1]),
        integral(mesh, f, measure=ufl.ds, degree=4),
        rtol=1e-12,
    )
    normal = points["normal"]
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0, rtol=1e-14)
    n = ufl.FacetNormal(mesh)
    for k in range(d):  # of a function that is no gradient, so that each normal counts
        np.testing.assert_allclose(
            total(points, normal[:, k] * (points.x[:, 0] ** 2 + points.x[:, 1])),
            integral(mesh, lambda x, k=k: f(x) * n[k], measure=ufl.ds, degree=4),
            atol=1e-12,
        )


def test_facets_by_predicate_and_inner_facets():
    mesh = box(CellType.tetrahedron)
    end = on_facets(mesh, lambda x: np.isclose(x[0], 2.0))
    np.testing.assert_allclose(end.volume(), 1.0, rtol=1e-13)
    np.testing.assert_allclose(end.x[:, 0], 2.0, rtol=1e-15)
    d = 3
    mesh.topology.create_entities(d - 1)
    facets = mesh.topology.index_map(d - 1).size_local
    np.testing.assert_allclose(end["normal"], np.tile([1.0, 0.0, 0.0], (len(end), 1)), atol=1e-14)
    everything = on_facets(mesh, np.arange(facets, dtype=np.int32))
    np.testing.assert_allclose(np.linalg.norm(everything["normal"], axis=1), 1.0, rtol=1e-14)
    expected = integral(mesh, measure=ufl.ds) + integral(mesh, measure=ufl.dS)
    np.testing.assert_allclose(everything.volume(), expected, rtol=1e-12)


def test_curve():
    mesh = box(CellType.triangle)
    points = on_curve(mesh, (0.5, 0.1), (1.5, 0.1), 0.02)
    assert points.size_global == 50
    np.testing.assert_allclose(points.volume(), 1.0, rtol=1e-14)
    # the lower side of a body on its way counter-clockwise
    np.testing.assert_allclose(points["normal"], np.tile([0.0, -1.0], (len(points), 1)))
    assert "normal" not in on_curve(box(CellType.hexahedron), (0, 0, 0.5), (1, 0, 0.5), 0.1)
    x = np.sort(gathered(points, points.x)[:, 0])
    np.testing.assert_allclose(x, 0.51 + 0.02 * np.arange(50), rtol=1e-14)
    assert on_curve(mesh, (0, 0), (2, 1), 0.4).size_global == 6
    with pytest.raises(PointsOutsideError):
        on_curve(mesh, (0, 0), (3, 1), 0.1)


def test_what_gives_no_points():
    mesh = box(CellType.triangle)

    def nowhere(x):
        return x[0] > 5

    for call in (
        lambda: quadrature(mesh, 2, inside=nowhere),
        lambda: fill(mesh, 2, inside=nowhere),
        lambda: random(mesh, 2, seed=0, inside=nowhere),
        lambda: lattice(mesh, 0.1, inside=nowhere),
        lambda: on_facets(mesh, nowhere),
    ):
        with pytest.raises(ValueError, match="gives no points in nowhere"):
            call()
    with pytest.raises(ValueError, match="gives no points in the given cells"):
        quadrature(mesh, 2, cells=[])
    with pytest.raises(ValueError, match="lattice of spacing 9"):
        lattice(mesh, 9.0)


def test_invalid_arguments():
    mesh = box(CellType.triangle)
    for call, message in (
        (lambda: quadrature(mesh, -1), "degree"),
        (lambda: quadrature(mesh, 1, cells=[10**6]), "cells to fill"),
        (lambda: quadrature(mesh, 1, inside=lambda x: x[0]), "must return a mask"),
        (lambda: fill(mesh, 0), "per_side must be at least 1"),
        (lambda: random(mesh, 0, seed=1), "per_cell must be at least 1"),
        (lambda: lattice(mesh, 0.0), "spacing"),
        (lambda: lattice(mesh, np.nan), "spacing"),
        (lambda: on_facets(mesh, [10**6]), "must be local indices from 0"),
        (lambda: on_curve(mesh, (0, 0), (0, 0), 0.1), "positive length"),
        (lambda: on_curve(mesh, (0, 0), (1, 0), -0.1), "positive spacing, not 1.0 and -0.1"),
        (lambda: on_curve(mesh, (0, 0, 0), (1, 0, 0), 0.1), "2 coordinates"),
    ):
        with pytest.raises(ValueError, match=message):
            call()


def test_rules_of_basix():
    """The points of a cell are those of basix' default rule."""
    mesh = box(CellType.tetrahedron, n=1, comm=MPI.COMM_SELF)
    points, weights = basix.make_quadrature(basix.CellType.tetrahedron, 4)
    np.testing.assert_array_equal(quadrature(mesh, 4).xi[: len(weights)], points)
    with pytest.raises(ValueError, match=r"weight -0.133.*take another degree"):
        quadrature(mesh, 3)
