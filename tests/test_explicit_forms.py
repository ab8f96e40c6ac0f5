# SPDX-License-Identifier: MIT
"""Explicit steps by forms: any mesh, any UFL; exact motions, conservation, bad input."""

import itertools

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from explicit_runs import use

from fenicsmpm import ExplicitMPM, UnstableError, basis, forms, formulations, points
from fenicsmpm.diagnostics import momentum
from fenicsmpm.materials import Hencky, NeoHookean, NewtonianFluid
from fenicsmpm.points.exits import Exits

COMM = MPI.COMM_WORLD
RUBBER = NeoHookean(E=100.0, nu=0.4).pointwise()
MESHES = {
    "triangles": lambda n: mesh.create_unit_square(COMM, n, n),
    "quadrilaterals": lambda n: mesh.create_unit_square(COMM, n, n, mesh.CellType.quadrilateral),
    "tetrahedra": lambda n: mesh.create_unit_cube(COMM, n, n, n),
    "hexahedra": lambda n: mesh.create_unit_cube(COMM, n, n, n, mesh.CellType.hexahedron),
    "bent": lambda n: _bent(n),
}


def _bent(n):
    domain = mesh.create_unit_square(COMM, n, n, mesh.CellType.quadrilateral)
    x = domain.geometry.x
    x[:, :2] += 0.03 * np.sin(np.pi * x[:, 1::-1]) * np.sin(np.pi * x[:, :2])
    return domain


def block(domain, velocity=None, half=0.22):
    """A block of 4 points a cell and more in the middle of the unit square or cube."""
    dim = domain.geometry.dim
    body = points.lattice(domain, 0.05, inside=lambda x: np.abs(x[:dim] - 0.5).max(axis=0) < half)
    formulations.set_initial_state(body, 2.0, velocity)
    z = formulations.Unknown(domain, "v")
    return body, z, z.test.v


@pytest.mark.mpi
@pytest.mark.parametrize("kind", MESHES)
def test_a_free_body_keeps_momentum(kind):
    domain = MESHES[kind](8)
    dim = domain.geometry.dim
    body, z, w = block(domain, lambda x: 0.05 * np.sin(7 * x[:dim][::-1]) + 0.5)
    sim = ExplicitMPM(formulations.internal_force(w, body, RUBBER), z, body)
    before = momentum(body)
    for _ in range(20):
        sim.step()
    assert COMM.allreduce(np.abs(body["sigma"]).max(initial=0.0), MPI.MAX) > 0.02
    assert momentum(body) == pytest.approx(before, rel=1e-12)


@pytest.mark.mpi
@pytest.mark.parametrize("kind", ["triangles", "tetrahedra", "bent"])
def test_free_flight(kind):
    """A block without stress flies on as it was, whatever part of a cell it fills."""
    domain = MESHES[kind](9)
    speed = np.array([0.3, -0.7, 0.2])[: domain.geometry.dim]
    body, z, w = block(domain, speed, half=0.16)
    law = Hencky(E=1e3, nu=0.3)
    sim = ExplicitMPM(formulations.internal_force(w, body, law), z, body)
    for _ in sim.run(0.25):
        pass
    assert COMM.allreduce(np.abs(body["v"] - speed).max(initial=0.0), MPI.MAX) < 1e-10


@pytest.mark.mpi
@pytest.mark.parametrize("kind", ["triangles", "tetrahedra"])
def test_homogeneous_deformation(kind):
    """All nodes are moved: points follow exactly, whatever is averaged (F-bar, equation 14)."""
    domain = MESHES[kind](6)
    dim = domain.geometry.dim
    rate = np.array([[0.3, -0.8, 0.2], [0.5, -0.2, 0.1], [-0.3, 0.4, 0.1]])[:dim, :dim]
    for fbar in (None, formulations.FBar(), formulations.FBar(0.3, 100.0)):
        body, z, w = block(domain, lambda x: rate @ (x[:dim] - 0.5))
        motion = fem.Function(z.space)
        motion.interpolate(lambda x: rate @ (x[:dim] - 0.5))
        nodes = z.space.dofmap.index_map
        everything = np.arange(nodes.size_local + nodes.num_ghosts, dtype=np.int32)
        R = formulations.internal_force(w, body, RUBBER, fbar=fbar)
        sim = ExplicitMPM(
            R,
            z,
            body,
            dt=1e-3,
            bcs=[fem.dirichletbc(motion, everything)],
        )
        for _ in range(3):
            sim.step()
        F = np.eye(3)
        F[:dim, :dim] = np.linalg.matrix_power(np.eye(dim) + sim.dt * rate, 3)
        assert body["F"] == pytest.approx(np.tile(F, (len(body), 1, 1)), abs=1e-12)
        assert body["J"] == pytest.approx(np.linalg.det(F), rel=1e-12)
        if fbar is not None:
            assert body["J_bar"] == pytest.approx(np.linalg.det(F), rel=1e-12)


