# SPDX-License-Identifier: MIT
"""Functions of positions: dolfinx's shapes everywhere, and errors that all ranks raise."""

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import mesh

from fenicsmpm import formulations as fm
from fenicsmpm import points
from fenicsmpm.points.of_position import CaughtMarker, mask_at, vectors_at

pytestmark = pytest.mark.ranks

COMM = MPI.COMM_WORLD
TOLD = r"\(3, n\) as in dolfinx, so that x\[0\] are the first coordinates"


def positions(n, d):
    return np.random.default_rng(n).uniform(0.1, 0.9, (n, d))


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("n", [1, 2, 3, 4, 9])
def test_positions_are_those_of_dolfinx(n, d):
    x = positions(n, d)
    kept = x.copy()

    def marker(given):
        assert given.shape[0] == 3 and np.all(given[d:] == 0)
        np.testing.assert_array_equal(given[:d, :n], x.T)
        mask = given[0] < 0.5
        given[:] = 7  # harms nobody
        return mask

    error, mask = mask_at(marker, x)
    assert error is None
    np.testing.assert_array_equal(mask, x[:, 0] < 0.5)
    np.testing.assert_array_equal(x, kept)
    matrix = np.arange(1.0, 10.0).reshape(3, 3)[:d, :d]
    error, values = vectors_at(lambda x: matrix @ x[:d], x)
    assert error is None
    np.testing.assert_allclose(values, x @ matrix.T, rtol=1e-14)
    error, values = vectors_at(lambda x: [x[0] > 0.5, *x[1:d]], x)  # a list, and numbers of bool
    assert error is None and values.dtype == np.float64
    np.testing.assert_array_equal(values, np.column_stack([x[:, 0] > 0.5, x[:, 1:]]))


def test_functions_are_not_called_without_points():
    def fails(x):
        raise AssertionError

    assert mask_at(fails, np.empty((0, 2)))[1].shape == (0,)
    assert vectors_at(fails, np.empty((0, 2)))[1].shape == (0, 2)


@pytest.mark.parametrize("n", [1, 2, 3, 4, 9])
def test_functions_of_rows_are_told_so(n):
    for d, marker in (
        (2, lambda x: x[:, 0] < 0.5),
        (3, lambda x: x[:, 2] < 0.5),
        (2, lambda x: x.max(axis=1) < 0.5),
        (3, lambda x: (x > 0.2).all(axis=1)),
        (2, lambda x: np.abs(x - (0.5, 0.5)).max(axis=1) < 0.3),
        (3, lambda x: np.linalg.norm(x - (0.5, 0.4, 0.3), axis=1) < 0.3),
        (2, lambda x: np.hypot(*(x - 0.5).T) < 0.3),
        (2, lambda x: np.full(len(x), True)),
        (2, lambda x: x.max(axis=2) < 0.5),
        (2, lambda x: x[0]),  # no mask
        (2, lambda x: True),
    ):
        error, mask = mask_at(marker, positions(n, d))
        assert not mask.any()
        with pytest.raises(ValueError, match=TOLD):
            raise error
    for d, function in (
        (2, lambda x: np.tile((1.0, 2.0), (len(x), 1))),
        (3, lambda x: np.tile((1.0, 2.0, 3.0), (len(x), 1))),
        (2, lambda x: np.column_stack([-x[:, 1], x[:, 0]])),
        (3, lambda x: np.column_stack([-x[:, 1], x[:, 0], np.zeros(len(x))])),
        (2, lambda x: x[:, ::-1]),
        (2, lambda x: (x - (0.5, 0.5)) @ np.ones((2, 2))),
        (2, lambda x: (1.0, x[0])),
        (2, lambda x: 1j * x[:2]),
    ):
        error, values = vectors_at(function, positions(n, d))
        assert not values.any()
        with pytest.raises(ValueError, match=TOLD):
            raise error


def test_what_a_message_says():
    def panel(x):
        return x[:, 0] < 0.5

    error, _ = mask_at(panel, positions(9, 2))
    assert str(error) == (
        "panel gets positions of the shape (3, n) as in dolfinx, so that x[0] are the first "
        "coordinates, and must return a mask of the shape (9,), not bool of the shape (3,)"
    )
    error, _ = mask_at(lambda x: x[:, 2] < 0.5, positions(2, 3))
    assert str(error).startswith("IndexError: index 2 is out of bounds for axis 1 with size 2 (")
    assert isinstance(error.__cause__, IndexError)
    error, _ = vectors_at(lambda x: x, positions(4, 2))
    assert str(error).endswith("values of the shape (2, 4), not float64 of the shape (3, 4)")


