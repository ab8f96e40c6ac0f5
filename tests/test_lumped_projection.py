# SPDX-License-Identifier: MIT
"""Projections in a residual: their values, and what they add to the tangent."""

import functools

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh

from fenicsmpm import forms, points
from fenicsmpm import formulations as fm
from fenicsmpm.cells import ActiveCells, Tying
from fenicsmpm.materials import NeoHookean
from fenicsmpm.simulation.parameters import of_residual
from fenicsmpm.simulation.renewals import renewals
from fenicsmpm.solvers import NewtonSolver
from fenicsmpm.transfer import p2g, project

pytestmark = pytest.mark.ranks

COMM = MPI.COMM_WORLD


@functools.cache  # on three ranks dolfinx does not always cut a mesh in the same way
def make_mesh(dim, n=5):
    if dim == 2:
        return mesh.create_unit_square(COMM, n, n)
    return mesh.create_unit_cube(COMM, n, n, n)


class Problem:
    """OSGS and another projection, of a body in a larger mesh."""

    def __init__(self, dim, tied=False, gap=0.0, options=None, **more):
        domain = make_mesh(dim)
        self.body = points.lattice(domain, 0.081, inside=lambda x: x.max(axis=0) < 0.7)
        self.z = z = fm.Unknown(domain, "u", "p")
        z.fix("u", lambda x: np.isclose(x[dim - 1], 0), gap)
        law, cells = NeoHookean(E=3.0, nu=0.5), ActiveCells(self.body)
        force = fem.Constant(domain, 0.1 * np.arange(1.0, dim + 1))
        self.R = fm.stabilized("osgs", z, self.body, law, force=force)
        tying = Tying(z.space, self.body, cells) if tied else None
        if not tied:
            self.R += fm.ghost_penalty(z, cells, law)
        mean = fm.LumpedProjection(self.body, z.p)
        self.R -= 0.1 * (z.p - mean) * z.test.p * self.body.dx
        options = {"petsc_options": options, "tying": tying, "rtol": 1e-11}
        self.newton = NewtonSolver(self.R, z.U, z.bcs, **options, **more)


def wave(x):
    return np.array([0.03 * np.sin(3 * x[0] + k) * np.cos(2 * x[1]) for k in range(len(x))])


