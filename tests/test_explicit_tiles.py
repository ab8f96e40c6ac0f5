# SPDX-License-Identifier: MIT
"""Explicit steps in tiles: sums against plain ones, drift, ranks, walls, light nodes, memory."""

import itertools
import tracemalloc

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem, mesh
from explicit_runs import simulate, use
from test_explicit import BASES, RUBBER, SHIFT, lattice

from fenicsmpm import formulations, points
from fenicsmpm.basis.lattice_stencil import KINDS
from fenicsmpm.basis.lines import tabulate_line
from fenicsmpm.materials import Hencky
from fenicsmpm.simulation.lattice_carried import half_size
from fenicsmpm.simulation.lattice_engine import LatticeEngine
from fenicsmpm.transfer.wall_averages import wall_shares

pytestmark = pytest.mark.ranks

COMM = MPI.COMM_WORLD
CELLS = 10


def spread_body(dim, basis):
    """Points at random places, on walls, edges and corners, with fields at random."""
    domain = lattice(dim, CELLS)
    size = np.array([1.0, 1.2, 0.9])[:dim]
    rng = np.random.default_rng(3)
    walls = list(itertools.product([0.0, 0.37, 1.0], repeat=dim))
    t = np.vstack([walls, rng.uniform(0, 0.7, (203, dim))])
    x = SHIFT[:dim] + t * size
    body = points.MaterialPoints(domain, x if COMM.rank == 0 else np.empty((0, dim)), 1e-4)
    use(body, basis)
    formulations.set_initial_state(body, 2.0)
    # the same at the same point on any rank
    of_point = np.random.default_rng(4).normal(size=(len(x), 3 + 9 + 9 + 1))[body.id]
    body["mass"] *= 1 + 0.1 * np.tanh(of_point[:, 21])
    body["v"] = of_point[:, :dim]
    sigma = of_point[:, 3:12].reshape(-1, 3, 3)
    body.add_field("sigma", (3, 3), sigma + np.swapaxes(sigma, 1, 2))
    body["F"][:, :dim, :dim] += 0.05 * of_point[:, 12:21].reshape(-1, 3, 3)[:, :dim, :dim]
    body["J"] = np.linalg.det(body["F"])
    body.add_field("J_bar", (), 1 + 0.1 * np.tanh(of_point[:, 20]))
    body.add_field("J_0", (), 1.0)
    return body, fem.functionspace(domain, ("Lagrange", 1, (dim,)))


def everywhere(body, name):
    return np.concatenate(COMM.allgather(body[name]))


def functions(x, kind, half, dim):
    """Nodes ``(n, width^d, d)`` of points, values and gradients, one after the other."""
    size = np.array([1.0, 1.2, 0.9])[:dim]
    t = (x - SHIFT[:dim]) / size * CELLS
    t = np.where(np.abs(t - np.rint(t)) < 1e-9, np.rint(t), t)
    line = np.zeros((3, 4))
    result = []
    for p in range(len(x)):
        parts = []
        for k in range(dim):
            cell = min(int(t[p, k]), CELLS - 1)
            first = tabulate_line(kind, cell, t[p, k] - cell, CELLS, half[k], line)
            parts.append([(first + a, *line[:2, a]) for a in range(4) if np.any(line[:2, a])])
            line[:] = 0.0
        for ends in itertools.product(*parts):
            node = tuple(e[0] for e in ends)
            w = np.prod([e[1] for e in ends])
            gradient = [
                ends[k][2] * CELLS / size[k] * np.prod([e[1] for j, e in enumerate(ends) if j != k])
                for k in range(dim)
            ]
            result.append((p, node, w, np.array(gradient)))
    return result


def continued(means, volumes, shares):
    """Averages of nodes, continued to the walls of a lattice where the next two are not light."""
    result = means.copy()
    for k in range(means.ndim):
        for upper in (False, True):
            for layer, share in enumerate(shares[k]):
                a, V, new = (
                    np.moveaxis(f, k, 0)[:: -1 if upper else 1] for f in (means, volumes, result)
                )
                limit = 2 * (a[layer + 1] - a[layer + 2])
                difference = np.clip(
                    a[layer] - a[layer + 1], np.minimum(limit, 0), np.maximum(limit, 0)
                )
                least = 1e-8 * V[layer]
                there = (least > 0) & (V[layer + 1] > least) & (V[layer + 2] > least)
                new[layer] += np.where(there, share * difference, 0.0)
    return result


