# SPDX-License-Identifier: MIT
"""Rows of eight numbers do what numbers do."""

import math

import numpy as np
import pytest
from numba import njit

from fenicsmpm import lanes
from fenicsmpm.materials import (
    Hencky,
    NeoHookean,
    NewtonianFluid,
    VonMises,
    compiled,
)
from fenicsmpm.materials.tensors import (
    cube_root,
    exponential,
    exprel,
    exprel_small,
    inverse_cube_root,
    log_of_one_plus,
    logarithm,
)

RNG = np.random.default_rng(5)


@compiled
def _formulas(x, y):
    a = x
    a += y
    a -= 2
    a *= y
    a /= 3.5
    return (
        x + y, 1 - x, 2 * x - y * 3, x / y, 1 / x, -x, math.sqrt(y), math.floor(10 * x),
        min(x, 0.5), max(x, y), a,
    )  # fmt: skip


@njit
def _on_rows(x, y, result):
    values = _formulas(lanes.load(x, 0), lanes.load(y, 0))
    for k in range(len(values)):
        lanes.store(result, k, values[k])


def test_formulas_give_in_each_lane_what_they_give_for_numbers():
    x, y = RNG.normal(size=(1, 8)), RNG.uniform(0.1, 2, (1, 8))
    result = np.empty((11, 8))
    _on_rows(x, y, result)
    for i in range(8):
        expected = _formulas(x[0, i], y[0, i])
        assert result[:, i] == pytest.approx(expected, rel=1e-14, abs=1e-14)


@njit
def _memory(x, integers, lines):
    row = lanes.load(x, 1)
    lanes.store_integers(integers, row)
    lanes.store(x, 0, lanes.add_scaled(lanes.zeros(), 2.0, row))
    line = lanes.add_scaled(lanes.zero_line(), 3.0, lanes.load_line(lines, 1))
    lanes.store_line(lines, 0, line)
    return lanes.between(row, 0, 7), lanes.between(row, 1, 7), lanes.number_at(x, 9)


def test_rows_and_lines_in_memory():
    x = np.vstack([np.zeros(8), np.arange(8.0)])
    integers, lines = np.zeros(8, np.int64), np.arange(8.0).reshape(2, 4)
    assert _memory(x, integers, lines) == (True, False, 1.0)
    assert integers.tolist() == list(range(8))
    assert x[0].tolist() == (2 * np.arange(8.0)).tolist()
    assert lines[0].tolist() == [12, 15, 18, 21]


@njit
def _columns(rows, lines, again):
    lanes.store_columns(
        lines, 1, lanes.load(rows, 0), lanes.load(rows, 1), lanes.load(rows, 2), lanes.load(rows, 3)
    )
    columns = lanes.load_columns(lines, 1)
    for k in range(4):
        lanes.store(again, k, columns[k])
    lanes.store_line(lines, 0, lanes.line_of(lines[1, 0], 2.0, 3.0, lines[8, 3]))


def test_rows_are_columns_of_lines():
    rows, lines, again = RNG.normal(size=(4, 8)), np.zeros((10, 4)), np.zeros((4, 8))
    _columns(rows, lines, again)
    assert np.array_equal(lines[1:9], rows.T)
    assert np.array_equal(again, rows)
    assert lines[0].tolist() == [rows[0, 0], 2.0, 3.0, rows[3, 7]]
    assert not lines[9].any()


@njit
def _between(x):
    return lanes.between(lanes.load(x, 0), 0, 1)


def test_nothing_is_between_if_a_lane_is_no_number():
    x = np.full((1, 8), 0.5)
    assert _between(x)
    x[0, 3] = np.nan
    assert not _between(x)


@njit
def _roots(x, result):
    lanes.store(result, 0, cube_root(lanes.load(x, 0)))
    lanes.store(result, 1, inverse_cube_root(lanes.load(x, 0)))


def test_cube_roots():
    x = np.exp(RNG.normal(scale=5, size=5000))
    exact = x.astype(np.longdouble) ** (np.longdouble(1) / 3)
    assert np.abs([cube_root(v) for v in x] / exact - 1).max() < 3e-16
    assert np.abs([inverse_cube_root(v) for v in x] * exact - 1).max() < 3e-16
    assert np.isnan([cube_root(v) for v in (0.0, -1.0, np.nan)]).all()
    rows = np.array([[1.0, 8.0, 0.001, 1e300, 1e-300, 2.0, -1.0, 0.0]])
    result = np.empty((2, 8))
    _roots(rows, result)
    for i, value in enumerate(rows[0]):
        assert result[0, i] == pytest.approx(cube_root(value), rel=1e-15, nan_ok=True)
        assert result[1, i] == pytest.approx(inverse_cube_root(value), rel=1e-15, nan_ok=True)


