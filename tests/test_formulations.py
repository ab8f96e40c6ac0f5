# SPDX-License-Identifier: MIT
"""Formulations against their formulas written out, and against exact solutions."""

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from forms_table import make_mesh

from fenicsmpm import forms, formulations, points
from fenicsmpm.formulations import Kinematics, LumpedProjection, Unknown, embed
from fenicsmpm.materials import VOLUMETRIC_LAWS, NeoHookean


def vector(form):
    return forms.assemble_vector(forms.form(form)).array


class State:
    """A mixed field far from zero at deformed points."""

    def __init__(self, cell, nu=0.4, volumetric="quadratic"):
        self.domain = make_mesh(cell)
        self.dim = self.domain.geometry.dim
        self.body = points.random(self.domain, 4, seed=2)
        rng = np.random.default_rng(3)
        self.body.add_field("F", (3, 3), np.eye(3))
        disturbance = 0.1 * rng.standard_normal((len(self.body), self.dim, self.dim))
        self.body["F"][:, : self.dim, : self.dim] += disturbance
        self.z = z = Unknown(self.domain, "u", "p")
        z.U.x.array[:] = 0.03 * rng.standard_normal(len(z.U.x.array))
        self.law = NeoHookean(E=2.0, nu=nu, volumetric=volumetric)
        self.k = Kinematics(z.u, self.body)


