# SPDX-License-Identifier: MIT
"""Solids by their boundaries: inside, distance, moments by closed formulas; what is refused."""

import pickle

import numpy as np
import pytest

from fenicsmpm import shapes
from fenicsmpm.shapes import OpenSurfaceError, Solid, contour, fractions, mask, polygon, surface

pytestmark = pytest.mark.once

L_SHAPE = [(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)]
RNG = np.random.default_rng


def cube(n=1):
    """Vertices and triangles of the unit cube, its sides of n x n squares."""
    values = np.ones((n, n, n), dtype=bool)
    facets = mask(values, 1.0 / n).facets.reshape(-1, 3)
    x, number = np.unique(facets.round(12), axis=0, return_inverse=True)
    return x, number.reshape(-1, 3)


def ball(n, radius=1.0):
    """The cube's surface pushed to a sphere around the origin."""
    x, t = cube(n)
    x = np.tan((2 * x - 1) * np.pi / 4)
    return surface(radius * x / np.linalg.norm(x, axis=1)[:, None], t)


def rotation(seed=1):
    q = np.linalg.qr(RNG(seed).normal(size=(3, 3)))[0]
    return q * np.linalg.det(q)


def to_cube(x):
    """Signed distance of the cube [0, 1]^d, x (d, n)."""
    q = np.abs(x - 0.5) - 0.5
    return np.linalg.norm(np.maximum(q, 0), axis=0) + np.minimum(q.max(axis=0), 0)


# --- in the plane --------------------------------------------------------------------------------


@pytest.mark.parametrize("turn", [1, -1], ids=["counter-clockwise", "clockwise"])
def test_polygon(turn):
    solid = polygon(L_SHAPE[::turn])
    assert (solid.dim, solid.volume, solid.area) == (2, pytest.approx(3), pytest.approx(8))
    np.testing.assert_allclose(solid.centroid, [5 / 6, 5 / 6])
    np.testing.assert_allclose(solid.second_moment[0, 0], 11 / 12)
    x = np.zeros((3, 5000))
    x[:2] = RNG(0).uniform(-0.5, 2.5, (2, 5000))
    inside = (x[:2].min(axis=0) > 0) & (x[:2].max(axis=0) < 2) & (x[:2].min(axis=0) < 1)
    np.testing.assert_array_equal(solid(x), inside)
    np.testing.assert_array_equal(solid(x[:2]), inside)
    np.testing.assert_array_equal(solid.distance(x) < 0, inside)
    np.testing.assert_allclose(solid.normals.T @ solid.areas, 0, atol=1e-15)
    middle = solid.facets.mean(axis=1)
    assert np.all(solid((middle - 1e-9 * solid.normals).T))
    assert not np.any(solid((middle + 1e-9 * solid.normals).T))


def test_polygon_with_holes():
    hole = [(0.2, 0.2), (0.4, 0.2), (0.4, 0.4), (0.2, 0.4), (0.2, 0.2)]  # the first vertex again
    solid = polygon([(0, 0), (1, 0), (1, 1), (0, 1)], [hole])
    assert solid.volume == pytest.approx(1 - 0.04) and solid.area == pytest.approx(4.8)
    np.testing.assert_array_equal(solid(np.array([[0.3, 0.1], [0.3, 0.1]])), [False, True])
    np.testing.assert_allclose(solid.distance([[0.3], [0.3]]), [0.1])


@pytest.mark.parametrize(
    "vertices, holes, match",
    [
        ([(0, 0), (1, 1), (1, 0), (0, 1)], [], "crosses itself: side 0 from .* side 2"),
        ([(0, 0), (2, 0), (1, 0), (1, 1)], [], "crosses itself"),
        ([(0, 0), (1, 0), (2, 0)], [], "crosses itself"),
        ([(0, 0), (1, 0), (1, 0), (0, 1)], [], "side 1 of the polygon, at .* no length"),
        ([(0, 0), (1, 0)], [], "at least 3 vertices, not 2"),
        ([(0, 0, 0), (1, 0, 0), (1, 1, 0)], [], r"shape \(n, 2\), not \(3, 3\)"),
        ([(0, 0), (np.nan, 0), (1, 1)], [], "must be finite"),
        (L_SHAPE, [[(3, 3), (4, 3), (4, 4)]], "crosses or covers itself"),
        (L_SHAPE, [[(0.5, 0.5), (1.5, 1.5), (0.5, 1.6)]], "crosses itself"),
    ],
)
def test_bad_polygons(vertices, holes, match):
    with pytest.raises(ValueError, match=match):
        polygon(vertices, holes)


