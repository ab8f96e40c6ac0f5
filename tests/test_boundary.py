# SPDX-License-Identifier: MIT
"""Loads and constraints on boundary points against hand values and equilibrium."""

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh

from fenicsmpm import ImplicitMPM, MaterialPoints, forms, points
from fenicsmpm import formulations as fm
from fenicsmpm.cells import ActiveCells
from fenicsmpm.materials import NeoHookean
from fenicsmpm.solvers import NewtonSolver

pytestmark = pytest.mark.ranks

COMM = MPI.COMM_WORLD


class Setting:
    """A unit square or cube with an unknown and points on its whole surface."""

    def __init__(self, dim, n=3):
        make = mesh.create_unit_square if dim == 2 else mesh.create_unit_cube
        self.dim, self.domain = dim, make(COMM, *[n] * dim)
        self.z = fm.Unknown(self.domain, "u", "p")
        self.edge = points.on_facets(self.domain, lambda x: np.full(x.shape[1], True), degree=2)
        self.x = ufl.SpatialCoordinate(self.domain)

    def disturb(self, size=0.05):
        """A smooth field and one that is not: 5 percent of random noise at each node."""
        rng = np.random.default_rng(COMM.rank)
        x = self.z.U.x
        x.array[:] = size * rng.standard_normal(len(x.array))
        x.scatter_forward()

    def resultant(self, form, direction):
        """Force or moment that a load applies in the direction of a field (collective)."""
        field = ufl.as_vector([*direction, 0])
        return -forms.assemble_scalar(forms.form(ufl.replace(form, {self.z.V: field})))

    def force(self, form):
        return np.array([self.resultant(form, e) for e in np.eye(self.dim)])

    def moments(self, form):
        """About the origin, of the forces where they are after the increment."""
        x = self.x + self.z.u
        result = []
        for i in range(self.dim):
            for j in range(i):
                turn = [0] * self.dim
                turn[i], turn[j] = -x[j], x[i]
                result.append(self.resultant(form, turn))
        return np.array(result)


def outward(x, dim):
    """Normals of the unit square or cube at points on its surface."""
    centred = x[:dim] - 0.5
    side, place = np.argmax(np.abs(centred), axis=0), np.arange(x.shape[1])
    normals = np.zeros_like(centred)
    normals[side, place] = np.sign(centred[side, place])
    return normals


@pytest.mark.mpi
@pytest.mark.parametrize("dim", [2, 3])
def test_dead_load_adds_up_to_force_and_moment(dim):
    s = Setting(dim, n=5)
    edge = points.on_curve(s.domain, [0.13] * dim, [0.77] * dim, spacing=0.03)
    s.disturb()  # its direction is fixed
    t, length = np.arange(1.0, dim + 1), 0.64 * np.sqrt(dim)
    for traction in (t, tuple(t), ufl.as_vector(t), fem.Constant(s.domain, t)):
        assert s.force(fm.dead_load(s.z.test.u, edge, traction)) == pytest.approx(length * t)
    s.z.U.x.array[:] = 0.0
    moment = [0.45 * length * (t[j] - t[i]) for i in range(dim) for j in range(i)]
    assert s.moments(fm.dead_load(s.z.test.u, edge, t)) == pytest.approx(moment)


