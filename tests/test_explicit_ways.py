# SPDX-License-Identifier: MIT
"""Fused kernels on lattices do what forms and the layer between points and grid do."""

from functools import cache

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from explicit_runs import use

from fenicsmpm import ExplicitMPM, basis, formulations, points
from fenicsmpm.materials import NeoHookean, NewtonianFluid, VonMises

pytestmark = pytest.mark.once

COMM = MPI.COMM_WORLD
BASES = ["linear", "gimp", "quadratic", "cubic"]
RUBBER = NeoHookean(E=100.0, nu=0.4).pointwise()
AVERAGES = [None, formulations.FBar(), formulations.TRUE_J, formulations.FBar(0.3, 100.0)]


@cache  # the partition is not the same twice
def lattice(dim, n=7):
    """The unit square or cube, whose cells are seen by all ranks that need them."""
    kind = mesh.CellType.quadrilateral if dim == 2 else mesh.CellType.hexahedron
    options = {"partitioner": basis.shared_vertex_partitioner}
    corners = [np.zeros(dim), np.ones(dim)]
    if dim == 2:
        return mesh.create_rectangle(COMM, corners, [n, n], kind, **options)
    return mesh.create_box(COMM, corners, [n] * 3, kind, **options)


def body_on_walls(dim, functions, law):
    """Points that fill a corner of the lattice, some of them on walls, edges and in the corner."""
    domain = lattice(dim)
    body = points.lattice(domain, 1 / 14, inside=lambda x: x.sum(axis=0) < 0.9)
    on_walls = np.array([[0, 0, 0], [0.4, 0, 0], [0, 0.3, 0.2], [1, 0, 0], [0, 1, 1], [1, 1, 1]])
    x = on_walls[:, :dim] if COMM.rank == 0 else np.empty((0, dim))
    body.add(points.MaterialPoints(domain, x, weight=14.0**-dim))
    use(body, functions)
    formulations.set_initial_state(body, 2.0, lambda x: 0.3 * np.sin(5 * x[:dim][::-1] + x[:dim]))
    formulations.internal_force(_test(domain), body, law)  # adds the state
    _deform(body)
    return body


def _test(domain):
    V = fem.functionspace(domain, ("Lagrange", 1, (domain.geometry.dim,)))
    return ufl.TestFunction(V)


def _deform(body):
    """Some deformation, stress and averaged J at each point, by its position."""
    dim = body.x.shape[1]
    F = np.tile(np.eye(3), (len(body), 1, 1))
    F[:, :dim, :dim] += 0.05 * np.sin(9 * body.x[:, :, None] + 4 * body.x[:, None, ::-1])
    body["F"], body["J"] = F, np.linalg.det(F)
    body["weight"] = body["V_0"] * body["J"]
    body["sigma"] = np.einsum("pij,pkj->pik", F, F) * (1 + body.x[:, :1, None])
    if "J_bar" in body:
        body["J_bar"] = body["J"] * (1 + 0.02 * np.cos(7 * body.x[:, 0]))


def simulation(body, law, averages, fused, **options):
    """By fused kernels, or with all forces by forms."""
    domain = body.mesh
    z = formulations.Unknown(domain, "v")
    w = z.test.v
    R = formulations.internal_force(w, body, law, fbar=averages)
    if not fused:
        R = fem.Constant(domain, 1.0) * R
    R += formulations.body_force(w, body, np.arange(1.0, domain.geometry.dim + 1))
    for k in range(domain.geometry.dim):
        z.fix("v", lambda x, k=k: np.isclose(x[k] * (1 - x[k]), 0), component=k)
    sim = ExplicitMPM(R, z, body, dt=1e-3, **options)
    assert ("fused kernels" in str(sim)) == fused
    return sim


def values(body, names):
    """Fields of all points of all ranks, by id."""
    order = np.argsort(np.concatenate(COMM.allgather(body.id)))
    return {name: np.concatenate(COMM.allgather(body[name]))[order] for name in names}


def check(found, expected, tolerance=1e-12):
    for name, value in expected.items():
        scale = np.abs(value).max()
        assert found[name] == pytest.approx(value, rel=0, abs=tolerance * scale), name


@pytest.mark.mpi
@pytest.mark.parametrize("functions", BASES)
@pytest.mark.parametrize("dim", [pytest.param(2, marks=pytest.mark.ranks), 3])
def test_a_step(dim, functions):
    """Mass, momentum and force of nodes, averages of J, what points get: all of them."""
    for averages in AVERAGES:
        fields, nodes = [], []
        names = ("x", "v", "u", "F", "J", "sigma", "weight")
        names += () if averages is None else ("J_bar",)
        for fused in (True, False):
            body = body_on_walls(dim, functions, RUBBER)
            sim = simulation(body, RUBBER, averages, fused, flip=0.9)
            sim.step()
            fields.append(values(body, names))
            mass = sim.mass().x.array[:, None]
            of_nodes = (sim.velocity, sim.acceleration())
            nodes.append([mass, *(mass * f.x.array.reshape(-1, dim) for f in of_nodes)])
        check(*fields)
        for a, b in zip(*nodes, strict=True):
            scale = COMM.allreduce(np.abs(b).max(), MPI.MAX)
            assert a == pytest.approx(b, rel=0, abs=1e-12 * scale)


@pytest.mark.mpi
@pytest.mark.parametrize("averages", [None, formulations.FBar(0.3, 100.0)])
@pytest.mark.parametrize("law", [RUBBER, NewtonianFluid(100.0, 0.5)], ids=["solid", "fluid"])
def test_stretches_out_of_the_plane(law, averages):
    """They stay what they are, but those of fluids, of which only J matters."""
    found = []
    for fused in (True, False):
        body = body_on_walls(2, "quadratic", law)
        F = body["F"].copy()
        F[:, 2, 2] = 1 + 0.02 * np.cos(3 * body.x[:, 0])
        J = np.linalg.det(F)
        body.assign({"F": F, "J": J, "weight": body["V_0"] * J})
        if "J_bar" in body:
            body["J_bar"] *= F[:, 2, 2]
        before = values(body, ("F",))["F"][:, 2, 2]
        sim = simulation(body, law, averages, fused)
        for _ in sim.run(0.005, 0.005):
            pass
        found.append(values(body, ("x", "v", "F", "J", "sigma", "weight")))
        after = found[-1]["F"][:, 2, 2]
        assert np.array_equal(after, np.ones_like(before) if law.is_fluid else before)
    check(*found, tolerance=1e-10)


@pytest.mark.ranks
@pytest.mark.mpi
def test_many_steps_of_many_laws():
    """Fluids and plasticity; velocities that laws read."""
    for law in (NewtonianFluid(100.0, 0.5), VonMises(100.0, 0.4, sigma_y=1.0)):
        found = []
        for fused in (True, False):
            body = body_on_walls(2, "quadratic", law)
            sim = simulation(body, law, formulations.default_fbar(law), fused)
            for _ in range(5):
                sim.step()
            found.append(values(body, ("x", "v", "F", "sigma", *law.state)))
        check(*found, tolerance=1e-11)
