# SPDX-License-Identifier: MIT
"""What has no meaning over points is an error that names the offending part."""

from mpi4py import MPI

import basix.ufl
import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh

from fenicsmpm import forms, formulations, materials, points

pytestmark = pytest.mark.ranks


class Scene:
    def __init__(self):
        comm = MPI.COMM_WORLD
        self.mesh = mesh.create_unit_square(comm, 3, 3)
        self.other_mesh = mesh.create_unit_square(comm, 3, 3)
        self.body = points.quadrature(self.mesh, 2)
        self.body.add_field("s", (), 1.0)
        self.dp = self.body.dx
        self.V = self.space("P", 1)
        self.u, self.v = ufl.TrialFunction(self.V), ufl.TestFunction(self.V)
        self.f = fem.Function(self.V, name="f")
        self.far = fem.Function(fem.functionspace(self.other_mesh, ("P", 1)), name="far")
        self.n = ufl.FacetNormal(self.mesh)
        self.x = ufl.SpatialCoordinate(self.mesh)

    def space(self, family, degree, **options):
        element = basix.ufl.element(family, "triangle", degree, **options)
        return fem.functionspace(self.mesh, element)

    def test(self, family, degree, **options):
        return ufl.TestFunction(self.space(family, degree, **options))

    def cubic(self):
        return fem.Function(self.space("P", 3))


def third(g):
    return ufl.grad(ufl.grad(ufl.grad(g)))


UNSUPPORTED = {
    r"FacetNormal .* formulations\.set_normals": lambda s: ufl.inner(s.n, ufl.grad(s.v)) * s.dp,
    "FacetArea": lambda s: ufl.FacetArea(s.mesh) * s.v * s.dp,
    "restriction": lambda s: ufl.jump(s.v) * s.dp,
    "RT, triangle, 1": lambda s: ufl.div(s.test("RT", 1)) * s.dp,
    "N1E, triangle, 1": lambda s: ufl.inner(s.test("N1curl", 1), s.x) * s.dp,
    "symmetric": lambda s: ufl.tr(s.test("P", 1, shape=(2, 2), symmetry=True)) * s.dp,
    "complex number.* complex": lambda s: 1j * s.u * s.v * s.dp,
    "complex number.* imag": lambda s: ufl.imag(s.f) * s.v * s.dp,
    "gradient of a field .* s": lambda s: (
        ufl.inner(ufl.grad(s.body.field("s")), ufl.grad(s.v)) * s.dp
    ),
    "order 3": lambda s: ufl.inner(third(s.cubic()), third(s.test("P", 3))) * s.dp,
    "'s' in an integral over cells": lambda s: s.body.field("s") * s.v * ufl.dx,
    "'s' in an integral over cells or facets": lambda s: (
        s.body.field("s") * s.v * ufl.ds + s.v * s.dp
    ),
    "quadrature options": lambda s: s.v * s.dp(degree=3),
    "not linear .* v_0: Applying nonlinear operator": lambda s: s.v**2 * s.dp,
    "not linear .* (differ in rank|non-matching)": lambda s: s.v * s.dp + s.f * s.dp,
    "cells or facets with the arguments v_0 ": lambda s: s.u * s.v * s.dp + s.v * ufl.dx,
    "constant without a value": lambda s: ufl.Constant(s.mesh) * s.v * s.dp,
    "coefficient without values": lambda s: ufl.Coefficient(s.V) * s.v * s.dp,
    "cell_avg of a nonlinear .* f": lambda s: ufl.cell_avg(s.f**2) * s.v * s.dp,
    "type complex128": lambda s: fem.Constant(s.mesh, 1j) * s.v * s.dp,
    "facet average": lambda s: ufl.facet_avg(s.f) * s.v * s.dp,
    "PointField for values": lambda s: (
        fem.Function(
            fem.functionspace(s.mesh, basix.ufl.quadrature_element("triangle", degree=2))
        )
        * s.v
        * s.dp
    ),
    "facet integral over material points": lambda s: (
        s.v * ufl.Measure("ds", domain=s.mesh, subdomain_data=s.body)
    ),
    "operator without": lambda s: ufl.ExternalOperator(s.f, function_space=s.V) * s.v * s.dp,
    "MixedFunctionSpace": lambda s: (
        ufl.TestFunctions(ufl.MixedFunctionSpace(s.V, s.V))[0] * s.dp
    ),
}  # fmt: skip