# --- in space ------------------------------------------------------------------------------------


def test_distance_from_a_cube():
    solid = surface(*cube(3))
    grid = np.stack(np.meshgrid(*3 * [np.linspace(-0.75, 1.75, 11)], indexing="ij")).reshape(3, -1)
    x = np.concatenate([grid, RNG(0).uniform(-0.5, 1.5, (3, 2000))], axis=1)
    distance, gradient = solid.distance_and_gradient(x)
    np.testing.assert_allclose(distance, to_cube(x), atol=1e-15)
    np.testing.assert_allclose(np.linalg.norm(gradient, axis=0), 1, rtol=1e-12)
    # where the gradient is unique
    step = 1e-6 * gradient
    change = (to_cube(x + step) - to_cube(x - step)) / 2e-6
    assert np.mean(np.abs(change - 1) < 1e-6) > 0.8
    np.testing.assert_allclose(solid.distance(x - distance * gradient), 0, atol=1e-14)


def test_cubes_side_by_side_share_no_point():
    """Lattice points on common sides, edges and corners are in one of them."""
    x, t = cube()
    grid = np.stack(np.meshgrid(*3 * [np.linspace(-1, 1, 9)], indexing="ij")).reshape(3, -1)
    count = sum(
        surface(x - [i, j, k], t)(grid).astype(int)
        for i in range(-1, 3)
        for j in range(-1, 3)
        for k in range(-1, 3)
    )
    assert np.all(count == 1)


def test_moments_of_a_ball():
    errors = []
    for n in (4, 8, 16):
        solid = ball(n)
        np.testing.assert_allclose(solid.centroid, 0, atol=1e-14)
        np.testing.assert_allclose(solid.normals.T @ solid.areas, 0, atol=1e-13)
        by_divergence = np.sum(solid.areas * np.sum(solid.normals * solid.facets[:, 0], axis=1)) / 3
        assert solid.volume == pytest.approx(by_divergence, rel=1e-13)
        exact = 4 / 3 * np.pi, 4 * np.pi, 4 / 15 * np.pi
        errors.append(np.array([solid.volume, solid.area, solid.second_moment[0, 0]]) / exact - 1)
    errors = np.abs(errors)
    assert np.all(errors[-1] < 0.01) and np.all(np.log2(errors[:-1] / errors[1:]) > 1.9)
    x = RNG(0).uniform(-1.5, 1.5, (3, 3000))
    np.testing.assert_allclose(solid.distance(x), np.linalg.norm(x, axis=0) - 1, atol=0.01)


def test_scaling_turning_moving():
    solid = ball(4)
    moved = solid.transformed(2e-3, (1, 2, 3), rotation())
    assert moved.volume == pytest.approx(8e-9 * solid.volume)
    assert moved.area == pytest.approx(4e-6 * solid.area)
    np.testing.assert_allclose(moved.centroid, [1, 2, 3])
    x = RNG(0).uniform(-1.5, 1.5, (3, 500))
    there = 2e-3 * rotation() @ x + np.array([[1], [2], [3]])
    np.testing.assert_allclose(moved.distance(there), 2e-3 * solid.distance(x), atol=1e-14)
    assert "Solid of 192 triangles: volume" in repr(moved)
    for bad, match in [
        ({"scale": 0}, "positive, not 0"),
        ({"rotation": np.diag([1, 1, -1])}, "needs an orthogonal matrix"),
        ({"translation": (1, 2)}, "3 components"),
    ]:
        with pytest.raises(ValueError, match=match):
            solid.transformed(**bad)