@pytest.mark.parametrize("functions", ["linear", "quadratic"])
def test_an_energy_in_ufl_is_the_law_at_points(functions):
    """Neo-Hooke's energy as UFL: the same internal force and motion as by its law at points."""
    law = NeoHookean(E=100.0, nu=0.4)

    def psi(F):
        J = ufl.det(F)
        return law.energy(F, J) + law.kappa / 2 * (J - 1) ** 2

    found = []
    for material in (law, psi):
        body, z, w = block(MESHES["quadrilaterals"](10), lambda x: 0.5 * np.sin(7 * x[1::-1]))
        use(body, functions)
        R = formulations.internal_force(w, body, material, fbar=formulations.FBar(0.1))
        sim = ExplicitMPM(R, z, body, dt=2e-3)
        for _ in range(10):
            sim.step()
        found.append({name: body[name].copy() for name in ("x", "v", "F", "J_bar")})
    for name, value in found[0].items():
        assert found[1][name] == pytest.approx(value, abs=1e-11 * np.abs(value).max()), name


@pytest.mark.mpi
def test_terms_of_one_s_own():
    """Body force by a field, a viscous term, a load over boundary points, and one over dx.

    The momentum gained in a step is the sum of these forces, and viscosity has none.
    """
    domain = MESHES["triangles"](10)
    body, z, w = block(domain, lambda x: 0.3 * np.sin(5 * x[1::-1]))
    edge = body.select(lambda x: x[0] > 0.65)
    edge["weight"] = 0.05
    b = body.add_field("b", (2,), body.x)
    expected = (body["mass"][:, None] * b).sum(axis=0) + [0.0, 3.0 * 0.05 * len(edge)]
    bump = ufl.SpatialCoordinate(domain)[0]
    inside = mesh.locate_entities(domain, 2, lambda x: np.abs(x[:2] - 0.5).max(axis=0) < 0.16)
    tags = mesh.meshtags(domain, 2, inside, np.ones(len(inside), dtype=np.int32))
    dx = ufl.Measure("dx", domain=domain, subdomain_data=tags)
    over_cells = fem.assemble_scalar(fem.form(bump * dx(1)))
    R = formulations.internal_force(w, body, RUBBER)
    R += formulations.body_force(w, body, body.field("b"))
    R += 0.2 * ufl.inner(ufl.sym(ufl.grad(z.v)), ufl.grad(w)) * body.dx
    R += formulations.dead_load(w, edge, (0.0, 3.0))
    R -= bump * w[0] * dx(1)
    sim = ExplicitMPM(R, z, body, carried=[edge], dt=1e-4)
    before = momentum(body)
    sim.step()
    forces = COMM.allreduce(expected) + [COMM.allreduce(over_cells), 0.0]
    assert momentum(body) - before == pytest.approx(sim.dt * forces, rel=1e-9)
    assert COMM.allreduce(np.abs(edge["u"]).max(initial=0.0), MPI.MAX) > 0


