# SPDX-License-Identifier: MIT
"""Splines and uGIMP on lattices: sums, derivatives, forms over them."""

from mpi4py import MPI

import basix.ufl
import numpy as np
import pytest
import ufl
from dolfinx import fem, la
from lattices import (
    COMM,
    EACH,
    EVERYWHERE,
    LOWER,
    SHAPE,
    UPPER,
    by_id,
    cloud,
    inner_cloud,
    noise,
    owned,
    product,
    space,
)  # fmt: skip

from fenicsmpm import MaterialPoints, basis, forms
from fenicsmpm.materials import NeoHookean
from fenicsmpm.transfer import p2g

pytestmark = pytest.mark.ranks

# --- functions and derivatives -------------------------------------------------------------------


@pytest.mark.mpi
@EVERYWHERE
@EACH
def test_sum_is_one_and_linear_functions_are_reproduced(dim, name):
    body = cloud(dim, name)
    V = space(body.mesh, dim)
    table = basis.stencil_of(body).table(V.ufl_element().sub_elements[0].basix_element, 2)
    assert table[:, 0].sum(axis=1) == pytest.approx(1, abs=1e-13)
    assert np.abs(table[:, 1:].sum(axis=2)).max(initial=0) < 1e-11  # 1/m and 1/m^2
    x = fem.Function(V)
    x.interpolate(lambda x: x[:dim])
    assert forms.evaluate(x, body) == pytest.approx(body.x, abs=1e-13)
    gradient = forms.evaluate(ufl.grad(x), body)
    assert gradient == pytest.approx(np.broadcast_to(np.eye(dim), gradient.shape), abs=1e-13)
    assert np.abs(forms.evaluate(ufl.grad(ufl.grad(x)), body)).max(initial=0) < 1e-11


@pytest.mark.mpi
@EVERYWHERE
@EACH
def test_derivatives_against_finite_differences(dim, name):
    body = inner_cloud(dim, name)
    f = noise(space(body.mesh))
    value, slope = forms.PointExpression(f, body), forms.PointExpression(ufl.grad(f), body)
    curvature = by_id(body, forms.evaluate(ufl.grad(ufl.grad(f)), body))
    gradient = by_id(body, slope.evaluate())
    assert np.abs(curvature).max() > 1
    step = 1e-6
    for k in range(dim):
        ends = []
        for sign in (1, -2):  # from the middle up, and from there down
            body.move(body.x + sign * step * np.eye(dim)[k])
            ends.append((by_id(body, value.evaluate()), by_id(body, slope.evaluate())))
        body.move(body.x + step * np.eye(dim)[k])
        differences = [(up - down) / (2 * step) for up, down in zip(*ends, strict=True)]
        assert gradient[:, k] == pytest.approx(differences[0], abs=1e-8)
        assert curvature[:, k] == pytest.approx(differences[1], abs=1e-6)


@pytest.mark.mpi
@EVERYWHERE
def test_linear_functions_are_those_of_the_finite_elements(dim):
    bodies = inner_cloud(dim, "linear"), None
    bodies = bodies[0], MaterialPoints(bodies[0].mesh, bodies[0].x, bodies[0].weight)
    V = space(bodies[0].mesh, dim)
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    w = noise(V)
    matrices = []
    for body in bodies:
        integrand = ufl.inner(ufl.grad(u), ufl.grad(v)) + ufl.inner(u, ufl.dot(ufl.grad(v), w))
        matrices.append(forms.assemble_matrix(forms.form(integrand * body.dx)).to_scipy().tocsr())
    difference = matrices[0] - matrices[1]
    assert abs(difference).max() < 1e-13 * abs(matrices[1]).max()


# --- forms ---------------------------------------------------------------------------------------