@pytest.mark.mpi
@pytest.mark.parametrize("dim", [2, 3])
def test_pressure_on_a_closed_surface_is_in_equilibrium(dim):
    s = Setting(dim)
    assert s.edge["normal"] == pytest.approx(outward(s.edge.x.T, dim).T, abs=1e-14)
    load = fm.follower_pressure(s.z, s.edge, 3.0)
    s.disturb()
    assert s.force(load) == pytest.approx(np.zeros(dim), abs=1e-14)
    # in 3D the moment is quadratic on a facet: the rule of degree 2 is exact
    assert s.moments(load) == pytest.approx(np.zeros(dim * (dim - 1) // 2), abs=1e-14)
    # its power in a deformation is p times the change of volume
    x, u = s.x, s.z.u
    k = fm.Kinematics(u, s.edge)
    body = points.quadrature(s.domain, 2)
    volume = forms.assemble_scalar(forms.form(k.j * body.dx))
    assert s.resultant(load, x + u) == pytest.approx(-3.0 * dim * volume)


@pytest.mark.mpi
def test_positive_pressure_pushes():
    s = Setting(2, n=4)
    edge = points.on_curve(s.domain, (1.0, 0.0), (1.0, 1.0), spacing=0.05)
    assert s.force(fm.follower_pressure(s.z, edge, 2.0)) == pytest.approx([-2.0, 0.0])
    # turned by 90 degrees and drawn to 3 times its length
    s.z.U.sub(0).interpolate(lambda x: np.array([-3 * x[1], x[0]]) - x[:2])
    load = fm.follower_pressure(s.z, edge, fem.Constant(s.domain, 2.0))
    assert s.force(load) == pytest.approx([0.0, -6.0], abs=1e-13)
    turned = edge.field("normal").renewals["normal"](fm.Kinematics(s.z.u, edge))
    assert forms.evaluate(turned, edge) == pytest.approx(
        np.tile([0.0, 3.0], (len(edge), 1)), abs=1e-14
    )


@pytest.mark.parametrize("dim", [2, 3])
def test_tangents_are_exact(dim):
    """Taylor: the error of the linearization is of second order."""
    s = Setting(dim)
    s.edge.add_field("u", (dim,), 0.1)
    R = fm.follower_pressure(s.z, s.edge, 3.0)
    R += fm.penalty_dirichlet(s.z, s.edge, 2.0, [0.2] * dim)
    residual, tangent = forms.form(R), forms.form(ufl.derivative(R, s.z.U))
    s.disturb()
    x = s.z.U.x.array
    start = x.copy()
    direction = np.random.default_rng(5).standard_normal(len(start))
    R0 = forms.assemble_vector(residual).array.copy()
    slope = forms.assemble_matrix(tangent).to_scipy() @ direction
    slope[forms.inactive_dofs(tangent)] = 0.0  # rows of the identity
    errors = []
    for h in (1e-1, 5e-2, 2.5e-2):
        x[:] = start + h * direction
        errors.append(np.linalg.norm(forms.assemble_vector(residual).array - R0 - h * slope))
    if dim == 2:  # linear in u: nothing is left
        assert max(errors) < 1e-13
    else:
        assert np.log2(np.divide(errors[:-1], errors[1:])) == pytest.approx([2, 2], abs=1e-6)


@pytest.mark.mpi
def test_pressure_turns_with_the_body():
    """A block in free rotation, by more than a right angle: normals and load turn with it."""
    domain = mesh.create_rectangle(COMM, [(-1, -1), (1, 1)], [10, 10])
    half = np.array([0.53, 0.33])
    box = mesh.create_rectangle(COMM, [-half, half], [24, 16])
    body = points.from_mesh(domain, points.quadrature(box, 2))
    a, b = (half[0], -half[1]), half
    edge = points.on_curve(domain, a, b, spacing=0.02)
    n = edge.size_global
    fm.set_initial_state(body, 1.0, lambda x: np.array([-x[1], x[0]]))
    z = fm.Unknown(domain, "u", "p")
    law = NeoHookean(E=10.0, nu=0.4)
    scheme = fm.Bossak(z, dt=0.1)
    R = fm.stabilized("asgs", z, body, law, force=scheme.force(body))
    R += fm.ghost_penalty(z, ActiveCells(body, edge), law)
    load = fm.follower_pressure(z, edge, 1e-6)
    sim = ImplicitMPM(R + load, z, scheme, body, carried=[edge])
    for _ in range(20):
        sim.step()
    x = np.concatenate(COMM.allgather(edge.x))[np.argsort(np.concatenate(COMM.allgather(edge.id)))]
    along = (x[-1] - x[0]) * n / (n - 1)
    across = np.array([along[1], -along[0]])
    assert 1.5 < np.arctan2(across[1], across[0]) < 2.0
    mean = COMM.allreduce((edge["normal"] * edge.weight[:, None]).sum(axis=0), MPI.SUM)
    assert mean == pytest.approx(across, abs=1e-3 * np.linalg.norm(across))
    z.U.x.array[:] = 0.0
    powers = (ufl.replace(load, {z.V: ufl.as_vector([*e, 0])}) for e in np.eye(2))
    force = [-forms.assemble_scalar(forms.form(power)) for power in powers]
    assert force == pytest.approx(-1e-6 * mean, rel=1e-10)


class PulledBlock:
    """A block with its left end on boundary points and a dead load on its right end."""

    def __init__(self, left, factor=30.0, n=8, value=None, moved=None, E=5.0):
        self.domain = mesh.create_unit_square(COMM, n, n)
        self.E, self.factor, self.t = E, factor, 0.2
        h = 1 / n
        self.body = points.lattice(self.domain, h / 6, inside=lambda x: x[0] > left)
        self.wall = points.on_curve(self.domain, (left, 0), (left, 1), spacing=h / 10)
        if moved is not None:
            self.wall.add_field("u", (2,), moved)
        end = points.on_curve(self.domain, (1, 0), (1, 1), spacing=h / 10)
        self.z = z = fm.Unknown(self.domain, "u", "p")
        law = NeoHookean(E, 0.3)
        R = fm.stabilized("asgs", z, self.body, law)
        R += fm.dead_load(z.test.u, end, (self.t, 0.0))
        R += fm.penalty_dirichlet(z, self.wall, law, value, factor=factor)
        NewtonSolver(R, z.U).solve()
        self.h = h / np.sqrt(2)  # of two triangles that share a square

    def gaps(self):
        """Displacement of the wall's points in this increment."""
        return forms.evaluate(self.z.u, self.wall)


@pytest.mark.mpi
@pytest.mark.parametrize("left", [0.25, 0.25 + 0.4 / 8, 0.25 + 0.9 / 8])
def test_penalty_holds_against_the_load(left):
    """On the average the points give way by t h / (factor E), for equilibrium of forces."""
    for factor in (10.0, 1000.0):
        block = PulledBlock(left, factor)
        estimate = block.t * block.h / (factor * block.E)
        gaps = COMM.allreduce(block.gaps().sum(axis=0), MPI.SUM) / block.wall.size_global
        assert gaps == pytest.approx([estimate, 0.0], rel=1e-8, abs=1e-8 * estimate)


@pytest.mark.mpi
def test_penalty_is_on_the_displacement_so_far():
    first = PulledBlock(0.3).gaps()
    moved = np.array([0.3, -0.2])
    assert PulledBlock(0.3, value=moved, moved=moved).gaps() == pytest.approx(first, abs=1e-12)
    # prescribed anew: the body follows
    driven = PulledBlock(0.3, value=[0.05, 0.1])
    assert driven.gaps() == pytest.approx(first + [0.05, 0.1], abs=1e-10)


def test_what_cannot_be():
    s = Setting(2)
    z, edge = s.z, s.edge
    nothing = MaterialPoints(s.domain, np.empty((0, 2)), 1.0)
    with pytest.raises(ValueError, match="load on no points"):
        fm.dead_load(z.test.u, nothing, (1.0, 0.0))
    with pytest.raises(ValueError, match="load on no points"):
        fm.follower_pressure(z, nothing, 1.0)
    with pytest.raises(ValueError, match="Dirichlet condition on no points"):
        fm.penalty_dirichlet(z, nothing, 1.0)
    with pytest.raises(ValueError, match=r"traction needs 2 components.* \(3,\)"):
        fm.dead_load(z.test.u, edge, (1.0, 0.0, 0.0))
    with pytest.raises(ValueError, match=r"traction needs 2 components.* \(\)"):
        fm.dead_load(z.test.u, edge, 1.0)
    with pytest.raises(ValueError, match=r"call set_normals"):
        fm.follower_pressure(z, points.at(s.domain, (0.5, 0.5)), 1.0)
    with pytest.raises(ValueError, match=r"not \(3,\)"):
        fm.set_normals(edge, (1.0, 0.0, 0.0))
    with pytest.raises(ValueError, match=r"not have the length 1, first 2\.0"):
        fm.set_normals(edge, lambda x: 2 * outward(x, 2))
    with pytest.raises(ValueError, match=r"pressure must be a scalar.* \(2,\)"):
        fm.follower_pressure(z, edge, ufl.as_vector((1.0, 0.0)))
    with pytest.raises(ValueError, match="modulus must be positive and finite: -1"):
        fm.penalty_dirichlet(z, edge, -1.0)
    with pytest.raises(ValueError, match="factor of the penalty must be positive and finite: 0"):
        fm.penalty_dirichlet(z, edge, 1.0, factor=0.0)
    with pytest.raises(ValueError, match="displacement needs 2 components"):
        fm.penalty_dirichlet(z, edge, 1.0, (1.0, 2.0, 3.0))
