# SPDX-License-Identifier: MIT
"""Functions on a line, from which those on lattices are products."""

import itertools

import numpy as np
import pytest

from fenicsmpm.basis import lines

pytestmark = pytest.mark.once


def line(kind, i, t, n, half=0.5):
    """Values and derivatives ``(3, n + 1)`` at the nodes of a line of n cells."""
    found = np.zeros((3, 4))
    first = lines.tabulate_line(kind, i, t, n, half, found)
    result = np.zeros((3, n + 1))
    for k in range(4):
        if 0 <= first + k <= n:
            result[:, first + k] += found[:, k]
        else:
            assert np.all(found[:, k] == 0)
    return result


@pytest.mark.parametrize("half", [0.5, 0.3, 0.02])
def test_ugimp_is_the_average_of_hat_functions_continued_beyond_the_walls(half):
    nodes = np.arange(4)
    rule, weights = np.polynomial.legendre.leggauss(4)
    for t in np.random.default_rng(0).random(30) * 3:
        # between kinks of the hat functions the rule is exact
        ends = np.unique([t - half, *nodes[np.abs(nodes - t) < half], t + half])
        mean = np.zeros(4)
        for a, b in itertools.pairwise(ends):
            for x, w in zip(a + (b - a) * (rule + 1) / 2, weights * (b - a) / 2, strict=True):
                i = min(max(int(x), 0), 2)
                mean[i] += w * (i + 1 - x)
                mean[i + 1] += w * (x - i)
        i = int(t)
        found = line(lines.GIMP, i, t - i, 3, half)[0]
        assert found == pytest.approx(mean / (2 * half), abs=1e-14)


def test_quadratic_splines_are_ugimp_of_points_as_large_as_cells():
    for t in np.linspace(0, 1, 8):  # not at the knot in the middle
        for i in range(3):
            spline, gimp = (line(kind, i, t, 3) for kind in (lines.QUADRATIC, lines.GIMP))
            assert spline == pytest.approx(gimp, abs=1e-15)


def test_cubic_splines_at_the_wall_are_those_of_steffen_kirby_and_berzins():
    for t in np.linspace(0, 1, 7):
        at_wall, next_cell = (line(lines.CUBIC, i, t, 6)[0] for i in (0, 1))
        assert at_wall[0] == pytest.approx(t**3 / 6 - t + 1, abs=1e-15)
        r = t - 1
        assert at_wall[1] == pytest.approx(-(r**3) / 3 - r**2 + 2 / 3, abs=1e-15)
        assert next_cell[0] == pytest.approx((1 - t) ** 3 / 6, abs=1e-15)
        mirrored = line(lines.CUBIC, 5, 1 - t, 6)[0]
        assert mirrored == pytest.approx(at_wall[::-1], abs=1e-15)


@pytest.mark.parametrize("kind", [lines.LINEAR, lines.QUADRATIC, lines.CUBIC, lines.GIMP])
@pytest.mark.parametrize("n", [1, 2, 3, 7])
def test_lines_of_any_length_reproduce_linear_functions_and_are_not_negative(kind, n):
    for i in range(n):
        for t in (0.0, 0.2, 0.5, 0.7, 1.0):
            value, slope, curvature = line(kind, i, t, n, 0.3)
            nodes = np.arange(n + 1)
            assert value.min() >= -1e-15
            assert [value.sum(), value @ nodes] == pytest.approx([1, i + t], abs=1e-14)
            assert [slope.sum(), slope @ nodes] == pytest.approx([0, 1], abs=1e-14)
            assert [curvature.sum(), curvature @ nodes] == pytest.approx([0, 0], abs=1e-14)
    # at a wall only its node counts
    assert line(kind, 0, 0.0, n, 0.3)[0] == pytest.approx(np.eye(n + 1)[0], abs=1e-15)