def test_inside_out_and_cavities():
    x, t = cube()
    assert surface(x, t[:, ::-1]).volume == pytest.approx(1)
    hollow = surface(np.concatenate([x, 0.25 + 0.5 * x]), np.concatenate([t, t[:, ::-1] + len(x)]))
    assert hollow.volume == pytest.approx(1 - 0.125) and hollow.area == pytest.approx(7.5)
    np.testing.assert_array_equal(hollow(np.array([[0.5, 0.1]] * 3)), [False, True])


def test_open_surface_says_how_much():
    """A cube without its upper side: 4 edges of length 1, a sixth of all directions."""
    x, t = cube()
    with pytest.raises(OpenSurfaceError, match="4 free edges with a total length of 4") as info:
        surface(x, t[x[t][:, :, 2].min(axis=1) < 1])
    error = info.value
    assert (error.free_edges, error.length) == (4, pytest.approx(4))
    # the centroid of the five sides is 0.1 below the middle
    sides = np.array([1, 1, 0.6])
    seen = 4 * np.arctan(0.25 / (0.6 * np.sqrt(0.25 + 0.25 + 0.36))) / (4 * np.pi)
    assert error.solid_angle == pytest.approx(seen, rel=1e-12) and sides[2] == 0.6
    assert str(pickle.loads(pickle.dumps(error))) == str(error)


def flipped(x, t):
    t = t.copy()
    t[3] = t[3][::-1]
    return x, t


def twice(x, t, shift):
    return np.concatenate([x, x + shift]), np.concatenate([t, t + len(x)])


@pytest.mark.parametrize(
    "x, t, match",
    [
        (*flipped(*cube()), "not oriented alike: .* 3 of 18 edges"),
        (*twice(*cube(4), 0.3), "crosses or covers itself"),
        (*twice(*cube(), 0.0), "crosses or covers itself"),
        ([(0, 0, 0), (1, 0, 0), (2, 0, 0), (0, 1, 1)], [(0, 1, 2), (2, 1, 0)], "without area"),
        ([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2), (2, 1, 0)], "must enclose a volume"),
        ([(0, 0, 0)], np.zeros((0, 3), dtype=int), "needs triangles"),
        ([(0, 0, 0)], [(0, 1, 2)], "must be 0 to 0, not 0 to 2"),
        ([(0, 0)], [(0, 1, 2)], r"shape \(m, 3\), not \(1, 2\)"),
        ([(0, 0, 0)], [(0.0, 1, 2)], "integers"),
        ([(0, 0, 0), (1, 0, 0), (0, np.inf, 0)], [(0, 1, 2), (2, 1, 0)], "finite"),
    ],
)
def test_bad_surfaces(x, t, match):
    with pytest.raises(ValueError, match=match):
        surface(x, t)


def test_bad_facets_and_positions():
    with pytest.raises(ValueError, match=r"shape \(n, 2, 2\) or"):
        Solid(np.zeros((3, 2, 3)))
    with pytest.raises(ValueError, match=r"not closed: its area vectors add up to 0\.333"):
        Solid([[(0, 0), (1, 0)], [(1, 0), (1, 1)], [(1, 1), (0, 1)]])
    with pytest.raises(ValueError, match=r"shape \(3, n\)"):
        polygon(L_SHAPE).distance(np.zeros((7, 2)))


# --- parts of boxes ------------------------------------------------------------------------------


def test_fractions_of_boxes_cut_by_one_side():
    """A turned cube, boxes in the middle of its sides: the part behind the plane is exact."""
    solid = surface(*cube()).transformed(1, -rotation() @ np.full(3, 0.5), rotation())
    size = np.array([0.05, 0.08, 0.11])
    rng = RNG(2)
    for normal, place in zip(solid.normals, solid.facets.mean(axis=1), strict=True):
        centre = place + rng.uniform(-0.06, 0.06, (5, 1)) * normal
        grid = np.stack(np.meshgrid(*3 * [(np.arange(100) + 0.5) / 100 - 0.5])).reshape(3, -1)
        x = centre[:, :, None] + size[:, None] * grid
        exact = np.mean(np.einsum("i,nim->nm", normal, x - place[:, None]) <= 0, axis=1)
        np.testing.assert_allclose(fractions(solid, centre, size), exact, atol=2e-3)