@pytest.mark.mpi
@EVERYWHERE
@EACH
def test_row_sums_of_the_mass_are_sums_of_weights(dim, name):
    body = cloud(dim, name)
    V = space(body.mesh)
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    one = fem.Function(V)
    one.x.array[:] = 1
    lumped = p2g(body, body.weight, V)
    mass = product(forms.form(u * v * body.dx), one)
    assert mass == pytest.approx(owned(lumped), abs=1e-15)
    assert COMM.allreduce(owned(lumped).sum()) == pytest.approx(body.volume(), rel=1e-14)
    moments = p2g(body, body.weight[:, None] * body.x, V).array.reshape(-1, dim)
    first = COMM.allreduce((body.weight[:, None] * body.x).sum(axis=0))
    n = V.dofmap.index_map.size_local
    assert COMM.allreduce(moments[:n].sum(axis=0)) == pytest.approx(first, rel=1e-13)


@pytest.mark.mpi
@EVERYWHERE
@EACH
def test_stiffness_of_constant_and_linear_fields(dim, name):
    body = cloud(dim, name)
    V = space(body.mesh)
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    a = forms.form(ufl.inner(ufl.grad(u), ufl.grad(v)) * body.dx)
    one, linear = fem.Function(V), fem.Function(V)
    one.x.array[:] = 1
    slope = np.arange(1.0, dim + 1)
    linear.interpolate(lambda x: slope @ x[:dim])
    assert np.abs(product(a, one)).max(initial=0) < 1e-12
    b = forms.assemble_vector(forms.form(ufl.dot(ufl.as_vector(slope), ufl.grad(v)) * body.dx))
    b.scatter_reverse(la.InsertMode.add)
    assert product(a, linear) == pytest.approx(owned(b), abs=1e-12)


def mixed_energy(body, U):
    """Of a hyperelastic solid with its pressure as unknown; any smooth function would do."""
    dim = body.mesh.geometry.dim
    u, p = ufl.split(U)
    gradient = ufl.grad(u)
    F = ufl.as_tensor(
        [
            [float(i == j) + (gradient[i, j] if max(i, j) < dim else 0) for j in range(3)]
            for i in range(3)
        ]
    )
    J = ufl.det(F)
    law = NeoHookean(E=10.0, nu=0.3)
    return (law.energy(F, J) + p * (J - 1) - p**2 / 4) * body.dx


@pytest.mark.mpi
@EVERYWHERE
@pytest.mark.parametrize("name", ["quadratic", "cubic", "gimp"])
def test_tangent_of_a_mixed_hyperelastic_residual_is_its_derivative(dim, name):
    body = cloud(dim, name)
    cell = body.mesh.basix_cell()
    of_u = basix.ufl.element("Lagrange", cell, 1, shape=(dim,))
    W = fem.functionspace(
        body.mesh, basix.ufl.mixed_element([of_u, basix.ufl.element("Lagrange", cell, 1)])
    )

    def function(scale):
        f = fem.Function(W)
        f.sub(0).interpolate(
            lambda x: scale * np.stack([np.sin(3 * x[1] + k) * x[0] for k in range(dim)])
        )
        f.sub(1).interpolate(lambda x: scale * np.cos(2 * x[0] * x[1]))
        return f

    U, dU = function(0.02), function(0.3)
    R = ufl.derivative(mixed_energy(body, U), U)
    residual, tangent = forms.form(R), forms.form(ufl.derivative(R, U))

    def assembled():
        b = forms.assemble_vector(residual)
        b.scatter_reverse(la.InsertMode.add)
        return owned(b).copy()

    start, slope, at = assembled(), product(tangent, dU), U.x.array.copy()
    errors = []
    for h in (1e-2, 5e-3):
        U.x.array[:] = at + h * dU.x.array
        difference = assembled() - start - h * slope
        errors.append(COMM.allreduce(difference @ difference) ** 0.5)
    assert errors[0] > 0
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.05)


