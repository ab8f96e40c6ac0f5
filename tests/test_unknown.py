# SPDX-License-Identifier: MIT
"""The unknown: parts by name, their places, test functions and conditions."""

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh

from fenicsmpm import forms, points
from fenicsmpm import formulations as fm

pytestmark = pytest.mark.ranks


@pytest.fixture
def domain():
    return mesh.create_unit_square(MPI.COMM_WORLD, 4, 3)


def left(x):
    return np.isclose(x[0], 0)


def top(x):
    return np.isclose(x[1], 1)


@pytest.mark.mpi
def test_parts_by_name(domain):
    z = fm.Unknown(domain, "u", "p", fm.Part("Pi", is_vector=True, role="grid", degree=2))
    assert [part.role for part in z.parts] == ["moves", "history", "grid"]
    assert (z.u.ufl_shape, z.p.ufl_shape, z.Pi.ufl_shape) == ((2,), (), (2,))
    assert (z.test.u.ufl_shape, z.test.p.ufl_shape) == ((2,), ())
    assert z.moving == "u" and "Pi" in z and "q" not in z
    z.U.sub(0).interpolate(lambda x: np.array([x[0], 2 * x[1]]))
    z.U.sub(1).interpolate(lambda x: x[0] * 3)
    # each part in its place, none twice
    everything = np.sort(np.concatenate([z.dofs(part.name) for part in z.parts]))
    assert everything == pytest.approx(np.arange(len(z.U.x.array)))
    p = fem.Function(z.part_space("p"))
    p.interpolate(lambda x: x[0] * 3)
    assert z.function("p").x.array == pytest.approx(p.x.array, abs=1e-14)
    assert z.U.x.array[z.dofs("p")] == pytest.approx(p.x.array, abs=1e-14)
    body = points.fill(domain, 3)
    x = ufl.SpatialCoordinate(domain)
    u, p = z.u, z.p
    error = ufl.inner(u - ufl.as_vector([x[0], 2 * x[1]]), u) + (p - 3 * x[0]) ** 2
    assert forms.assemble_scalar(forms.form(error * body.dx)) == pytest.approx(0, abs=1e-14)


@pytest.mark.mpi
def test_functions_of_ones_own(domain):
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    own = fem.Function(V)
    z = fm.Unknown(own, "u")
    assert z.U is own and z.u is own and z.part_space("u") is V
    with pytest.raises(ValueError, match=r"parts of shapes \[\(2,\)\], but .*p \(scalar"):
        fm.Unknown(own, "p")
    # parts of both have the same names
    z = fm.Unknown(domain, "T")
    assert z.T.ufl_shape == () and z.old.T.function_space is z.space


@pytest.mark.mpi
def test_conditions(domain):
    z = fm.Unknown(domain, "u", "p")
    z.fix("u", left)
    z.fix("u", top, lambda x, t: (1 + x[0]) * t**2, component=1)
    z.fix("p", top, lambda x: 5 * x[0])
    z.set_conditions(2.0, 3.0)
    z.U.x.array[:] = 7.0
    for bc in z.bcs:
        fm_set(bc, z.U.x.array)
    u, p = z.function("u"), z.function("p")
    xu, xp = (
        u.function_space.tabulate_dof_coordinates(),
        p.function_space.tabulate_dof_coordinates(),
    )
    values = u.x.array.reshape(-1, 2)
    on_left, on_top = left(xu.T), top(xu.T)
    assert np.all(values[on_left & ~on_top] == 0)
    # the increment from 2 s to 3 s of the displacement since the start
    assert values[on_top, 1] == pytest.approx((1 + xu[on_top, 0]) * 5)
    assert np.all(values[~on_left, 0] == 7) and np.all(values[~(on_left | on_top)] == 7)
    # other parts have the value of the end
    assert p.x.array == pytest.approx(np.where(top(xp.T), 5 * xp[:, 0], 7))


def fm_set(bc, x):
    """Set the values of a condition, in dolfinx 0.9 and newer."""
    from fenicsmpm import _compat

    _compat.bc_set(bc, x, None, 1.0)