@pytest.mark.mpi
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("basis", BASES)
def test_sums_in_tiles_are_plain_sums(basis, dim):
    """Mass, momentum and force of nodes; averages; velocities back at the points."""
    body, V = spread_body(dim, basis)
    W = fem.functionspace(V.mesh, ("Lagrange", 1))
    half = half_size(body)
    engine = LatticeEngine(V, {body: RUBBER}, [formulations.TRUE_J], [], KINDS[basis])
    engine.begin({body: RUBBER}, [], [])
    engine.sum_nodes({})

    x, m, v = (everywhere(body, name) for name in ("x", "mass", "v"))
    ids, sigma, J = (everywhere(body, name) for name in ("id", "sigma", "J"))
    volume = J * everywhere(body, "V_0")
    shape = (CELLS + 1,) * dim
    mass, momentum, force = np.zeros(shape), np.zeros((*shape, dim)), np.zeros((*shape, dim))
    stencil = functions(x, KINDS[basis], half, dim)
    for p, node, w, gradient in stencil:
        mass[node] += w * m[p]
        momentum[node] += w * m[p] * v[p]
        force[node] -= volume[p] * sigma[p, :dim, :dim] @ gradient
    size = np.array([1.0, 1.2, 0.9])[:dim]
    at = (W.tabulate_dof_coordinates()[:, :dim] - SHIFT[:dim]) / size * CELLS
    at = tuple(np.rint(at).astype(int).T)

    scalar, vector = fem.Function(W), fem.Function(V)
    engine.write("mass", scalar)
    assert scalar.x.array == pytest.approx(mass[at], abs=1e-12 * mass.max())
    for name, expected in (("momentum", momentum), ("force", force)):
        engine.write(name, vector)
        largest = np.abs(expected).max()
        assert vector.x.array.reshape(-1, dim) == pytest.approx(expected[at], abs=1e-12 * largest)

    # forces that are known at dolfinx' nodes
    owned = V.dofmap.index_map.size_local
    added = 1 + np.arange(dim) + V.tabulate_dof_coordinates()[:owned, :dim]
    with_mass = mass[tuple(a[:owned] for a in at)] > 1e-6 * mass.max()
    added[~with_mass] = 0.0  # forces on light nodes go to those around them
    engine.add_forces(added)
    engine.write("force", vector)
    seen = vector.x.array.reshape(-1, dim)[:owned]
    expected = force[tuple(a[:owned] for a in at)] + added
    assert COMM.allreduce(int(with_mass.sum())) > 50
    assert seen[with_mass] == pytest.approx(expected[with_mass], abs=1e-12 * np.abs(force).max())

    dt = 1e-20
    engine.move_nodes(dt, 0.0)
    engine.write("velocity", vector)
    nodal_v = np.where(mass[..., None] > 0, momentum, 0) / np.where(mass > 0, mass, 1)[..., None]
    heavy = mass[at] > 1e-3 * mass.max()
    largest = np.abs(v).max()
    assert vector.x.array.reshape(-1, dim)[heavy] == pytest.approx(
        nodal_v[at][heavy], abs=1e-9 * largest
    )
    assert engine.gather(dt, 0.0) == []
    assert engine.deform(dt) == []
    engine.average()
    volumes, sums = np.zeros(shape), np.zeros(shape)
    for p, node, w, _ in stencil:
        volumes[node] += w * volume[p]
        sums[node] += w * volume[p] * J[p]
    engine.write_average(0, scalar)
    expected = np.where(volumes > 0, sums, 0) / np.where(volumes > 0, volumes, 1)
    V_0 = everywhere(body, "V_0")
    in_a_cell = round((np.prod(size / CELLS) * len(x) / V_0.sum()) ** (1 / dim))
    shares = [wall_shares(KINDS[basis], CELLS, half[k], in_a_cell) for k in range(dim)]
    expected = continued(expected, volumes, shares)
    heavy = volumes[at] > 1e-6 * volumes.max()
    assert scalar.x.array[heavy] == pytest.approx(expected[at][heavy], rel=1e-12)
    engine.finish(again=False, keep=True, anew=False)
    engine.settle(sort=True)
    J_bar = np.zeros(len(x))
    for p, node, w, _ in stencil:
        J_bar[p] += w * expected[node]
    order = np.argsort(ids)
    by_id = dict(zip(ids[order], J_bar[order], strict=True))
    assert body["J_bar"] == pytest.approx([by_id[i] for i in body.id], rel=1e-12)
    assert len(everywhere(body, "id")) == len(x)