@pytest.mark.parametrize("n", [4, 7, 13])
def test_fractions_add_up(n):
    for solid in (ball(12, 0.9), polygon(L_SHAPE).transformed(0.8, -0.77)):
        d = solid.dim
        grid = np.meshgrid(*d * [(np.arange(n) + 0.5) / n * 2 - 1])
        centre = np.stack(grid).reshape(d, -1).T
        total = fractions(solid, centre, np.full(d, 2 / n)).sum() * (2 / n) ** d
        assert total == pytest.approx(solid.volume, rel=0.1 / n)


# --- images --------------------------------------------------------------------------------------


@pytest.mark.parametrize("shape", [(30, 20), (9, 8, 7)], ids=["2D", "3D"])
def test_mask(shape):
    """Any pattern, whose voxels also meet in edges and corners, is what its boundary encloses."""
    d, size = len(shape), np.array([0.5, 0.25, 1.0])[: len(shape)]
    values = RNG(0).random(shape) > 0.5
    solid = mask(values, size, -1.0)
    assert solid.volume == pytest.approx(values.sum() * np.prod(size), rel=1e-13)
    sides = sum(
        np.prod(size) / size[k] * np.abs(np.diff(np.pad(values, 1).astype(int), axis=k)).sum()
        for k in range(d)
    )
    assert solid.area == pytest.approx(sides)
    x = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij")).reshape(d, -1) + 0.5
    np.testing.assert_array_equal(solid(size[:, None] * x - 1), values.ravel())


@pytest.mark.parametrize("d", [2, 3])
def test_contour_of_a_ball(d):
    exact = (np.pi * 0.49, 2 * np.pi * 0.7) if d == 2 else (4 / 3 * np.pi * 0.343, 4 * np.pi * 0.49)
    errors = []
    for n in (16, 32):
        x = np.stack(np.meshgrid(*d * [(np.arange(n) + 0.5) * 2 / n], indexing="ij"))
        solid = contour(-np.sum((x - 1) ** 2, axis=0), -0.49, 2 / n, (4.0, 5.0, 6.0)[:d])
        np.testing.assert_allclose(solid.centroid, np.array([5.0, 6.0, 7.0])[:d], atol=2e-6)
        errors.append(np.abs([solid.volume / exact[0] - 1, solid.area / exact[1] - 1]))
    assert np.all(errors[1] < 0.01) and np.all(errors[1] < 0.5 * errors[0])


def test_contour_cut_off_at_the_edge_of_the_image():
    """An image that is above the level everywhere but in one pixel goes to half a pixel outside."""
    values = np.ones((10, 10))
    values[0, 0] = 0
    solid = contour(values, 0.5)
    np.testing.assert_allclose(solid.bounds(), [(0, 0), (10, 10)], atol=1e-12)


@pytest.mark.parametrize(
    "make, match",
    [
        (lambda: mask(np.ones((2, 2))), "bool values .* not float64"),
        (lambda: mask(np.ones(4, dtype=bool)), r"not bool of shape \(4,\)"),
        (lambda: mask(np.zeros((2, 2), dtype=bool)), "must be true somewhere"),
        (lambda: mask(np.ones((2, 2), dtype=bool), 0.0), "positive, not 0.0"),
        (lambda: mask(np.ones((2, 2), dtype=bool), (1, 1, 1)), "1 or 2 numbers"),
        (lambda: contour(np.eye(3), 2.0), "level 2.0 must lie between .* 0.0 to 1.0"),
        (lambda: contour(np.full((3, 3), np.nan), 0.5), "finite"),
        (lambda: contour(np.ones(4), 0.5), r"not \(4,\)"),
    ],
)
def test_bad_images(make, match):
    with pytest.raises(ValueError, match=match):
        make()


def test_the_whole_is_exported():
    assert set(shapes.__all__) == {
        "Box", "OpenSurfaceError", "SignedDistance", "Solid", "contour", "fractions", "mask",
        "polygon", "surface",
    }  # fmt: skip
