# SPDX-License-Identifier: MIT
"""MaterialPoints: arrays, changes, errors and what travels between ranks."""

from mpi4py import MPI

import basix.ufl
import numpy as np
import pytest
import ufl
from dolfinx import mesh as dmesh
from dolfinx.mesh import CellType

from fenicsmpm.points import MaterialPoints, PointsOutsideError, at, quadrature
from fenicsmpm.points.geometry import cell_geometry
from fenicsmpm.points.migration import exchange
from fenicsmpm.points.sorting import order_by_number

WORLD = MPI.COMM_WORLD
KINDS = [CellType.triangle, CellType.tetrahedron, CellType.quadrilateral, CellType.hexahedron]

pytestmark = [pytest.mark.mpi, pytest.mark.ranks]


def box(kind=CellType.triangle, n=5, comm=WORLD):
    if kind in (CellType.triangle, CellType.quadrilateral):
        return dmesh.create_unit_square(comm, n, n, kind)
    return dmesh.create_unit_cube(comm, n, n, n, kind)


def cloud(n, d, seed=0):
    """The same random positions on all ranks."""
    return np.random.default_rng(seed).random((n, d))


def everywhere(points, name):
    """An array of all points on all ranks, in the order of the ids."""
    ids = np.concatenate(WORLD.allgather(points.id))
    values = np.concatenate(WORLD.allgather(points[name]))
    assert len(np.unique(ids)) == len(ids) == points.size_global
    return values[np.argsort(ids)]


def check_consistent(points):
    """Every point is in an owned cell whose map gives its position."""
    geometry = cell_geometry(points.mesh)
    assert np.all((points.cell >= 0) & (points.cell < geometry.num_owned))
    back = geometry.push_forward(points.cell, points.xi)
    np.testing.assert_allclose(back, points.x, rtol=0, atol=1e-15)
    lowest, highest = points.xi.min(initial=0.0), points.xi.max(initial=0.0)
    assert lowest >= -1e-12 and highest <= 1 + 1e-12
    by_cell = points.cell[points.order]
    offsets = points.cell_offsets
    assert offsets.shape == (geometry.num_cells + 1,)
    assert offsets.dtype == points.order.dtype == np.int64
    np.testing.assert_array_equal(by_cell, np.repeat(np.arange(len(offsets) - 1), np.diff(offsets)))