@pytest.mark.mpi
@EVERYWHERE
@pytest.mark.parametrize("name", ["quadratic", "cubic", "gimp"])
def test_forms_do_not_depend_on_the_number_of_ranks(dim, name):
    sums = []
    for comm in (COMM, MPI.COMM_SELF):
        body = cloud(dim, name, comm)
        V = space(body.mesh, dim)
        u, v, w = ufl.TrialFunction(V), ufl.TestFunction(V), noise(V)
        a = ufl.inner(ufl.grad(u), ufl.grad(v)) + ufl.inner(ufl.dot(ufl.grad(u), w), v)
        compact = forms.create_matrix(forms.form(a * body.dx), compact=True)
        A = forms.assemble_matrix(forms.form(a * body.dx), A=compact)
        A2 = forms.assemble_matrix(forms.form(a * body.dx))
        b = forms.assemble_vector(forms.form(ufl.inner(w, v) * ufl.dot(w, w) * body.dx))
        b.scatter_reverse(la.InsertMode.add)
        squares = [m.squared_norm() for m in (A, A2)] + [comm.allreduce(owned(b) @ owned(b))]
        # these sum over ranks already
        sums.append([*squares, comm.allreduce(len(forms.inactive_dofs(forms.form(a * body.dx))))])
    assert sums[0] == pytest.approx(sums[1], rel=1e-12)
    assert sums[0][0] == pytest.approx(sums[0][1], rel=1e-14)


@pytest.mark.mpi
@EVERYWHERE
@EACH
def test_constants_of_cells_tags_and_geometry_are_those_of_the_points(dim, name):
    body = cloud(dim, name)
    spacing = (UPPER - LOWER)[:dim] / SHAPE[:dim]
    volume = forms.evaluate(ufl.CellVolume(body.mesh), body)
    assert volume == pytest.approx(np.prod(spacing), rel=1e-13)
    J = forms.evaluate(ufl.Jacobian(body.mesh), body)
    assert np.abs(J).sum(axis=2) == pytest.approx(np.tile(spacing, (len(body), 1)), rel=1e-13)
    K = forms.evaluate(ufl.JacobianInverse(body.mesh), body)
    assert J @ K == pytest.approx(np.broadcast_to(np.eye(dim), J.shape), abs=1e-13)
    body["tag"] = body.id % 3
    x = ufl.SpatialCoordinate(body.mesh)
    left = COMM.allreduce((body.weight * body.x[:, 0])[body.tag == 1].sum())
    f = fem.Function(space(body.mesh))
    f.interpolate(lambda x: x[0])
    for first in (x[0], f):
        integral = forms.assemble_scalar(forms.form(first * body.dx(1)))
        assert integral == pytest.approx(left, rel=1e-13)


@pytest.mark.mpi
def test_conditions_and_lifting():
    """Rows without conditions of A x, from the matrix without and with lifting of a condition."""
    body = cloud(2, "cubic")
    V = space(body.mesh)
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    a = forms.form((ufl.inner(ufl.grad(u), ufl.grad(v)) + u * v) * body.dx)
    g = noise(V)
    dofs = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[0], LOWER[0]))
    bc = fem.dirichletbc(g, dofs)
    at_wall, inside = fem.Function(V), fem.Function(V)
    at_wall.x.array[dofs] = g.x.array[dofs]
    at_wall.x.scatter_forward()
    inside.x.array[:] = g.x.array - at_wall.x.array
    lifted = la.vector(V.dofmap.index_map, 1)
    lifted.array[:] = 0
    forms.apply_lifting(lifted.array, [a], [[bc]])
    lifted.scatter_reverse(la.InsertMode.add)
    free = np.setdiff1d(np.arange(V.dofmap.index_map.size_local), dofs)
    expected = product(a, g)[free] - product(a, inside)[free]
    assert -owned(lifted)[free] == pytest.approx(expected, abs=1e-13)
    assert np.abs(COMM.allreduce(np.abs(expected).sum())) > 0.1
