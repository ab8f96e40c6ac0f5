# SPDX-License-Identifier: MIT
"""Formulations against their formulas written out, and against exact solutions."""

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from forms_table import make_mesh

from fenicsmpm import forms, formulations, points
from fenicsmpm.formulations import Kinematics, embed
from fenicsmpm.materials import VOLUMETRIC_LAWS, NeoHookean


def vector(form):
    return forms.assemble_vector(forms.form(form)).array


class State:
    """A mixed field far from zero at deformed points."""

    def __init__(self, cell, nu=0.4, volumetric="quadratic", projections=False):
        self.domain = make_mesh(cell)
        self.dim = self.domain.geometry.dim
        self.body = points.random(self.domain, 4, seed=2)
        rng = np.random.default_rng(3)
        self.body.add_field("F", (3, 3), np.eye(3))
        disturbance = 0.1 * rng.standard_normal((len(self.body), self.dim, self.dim))
        self.body["F"][:, : self.dim, : self.dim] += disturbance
        W = formulations.mixed_space(self.domain, projections)
        self.U, self.V = fem.Function(W), ufl.TestFunction(W)
        self.U.x.array[:] = 0.03 * rng.standard_normal(len(self.U.x.array))
        self.law = NeoHookean(E=2.0, nu=nu, volumetric=volumetric)
        self.u, self.p = formulations.parts(self.U)[:2]
        self.w, self.q = formulations.parts(self.V)[:2]
        self.k = Kinematics(self.u, self.body)


@pytest.mark.parametrize("volumetric", VOLUMETRIC_LAWS)
@pytest.mark.parametrize("cell", ["triangle", "tetrahedron", "quadrilateral", "hexahedron"])
def test_mixed_is_the_weak_form_with_cauchy_stress(cell, volumetric):
    s = State(cell, volumetric=volumetric)
    k, law = s.k, s.law
    sigma = law.deviatoric_stress(k.F) + s.p * ufl.Identity(3)
    g = {"quadratic": k.J - 1, "miehe": 1 - 1 / k.J, "simo-taylor": (k.J - 1 / k.J) / 2}
    constraint = (g[volumetric] - s.p / law.kappa) * s.q
    power = k.j * ufl.inner(sigma, embed(k.grad(s.w)))
    explicit = (power + constraint) * s.body.dx
    expected = vector(explicit)
    computed = vector(formulations.mixed(s.U, s.V, s.body, law))
    assert computed == pytest.approx(expected, rel=1e-11, abs=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize("name", ["asgs", "osgs"])
@pytest.mark.parametrize("cell", ["triangle", "tetrahedron"])
def test_subscales_are_tested_with_the_adjoint(cell, name):
    """grad q + (div w) grad p - (grad w)^T grad p and div w - q / kappa (VMS, equation 20)."""
    s = State(cell, volumetric="miehe", projections=name == "osgs")
    k, law = s.k, s.law
    force = fem.Constant(s.domain, np.arange(1.0, s.dim + 1))
    grad_p, grad_w = ufl.dot(ufl.inv(k.f).T, ufl.grad(s.p)), k.grad(s.w)
    S_u = force / k.j + grad_p
    S_p = 1 - 1 / k.J - s.p / law.kappa
    if name == "osgs":
        Pi_u, Pi_p = formulations.parts(s.U)[2:]
        S_u, S_p = S_u - Pi_u / k.j, S_p - Pi_p
    tau1, tau2 = formulations.tau(s.body, law)
    adjoint = ufl.dot(ufl.inv(k.f).T, ufl.grad(s.q))
    adjoint += ufl.tr(grad_w) * grad_p - ufl.dot(grad_w.T, grad_p)
    explicit = -tau1 * k.j * ufl.inner(S_u, adjoint) * s.body.dx
    explicit += tau2 * S_p * (k.j * ufl.tr(grad_w) - s.q / law.kappa) * s.body.dx
    expected = vector(explicit)
    computed = vector(getattr(formulations, name)(s.U, s.V, s.body, law, force=force))
    # the equations of the projections, in the other half of OSGS' space, have a test of their own
    space = s.U.function_space
    dofs = np.concatenate([space.sub(i).dofmap.list.ravel() for i in (0, 1)])
    assert np.abs(expected[dofs]).max() > 0
    assert computed[dofs] == pytest.approx(expected[dofs], rel=1e-10, abs=1e-12)


@pytest.mark.parametrize("cell", ["triangle", "tetrahedron"])
def test_osgs_projects_with_the_lumped_mass(cell):
    s = State(cell, projections=True)
    space = s.U.function_space
    s.U.sub(2).interpolate(lambda x: np.zeros((s.dim, x.shape[1])))
    s.U.sub(3).interpolate(lambda x: np.zeros(x.shape[1]))
    form = formulations.osgs(s.U, s.V, s.body, s.law)
    dofs = space.sub(3).dofmap.list.ravel()
    R_p = formulations.residuals(s.U, s.body, s.law)[1]
    minus_projected = vector(form)
    Q, to_parent = space.sub(3).collapse()
    to_parent = np.ravel(to_parent)
    expected = -vector(R_p * ufl.TestFunction(Q) * s.body.dx)
    assert minus_projected[to_parent] == pytest.approx(expected, rel=1e-11, abs=1e-14)
    # the equation for Pi_p is m_I Pi_I - (R_p, eta_I) with m_I = sum_p N_I V_p
    s.U.x.array[dofs] = 1.0
    lumped = vector(form)[to_parent] - minus_projected[to_parent]
    mass = vector(ufl.TestFunction(Q) * s.body.dx)
    assert lumped == pytest.approx(mass, rel=1e-11, abs=1e-14)


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
        W = formulations.mixed_space(domain, projections=name == "osgs")
        U, V = fem.Function(W), ufl.TestFunction(W)
        if nu == 0.5:  # simple shear
            gradient, pressure = np.zeros((dim, dim)), 0.7
            gradient[0, 1] = 0.3
        else:
            gradient = np.array([[0.2, 0.1, 0.0], [-0.1, 0.1, 0.2], [0.1, 0.0, -0.1]])[:dim, :dim]
            J = np.linalg.det(np.eye(dim) + gradient)
            pressure = law.kappa * law.volumetric_strain(J)
        U.sub(0).interpolate(lambda x, G=gradient: G @ x[:dim])
        U.sub(1).interpolate(lambda x, p=pressure: np.full(x.shape[1], p))
        R = vector(formulations.stabilized(name, U, V, body, law))
        domain.topology.create_connectivity(dim - 1, dim)
        boundary = mesh.exterior_facet_indices(domain.topology)
        outer = fem.locate_dofs_topological(W.sub(0), dim - 1, boundary)
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
    text = str(formulations.asgs(s.U, s.V, s.body, s.law))
    assert "det(F)" in text and "dx(" in text
    assert len(text) < 2000