def test_logarithm_of_a_number():
    for x in (0.0, 1e-300, -1e-17, 3e-9, -0.0999, 0.0999, 0.1, -0.5, 7.0):
        assert log_of_one_plus(x) == pytest.approx(math.log1p(x), rel=3e-16)
    assert math.isnan(log_of_one_plus(-1.5))


@pytest.mark.parametrize("size", [1e-9, 1e-3, 0.05, 0.3, 2.0])
@pytest.mark.parametrize("axes", ["any", "plane", "equal"])
def test_logarithm_and_exponential_of_tensors(size, axes):
    """On both sides of where the series end; relative errors are those of the largest value."""
    Q = np.linalg.qr(RNG.normal(size=(3, 3)))[0]
    strains = size * np.array([1.0, -0.4, 0.3])
    if axes == "plane":
        Q[:] = [[0.6, -0.8, 0], [0.8, 0.6, 0], [0, 0, 1]]
    elif axes == "equal":
        strains[1] = strains[0]
    change = Q @ np.diag(np.expm1(strains)) @ Q.T
    result = logarithm(tuple(change[i, j] for i, j in _PAIRS))
    expected = Q @ np.diag(strains) @ Q.T
    assert result == pytest.approx([expected[i, j] for i, j in _PAIRS], abs=2e-15 * size)
    result = exponential(tuple(expected[i, j] for i, j in _PAIRS))
    expected = change + np.eye(3)
    assert result == pytest.approx([expected[i, j] for i, j in _PAIRS], abs=4e-15 * np.exp(size))


_PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))


@njit
def _stresses(update, F, L, parameters, sigma):
    nothing = lanes.tensors(F, 0)
    update(lanes.tensors(F, 0), lanes.tensors(L, 0), parameters, nothing, lanes.tensors(sigma, 0))


@pytest.mark.parametrize(
    "law",
    [NeoHookean(70.0, 0.3, v).pointwise() for v in ("quadratic", "miehe", "simo-taylor")]
    + [NewtonianFluid(100.0, 0.1)],
)
def test_laws_without_branches_are_compiled_for_eight_points(law):
    assert lanes.works_on_rows(law.update)
    F, L = np.eye(3) + 0.1 * RNG.normal(size=(8, 3, 3)), RNG.normal(size=(8, 3, 3))
    F[5] *= -1  # inverted
    sigma = np.empty((9, 8))
    _stresses(law.update, _in_rows(F), _in_rows(L), law.parameters, sigma)
    for i in range(8):
        expected = np.empty((3, 3))
        law.update(F[i], L[i], law.parameters, np.empty(0), expected)
        scale = np.abs(expected).max() if i != 5 else 1.0
        assert sigma[:, i] == pytest.approx(expected.ravel(), abs=1e-14 * scale, nan_ok=True)


def _in_rows(tensors):
    return np.ascontiguousarray(tensors.reshape(8, 9).T)


def test_laws_with_branches_are_not():
    assert not lanes.works_on_rows(Hencky(70.0, 0.3).update)
    assert not lanes.works_on_rows(VonMises(70.0, 0.3, 1.0).update)


@njit
def _eight(update_eight, F, L, parameters, state, sigma):
    state, sigma = lanes.tensors(state, 0), lanes.tensors(sigma, 0)
    return update_eight(lanes.tensors(F, 0), lanes.tensors(L, 0), parameters, state, sigma)


@pytest.mark.parametrize(
    "law",
    [
        Hencky(70.0, 0.3),
        VonMises(70.0, 0.3, 5.0, H=3.0),
        VonMises(70.0, 0.3, 5.0, sigma_r=1.0, eta=5.0),
        VonMises(70.0, 0.3, 5.0, sigma_r=9.0, eta=5.0),
    ],
)
def test_easy_steps_of_eight_points_are_those_of_one(law):
    F, L = np.eye(3) + 0.01 * RNG.normal(size=(8, 3, 3)), np.zeros((8, 3, 3))
    state = law.initial_state(8)
    for i in range(8):
        if law.n_state > 0:  # plastic deformation in the past
            state[i, law.columns["eps_p"]] = 0.1 * i / 8
            stretch = np.diag(np.exp([0.02 * i, -0.01 * i, -0.01 * i]))
            state[i, law.columns["C_p_inverse"]] = np.linalg.inv(stretch @ stretch).ravel()
            F[i] = F[i] @ stretch
    rows, sigma = np.ascontiguousarray(state.T), np.empty((9, 8))
    arguments = _in_rows(F), _in_rows(L), law.parameters, rows, sigma
    assert _eight(law.update_eight, *arguments)
    before = state.copy()
    for i in range(8):
        expected = np.empty((3, 3))
        law.update(F[i], L[i], law.parameters, state[i], expected)
        assert sigma[:, i] == pytest.approx(expected.ravel(), abs=1e-14 * np.abs(expected).max())
    assert np.array_equal(state, before)
    F[3] += 0.2 * np.eye(3)[::-1]  # a large strain
    assert not _eight(law.update_eight, _in_rows(F), *arguments[1:])