def test_a_viscous_term_is_a_newtonian_fluid():
    """2 mu dev sym L of the law at points, written in UFL with the velocity on the grid."""
    mu, speed = 3.0, lambda x: 0.3 * np.sin(5 * x[1::-1])
    gained = []
    for law, extra in ((NewtonianFluid(100.0, mu), 0.0), (NewtonianFluid(100.0), mu)):
        body, z, w = block(MESHES["quadrilaterals"](10), speed)
        use(body, "quadratic")
        R = formulations.internal_force(w, body, law, fbar=None)
        if extra:
            D = ufl.sym(ufl.grad(z.v))
            deviator = D - ufl.tr(D) / 3 * ufl.Identity(2)
            R += 2 * extra * ufl.inner(deviator, ufl.grad(w)) * body.dx
        sim = ExplicitMPM(R, z, body, dt=1e-6)
        first = forms.evaluate(ufl.grad(z.v), body)
        assert np.all(first == 0)
        sim.step()
        sim.step()
        gained.append(body["v"] - speed((body.x - body["u"]).T).T)
    # the law's stress is that of the step before: the first step has none
    assert np.abs(gained[1]).max() > 0
    assert gained[1] == pytest.approx(2 * gained[0], rel=1e-3, abs=1e-3 * np.abs(gained[1]).max())


@pytest.mark.mpi
def test_nodal_fields_are_functions():
    body, z, w = block(MESHES["triangles"](10))
    R = formulations.internal_force(w, body, RUBBER)
    R += formulations.body_force(w, body, (0.0, -2.0))
    sim = ExplicitMPM(R, z, body, dt=1e-3)
    sim.step()
    assert sim.velocity is z.U
    assert forms.evaluate(z.v, body) == pytest.approx(
        np.tile((0, -2e-3), (len(body), 1)), abs=1e-14
    )
    assert forms.evaluate(sim.acceleration()[1], body) == pytest.approx(-2.0, abs=1e-10)
    owned = sim.mass().function_space.dofmap.index_map.size_local
    total = COMM.allreduce(sim.mass().x.array[:owned].sum())
    assert total == pytest.approx(COMM.allreduce(body["mass"].sum()), rel=1e-12)


@pytest.mark.ranks
@pytest.mark.mpi
@pytest.mark.parametrize("kind", ["triangles", "hexahedra"])
def test_the_same_on_any_number_of_ranks(kind):
    def run(comm):
        global COMM
        everyone, COMM = COMM, comm
        domain = MESHES[kind](8)
        COMM = everyone
        dim = domain.geometry.dim
        body, z, w = block(domain, (1.0, 0.4, 0.2)[:dim])
        body["v"] += 0.3 * np.sin(5 * body.x[:, ::-1])
        R = formulations.internal_force(w, body, RUBBER, fbar=formulations.FBar(0.1, 20.0))
        sim = ExplicitMPM(R, z, body, dt=5e-3, flip=0.98)
        for _ in sim.run(0.15):
            pass
        start = np.concatenate(comm.allgather(body.x - body["u"]))
        order = np.lexsort(np.round(start, 8).T)
        return [np.concatenate(comm.allgather(body[k]))[order] for k in ("u", "sigma", "J_bar")]

    for a, b in zip(run(MPI.COMM_SELF), run(COMM), strict=True):
        assert b == pytest.approx(a, abs=1e-9 * np.abs(a).max())


@pytest.mark.mpi
@pytest.mark.parametrize("on_exit", ["error", "delete", "clamp"])
def test_points_that_leave(on_exit):
    body, z, w = block(MESHES["triangles"](10), (4.0, 0.0))
    R = formulations.internal_force(w, body, RUBBER)
    sim = ExplicitMPM(R, z, body, dt=2e-3, on_exit=on_exit)
    n = body.size_global
    if on_exit == "error":
        before = body.snapshot()
        with pytest.raises(UnstableError, match="outside the background mesh"):
            for _ in sim.run(0.2):
                before = body.snapshot()
        assert all(np.array_equal(body[name], array) for name, array in before.items())
        return
    removed = sum(step.removed for step in sim.run(0.12))
    assert removed > 0
    assert body.size_global == (n - removed if on_exit == "delete" else n)
    assert body.bounds()[1][0] <= 1.0 + 1e-12


@pytest.mark.mpi
def test_points_at_the_wall_are_counted_once(said):
    """Points without stress are held back by the wall when they get there; it is said once."""
    body, z, w = block(MESHES["bent"](10), (1.9, 0.0))
    still = formulations.body_force(w, body, (0.0, 0.0))
    sim = ExplicitMPM(still, z, body, dt=0.02, on_exit="clamp")
    x0 = np.concatenate(COMM.allgather(body.x[:, 0]))
    removed = 0
    for step in sim.run(0.6):
        removed += step.removed
        assert removed == np.sum(x0 + 1.9 * step.time > 1.0)
    assert removed == len(x0) == body.size_global
    assert sum("held back" in line for line in said) == 1