@pytest.mark.parametrize("kind", KINDS, ids=lambda k: k.name)
@pytest.mark.parametrize("source", ["rank 0", "last rank", "all ranks"])
def test_points_arrive_at_the_owners_of_their_cells(kind, source):
    mesh = box(kind)
    d = mesh.geometry.dim
    x = cloud(500, d)
    n = len(x)
    parts = {
        "rank 0": [slice(None)] + [slice(0, 0)] * (WORLD.size - 1),
        "last rank": [slice(0, 0)] * (WORLD.size - 1) + [slice(None)],
        "all ranks": [slice(r * n // WORLD.size, (r + 1) * n // WORLD.size) for r in range(99)],
    }
    part = parts[source][WORLD.rank]
    tensor = x[:, :, None] * x[:, None, :]
    points = MaterialPoints(
        mesh,
        x[part],
        x[part].sum(axis=1),
        tag=np.arange(n)[part],
        fields={"a": x[part, 0], "T": tensor[part]},
    )
    check_consistent(points)
    assert points.size_global == n
    assert points.field_names == ("a", "T")
    assert points.field_shape("T") == (d, d)
    np.testing.assert_array_equal(everywhere(points, "id"), np.arange(n))
    np.testing.assert_array_equal(everywhere(points, "x"), x)
    np.testing.assert_array_equal(everywhere(points, "weight"), x.sum(axis=1))
    np.testing.assert_array_equal(everywhere(points, "tag"), np.arange(n))
    np.testing.assert_array_equal(everywhere(points, "T"), tensor)
    np.testing.assert_allclose(points.volume(), x.sum(), rtol=1e-13)
    np.testing.assert_array_equal(points.bounds(), (x.min(axis=0), x.max(axis=0)))
    for name, dtype in (("cell", np.int32), ("id", np.int64), ("tag", np.int32)):
        assert points[name].dtype == dtype
    assert all(points[name].flags.c_contiguous for name in (*points.field_names, "x", "xi"))


@pytest.mark.parametrize("kind", KINDS, ids=lambda k: k.name)
def test_moving_there_and_back(kind):
    """A rotation by random steps, in which many points change rank, ends where it began."""
    mesh = box(kind)
    d = mesh.geometry.dim
    start = cloud(400, d)
    points = MaterialPoints(mesh, start[WORLD.rank :: WORLD.size], 1.0)
    points.add_field("home", (d,), points.x)
    for seed in range(1, 6):
        version = points.version
        # A smooth map of the unit box onto itself, different in each step.
        shift = 0.3 * np.random.default_rng(seed).uniform(-1, 1, d)
        points.move(points.x + shift * np.sin(np.pi * points.x) / np.pi)
        assert points.version > version
        check_consistent(points)
    assert np.linalg.norm(points.x - points["home"]) > 0.1 or len(points) == 0
    points.move(points["home"])
    check_consistent(points)
    np.testing.assert_array_equal(points.x, points["home"])
    again = MaterialPoints(mesh, points.x, 1.0)
    np.testing.assert_array_equal(everywhere(points, "x"), everywhere_by(points, again))


def everywhere_by(points, again):
    """Positions of `again` in the order of the ids of `points` it was made from."""
    ids = np.concatenate(WORLD.allgather(points.id))
    return everywhere(again, "x")[np.argsort(ids)]


@pytest.mark.parametrize("mode", [dmesh.GhostMode.none, dmesh.GhostMode.shared_facet])
@pytest.mark.parametrize("n", [1, 6])
def test_any_ghosts_and_ranks_without_cells(mode, n):
    """Vertices are on facets between ranks; one square leaves some of the ranks without cells."""
    mesh = dmesh.create_unit_square(WORLD, n, n, ghost_mode=mode)
    grid = np.linspace(0, 1, n + 1)
    x = np.stack(np.meshgrid(grid, grid), axis=-1).reshape(-1, 2)
    points = MaterialPoints(mesh, x if WORLD.rank == 0 else x[:0], 1.0)
    check_consistent(points)
    np.testing.assert_array_equal(everywhere(points, "x"), x)
    points.move(1.0 - points.x)
    check_consistent(points)
    np.testing.assert_array_equal(everywhere(points, "x"), 1.0 - x)
    np.testing.assert_allclose(quadrature(mesh, 1).volume(), 1.0, rtol=1e-14)


def test_corner_points_move_to_the_same_cell_from_anywhere():
    mesh = box(n=4, comm=MPI.COMM_SELF)
    corners = np.unique(np.round(mesh.geometry.x[:, :2], 12), axis=0)
    expected = MaterialPoints(mesh, corners, 1.0).cell
    for seed in range(4):
        points = MaterialPoints(mesh, cloud(len(corners), 2, seed), 1.0)
        points.move(corners)
        np.testing.assert_array_equal(points.cell, expected)


def test_a_failed_move_changes_nothing():
    mesh = box()
    points = MaterialPoints(mesh, cloud(60, 2)[WORLD.rank :: WORLD.size], 1.0)
    points.add_field("v", (2,), points.x)
    before = {name: points[name].copy() for name in ("x", "xi", "cell", "id", "v", "weight")}
    version, size = points.version, points.size_global
    wrong = points.x.copy()
    bad = points.id == 7  # on one rank only
    wrong[bad] += 5.0
    with pytest.raises(PointsOutsideError) as caught:
        points.move(wrong)
    assert caught.value.count == 1 and caught.value.total == 60
    assert str(caught.value).startswith("points outside the background mesh: 1 of 60, first at (5.")
    np.testing.assert_array_equal(caught.value.indices, np.flatnonzero(bad))
    np.testing.assert_array_equal(caught.value.positions, wrong[bad])
    wrong[bad] = np.nan
    with pytest.raises(ValueError, match="positions must be finite: 1 of"):
        points.move(wrong)
    with pytest.raises(ValueError, match="positions"):
        points.move(np.zeros((3 * len(points) + 1, 2)))
    assert (points.version, points.size_global) == (version, size)
    for name, values in before.items():
        np.testing.assert_array_equal(points[name], values)


def test_a_moved_mesh_is_noticed():
    """Only one node, so that most ranks do not see the change themselves."""
    mesh = box(n=8)
    points = quadrature(mesh, 1)
    mesh.geometry.x[np.all(mesh.geometry.x == 0.0, axis=1)] = [0.05, 0.04, 0.0]
    with pytest.raises(ValueError, match="background mesh have moved"):
        points.move(points.x)
    lost = 0.5 * (0.05 + 0.04) * 0.125
    np.testing.assert_allclose(quadrature(mesh, 1).volume(), 1.0 - lost, rtol=1e-13)
    check_consistent(quadrature(mesh, 1))


def test_outside_raises_on_all_ranks():
    mesh = box(CellType.hexahedron)
    x = np.full((4, 3), 0.5)
    x[1:3, 2] = [1.5, -0.25]
    if WORLD.rank:
        x = x[:0]
    with pytest.raises(PointsOutsideError) as caught:
        MaterialPoints(mesh, x, 1.0)
    assert "2 of 4, first at (0.5, 0.5, 1.5)" in str(caught.value)
    assert list(caught.value.indices) == ([1, 2] if WORLD.rank == 0 else [])


def test_wrong_input_on_one_rank_raises_on_all():
    mesh = box()
    x = cloud(5, 2)
    last = WORLD.rank == WORLD.size - 1
    nan = x.copy()
    nan[3, 1] = np.nan
    weight = np.ones(5)
    weight[[2, 4]] = [-0.5, np.inf]
    ones = np.ones(5)
    for bad, good, message in (
        ({"x": nan}, {"x": x}, "positions must be finite: 1 of 5 are not, first point 3"),
        ({"weight": weight}, {"weight": ones}, "2 of 5 are not, first -0.5 at point 2"),
        ({"weight": 0.0}, {"weight": 1.0}, "5 of 5 are not, first 0.0 at point 0"),
        ({"weight": np.ones(4)}, {"weight": ones}, r"weight of shape \(4,\) does not fit 5 points"),
        ({"x": np.zeros((5, 3))}, {"x": x}, r"shape \(n, 2\), not \(5, 3\)"),
        ({"x": ["a"]}, {"x": x}, "must be numbers"),
        ({"tag": [1, 2]}, {}, "tag of shape"),
        ({"cells": np.full(5, 10**6)}, {}, "5 are not, first 1000000 at point 0"),
        (
            {"fields": {"a": np.zeros(4)}},
            {"fields": {"a": ones}},
            "the first index must be the point",
        ),
        ({"fields": {"x": ones}}, {"fields": {"a": ones}}, "'x' cannot be the name"),
        ({"xi": x}, {}, "xi needs cells"),
        ({"xi": x, "cells": np.zeros(5)}, {}, "do not give the positions"),
    ):
        arguments = {"x": x, "weight": 1.0} | (bad if last else good)
        with pytest.raises(ValueError, match=message):
            MaterialPoints(mesh, **arguments)


def test_different_fields_on_ranks():
    if WORLD.size == 1:
        pytest.skip("needs two ranks")
    fields = {"a": np.zeros(5)} if WORLD.rank else {"b": np.zeros(5)}
    with pytest.raises(ValueError, match="pass the same on all ranks"):
        MaterialPoints(box(), cloud(5, 2), 1.0, fields=fields)


def unsupported_meshes():
    surface = ufl.Mesh(basix.ufl.element("Lagrange", "triangle", 1, shape=(3,)))
    x3 = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 1.0]])
    curved = ufl.Mesh(basix.ufl.element("Lagrange", "triangle", 2, shape=(2,)))
    x6 = np.array([[0, 0], [1, 0], [0, 1], [0.5, 0.6], [0, 0.5], [0.5, 0.0]])
    prism = ufl.Mesh(basix.ufl.element("Lagrange", "prism", 1, shape=(3,)))
    xp = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [0, 1, 1.0]])
    one = MPI.COMM_SELF
    return {
        "interval": dmesh.create_unit_interval(one, 3),
        "surface": dmesh.create_mesh(one, cells=np.array([[0, 1, 2]]), x=x3, e=surface),
        "degree 2": dmesh.create_mesh(one, cells=np.array([[0, 1, 2, 3, 4, 5]]), x=x6, e=curved),
        "prism": dmesh.create_mesh(one, cells=np.array([[0, 1, 2, 3, 4, 5]]), x=xp, e=prism),
        "float32": dmesh.create_unit_square(one, 2, 2, dtype=np.float32),
    }