def flight(comm, basis="quadratic", interval=None, velocity=(4.0, 1.0), n=24, steps=60):
    """A small body that crosses many cells, and turns."""
    domain = mesh.create_unit_square(comm, n, n, mesh.CellType.quadrilateral)
    centre = np.array([[0.2], [0.3]])
    body = points.lattice(
        domain, 0.5 / n, inside=lambda x: np.abs(x[:2] - centre).max(axis=0) < 0.1
    )

    def start(x):
        right, up = x[:2] - centre
        return np.array([velocity[0] - 2.0 * up, velocity[1] + 2.0 * right])

    formulations.set_initial_state(body, 2.0, start)
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    averages = formulations.FBar()
    sim = simulate(V, {body: RUBBER}, fbar=averages, functions=basis, dt=2e-3)
    owned = domain.topology.index_map(2).size_local
    for step in sim.run(steps * sim.dt, interval):
        # points that stay in working arrays may do so only on the ranks that own their cells
        if step.number % 37 == 0:
            is_home = bool(np.all((body.cell >= 0) & (body.cell < owned)))
            assert comm.allreduce(is_home, MPI.LAND)
    start_at = np.concatenate(comm.allgather(body.x - body["u"]))
    order = np.lexsort(np.round(start_at, 8).T)
    return {
        name: np.concatenate(comm.allgather(body[name]))[order]
        for name in ("x", "v", "F", "sigma", "J_bar")
    }


@pytest.mark.parametrize("basis", BASES)
def test_points_that_drift_out_of_their_tile(basis, monkeypatch):
    """Over 11 cells in one block of steps, and laid anew in each step: the same."""
    laid = []
    lay = LatticeEngine._lay
    monkeypatch.setattr(LatticeEngine, "_lay", lambda self: (laid.append(1), lay(self))[1])
    at_once = flight(MPI.COMM_SELF, basis, interval=1.0)
    assert 4 < len(laid) < 40
    each = flight(MPI.COMM_SELF, basis, interval=2e-3)
    for name, a in each.items():
        assert at_once[name] == pytest.approx(a, abs=1e-10 * np.abs(a).max()), name


@pytest.mark.mpi
@pytest.mark.parametrize("interval", [0.06, None])
@pytest.mark.parametrize("ghosts", ["none", "shared_facet"])
def test_a_body_crosses_ranks(ghosts, interval, monkeypatch):
    """In blocks of steps, and in single ones, after which points may stay where they are."""
    alone = flight(MPI.COMM_SELF, interval=0.06)
    mode = getattr(mesh.GhostMode, ghosts)
    make = mesh.create_unit_square
    monkeypatch.setattr(mesh, "create_unit_square", lambda *a: make(*a, ghost_mode=mode))
    together = flight(COMM, interval=interval)
    for name, a in alone.items():
        assert together[name] == pytest.approx(a, abs=1e-10 * np.abs(a).max()), name


@pytest.mark.mpi
def test_ranks_without_points_and_supports_of_other_ranks():
    """A body of four cells in a corner, on rollers that move."""

    def run(comm):
        domain = mesh.create_unit_square(comm, 12, 12, mesh.CellType.quadrilateral)
        body = points.lattice(domain, 1 / 24, inside=lambda x: x.max(axis=0) < 0.16)
        formulations.set_initial_state(body, 2.0)
        z = formulations.Unknown(domain, "v")
        z.fix("v", lambda x: np.isclose(x[0], 0), lambda t: np.sin(20 * t), component=0)
        sim = simulate(z, {body: RUBBER}, gravity=(0.5, 0.0))
        for _ in sim.run(0.05, 0.025):
            pass
        x = np.concatenate(comm.allgather(body.x))
        return x[np.lexsort(np.round(x, 7).T)], sim.reaction

    (x, reaction), (x_alone, reaction_alone) = run(COMM), run(MPI.COMM_SELF)
    assert x == pytest.approx(x_alone, abs=1e-12)
    assert reaction == pytest.approx(reaction_alone, rel=1e-9)


PAIR = [(1.0, 0.5), (0.5, 0.5)]
FOUR = [(0.0, 0.5), (0.02, 0.5), (0.02, 0.52), (0.0, 0.52)]


