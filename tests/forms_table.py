# SPDX-License-Identifier: MIT
"""Table of forms that are compared with dolfinx: name -> function of a Setting -> UFL form.

A form function gets a measure, so that the same integrand is taken over points and over cells.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from mpi4py import MPI

import basix.ufl
import numpy as np
import ufl
from dolfinx import fem, mesh

from fenicsmpm.points import MaterialPoints
from fenicsmpm.points.seeding import quadrature

RULE = 5  # degree of the quadrature rule, the same on both sides

CELLS = {
    "triangle": mesh.CellType.triangle,
    "tetrahedron": mesh.CellType.tetrahedron,
    "quadrilateral": mesh.CellType.quadrilateral,
    "hexahedron": mesh.CellType.hexahedron,
}


def make_mesh(cell: str, distort: bool = True, n: int = 2) -> mesh.Mesh:
    kind = CELLS[cell]
    comm = MPI.COMM_WORLD
    if cell in ("triangle", "quadrilateral"):
        domain = mesh.create_unit_square(comm, n, n + 1, kind)
    else:
        domain = mesh.create_unit_cube(comm, n, n, n, kind)
    if distort:
        x = domain.geometry.x
        x[:, 0] += 0.08 * np.sin(3 * x[:, 1]) * (1 + x[:, 2])
        x[:, 1] += 0.06 * np.cos(4 * x[:, 0]) * x[:, 1]
    return domain


def smooth(x):
    return np.sin(2 * x[0]) + x[1] ** 2 + 0.3 * x[2] * x[0]


@dataclass
class Setting:
    """Spaces, functions and measures for one cell type and degree."""

    cell: str
    degree: int
    domain: mesh.Mesh = field(init=False)
    points: MaterialPoints = field(init=False)

    def __post_init__(self):
        self.domain = make_mesh(self.cell)
        self.dim = self.domain.geometry.dim
        self.points = quadrature(self.domain, RULE)
        rng = np.random.default_rng(1)
        self.at_points = {}
        self.at_quadrature = {}
        for name, shape in {"s": (), "b": (self.dim,), "F": (3, 3)}.items():
            offset = np.eye(3) if shape == (3, 3) else 2.0
            values = offset + 0.1 * rng.standard_normal((len(self.points), *shape))
            self.points.add_field(name, shape, values)
            element = basix.ufl.quadrature_element(
                self.domain.basix_cell(), value_shape=shape, degree=RULE
            )
            function = fem.Function(fem.functionspace(self.domain, element))
            # points are sorted by cell and, within a cell, in the order of the rule
            function.x.array[: values.size] = values.reshape(-1)
            function.x.scatter_forward()
            self.at_points[name] = self.points.field(name)
            self.at_quadrature[name] = function
        self.S = fem.functionspace(self.domain, ("Lagrange", self.degree))
        self.V = fem.functionspace(self.domain, ("Lagrange", self.degree, (self.dim,)))
        self.T = fem.functionspace(self.domain, ("Lagrange", self.degree, (self.dim, self.dim)))
        lower = max(self.degree - 1, 1)
        cell = self.domain.basix_cell()
        self.W = fem.functionspace(
            self.domain,
            basix.ufl.mixed_element(
                [
                    basix.ufl.element("Lagrange", cell, self.degree, shape=(self.dim,)),
                    basix.ufl.element("Lagrange", cell, lower),
                ]
            ),
        )
        self.D = fem.functionspace(self.domain, ("DG", 0))
        self.D1 = fem.functionspace(self.domain, ("DG", 1))
        self.f = fem.Function(self.S)
        self.f.interpolate(smooth)
        self.v = fem.Function(self.V)
        self.v.interpolate(
            lambda x: (
                0.1
                * np.array([smooth(x[[(i + k) % 3 for k in range(3)]]) for i in range(self.dim)])
            )
        )
        self.U = fem.Function(self.W)
        self.U.sub(0).interpolate(self.v)
        self.U.sub(1).interpolate(smooth)
        self.d = fem.Function(self.D)
        self.d.interpolate(smooth)
        self.c = fem.Constant(self.domain, 1.7)
        self.k = fem.Constant(self.domain, np.arange(1.0, self.dim + 1))
        self.A = fem.Constant(self.domain, np.arange(1.0, self.dim**2 + 1).reshape(self.dim, -1))
        self.x = ufl.SpatialCoordinate(self.domain)
        self.is_simplex = self.cell in ("triangle", "tetrahedron")
        self.over_cells = ufl.dx(domain=self.domain, metadata={"quadrature_degree": RULE})

    def args(self, space):
        return ufl.TestFunction(space), ufl.TrialFunction(space)


def _elasticity(s, dx, at):
    v, u = s.args(s.V)
    eps = ufl.sym(ufl.grad(u))
    sigma = 2 * s.c * eps + s.c * ufl.tr(eps) * ufl.Identity(s.dim)
    return ufl.inner(sigma, ufl.grad(v)) * dx


def _energy(s, F):
    J = ufl.det(F)
    return (J ** (-2 / 3) * ufl.inner(F, F) - 3) / 2 + 2 * (J - 1) ** 2


def _hyper(s, dx, at):
    from fenicsmpm.formulations import embed

    F = (ufl.Identity(3) + embed(ufl.grad(s.v))) * at["F"]
    return ufl.derivative(_energy(s, F) * dx, s.v)


def _stress_by_diff(s, dx, at):
    F = ufl.variable(ufl.Identity(s.dim) + ufl.grad(s.v))
    P = ufl.diff(ufl.inner(F, F) / 2 - ufl.ln(ufl.det(F)) + ufl.ln(ufl.det(F)) ** 2, F)
    return ufl.inner(P, ufl.grad(ufl.TestFunction(s.V))) * dx


def _stabilized(name):
    """Mixed residual with all terms of a stabilization, over points or cells alike."""

    def residual(s, dx, at):
        from fenicsmpm import formulations
        from fenicsmpm.materials import NeoHookean

        body = _Carrier(s, dx, at)
        law = NeoHookean(E=3.0, nu=0.4, volumetric="simo-taylor")
        z = formulations.Unknown(s.U, "u", "p")
        R = formulations.mixed(z, body, law, force=s.k)
        if name:
            R += getattr(formulations, name)(z, body, law, force=s.k)
        return R

    return residual


class _Carrier:
    """What formulations need of a point set, with any measure and fields."""

    def __init__(self, s, dx, at):
        self.mesh, self.dx, self._at = s.domain, dx, at
        self.grid_functions = None

    def __contains__(self, name):
        return name in self._at

    def field(self, name):
        return self._at[name]


def _tangent(residual):
    def form(s, dx, at):
        R = residual(s, dx, at)
        unknown = s.U if any(a.ufl_function_space() == s.W for a in R.arguments()) else s.v
        return ufl.derivative(R, unknown)

    return form


def _functions(s, dx, at):
    f, d = s.f, s.d
    g = ufl.exp(-(f**2)) + ufl.ln(3 + f) + ufl.sqrt(4 + f) + ufl.sin(f) * ufl.cos(d)
    g += ufl.tan(f / 2)  # far from its pole, where round-off would grow
    g += ufl.sinh(f) + ufl.cosh(f) + ufl.tanh(f) + ufl.asin(f / 9) + ufl.acos(f / 9) + ufl.atan(f)
    g += ufl.atan2(f, 3 + d) + ufl.erf(f) + ufl.bessel_J(1, 1 + f) + ufl.bessel_Y(0, 3 + f)
    g += abs(f - 0.5) + ufl.sign(f - 0.5) + ufl.max_value(f, 0.4) + ufl.min_value(f, d)
    g += f**3 + (5 + f) ** 0.3 + 1 / (4 + f) + (4 + f) ** -2
    return g * ufl.TestFunction(s.S) * dx


def _conditionals(s, dx, at):
    v, u = s.args(s.S)
    inside = ufl.And(ufl.lt(s.x[0], 0.6), ufl.Not(ufl.gt(s.f, 1)))
    either = ufl.Or(ufl.le(s.x[1], 0.2), ufl.ne(s.d, s.d))
    return (ufl.conditional(inside, s.f, 2) + ufl.conditional(either, 1, s.c)) * u * v * dx


def _eq(s, dx, at):
    return ufl.conditional(ufl.eq(s.d, s.d), s.f, 0) * ufl.conditional(ufl.ge(s.f, 0), 1, 3) * dx


FORMS = {
    # rank 0
    "volume": lambda s, dx, at: s.c * dx,
    "function": lambda s, dx, at: s.f**2 * dx,
    "norm of gradient": lambda s, dx, at: ufl.inner(ufl.grad(s.v), ufl.grad(s.v)) * dx,
    "comparisons": _eq,
    "tensor constant": lambda s, dx, at: ufl.inner(s.A * s.v, s.k) * dx,
    # rank 1
    "load": lambda s, dx, at: ufl.inner(s.k, ufl.TestFunction(s.V)) * dx,
    "load by coordinates": lambda s, dx, at: ufl.sin(s.x[0] * s.x[1]) * ufl.TestFunction(s.S) * dx,
    "all functions": _functions,
    "coefficients by cell": lambda s, dx, at: s.d * ufl.div(ufl.TestFunction(s.V)) * dx,
    "scalar point field": lambda s, dx, at: at["s"] * ufl.TestFunction(s.S) * dx,
    "vector point field": lambda s, dx, at: ufl.inner(at["b"], ufl.TestFunction(s.V)) * dx,
    "stress by diff": _stress_by_diff,
    "hyperelastic residual": _hyper,
    "mixed residual": _stabilized(None),
    "asgs residual": _stabilized("asgs"),
    "tensor space": lambda s, dx, at: (
        ufl.inner(ufl.grad(s.v), ufl.TestFunction(s.T)) * dx
    ),
    "second gradient": lambda s, dx, at: (
        ufl.inner(ufl.grad(ufl.grad(s.f)), ufl.grad(ufl.grad(ufl.TestFunction(s.S)))) * dx
    ),
    # rank 2
    "mass": lambda s, dx, at: s.args(s.S)[0] * s.args(s.S)[1] * dx,
    "vector mass": lambda s, dx, at: ufl.inner(*s.args(s.V)) * dx,
    "stiffness": lambda s, dx, at: ufl.inner(*map(ufl.grad, s.args(s.S))) * dx,
    "anisotropic stiffness": lambda s, dx, at: (
        ufl.inner(s.A * ufl.grad(s.args(s.S)[1]), ufl.grad(s.args(s.S)[0])) * dx
    ),
    "advection": lambda s, dx, at: (
        ufl.inner(ufl.dot(ufl.grad(s.args(s.V)[1]), s.v), s.args(s.V)[0]) * dx
    ),
    "elasticity": _elasticity,
    "conditionals": _conditionals,
    "laplacian": lambda s, dx, at: (
        ufl.div(ufl.grad(s.args(s.S)[1])) * s.args(s.S)[0] * dx
    ),
    "second gradients": lambda s, dx, at: (
        ufl.inner(*(ufl.grad(ufl.grad(a)) for a in s.args(s.V))) * dx
    ),
    "weighted by point tensor": lambda s, dx, at: (
        ufl.inner(ufl.grad(s.args(s.S)[1]), ufl.grad(s.args(s.S)[0])) * at["F"][0, 1] * dx
    ),
    "rectangular": lambda s, dx, at: (
        ufl.TestFunction(s.D1) * ufl.div(ufl.TrialFunction(s.V)) * dx
    ),
    "metric tensor": lambda s, dx, at: (
        ufl.inner(ufl.JacobianInverse(s.domain).T * ufl.JacobianInverse(s.domain),
                  ufl.outer(ufl.grad(s.args(s.S)[1]), s.k))
        * s.args(s.S)[0] * ufl.JacobianDeterminant(s.domain) * ufl.Jacobian(s.domain)[0, 0] * dx
    ),
    "hyperelastic tangent": _tangent(_hyper),
    "mixed tangent": _tangent(_stabilized(None)),
    "asgs tangent": _tangent(_stabilized("asgs")),
}  # fmt: skip

# dolfinx knows these sizes on affine simplices only
SIMPLEX_FORMS = {
    "cell volume": lambda s, dx, at: (
        ufl.CellVolume(s.domain) * s.f * ufl.TestFunction(s.S) * dx
    ),
    "circumradius": lambda s, dx, at: (
        ufl.Circumradius(s.domain) * s.args(s.S)[0] * s.args(s.S)[1] * dx
    ),
    "edge lengths": lambda s, dx, at: (
        ufl.MinCellEdgeLength(s.domain) * ufl.MaxCellEdgeLength(s.domain)
        * ufl.CellDiameter(s.domain) * s.f * dx
    ),
}  # fmt: skip