@pytest.mark.parametrize("volumetric", VOLUMETRIC_LAWS)
@pytest.mark.parametrize("cell", ["triangle", "tetrahedron", "quadrilateral", "hexahedron"])
def test_mixed_is_the_weak_form_with_cauchy_stress(cell, volumetric):
    s = State(cell, volumetric=volumetric)
    k, law, z = s.k, s.law, s.z
    sigma = law.deviatoric_stress(k.F) + z.p * ufl.Identity(3)
    g = {"quadratic": k.J - 1, "miehe": 1 - 1 / k.J, "simo-taylor": (k.J - 1 / k.J) / 2}
    constraint = (g[volumetric] - z.p / law.kappa) * z.test.p
    power = k.j * ufl.inner(sigma, embed(k.grad(z.test.u)))
    explicit = (power + constraint) * s.body.dx
    expected = vector(explicit)
    computed = vector(formulations.mixed(z, s.body, law))
    assert computed == pytest.approx(expected, rel=1e-11, abs=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize("cell", ["triangle", "tetrahedron", "quadrilateral", "hexahedron"])
def test_points_without_a_deformation_gradient_are_undeformed(cell):
    """Their stress and its work are those of dolfinx over the cells, and those of F = I."""
    domain = make_mesh(cell)
    body = points.quadrature(domain, 4)
    z = Unknown(domain, "u")
    z.u.x.array[:] = 0.03 * np.random.default_rng(5).standard_normal(len(z.u.x.array))

    def energy(F):
        return ufl.inner(F, F) + (ufl.det(F) - 2) ** 2

    def work(points):
        P = formulations.Response(energy, points, Kinematics(z.u, points).F).P
        return vector(formulations.stress_power(P, z.test.u, points))

    F = ufl.variable(ufl.Identity(3) + embed(ufl.grad(z.u)))
    P = ufl.diff(energy(F), F)
    order = ufl.dx(degree=4)
    expected = fem.assemble_vector(fem.form(ufl.inner(P, embed(ufl.grad(z.test.u))) * order)).array
    size = np.abs(expected).max()
    assert work(body) == pytest.approx(expected, rel=1e-10, abs=1e-12 * size)
    body.add_field("F", (3, 3), np.eye(3))
    assert work(body) == pytest.approx(expected, rel=1e-10, abs=1e-12 * size)


def test_forces_that_need_an_initial_state_say_so():
    body = points.fill(make_mesh("triangle"), 2)
    z = Unknown(body.mesh, "u")
    message = (
        r"without the fields F, J, mass, V_0 has no .*: call set_initial_state\(points, density"
    )
    for force in (
        lambda: formulations.internal_force(z.test.u, body, lambda F: ufl.inner(F, F)),
        lambda: formulations.internal_force(z.test.u, body, NeoHookean(1.0, 0.3)),
        lambda: formulations.EnergyMomentum(lambda F: ufl.inner(F, F), body, z),
    ):
        with pytest.raises(ValueError, match=message):
            force()
    assert body.field_names == ()


def projection_in(form):
    (projection,) = (c for c in form.coefficients() if isinstance(c, LumpedProjection))
    return projection


@pytest.mark.parametrize("name", ["asgs", "osgs"])
@pytest.mark.parametrize("cell", ["triangle", "tetrahedron"])
def test_subscales_are_tested_with_the_adjoint(cell, name):
    """grad q + (div w) grad p - (grad w)^T grad p and div w - q / kappa (VMS, equation 20)."""
    s = State(cell, volumetric="miehe")
    k, law, z = s.k, s.law, s.z
    force = fem.Constant(s.domain, np.arange(1.0, s.dim + 1))
    grad_p, grad_w = ufl.dot(ufl.inv(k.f).T, ufl.grad(z.p)), k.grad(z.test.u)
    S_u = force / k.j + grad_p
    S_p = 1 - 1 / k.J - z.p / law.kappa
    form = getattr(formulations, name)(z, s.body, law, force=force)
    if name == "osgs":
        Pi = projection_in(form)
        S_u = S_u - ufl.as_vector([Pi[i] for i in range(s.dim)]) / k.j
        S_p = S_p - Pi[s.dim]
    tau1, tau2 = formulations.tau(s.body, law)
    adjoint = ufl.dot(ufl.inv(k.f).T, ufl.grad(z.test.p))
    adjoint += ufl.tr(grad_w) * grad_p - ufl.dot(grad_w.T, grad_p)
    explicit = -tau1 * k.j * ufl.inner(S_u, adjoint) * s.body.dx
    explicit += tau2 * S_p * (k.j * ufl.tr(grad_w) - z.test.p / law.kappa) * s.body.dx
    expected = vector(explicit)
    computed = vector(form)
    assert np.abs(expected).max() > 0
    assert computed == pytest.approx(expected, rel=1e-10, abs=1e-12)


@pytest.mark.parametrize("cell", ["triangle", "tetrahedron"])
def test_osgs_projects_residuals_with_the_lumped_mass(cell):
    s = State(cell)
    form = formulations.osgs(s.z, s.body, s.law)
    vector(form)
    Pi = projection_in(form)
    eta = ufl.TestFunction(fem.functionspace(s.domain, ("Lagrange", 1)))
    volume = vector(eta * s.body.dx)
    R_u, R_p = formulations.residuals(s.z, s.body, s.law)
    for i, R in enumerate([*R_u, R_p]):
        projected = Pi.x.array[i :: s.dim + 1] * volume
        assert projected == pytest.approx(vector(R * eta * s.body.dx), rel=1e-11, abs=1e-14)


@pytest.mark.parametrize("name", ["none", "ppp", "asgs", "osgs"])
@pytest.mark.parametrize("nu", [0.3, 0.5])
@pytest.mark.parametrize("cell", ["triangle", "tetrahedron"])
def test_homogeneous_deformation_is_in_equilibrium(cell, nu, name):
    """Patch test: constant F and p = kappa g(J) leave no residual at interior nodes."""
    for volumetric in VOLUMETRIC_LAWS:
        domain = make_mesh(cell, n=3)
        dim = domain.geometry.dim
        body = points.quadrature(domain, 2)
        law = NeoHookean(E=3.0, nu=nu, volumetric=volumetric)
        z = Unknown(domain, "u", "p")
        if nu == 0.5:  # simple shear
            gradient, pressure = np.zeros((dim, dim)), 0.7
            gradient[0, 1] = 0.3
        else:
            gradient = np.array([[0.2, 0.1, 0.0], [-0.1, 0.1, 0.2], [0.1, 0.0, -0.1]])[:dim, :dim]
            J = np.linalg.det(np.eye(dim) + gradient)
            pressure = law.kappa * law.volumetric_strain(J)
        z.U.sub(0).interpolate(lambda x, G=gradient: G @ x[:dim])
        z.U.sub(1).interpolate(lambda x, p=pressure: np.full(x.shape[1], p))
        R = vector(formulations.stabilized(name, z, body, law))
        domain.topology.create_connectivity(dim - 1, dim)
        boundary = mesh.exterior_facet_indices(domain.topology)
        outer = fem.locate_dofs_topological(z.space.sub(0), dim - 1, boundary)
        scale = np.abs(R[outer]).max()
        inner = np.setdiff1d(np.arange(len(R)), outer)
        assert scale > 1e-2
        assert np.abs(R[inner]).max() < 1e-13 * scale + 1e-14


def test_cofactor_is_j_times_inverse_transposed():
    for cell in ("triangle", "tetrahedron"):
        s = State(cell)
        difference = s.k.cofactor() - s.k.j * ufl.inv(s.k.f).T
        assert np.abs(forms.evaluate(difference, s.body)).max() < 1e-14


def test_stress_is_the_derivative_of_the_energy():
    s = State("tetrahedron")
    F = ufl.variable(s.k.F)
    P = ufl.diff(s.law.energy(F, ufl.det(F)), F)
    kirchhoff = forms.evaluate(P * F.T, s.body)
    cauchy = forms.evaluate(s.law.deviatoric_stress(s.k.F) * s.k.J, s.body)
    assert kirchhoff == pytest.approx(cauchy, abs=1e-13)
    assert np.trace(cauchy, axis1=1, axis2=2) == pytest.approx(np.zeros(len(s.body)), abs=1e-13)


def test_forms_can_be_printed():
    s = State("triangle")
    text = str(formulations.asgs(s.z, s.body, s.law))
    assert "det(F)" in text and "dx(" in text
    assert len(text) < 2000