@pytest.mark.mpi
def test_exits_know_the_points_of_each_set():
    domain = MESHES["triangles"](10)
    x = np.array([[0.95, 0.5], [0.5, 0.5]])[COMM.rank :: COMM.size]
    line = points.MaterialPoints(domain, x, 1.0)
    exits = Exits("clamp")
    assert exits.move(line, line.x + (0.2, 0.0)) == 1
    assert exits.move(line, line.x + (0.2, 0.0)) == 0
    assert exits.move(line, line.x + (0.4, 0.0)) == 1
    assert exits.move(line.copy(), line.x + (0.4, 0.0)) == 2
    assert line.size_global == 2


@pytest.mark.mpi
def test_wrong_input():
    domain = MESHES["triangles"](8)
    body, z, w = block(domain)
    V = z.space
    R = formulations.internal_force(w, body, RUBBER)
    other = fem.Function(fem.functionspace(MESHES["triangles"](4), ("Lagrange", 1, (2,))))
    energy = 0.5 * ufl.inner(z.v, z.v) * body.dx
    unknown = R + ufl.inner(ufl.TrialFunction(V), w) * body.dx
    lone = points.fill(domain, 1)
    alone = formulations.internal_force
    with pytest.raises(TypeError, match="must be a UFL form"):
        ExplicitMPM(0.0, z, body)
    for form, message in ((energy, "rank 1, not 0"), (unknown, "rank 1, not 2")):
        with pytest.raises(ValueError, match=message):
            ExplicitMPM(form, z, body)
    with pytest.raises(ValueError, match="tested on the function space of the velocity"):
        ExplicitMPM(R, formulations.Unknown(domain, "v"), body)
    with pytest.raises(ValueError, match="on the mesh of the velocity"):
        ExplicitMPM(R, formulations.Unknown(other, "v"), body)
    with pytest.raises(forms.UnsupportedFormError, match="not linear in the arguments"):
        ExplicitMPM(R + ufl.inner(w, w) * body.dx, z, body)
    with pytest.raises(ValueError, match="fields F, J, mass, V_0 has no stress"):
        alone(w, lone, RUBBER)
    with pytest.raises(ValueError, match="points that are no body"):
        ExplicitMPM(R, z, block(domain)[0])
    with pytest.raises(ValueError, match="two laws at its points"):
        ExplicitMPM(R + alone(w, body, Hencky(1.0, 0.3)), z, body)
    with pytest.raises(ValueError, match=r"use 0\.499"):
        alone(w, block(domain)[0], NeoHookean(E=1.0, nu=0.5))
    dust, y, w_dust = block(domain)
    with pytest.raises(ValueError, match="set the time step dt"):
        ExplicitMPM(formulations.body_force(w_dust, dust, (0.0, -1.0)), y, dust)
    with pytest.raises(ValueError, match="2 finite numbers"):
        formulations.body_force(w, body, (0.0, np.nan))
    with pytest.raises(ValueError, match="all bodies are empty"):
        ExplicitMPM(R, z, body.select([]))
    for options, message in (
        ({"flip": 1.5}, "flip"),
        ({"damping": 1.0}, "damping"),
        ({"cfl": np.nan}, "cfl"),
        ({"dt": 0.0}, "time step must be positive"),
        ({"on_exit": "vanish"}, "on_exit must be"),
        ({"carried": [body]}, "given twice"),
    ):
        with pytest.raises(ValueError, match=message):
            ExplicitMPM(R, z, body, **options)
    if COMM.size == 1:
        quads, y, v = block(MESHES["quadrilaterals"](8))
        load = quads.select(lambda x: x[0] > 0.6)
        basis.use(quads, "quadratic")
        with pytest.raises(ValueError, match="same grid functions, not linear, quadratic"):
            ExplicitMPM(alone(v, quads, RUBBER), y, quads, carried=[load])