def test_unsupported_meshes():
    for name, mesh in unsupported_meshes().items():
        d = mesh.geometry.dim
        with pytest.raises(ValueError, match="a mesh of unsupported cells") as error:
            MaterialPoints(mesh, np.zeros((1, d)), 1.0)
        # what Gmsh's meshes of the plane become unless one says otherwise
        assert ("pass gdim=2" in str(error.value)) == (name == "surface")


def test_what_one_rank_reads():
    """Attributes, properties and what is printed do not wait for other ranks."""
    mesh = box()
    points = MaterialPoints(mesh, cloud(20, 2)[WORLD.rank :: WORLD.size], 1.0)
    points.add_field("v", (2,))
    names = [name for name in dir(points) if not callable(getattr(points, name))]
    assert {"size_global", "version", "weight", "order", "field_names"} <= set(names)
    if WORLD.rank == 0:
        seen = {name: getattr(points, name) for name in names}
        assert seen["size_global"] == 20 and "of 20 points" in repr(points)
    assert points.volume() == 20.0
    lower, upper = points.bounds()
    np.testing.assert_array_equal([lower, upper], [cloud(20, 2).min(0), cloud(20, 2).max(0)])


def test_fields():
    points = MaterialPoints(box(), cloud(20, 2)[WORLD.rank :: WORLD.size], 1.0)
    n = len(points)
    f = points.add_field("F", (3, 3), np.eye(3))
    assert f is points["F"] and f.shape == (n, 3, 3)
    np.testing.assert_array_equal(f, np.broadcast_to(np.eye(3), (n, 3, 3)))
    points.add_field("rho", value=1000)
    assert points["rho"].dtype == np.float64 and np.all(points["rho"] == 1000.0)
    points["F"] = 2 * np.eye(3)
    assert points["F"] is f and np.all(f[:, 0, 0] == 2.0)
    points["rho"] = np.arange(n)
    np.testing.assert_array_equal(points["rho"], np.arange(n))
    points["weight"] = 0.5
    assert points.weight is points["weight"] and np.all(points.weight == 0.5)
    assert "F" in points and "x" in points and "J" not in points
    assert points.field_names == ("F", "rho")
    with pytest.raises(ValueError, match=r"field 'F' needs a value of shape \(3, 3\)"):
        points["F"] = np.zeros(3)
    with pytest.raises(ValueError, match="already a field 'F'"):
        points.add_field("F")
    with pytest.raises(ValueError, match="already a field 'weight'"):
        points.add_field("weight")
    with pytest.raises(ValueError, match=r"move\(\)"):
        points["x"] = 0.0
    with pytest.raises(KeyError, match="no field 'J'"):
        points["J"]
    with pytest.raises(KeyError, match="no field 'J'"):
        points["J"] = 1.0
    for name in ("x", "xi", "cell", "id"):
        with pytest.raises(ValueError, match="read-only"):
            points[name][...] = 0