@pytest.mark.parametrize(
    "n, basis, x, normal",
    [
        (49, "linear", PAIR, 0.0),
        (98, "gimp", PAIR, 0.0),
        (107, "quadratic", PAIR, 0.0),
        (107, "cubic", PAIR, 0.0),
        (20, "cubic", FOUR, -1e-3),
    ],
)
def test_points_on_walls(n, basis, x, normal):
    """On the wall, by round-off beyond it, and sliding along it."""
    domain = mesh.create_unit_square(MPI.COMM_SELF, n, n, mesh.CellType.quadrilateral)
    body = points.MaterialPoints(domain, x, 1e-4)
    law = Hencky(E=1e6, nu=0.3)
    formulations.set_initial_state(body, 1000.0, (normal, 0.1))
    z = formulations.Unknown(domain, "v")
    z.fix("v", lambda x: np.isclose(x[0], 0) | np.isclose(x[0], 1), component=0)
    sim = simulate(z, {body: law}, functions=basis)
    for _ in sim.run(200 * sim.dt, 50 * sim.dt):
        pass
    start = body.x - body["u"]
    on_wall = np.isclose(start[:, 0] * (1 - start[:, 0]), 0.0, atol=1e-12)
    assert on_wall.sum() == len(x) // 2
    assert body["u"][on_wall, 0] == pytest.approx(0.0, abs=1e-9 / n)
    momentum = body["mass"] @ body["v"][:, 1]
    assert momentum == pytest.approx(0.1 * body["mass"].sum(), rel=1e-12)


@pytest.mark.parametrize("velocity", [(0.0, -1.0), (0.3, -0.7)])
@pytest.mark.parametrize("basis", BASES)
def test_free_flight(basis, velocity):
    """A stress-free block: nodes of nearly no mass must not be thrown ahead."""
    domain = mesh.create_unit_square(MPI.COMM_SELF, 20, 20, mesh.CellType.quadrilateral)
    law = Hencky(E=1e5, nu=0.3)
    body = points.lattice(
        domain, 0.0125, inside=lambda x: np.abs(x[:2].T - (0.5, 0.6)).max(axis=1) < 0.1
    )
    formulations.set_initial_state(body, 1.0, velocity)
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    sim = simulate(V, {body: law}, functions=basis)
    for _ in sim.run(0.1, 0.05):
        pass
    assert sim.number > 1000
    assert body["v"] == pytest.approx(np.tile(velocity, (len(body), 1)), abs=1e-10)


def test_an_elastic_block_in_motion_with_linear_functions():
    """It oscillates and flies: momentum is kept, and energy does not grow."""
    domain = mesh.create_unit_square(MPI.COMM_SELF, 20, 20, mesh.CellType.quadrilateral)
    law = Hencky(E=1e3, nu=0.3)
    centre = np.array([[0.35], [0.6]])
    body = points.lattice(
        domain, 0.0125, inside=lambda x: np.abs(x[:2] - centre).max(axis=0) < 0.15
    )

    def start(x):
        right, up = x[:2] - centre
        return np.array([0.3 + 0.5 * right, -0.2 - 0.5 * up])

    formulations.set_initial_state(body, 1.0, start)
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    sim = simulate(V, {body: law}, functions="linear")
    before = body["mass"] @ body["v"]
    kinetic = 0.5 * body["mass"] @ (body["v"] ** 2).sum(axis=1)
    for _ in sim.run(1.0, 0.25):
        assert 0.5 * body["mass"] @ (body["v"] ** 2).sum(axis=1) < 1.05 * kinetic
    assert sim.number > 1000
    assert body["mass"] @ body["v"] == pytest.approx(before, rel=1e-10)
    assert body["J"].min() > 0.9 and body["J"].max() < 1.1


def test_no_points_are_left():
    domain = mesh.create_unit_square(MPI.COMM_SELF, 6, 6, mesh.CellType.quadrilateral)
    body = points.fill(domain, 2, inside=lambda x: x[0] < 0.5)
    formulations.set_initial_state(body, 1.0)
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    sim = simulate(V, {body: RUBBER})
    body.remove(np.full(len(body), True))
    with pytest.raises(ValueError, match="all bodies are empty"):
        sim.step()


def test_memory_does_not_go_with_the_room():
    """Beside the mesh: the same points in a lattice of 5 times the side."""
    peak = []
    for room in (1, 1, 5):  # the first one compiles
        n = 12 * room
        corners = [(0, 0, 0), (room,) * 3]
        domain = mesh.create_box(MPI.COMM_SELF, corners, [n] * 3, mesh.CellType.hexahedron)
        body = points.lattice(domain, 1 / 36, inside=lambda x: x.max(axis=0) < 1)
        formulations.set_initial_state(body, 1.0)
        V = fem.functionspace(domain, ("Lagrange", 1, (3,)))
        sim = simulate(V, {body: RUBBER})
        tracemalloc.start()
        try:
            for _ in sim.run(5 * sim.dt, 5 * sim.dt):
                pass
            peak.append(tracemalloc.get_traced_memory()[1])
        finally:
            tracemalloc.stop()
    assert peak[2] < 1.2 * peak[1]
