# SPDX-License-Identifier: MIT
"""Few sites instead of many points, where the integrand is a polynomial in each cell."""

import math

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh

from fenicsmpm import forms, points
from fenicsmpm.formulations import Unknown, asgs, mixed, ppp
from fenicsmpm.materials import NeoHookean


def problem(dim):
    """Points at random, with weights at random, and the functions of a mixed problem."""
    create = mesh.create_unit_square if dim == 2 else mesh.create_unit_cube
    domain = create(MPI.COMM_WORLD, *[3] * dim)
    body = points.random(domain, 30, seed=1)
    rng = np.random.default_rng(2)
    body.weight[:] *= rng.uniform(0.5, 1.5, len(body))
    body.tag[:] = rng.integers(0, 2, len(body))
    z = Unknown(domain, "u", "p")
    z.U.x.array[:] = 0.01 * rng.standard_normal(len(z.U.x.array))
    return body, z


RESIDUALS = {
    # name: residual, nu, degree
    "asgs 0.5": (lambda z, b: asgs(z, b, NeoHookean(70.0, 0.5)), 0),
    "mixed 0.5": (lambda z, b: mixed(z, b, NeoHookean(70.0, 0.5)), 1),
    "ppp 0.5": (lambda z, b: ppp(z, b, NeoHookean(70.0, 0.5)), 2),
    "mixed 0.4": (lambda z, b: mixed(z, b, NeoHookean(70.0, 0.4)), 2),
    "asgs 0.4": (lambda z, b: asgs(z, b, NeoHookean(70.0, 0.4)), 2),
    "cubic": (lambda z, b: z.U[0] * z.U[1] * z.V[0] * b.dx, 3),
    "tagged": (lambda z, b: z.U[0] * ufl.grad(z.U)[1, 0] * z.V[1] * b.dx(1), 2),
    "conditional": (
        lambda z, b: (
            ufl.conditional(ufl.lt(z.U[0].dx(0), 0.0), z.U[1], z.U[0]) * z.V[1] / 3.0 * b.dx
        ),
        2,
    ),
    "sine": (lambda z, b: ufl.sin(z.U[0]) * z.V[0] * b.dx, math.inf),
    "quartic": (lambda z, b: z.U[0] ** 2 * z.U[1] * z.V[0] * b.dx, math.inf),
    "quotient": (lambda z, b: z.V[0] / (2.0 + z.U[0]) * b.dx, math.inf),
    "position": (
        lambda z, b: ufl.SpatialCoordinate(b.mesh)[0] * z.U[0] * z.V[0] * b.dx,
        math.inf,
    ),
}


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("name", RESIDUALS)
def test_degree_and_equality(name, dim):
    body, z = problem(dim)
    residual, degree = RESIDUALS[name]
    # a field that differs from point to point prevents any condensation
    body.add_field("zero", (), np.zeros(len(body)))
    zero = body.field("zero")
    R = residual(z, body)
    for form in (R, ufl.derivative(R, z.U)):
        few = forms.form(form)
        all_points = forms.form(form + zero_form(zero, form, body))
        assert few.point_integrals[0].lowered.degree == degree
        assert all_points.point_integrals[0].lowered.degree == math.inf
        assert_same(few, all_points)
        body.weight[:] *= np.linspace(0.5, 1.5, len(body))  # seen without any notification
        assert_same(few, all_points)


def zero_form(zero, form, body):
    """A vanishing form of the same rank and measure."""
    arguments = form.arguments()
    tag = {i.subdomain_id() for i in form.integrals()} - {"everywhere"}
    measure = body.dx(1) if tag else body.dx
    return zero * math.prod(a[0] for a in arguments) * measure


def assert_same(first, second):
    if first.rank == 1:
        a, b = (forms.assemble_vector(f).array for f in (first, second))
    else:
        size = len(forms.assemble_matrix(first).to_dense())
        used = np.setdiff1d(np.arange(size), forms.inactive_dofs(first))
        a, b = (forms.assemble_matrix(f).to_dense()[np.ix_(used, used)] for f in (first, second))
    assert np.max(np.abs(b)) > 0
    assert np.max(np.abs(a - b)) <= 1e-13 * np.max(np.abs(b))


def test_averages_of_quadratic_functions():
    body, _ = problem(2)
    space = fem.functionspace(body.mesh, ("Lagrange", 2))
    f = fem.Function(space)
    f.interpolate(lambda x: x[0] ** 2)
    form = forms.form(ufl.cell_avg(f) * body.dx)
    assert form.point_integrals[0].lowered.degree == math.inf
    expected = MPI.COMM_WORLD.allreduce(body.weight @ forms.evaluate(f, body))
    assert forms.assemble_scalar(form) == pytest.approx(expected, rel=1e-12)


def test_scalar():
    body, z = problem(2)
    product = z.U[0] * z.U[1]
    form = forms.form(product * body.dx)
    assert form.point_integrals[0].lowered.degree == 2
    values = forms.evaluate(product, body)
    expected = MPI.COMM_WORLD.allreduce(body.weight @ values)
    assert forms.assemble_scalar(form) == pytest.approx(expected, rel=1e-12)


def test_weights_that_are_not_positive():
    body, z = problem(2)
    form = forms.form(z.U[0] * z.V[0] * body.dx)
    expected = forms.assemble_vector(form).array
    body.weight[: len(body) // 2] = 0.0  # whole cells without any weight
    first = forms.assemble_vector(form).array
    body.weight[:] = 0.0
    assert np.all(forms.assemble_vector(form).array == 0.0)
    assert np.all(np.isfinite(first)) and np.any(first != expected)


def test_it_follows_the_points():
    body, z = problem(2)
    body.add_field("zero", (), np.zeros(len(body)))
    zero = body.field("zero")
    U, V = z.U, z.V
    form = forms.form(U[1] * ufl.grad(V)[0, 0] * body.dx)
    full = forms.form((U[1] * ufl.grad(V)[0, 0] + zero * V[0]) * body.dx)
    for _ in range(3):
        body.move(0.9 * body.x + 0.05)
        assert_same(form, full)


def test_the_dofs_without_points_are_those_of_the_points():
    domain = mesh.create_unit_square(MPI.COMM_SELF, 1, 1)
    corner = np.zeros((4, 2))  # all points at one corner, where the other functions vanish
    body = points.MaterialPoints(domain, corner, np.ones(4))
    space = fem.functionspace(domain, ("Lagrange", 1))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    assert len(forms.inactive_dofs(forms.form(u * v * body.dx))) == 3