def test_add_select_remove_and_copy():
    mesh = box(CellType.quadrilateral)
    x = cloud(90, 2)
    a = MaterialPoints(mesh, x[:50][WORLD.rank :: WORLD.size], 1.0, tag=1)
    b = MaterialPoints(mesh, x[50:][WORLD.rank :: WORLD.size], 2.0, tag=2)
    with pytest.raises(ValueError, match="add the missing fields first"):
        a.add_field("v", (2,), a.x)
        a.add(b)
    b.add_field("v", (2,), b.x)
    version = a.version
    both = a.copy()
    both.add(b)
    assert a.version == version and a.size_global == 50 and both.size_global == 90
    assert both.version > version
    check_consistent(both)
    np.testing.assert_array_equal(everywhere(both, "id"), np.arange(90))
    np.testing.assert_array_equal(everywhere(both, "tag"), np.repeat([1, 2], [50, 40]))
    np.testing.assert_array_equal(both["v"], both.x)
    np.testing.assert_allclose(both.volume(), 130.0, rtol=1e-14)

    left = both.select(lambda x: x[0] < 0.5)
    assert left.size_global == np.sum(x[:, 0] < 0.5)
    np.testing.assert_array_equal(left["v"], left.x)
    left["v"] = 0.0
    assert np.any(both["v"] != 0.0) or len(both) == 0
    check_consistent(left)
    kept = set(np.concatenate(WORLD.allgather(left.id)))

    removed = both.remove(both.x[:, 0] >= 0.5)
    assert removed == 90 - left.size_global
    assert kept == set(np.concatenate(WORLD.allgather(both.id)))
    check_consistent(both)
    first = np.array([0] if len(both) else [], dtype=int)
    expected = WORLD.allreduce(len(first))
    assert both.remove(first) == expected
    # Ids are never used twice.
    highest = WORLD.allreduce(int(both.id.max(initial=0)), MPI.MAX)
    both.add(b)
    new = np.concatenate(WORLD.allgather(both.id[both.id > highest]))
    assert new.min() >= 90 and len(new) >= 40
    assert len(both.select([])) == 0
    both.remove(np.ones(len(both), dtype=bool))
    assert both.size_global == 0 and "0 of 0 points" in repr(both)
    check_consistent(both)

    with pytest.raises(ValueError, match="another mesh"):
        a.add(MaterialPoints(box(), x[:0], 1.0))
    with pytest.raises(ValueError, match="mask of points"):
        a.remove(np.ones(len(a) + 1, dtype=bool))
    with pytest.raises(ValueError, match="indices of points"):
        a.select([len(a)])
    with pytest.raises(ValueError, match="by a mask or by indices"):
        a.select([0.5])