def test_markers_for_dolfinx():
    domain = mesh.create_unit_square(MPI.COMM_SELF, 4, 4)
    marker = CaughtMarker(lambda x: np.isclose(x[0], 0))
    assert len(mesh.locate_entities_boundary(domain, 1, marker)) == 4
    assert marker.error is None
    marker = CaughtMarker(lambda x: np.isclose(x[:, 0], 0))
    assert len(mesh.locate_entities_boundary(domain, 1, marker)) == 0
    assert isinstance(marker.error, ValueError)


class Own(Exception):
    """An error of the user's."""


def fails_on_the_last_rank(kind):
    def function(x):
        if COMM.rank == COMM.size - 1:
            if kind == "IndexError":
                return x[:, 10**6] < 0
            if kind == "shape":
                return x[:, 0] < 0.5
            if kind == "not sent":

                class Local(Exception):
                    pass

                raise Local("mine")
            raise Own("mine")
        return np.full(x.shape[1], True)

    return function


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("kind", "expected", "message"),
    [
        ("Own", Own, "mine"),
        ("IndexError", ValueError, TOLD),
        ("shape", ValueError, TOLD),
        ("not sent", Exception, "mine"),
    ],
)
def test_functions_that_fail_on_one_rank(kind, expected, message):
    domain = mesh.create_rectangle(COMM, [(0, 0), (2, 1)], [8, 4], mesh.CellType.quadrilateral)
    body = points.fill(domain, 2)
    edge = points.on_facets(domain, lambda x: np.full(x.shape[1], True))
    z = fm.Unknown(domain, "u")
    marker = fails_on_the_last_rank(kind)

    def vectors(x):
        mask = marker(x)
        return mask[:2] if mask.shape == (3,) else np.array([mask, ~mask])

    before, normals = body.snapshot(), edge["normal"].copy()
    for call in (
        lambda: points.quadrature(domain, 2, inside=marker),
        lambda: points.fill(domain, 2, inside=marker),
        lambda: points.random(domain, 2, seed=1, inside=marker),
        lambda: points.lattice(domain, 0.1, inside=marker),
        lambda: points.on_facets(domain, marker),
        lambda: body.select(marker),
        lambda: body.remove(marker),
        lambda: fm.set_initial_state(body, 1.0, vectors),
        lambda: fm.set_normals(edge, vectors),
        lambda: z.fix("u", marker),
    ):
        with pytest.raises(expected, match=message):
            call()
        COMM.Barrier()
    assert list(body.snapshot()) == list(before)
    np.testing.assert_array_equal(edge["normal"], normals)
    for name, array in before.items():
        np.testing.assert_array_equal(body[name], array)


@pytest.mark.mpi
def test_values_of_conditions_that_fail_on_one_rank():
    domain = mesh.create_unit_square(COMM, 6, 6)
    z = fm.Unknown(domain, "u", "p")

    def value(x, t):
        if COMM.rank == COMM.size - 1 and t > 1:
            raise Own("late")
        return t * x[:2]

    z.fix("u", lambda x: np.isclose(x[0], 0), value)
    z.set_conditions(0.0, 0.5)
    with pytest.raises(Own, match="late"):
        z.set_conditions(0.5, 1.5)

    def at_once(x):
        if COMM.rank == 0:
            raise Own("at once")
        return x[0]

    with pytest.raises(Own, match="at once"):
        z.fix("p", lambda x: np.isclose(x[0], 0), at_once)


@pytest.mark.mpi
def test_initial_velocities():
    """Of all points alike, and as a function that differences over a small step differentiate."""
    domain = mesh.create_unit_cube(COMM, 3, 3, 3, mesh.CellType.hexahedron)
    uniform, shear = points.fill(domain, 2), points.fill(domain, 2)
    fm.set_initial_state(uniform, 2.0, (1.0, -2.0, 0.5))
    np.testing.assert_array_equal(uniform["v"], np.tile((1.0, -2.0, 0.5), (len(uniform), 1)))
    assert not uniform["grad_v"].any()
    fm.set_initial_state(shear, 2.0, lambda x: np.array([3 * x[2], x[0], 0 * x[0]]))
    x = shear.x
    np.testing.assert_array_equal(shear["v"], np.column_stack([3 * x[:, 2], x[:, 0], 0 * x[:, 0]]))
    gradient = np.array([[0, 0, 3.0], [1.0, 0, 0], [0, 0, 0]])
    np.testing.assert_allclose(shear["grad_v"], np.tile(gradient, (len(x), 1, 1)), atol=1e-9)
    with pytest.raises(ValueError, match=r"shape \(3,\), not \(2,\)"):
        fm.set_initial_state(points.fill(domain, 1), 2.0, (1.0, 2.0))