@pytest.mark.mpi
def test_values_of_several_shapes(domain):
    z = fm.Unknown(domain, "u")
    given = fem.Function(z.part_space("u"))
    given.x.array[:] = 3.0
    for value, wanted in [
        (2.0, (2, 2)), ((1, 2), (1, 2)), (lambda x: 0 * x[:2] + 4, (4, 4)), (given, (3, 3)),
        (lambda t, k=4: (t, k), (0, 0)), (lambda x: (5, 6), (5, 6)),
    ]:  # fmt: skip
        condition = z.fix("u", left, value)
        z.U.x.array[:] = -1.0
        fm_set(condition.bc, z.U.x.array)
        u = z.function("u")
        found = u.x.array.reshape(-1, 2)[left(u.function_space.tabulate_dof_coordinates().T)]
        assert np.all(found == wanted)


@pytest.mark.mpi
def test_facets(domain):
    domain.topology.create_connectivity(1, 2)
    boundary = mesh.exterior_facet_indices(domain.topology)
    z = fm.Unknown(domain, "u", "p")
    z.fix("p", boundary, lambda x: x[0] + x[1])
    z.fix("u", boundary, 1.0, component=0)
    z.interpolate("p", lambda x: 0 * x[0] - 5)
    for bc in z.bcs:
        fm_set(bc, z.U.x.array)
    p, u = z.function("p"), z.function("u")
    for function in (p, u):
        x = function.function_space.tabulate_dof_coordinates().T
        outside = np.any(np.isclose(x[:2], 0) | np.isclose(x[:2], 1), axis=0)
        values = function.x.array.reshape(x.shape[1], -1)
        wanted = np.where(outside, x[0] + x[1], -5) if function is p else 1.0 * outside
        assert values[:, 0] == pytest.approx(wanted)


@pytest.mark.mpi
def test_wrong_use(domain):
    z = fm.Unknown(domain, "u", "p")
    moves = {"is_vector": True, "role": "moves"}
    for wrong, message in [
        (lambda: fm.Unknown(domain), "needs parts"),
        (lambda: fm.Unknown(domain, "u", "u"), "'u' of a part is taken"),
        (lambda: fm.Unknown(domain, "U"), "'U' of a part is taken"),
        (lambda: fm.Unknown(domain, "fix"), "'fix' of a part is taken"),
        (lambda: fm.Unknown(domain, "conditions"), "'conditions' of a part is taken"),
        (lambda: fm.Unknown(domain, "parts"), "'parts' of a part is taken"),
        (lambda: fm.Unknown(domain, "u", fm.Part("d", **moves)), "u and d would both move"),
        (lambda: fm.Part("a b"), "must be a Python identifier"),
        (lambda: fm.Part("T", role="carried"), "unknown role 'carried'"),
        (lambda: fm.Part("T", role="moves"), "'T' is a scalar"),
        (lambda: fm.Part("T", flip=2.0), "flip = 2.0"),
        (lambda: z.fix("q", left), "part q of the unknown, which has u, p"),
        (lambda: z.fix("p", left, component=0), "no component 0"),
        (lambda: z.fix("u", left, component=2), "no component 2"),
        (lambda: z.fix("u", lambda x: x[0] > 5), "at no node"),
        (lambda: z.fix("u", lambda x: x[:, 0] == 0), r"positions of the shape \(3, n\)"),
        (lambda: z.fix("u", lambda x: x[0]), "not float64"),
        (lambda: z.fix("u", np.array([[1, 2]])), "local facets"),
        (lambda: z.fix("u", np.array([], dtype=np.int32)), "at no node"),
        (lambda: z.fix("u", left, (1, 2, 3)), r"needs 2 component\(s\)"),
        (lambda: z.fix("p", left, lambda x: x), r"needs 1 component\(s\)"),
        (lambda: z.fix("u", left, lambda x: x[:2, 1]), "depends on position, but is a"),
        (lambda: z.fix("p", left, lambda y: y), "parameters y"),
        (lambda: z.fix("p", left, fem.Function(z.part_space("u"))), "function of another space"),
        (lambda: z.require("T", of="heat"), "heat needs the part T of the unknown"),
    ]:
        with pytest.raises(ValueError, match=message):
            wrong()
    with pytest.raises(AttributeError, match="no part 'q' of the unknown: it has u, p"):
        z.q
    assert repr(z) == "Unknown(u (vector, moves), p (scalar, history))"


@pytest.mark.mpi
def test_a_marker_that_fails_on_one_rank(domain):
    z = fm.Unknown(domain, "u")

    def marker(x):
        if domain.comm.rank == domain.comm.size - 1:
            raise RuntimeError("mine")
        return left(x)

    with pytest.raises(RuntimeError, match="mine"):
        z.fix("u", marker)