def test_sort_keeps_rows_together():
    points = MaterialPoints(box(CellType.tetrahedron), cloud(300, 3)[WORLD.rank :: WORLD.size], 1.0)
    points.add_field("v", (3,), points.x)
    ids, version = everywhere(points, "v"), points.version
    points.sort()
    assert points.version > version
    assert np.all(np.diff(points.cell) >= 0)
    np.testing.assert_array_equal(points.order, np.arange(len(points)))
    np.testing.assert_array_equal(points["v"], points.x)
    np.testing.assert_array_equal(everywhere(points, "v"), ids)
    check_consistent(points)


def test_sort_by_other_numbers():
    points = MaterialPoints(box(), cloud(200, 2)[WORLD.rank :: WORLD.size], 1.0)
    points.add_field("v", (2,), points.x)
    before = everywhere(points, "v")
    points.sort(np.rint(10 - 10 * points.x[:, 0]).astype(np.int64))
    assert np.all(np.diff(np.rint(10 * points.x[:, 0])) <= 0)
    np.testing.assert_array_equal(everywhere(points, "v"), before)
    np.testing.assert_array_equal(points.cell[points.order], np.sort(points.cell))
    check_consistent(points)


def test_known_cells_are_taken_as_given():
    """The owner can be named for a point on a facet, which would otherwise go to the lowest."""
    mesh = box(n=1, comm=MPI.COMM_SELF)
    geometry = cell_geometry(mesh)
    x = np.array([[0.5, 0.5]])
    for cell in (0, 1):
        a = geometry.coefficients(np.array([cell]))[0]
        xi = np.linalg.solve(a[1:].T, x[0] - a[0])[None]
        points = MaterialPoints(mesh, x, 1.0, cells=[cell], xi=xi)
        assert points.cell[0] == cell
    lowest = np.argmin(geometry.key)
    assert MaterialPoints(mesh, x, 1.0, cells=[1]).cell[0] == lowest