@pytest.mark.mpi
@pytest.mark.parametrize("message", UNSUPPORTED)
def test_unsupported_form(message):
    scene = Scene()
    with pytest.raises(forms.UnsupportedFormError, match=message):
        forms.form(UNSUPPORTED[message](scene))


WRONG = {
    "on different meshes": lambda s: s.far * s.v * s.dp,
    "different meshes: define": lambda s: s.far * s.dp,
    "rank 0, 1 or 2": lambda s: s.u * s.v * ufl.Argument(s.V, 2) * s.dp,
    "identically zero": lambda s: 0 * s.f * s.dp,
    "without a dolfinx function space": lambda s: (
        ufl.TestFunction(
            ufl.FunctionSpace(s.mesh.ufl_domain(), basix.ufl.element("P", "triangle", 1))
        )
        * s.dp
    ),
    "another mesh": lambda s: s.f * s.dp(domain=s.other_mesh.ufl_domain()),
    "part of a mixed space": lambda s: (
        ufl.TestFunction(formulations.Unknown(s.mesh, "u", "p").space.sub(1)) * s.dp
    ),
}  # fmt: skip


@pytest.mark.parametrize("message", WRONG)
def test_wrong_form(message):
    with pytest.raises(ValueError, match=message):
        forms.form(WRONG[message](Scene()))


def test_wrong_objects():
    s = Scene()
    matrix = forms.form(s.u * s.v * s.dp)
    with pytest.raises(TypeError, match="UFL form is needed, not int"):
        forms.form(3)
    with pytest.raises(ValueError, match=r"rank 1 is needed, not Form\(matrix"):
        forms.assemble_vector(matrix)
    with pytest.raises(TypeError, match="compiled by fenicsmpm"):
        forms.assemble_matrix(s.u * s.v * s.dp)
    with pytest.raises(forms.UnsupportedFormError, match="arguments at points: v_0"):
        forms.evaluate(s.v, s.body)
    with pytest.raises(forms.UnsupportedFormError, match=r"another mesh .* far"):
        forms.evaluate(s.far, s.body)


def test_wrong_material():
    with pytest.raises(ValueError, match="E = -1"):
        materials.NeoHookean(E=-1.0, nu=0.3)
    with pytest.raises(ValueError, match="E = nan"):
        materials.NeoHookean(E=np.nan, nu=0.3)
    with pytest.raises(ValueError, match=r"nu = 0.51. Use nu = 0.5"):
        materials.NeoHookean(E=1.0, nu=0.51)
    with pytest.raises(ValueError, match=r"'cubic': use one of quadratic, miehe, simo-taylor"):
        materials.NeoHookean(E=1.0, nu=0.3, volumetric="cubic")


def test_wrong_formulation():
    s = Scene()
    law = materials.NeoHookean(E=1.0, nu=0.5)
    z = formulations.Unknown(s.mesh, "u", "p")
    with pytest.raises(ValueError, match="'gls': use one of none, ppp, asgs, osgs"):
        formulations.stabilized("gls", z, s.body, law)
    quadratic = formulations.Unknown(s.mesh, "u", "p", degree=2)
    with pytest.raises(ValueError, match="OSGS needs continuous linear functions"):
        formulations.osgs(quadratic, s.body, law)
    with pytest.raises(ValueError, match=r"of shapes \[\(\)\], but .* needs \[\(2,\), \(\)\]"):
        formulations.Unknown(s.f, "u", "p")
    far = formulations.Unknown(s.other_mesh, "u", "p")
    with pytest.raises(ValueError, match="on different meshes"):
        forms.form(formulations.mixed(far, s.body, law))


def test_weights_stay_positive():
    s = Scene()
    with pytest.raises(ValueError, match=r"weights must be positive and finite: .* first -1"):
        s.body["weight"] = -1.0