@pytest.mark.mpi
def test_a_load_away_from_all_bodies():
    body, z, w = block(MESHES["triangles"](8))
    x = [(0.95, 0.95)] if COMM.rank == 0 else np.empty((0, 2))
    edge = points.MaterialPoints(body.mesh, x, weight=1.0)
    R = formulations.internal_force(w, body, RUBBER)
    sim = ExplicitMPM(
        R + formulations.dead_load(w, edge, (1.0, 0.0)),
        z,
        body,
        carried=[edge],
    )
    with pytest.raises(UnstableError, match="a load acts away from all bodies"):
        sim.step()
    assert (sim.time, sim.number) == (0.0, 0)


@pytest.mark.mpi
@pytest.mark.parametrize("functions", ["linear", "quadratic"])
@pytest.mark.parametrize("where", [0.65, 0.9])
def test_a_force_over_cells_away_from_all_bodies(functions, where):
    """By kernels, and by forms on the same lattice; near the body or far from it."""
    partitioner = basis.shared_vertex_partitioner
    kind = mesh.CellType.quadrilateral
    domain = mesh.create_unit_square(COMM, 40, 40, kind, partitioner=partitioner)
    for on_exit in ("error", "clamp"):
        body, z, w = block(domain, half=0.1)
        use(body, functions)
        x = ufl.SpatialCoordinate(domain)
        pull = ufl.conditional(ufl.gt(x[0], where), 1.0, 0.0) * w[0] * ufl.dx(degree=2)
        R = formulations.internal_force(w, body, RUBBER) - pull
        sim = ExplicitMPM(R, z, body, on_exit=on_exit)
        assert ("kernels" in str(sim)) == (on_exit == "error")
        with pytest.raises(UnstableError, match="a load acts away from all bodies"):
            sim.step()
        assert (sim.time, sim.number) == (0.0, 0)


@pytest.mark.mpi
@pytest.mark.parametrize("interval", [None, 0.02])
def test_data_may_look_at_points(interval):
    """What is read before each step is right, and reading changes no result."""
    domain = MESHES["quadrilaterals"](20)

    def start(x):
        return 0.1 * np.sin(7 * x[1::-1])

    found = []
    for look in (False, True):
        body, z, w = block(domain, start)
        seen = []

        def data(begin, end, body=body, seen=seen):
            order = np.argsort(body.id)
            seen.append((body["v"][order], body.x[order], body["u"][order]))

        R = formulations.internal_force(w, body, RUBBER)
        sim = ExplicitMPM(R, z, body, data=data if look else None, dt=1e-3)
        for _ in sim.run(0.15, interval):
            pass
        order = np.argsort(body.id)
        found.append([body[k][order] for k in ("x", "v", "F", "sigma")])
        assert len(seen) == (150 if look else 0)
        for (_, x, u), (_, x_next, u_next) in itertools.pairwise(seen):
            if len(x) == len(x_next) and COMM.size == 1:
                assert x_next - x == pytest.approx(u_next - u, abs=1e-15)
                assert np.abs(x_next - x).max() > 1e-6
    if COMM.size == 1:
        for a, b in zip(*found, strict=True):
            assert b == pytest.approx(a, rel=1e-9, abs=1e-9)


def test_carried_points_that_are_changed_between_steps():
    """On a lattice their places are taken anew, as by forms."""
    results = []
    for on_exit in ("error", "clamp"):
        domain = mesh.create_unit_square(MPI.COMM_SELF, 20, 20, mesh.CellType.quadrilateral)
        body = points.lattice(domain, 0.025, inside=lambda x: np.abs(x[:2] - 0.5).max(axis=0) < 0.2)
        formulations.set_initial_state(body, 2.0)
        z = formulations.Unknown(domain, "v")
        w = z.test.v
        edge = body.select(lambda x: x[0] > 0.67)
        edge["weight"] = 0.01
        R = formulations.internal_force(w, body, RUBBER)
        R += formulations.dead_load(w, edge, (0.0, 1.0))
        sim = ExplicitMPM(R, z, body, carried=[edge], dt=1e-3, on_exit=on_exit)
        for _ in range(3):
            sim.step()
        edge.remove(edge.x[:, 1] > 0.5)
        sim.step()
        edge.move(edge.x - np.array([0.1, 0.0]))
        for _ in range(3):
            sim.step()
        results.append((body.x, body["v"], edge.x))
    for a, b in zip(*results, strict=True):
        assert a == pytest.approx(b, abs=1e-12)
    assert results[0][2][:, 0].max() < 0.6