def test_measure_is_ordinary_ufl():
    mesh = box()
    points = quadrature(mesh, 2)
    f = ufl.SpatialCoordinate(mesh)[0]
    form = f * points.dx + 2 * f * points.dx(3) + f * ufl.dx + f * ufl.ds
    found = {
        (i.integral_type(), i.subdomain_id(), id(i.subdomain_data())) for i in form.integrals()
    }
    assert found == {
        ("cell", "everywhere", id(points)),
        ("cell", 3, id(points)),
        ("cell", "everywhere", id(None)),
        ("exterior_facet", "everywhere", id(None)),
    }


def test_repr_says_what_there_is():
    mesh = box(CellType.quadrilateral, n=2, comm=MPI.COMM_SELF)
    points = MaterialPoints(mesh, [[0.1, 0.1], [0.2, 0.3], [0.9, 0.8]], 0.25)
    points.add_field("v", (2,))
    assert repr(points) == (
        "MaterialPoints\n"
        "  number            3 of 3 points\n"
        "  in cells          2 of 4\n"
        "  points in a cell  1 to 2, 1.5 on average\n"
        "  bounds            [0.1 0.1] to [0.9 0.8] m\n"
        "  total weight      0.75\n"
        "  fields            v (2)"
    )


def test_exchange_sends_rows_in_order():
    n = 4 * WORLD.size
    destination = np.arange(n, dtype=np.int32) % WORLD.size
    sent = {
        "a": np.arange(n, dtype=np.int64) + 1000 * WORLD.rank,
        "b": np.full((n, 2, 2), float(WORLD.rank)),
    }
    received = exchange(WORLD, destination, sent)
    own = np.arange(n)[destination == WORLD.rank]
    expected = np.concatenate([own + 1000 * r for r in range(WORLD.size)])
    np.testing.assert_array_equal(received["a"], expected)
    np.testing.assert_array_equal(received["b"][:, 1, 1], np.repeat(np.arange(WORLD.size), 4))
    nothing = exchange(WORLD, destination[:0], {name: a[:0] for name, a in sent.items()})
    assert nothing["a"].shape == (0,) and nothing["b"].shape == (0, 2, 2)


@pytest.mark.parametrize("highest", [0, 5, 300, 10**6, 2**31 - 2])
@pytest.mark.parametrize("n", [0, 1, 400])
def test_order_by_number_is_a_stable_sort(highest, n):
    number = np.random.default_rng(8).integers(0, highest, n, endpoint=True)
    for kind in (np.int32, np.int64):
        order = order_by_number(number.astype(kind))
        np.testing.assert_array_equal(order, np.argsort(number, kind="stable"))


@pytest.mark.mpi
def test_points_at_positions_that_all_ranks_know():
    domain = dmesh.create_unit_square(MPI.COMM_WORLD, 4, 4)
    probe = at(domain, (0.3, 0.6))
    assert probe.size_global == 1 and len(at(domain, np.empty((0, 2)))) == 0
    three = at(domain, [(0.9, 0.1), (0.3, 0.6), (1.0, 1.0)], weight=2.0)
    found = MPI.COMM_WORLD.allgather([(i, *x) for i, x in zip(three.id, three.x, strict=True)])
    assert sorted(row for rows in found for row in rows) == [
        (0, 0.9, 0.1),
        (1, 0.3, 0.6),
        (2, 1.0, 1.0),
    ]
    with pytest.raises(ValueError, match="shape"):
        at(domain, (0.3, 0.6, 0.0))
    with pytest.raises(PointsOutsideError):
        at(domain, (1.3, 0.6))