@pytest.mark.parametrize(
    "law",
    [
        VonMises(70.0, 0.3, 0.1),
        VonMises(70.0, 0.3, 0.1, H=3.0),
        VonMises(70.0, 0.3, 0.1, sigma_r=0.05, eta=5.0),
        VonMises(70.0, 0.3, 0.1, H=2.0, sigma_r=0.4, eta=3.0),
    ],
)
def test_plastic_steps_of_eight_points_are_those_of_one(law):
    """The points yield at a shear strain of 0.002; 0 and 1 do not, and 7 unloads at the end."""
    directions = RNG.normal(size=(8, 3, 3))
    sizes = np.array([0, 1e-3, 2e-3, 0.005, 0.01, 0.02, 0.03, 0.03])
    change = directions * (sizes / np.linalg.norm(directions, axis=(1, 2)))[:, None, None]
    change[0, 0, 0] = 1e-12
    F, state = np.tile(np.eye(3), (8, 1, 1)), law.initial_state(8)
    flows = []
    for factor in (1.0, 0.9, -0.01):
        F = (np.eye(3) + factor * change) @ F
        rows, sigma = np.ascontiguousarray(state.T), np.empty((9, 8))
        assert _eight(law.update_eight, _in_rows(F), np.zeros((9, 8)), law.parameters, rows, sigma)
        before = state.copy()
        for i in range(8):
            expected = np.empty((3, 3))
            law.update(F[i], np.zeros((3, 3)), law.parameters, state[i], expected)
            assert sigma[:, i] == pytest.approx(expected.ravel(), abs=2e-14 * law.kappa)
            assert rows[:, i] == pytest.approx(state[i], abs=1e-14)
        still = (state == before).all(axis=1)
        assert np.array_equal(rows[:, still], before[still].T)
        flows.append(np.flatnonzero(~still))
    assert flows[0].tolist() in ([2, 3, 4, 5, 6, 7], [3, 4, 5, 6, 7])
    assert {4, 5, 6, 7} <= set(flows[1]) and len(flows[2]) == 0


def test_large_flow_of_one_in_eight_is_not_easy():
    law = VonMises(70.0, 0.3, 0.1, sigma_r=0.05, eta=50.0)
    F = np.tile(np.eye(3), (8, 1, 1))
    rows, sigma = np.ascontiguousarray(law.initial_state(8).T), np.empty((9, 8))
    F[6, 0, 1] = 0.01
    before, zero = rows.copy(), np.zeros((9, 8))
    assert not _eight(law.update_eight, _in_rows(F), zero, law.parameters, rows, sigma)
    assert np.array_equal(rows, before)


@njit
def _exponentials(x, result):
    lanes.store(result, 0, math.exp(lanes.load(x, 0)))
    lanes.store(result, 1, exprel_small(lanes.load(x, 0)))


def test_exponentials():
    x, result = (
        np.array([[0.0, 1e-20, -1e-9, 0.01, -0.03, 0.0999, -0.0999, 1e-3]]),
        np.empty((2, 8)),
    )
    _exponentials(x, result)
    assert result[0] == pytest.approx(np.exp(x[0]), rel=3e-16)
    assert result[1] == pytest.approx([exprel(v) for v in x[0]], rel=3e-16)
    assert exprel(0.0) == 1 and exprel(2.0) == pytest.approx(math.expm1(2.0) / 2, rel=1e-15)


@njit
def _halves(lines, rows):
    low, high = lanes.load_line(lines, 1), lanes.load_line(lines, 0)
    row = lanes.scaled(2.0, lanes.join(low, high))
    lanes.store(rows, 0, row)
    lanes.store_line(lines, 0, lanes.low_half(row))
    lanes.store_line(lines, 1, lanes.high_half(row))


def test_a_row_consists_of_two_lines():
    lines, rows = np.arange(8.0).reshape(2, 4), np.empty((1, 8))
    _halves(lines, rows)
    assert rows[0].tolist() == [8, 10, 12, 14, 0, 2, 4, 6]
    assert lines.tolist() == [[8, 10, 12, 14], [0, 2, 4, 6]]