@pytest.mark.mpi
@pytest.mark.parametrize("dim", [2, 3])
def test_lumped_projection_of_an_expression(dim):
    domain = make_mesh(dim)
    body = points.random(domain, 4, seed=1)
    body.add_field("T", (), 2.5)
    f = fem.Function(fem.functionspace(domain, ("Lagrange", 1)))
    f.x.array[:] = 3.0
    projection = fm.LumpedProjection(body, ufl.as_vector([f * body.field("T"), 1]))
    projection.follow_points()
    expected = np.tile([7.5, 1.0], len(projection.x.array) // 2)
    assert projection.x.array == pytest.approx(expected, rel=1e-13)
    f.x.array[:] = 1.0  # a form that is assembled sees it
    V = projection.function_space
    forms.assemble_vector(forms.form(ufl.inner(projection, ufl.TestFunction(V)) * body.dx))
    assert projection.x.array[::2] == pytest.approx(2.5, rel=1e-13)


@pytest.mark.mpi
def test_nodes_without_points_have_zero():
    domain = make_mesh(2)
    body = points.lattice(domain, 0.05, inside=lambda x: x[0] < 0.45)
    projection = fm.LumpedProjection(body, 4.0)
    projection.follow_points()
    volume = p2g(body, body.weight, projection.function_space).array
    there = volume > 1e-12  # and not what is zero but for round-off
    assert 0 < COMM.allreduce(np.sum(there)) < COMM.allreduce(len(there))
    assert projection.x.array == pytest.approx(np.where(there, 4.0, 0.0), abs=1e-3)


@pytest.mark.mpi
@pytest.mark.parametrize("tied", [False, True])
@pytest.mark.parametrize("dim", [2, 3])
def test_the_tangent_is_that_of_the_residual(dim, tied):
    """Products and matrix are the same, and what differences of the residual say."""
    s = Problem(dim, tied)
    newton, z = s.newton, s.z
    z.interpolate("u", lambda x: wave(x)[:dim] * x[dim - 1])
    z.interpolate("p", lambda x: wave(x)[0])
    newton._prepare_matrix()
    if tied:
        newton._tie()
    at = z.U.x.array.copy()
    newton._residual_norm()
    A = newton._tangent()
    projected = newton._projected
    operator, matrix = projected.operator(A, preconditions=True), projected.matrix(A)
    x, by_products, by_matrix = (newton._b.duplicate() for _ in range(3))
    start, end = x.getOwnershipRange()
    x.array_w[:] = np.sin(np.arange(start, end) ** 2.0)
    if tied:
        newton.tying.extend(x)
    for bc in z.bcs:
        x.array_w[bc.dof_indices()[0][: bc.dof_indices()[1]]] = 0.0
    operator.mult(x, by_products)
    matrix.mult(x, by_matrix)
    by_matrix.axpy(-1.0, by_products)
    assert by_matrix.norm() < 1e-13 * by_products.norm()

    scaling, scaled = x.duplicate(), projected.operator(A, preconditions=False)
    scaling.array_w[:] = 1 + np.cos(np.arange(start, end)) ** 2
    scaled.diagonalScale(scaling, scaling)
    by_scaling, by_hand = x.duplicate(), x.duplicate()
    scaled.mult(x, by_scaling)
    by_matrix.pointwiseMult(x, scaling)
    matrix.mult(by_matrix, by_hand)
    by_hand.pointwiseMult(by_hand, scaling)
    by_hand.axpy(-1.0, by_scaling)
    assert by_hand.norm() < 1e-13 * by_scaling.norm()

    # the preconditioner has the pressure's own entries of the whole, and those of A elsewhere
    P, pressures = projected.preconditioner(A), np.zeros(len(x.array_r), dtype=bool)
    pressures[[dof for dof in z.dofs("p") if dof < len(pressures)]] = True
    only_p, by_P, by_A = (x.duplicate() for _ in range(3))
    only_p.array_w[:] = np.where(pressures, x.array_r, 0)
    P.mult(only_p, by_P)
    A.mult(only_p, by_A)
    matrix.mult(only_p, by_matrix)
    expected = np.where(pressures, by_matrix.array_r, by_A.array_r)
    assert by_P.array_r == pytest.approx(expected, rel=1e-12, abs=1e-12 * by_P.norm())

    direction = fem.Function(z.space)
    direction.x.array[: len(x.array_r)] = x.array_r
    direction.x.scatter_forward()
    size, residuals = 1e-6, []
    for sign in (1, -1):
        z.U.x.array[:] = at + sign * size * direction.x.array
        newton._residual_norm()
        residuals.append(newton._b.array_r.copy())
    difference = (residuals[0] - residuals[1]) / (2 * size)
    free = np.ones(len(difference), dtype=bool)
    for bc in z.bcs:
        free[bc.dof_indices()[0][: bc.dof_indices()[1]]] = False
    if tied:
        free[newton.tying.tied_dofs] = False
    free &= np.abs(difference) > 0  # not inactive
    wrong = np.abs(by_products.array_r - difference)[free].max(initial=0.0)
    assert wrong < 1e-7 * COMM.allreduce(np.abs(difference).max(initial=0.0), MPI.MAX)
    K = newton._b.duplicate()
    A.mult(x, K)
    K.axpy(-1.0, by_products)
    assert K.norm() > 1e-3 * by_products.norm()


@pytest.mark.mpi
@pytest.mark.parametrize("tied", [False, True])
@pytest.mark.parametrize("dim", [2, 3])
def test_iterations_and_factors_find_the_same_in_quadratic_steps(dim, tied):
    """Also from a start that the conditions do not hold for."""
    default = Problem(dim, tied, gap=0.02)
    direct = Problem(dim, tied, gap=0.02, options={"pc_type": "lu"})
    result, exact = default.newton.solve(), direct.newton.solve()
    assert default.newton.linear.method == "GMRES + mumps" and result.linear_iterations > 0
    assert default.newton.linear.direct_after_all == 0
    assert direct.newton.linear.method == "mumps" and exact.linear_iterations == 0
    assert exact.iterations <= result.iterations <= exact.iterations + 1 <= 6
    norms = np.array(exact.residuals)
    norms = norms[norms > 1e-13 * norms[0]]
    assert len(norms) > 3
    assert np.all(np.log(norms[2:]) < 1.6 * np.log(norms[1:-1]) - 0.6 * np.log(norms[0]))
    assert norms[1] < 0.5 * norms[0]  # what the conditions add is in the first step, too
    one, other = (s.z.U.x.array for s in (default, direct))
    assert one == pytest.approx(other, abs=1e-8 * np.abs(other).max())


@pytest.mark.mpi
def test_a_kept_tangent_and_one_of_ones_own_find_the_same():
    solution = Problem(2)
    solution.newton.solve()
    for options in (None, {"pc_type": "lu"}):
        kept = Problem(2, options=options, keep_tangent=0.5)
        result = kept.newton.solve()
        assert result.tangents < result.iterations < 25
        found = kept.z.U.x.array
        assert found == pytest.approx(solution.z.U.x.array, abs=1e-8)
    lagged = Problem(2)  # projections lag by an iteration, as in VMS
    J = ufl.derivative(lagged.R, lagged.z.U)
    newton = NewtonSolver(lagged.R, lagged.z.U, lagged.z.bcs, J=J, rtol=1e-9, max_iterations=60)
    result = newton.solve()
    assert newton.linear.method == "mumps" and result.iterations > 6
    assert lagged.z.U.x.array == pytest.approx(solution.z.U.x.array, abs=1e-7)


def test_fields_in_a_projection_are_known():
    domain = make_mesh(2)
    body = points.quadrature(domain, 2)
    body.add_field("F", (3, 3), np.eye(3))
    body.add_field("H", (), 1.0)
    z = fm.Unknown(domain, "u")
    new = 2 * ufl.tr(ufl.grad(z.u))
    H = body.field("H").renew(new)
    R = fm.LumpedProjection(body, H) * z.test.u[0] * body.dx
    assert renewals(R, {body: z.u})[body] == {"H": new}
    other = fm.LumpedProjection(body, 2 * H) * z.test.u[0] * body.dx
    assert of_residual(R) != of_residual(other)


@pytest.mark.mpi
def test_a_field_that_varies_is_averaged_by_its_neighbours():
    domain = make_mesh(2)
    body = points.random(domain, 4, seed=1)
    body.add_field("T", (), np.sin(5 * body.x[:, 0]))
    projection = fm.LumpedProjection(body, body.field("T"))
    projection.follow_points()
    expected = fem.Function(projection.function_space)
    project([body], {"T": expected}, mass="weight")
    assert projection.x.array == pytest.approx(expected.x.array, rel=1e-12, abs=1e-14)


@pytest.mark.parametrize(
    ("expression", "message"),
    [
        (lambda body, f: ufl.grad(ufl.grad(f)), r"not a tensor of shape \(2, 2\)"),
        (lambda body, f: fm.LumpedProjection(body, f), "cannot have another projection in it"),
    ],
)
def test_what_cannot_be_projected(expression, message):
    domain = make_mesh(2)
    body = points.quadrature(domain, 1)
    f = fem.Function(fem.functionspace(domain, ("Lagrange", 1)))
    with pytest.raises(ValueError, match=message):
        fm.LumpedProjection(body, expression(body, f))
