# SPDX-License-Identifier: MIT
"""What acts on bodies in explicit dynamics: each other, walls, loads, rigid boxes; and restarts."""

import math
import re

from mpi4py import MPI

import numba
import numpy as np
import pytest
from dolfinx import fem, mesh
from explicit_runs import simulate

from fenicsmpm import ExplicitMPM, RigidBody, UnstableError, formulations, io, points, shapes
from fenicsmpm.basis.blocks import in_blocks, plain_order, stencils
from fenicsmpm.basis.lines import CUBIC, GIMP, LINEAR, QUADRATIC, WIDTH, tabulate_line
from fenicsmpm.basis.windows import window
from fenicsmpm.diagnostics import mean_stress, momentum
from fenicsmpm.lanes import LANES
from fenicsmpm.materials import Law, NeoHookean, VonMises, compiled
from fenicsmpm.simulation import Reaction
from fenicsmpm.transfer.tiles import make_nodes

pytestmark = pytest.mark.ranks

COMM = MPI.COMM_WORLD
RUBBER = NeoHookean(E=100.0, nu=0.4).pointwise()


def box(lower, upper, law=RUBBER, velocity=None, comm=COMM, n=10, V=None):
    """A rectangular body in the unit square."""
    if V is None:
        domain = mesh.create_unit_square(comm, n, n, mesh.CellType.quadrilateral)
        V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    body = points.lattice(
        V.mesh, 0.5 / n, inside=lambda x: np.all((x[:2].T > lower) & (x[:2].T < upper), axis=1)
    )
    formulations.set_initial_state(body, 2.0, velocity)
    return body, V


@numba.njit
def call(fill, rows, block, nodes, half, lower, corner, base, w, d):
    """Only compiled functions can call what is part of kernels."""
    fill(rows, block, nodes, half, lower, corner, base, w, d)


@pytest.mark.parametrize("in_window", [False, True])
@pytest.mark.parametrize("kind", [LINEAR, QUADRATIC, CUBIC, GIMP])
def test_functions_at_walls_are_those_of_the_basis(kind, in_window):
    """Kernels have functions for eight points of their own."""
    cells, half, width = 6, 0.3, WIDTH[kind]
    t = np.concatenate([np.linspace(0, cells, 121), [0.2, 5.8, 0.5, 5.5, 1e-8, cells - 1e-8]])
    x = np.column_stack([t, t[::-1]])
    nodes = make_nodes(np.zeros(2), np.ones(2), np.array([cells, cells]))
    fill, rows = stencils(2, kind, in_window), in_blocks(x, plain_order(len(x)))
    lower = np.array([-2.0, -1.0, 0.0]) if in_window else np.zeros(3)
    far = window(2, width).far if in_window else cells + 1
    corner, base = np.empty((3, LANES)), np.empty(LANES, np.int64)
    w, d = np.empty((3 * width, LANES)), np.empty((12, LANES))
    line = np.zeros((3, 4))
    for p in range(len(x)):
        call(fill, rows, p // LANES, nodes, np.full(3, half), lower, corner, base, w, d)
        i, firsts = p % LANES, []
        for k in range(2):
            cell = min(int(x[p, k]), cells - 1)
            first = tabulate_line(kind, cell, x[p, k] - cell, cells, half, line)
            expected = np.zeros((2, cells + 3))
            expected[:, first + 1 : first + 1 + width] = line[:2, :width]
            firsts.append(int(base[i] // far if k == 0 else base[i] % far) + int(lower[k]))
            found = np.zeros((2, cells + 3))
            there = slice(firsts[k] + 1, firsts[k] + 1 + width)
            found[0, there] = w[k * width : (k + 1) * width, i]
            found[1, there] = d[k * width : (k + 1) * width, i]
            assert found == pytest.approx(expected, abs=1e-12), (x[p], k)
        assert 0 <= min(firsts) and max(firsts) <= cells + 1 - width


@pytest.mark.parametrize("fbar", ["default", formulations.TRUE_J, formulations.ALGORITHM_1])
def test_bodies_keep_their_own_volumes(fbar):
    """A squeezed soft body beside one that cannot be: averages of J must not mix."""
    soft = NeoHookean(E=1.0, nu=0.0).pointwise()
    hard = NeoHookean(E=100.0, nu=0.499).pointwise()
    left, V = box((0.2, 0.3), (0.5, 0.7), soft)
    right, _ = box((0.5, 0.3), (0.8, 0.7), hard, V=V)
    left["F"] = np.diag([0.8, 0.8, 1.0])
    left["J"] = 0.64
    left.add_field("J_bar", (), 0.64)
    sim = simulate(V, {left: soft, right: hard}, dt=1e-7, fbar=fbar)
    sim.step()
    assert right["J_bar"] == pytest.approx(1.0, abs=1e-7)
    assert np.abs(mean_stress(right["sigma"])).max() < 1e-3
    assert left["J_bar"] == pytest.approx(0.64, abs=1e-7)


@pytest.mark.mpi
def test_bodies_that_meet_keep_momentum_and_do_not_mix():
    left, V = box((0.2, 0.3), (0.45, 0.7), velocity=(1.0, 0))
    right, _ = box((0.55, 0.3), (0.8, 0.7), velocity=(-1.0, 0), V=V)
    sim = simulate(V, {left: RUBBER, right: RUBBER})
    for _ in sim.run(0.15, 0.05):
        assert momentum(left) + momentum(right) == pytest.approx([0, 0], abs=1e-12)
        assert left.bounds()[1][0] < right.bounds()[0][0]
    assert momentum(left)[0] < 0 < momentum(right)[0]


@pytest.mark.mpi
@pytest.mark.parametrize("basis", ["gimp", "quadratic", "cubic"])
def test_a_load_on_the_surface_pushes_all_of_the_body_and_stays_there(basis):
    """Some of its nodes have little mass or none: they must not run away with it."""
    body, V = box((0.2, 0.2), (0.5, 0.5))
    y = np.linspace(0.21, 0.49, 12)
    x = np.column_stack([np.full(12, 0.5001), y]) if COMM.rank == 0 else np.empty((0, 2))
    load = points.MaterialPoints(V.mesh, x, weight=1.0)
    load.add_field("force", (2,), (0.05, 0.0))
    sim = simulate(V, {body: RUBBER}, loads=[load], functions=basis)
    for _ in sim.run(0.45, 0.09):
        assert momentum(body) == pytest.approx([12 * 0.05 * sim.time, 0.0], rel=1e-12, abs=1e-12)
    gap = load.bounds()[0][0] - body.bounds()[1][0], load.bounds()[1][0] - body.bounds()[1][0]
    assert 0.015 < gap[0] <= gap[1] < 0.03
    assert body.bounds()[1][0] > 0.8


def test_a_load_away_from_all_bodies():
    body, V = box((0.2, 0.2), (0.5, 0.5))
    load = points.MaterialPoints(V.mesh, [(0.85, 0.85)], weight=1.0)
    load.add_field("force", (2,), (0.3, 0.1))
    sim = simulate(V, {body: RUBBER}, loads=[load])
    with pytest.raises(UnstableError, match="point 0 of a load is away from all bodies"):
        sim.step()
    assert (sim.time, sim.number) == (0.0, 0)


@pytest.mark.mpi
def test_a_reaction_does_not_depend_on_ranks():
    def reaction(comm):
        body, V = box((0.2, 0.2), (0.8, 0.8), comm=comm)
        value = fem.Function(V)
        value.interpolate(lambda x: np.vstack([np.sin(5 * x[0] + x[1]), x[0] / 3]))
        everywhere = fem.locate_dofs_geometrical(V, lambda x: x[0] < 0.55)
        bc = fem.dirichletbc(value, everywhere)
        sim = simulate(V, {body: RUBBER}, bcs=[bc], dt=1e-4)
        for _ in range(3):
            sim.step()
        return sim.reaction

    assert reaction(COMM) == pytest.approx(reaction(MPI.COMM_SELF), rel=1e-9)


@pytest.mark.mpi
@pytest.mark.parametrize("cell", ["quadrilateral", "triangle"])
def test_reactions_of_several_conditions(cell):
    """A block between a wall and a pusher: what both do is what changes its momentum."""
    kind = getattr(mesh.CellType, cell)
    domain = mesh.create_rectangle(COMM, [(0, 0), (1, 1)], [8, 8], kind)
    body = points.fill(domain, 2)
    formulations.set_initial_state(body, 2.0)
    z = formulations.Unknown(domain, "v")
    wall = z.fix("v", lambda x: np.isclose(x[0], 0))
    pusher = z.fix("v", lambda x: np.isclose(x[0], 1), lambda t: 0.1 * np.cos(20 * t), component=0)
    at_wall, at_pusher = Reaction(wall), Reaction(pusher)
    R = formulations.internal_force(z.test.v, body, RUBBER, fbar=None)
    sim = ExplicitMPM(R, z, body, dt=1e-3, observers=[at_wall, at_pusher])
    owned = z.space.dofmap.index_map.size_local
    for _ in sim.run(0.02):
        total = at_wall.value + at_pusher.value
        assert total == pytest.approx(sim.reaction, rel=1e-12, abs=1e-13)
        acceleration = sim.acceleration().x.array.reshape(-1, 2)[:owned]
        rate = COMM.allreduce(sim.mass().x.array[:owned] @ acceleration)
        assert total == pytest.approx(rate, rel=1e-9, abs=1e-11)
    assert at_pusher.value[1] == 0.0 and abs(at_pusher.value[0]) > 1e-3


def unchanged(body, before):
    return all(np.array_equal(body[name], array) for name, array in before.items())


@pytest.mark.parametrize("interval", [1, 3])
def test_a_box_that_fails_leaves_the_points_as_they_were(interval):
    """Pushed out of the lattice, or entered from the start."""
    for upper, velocity, message in (
        (0.19, 300.0, "leaves the lattice|is not finite|is inverted"),
        (0.4, 0.0, "a point is inside of the rigid body"),
    ):
        body, V = box((0.2, 0.3), (0.5, 0.7))
        wall = RigidBody(shapes.Box([-np.inf] * 2, [upper, np.inf]), 0.01, velocity=(velocity, 0.0))
        sim = simulate(V, {body: RUBBER}, rigid=[wall], dt=4e-3)
        before = body.snapshot()
        with pytest.raises((UnstableError, ValueError), match=message):
            next(sim.run(1.0, interval * sim.dt))
        assert unchanged(body, before)
        assert (sim.time, sim.number, wall.moved[0]) == (0.0, 0, 0.0)


@pytest.mark.mpi
def test_all_at_once_is_the_same_on_any_number_of_ranks():
    """Plastic state, loads, a moving box and supports."""

    def run(comm):
        clay = VonMises(100.0, 0.45, sigma_y=2.0)
        body, V = box((0.2, 0.0), (0.7, 0.6), clay, comm=comm)
        wall = RigidBody(shapes.Box([-np.inf] * 2, [0.195, np.inf]), 0.02, velocity=(0.4, 0.0))
        load = body.select(lambda x: x[1] > 0.56)
        load.add_field("force", (2,), (0.0, -0.05))
        z = formulations.Unknown(fem.Function(V), "v")
        z.fix("v", lambda x: np.isclose(x[1], 0), component=1)
        sim = simulate(z, {body: clay}, rigid=[wall], loads=[load], gravity=(0.0, -1.0))
        for _ in sim.run(0.2, 0.05):
            pass
        start = np.concatenate(comm.allgather(body.x - body["u"]))
        order = np.lexsort(np.round(start, 8).T)
        fields = {
            name: np.concatenate(comm.allgather(body[name]))[order]
            for name in ("u", "sigma", "eps_p", "J_bar")
        }
        return fields, wall.force, sim.reaction, momentum(body)

    (alone, *sums), (together, *same) = run(MPI.COMM_SELF), run(COMM)
    assert alone["eps_p"].max() > 1e-3
    for name, a in alone.items():
        assert together[name] == pytest.approx(a, abs=1e-9 * np.abs(a).max()), name
    for a, b in zip(sums, same, strict=True):
        assert b == pytest.approx(a, rel=1e-9, abs=1e-12)


@pytest.mark.mpi
def test_restart_between_intervals_goes_on_bit_by_bit(tmp_path):
    path = COMM.bcast(tmp_path) / "state.h5"

    def start(boxes=1):
        body, V = box((0.2, 0.3), (0.5, 0.7), VonMises(100.0, 0.4, sigma_y=1.0))
        law = VonMises(100.0, 0.4, sigma_y=1.0)
        wall = [
            RigidBody(
                shapes.Box([-np.inf] * 2, [0.2 - 0.02 * (k + 1), np.inf]), 0.02, velocity=(0.5, 0)
            )
            for k in range(boxes)
        ]
        load = body.select(lambda x: x[0] > 0.46)
        load.add_field("force", (2,), (-1e-2, 3e-2))
        return simulate(V, {body: law}, rigid=wall, loads=[load]), body

    sim, body = start()
    for k, _ in enumerate(sim.run(0.1, 0.013)):
        if k == 2:
            io.checkpoint.save(path, sim)
    again, copy = start()
    io.checkpoint.restore(path, again)
    assert again.rigid[0].moved[0] == pytest.approx(0.5 * 0.039)
    for _ in again.run(0.1, 0.013):
        pass
    assert (again.number, again.time) == (sim.number, sim.time)
    for name in body.snapshot():
        assert np.array_equal(body[name], copy[name]), name
    for boxes in (0, 2):
        other, untouched = start(boxes)
        before = untouched.snapshot()
        with pytest.raises(io.checkpoint.CheckpointError, match="rigid bod"):
            io.checkpoint.restore(path, other)
        assert unchanged(untouched, before)


@compiled
def late_nan(F, L, parameters, state, sigma):
    state[0] += 1.0
    sigma[:, :] = 0.0
    if state[0] > 2.0:
        sigma[0, 0] = math.nan


def test_a_stress_that_is_not_finite_is_not_handed_out():
    law = Law(late_nan, np.empty(0), 1.0, state={"count": ((), 0.0)}, needs_rate=False)
    body, V = box((0.2, 0.2), (0.5, 0.5), law)
    sim = simulate(V, {body: law}, dt=1e-3)
    body["count"][13] = 1.0
    where = np.array2string(body.x[13], precision=6)
    sim.step()
    before = body.snapshot()
    message = f"point {body.id[13]} has a stress that is not finite at {where}"
    with pytest.raises(UnstableError, match=re.escape(message)):
        sim.step()
    assert unchanged(body, before) and sim.number == 1


@pytest.mark.parametrize("rate", [0.0, 0.4, 10.0])
def test_the_true_J_is_drawn_to_its_average_by_strain(rate):
    """F <- (J* / J)^(1/2) F with J* = J + min(s e, 1) (J_bar - J), nothing at rest."""
    s, dt = 100.0, 1e-3
    body, V = box((0.2, 0.2), (0.5, 0.5))
    body.add_field("J_bar", (), 1.02)
    L = np.array([[rate, rate], [0.0, -rate]])
    motion = fem.Function(V)
    motion.interpolate(lambda x: L @ x[:2])
    held = fem.dirichletbc(motion, np.arange(V.dofmap.index_map.size_local, dtype=np.int32))
    fbar = formulations.FBar(r=0.3, s=s)
    simulate(V, {body: RUBBER}, bcs=[held], dt=dt, fbar=fbar).step()
    strain = dt * rate * math.sqrt(2 + 0.5)
    J = 1 + min(s * strain, 1.0) * 0.02
    expected = math.sqrt(J) * (np.eye(2) + dt * L)
    assert (s * strain < 1) == (rate < 1)
    assert body["F"][:, :2, :2] == pytest.approx(np.tile(expected, (len(body), 1, 1)), abs=1e-13)


@compiled
def tait(F, L, parameters, state, sigma):
    J = F[0, 0] * F[1, 1] - F[0, 1] * F[1, 0]
    sigma[:, :] = 0.0
    sigma[0, 0] = sigma[1, 1] = sigma[2, 2] = -parameters[0] * (J**-7 - 1) / 7


def test_a_fluid_of_one_s_own_flows():
    """Its averages are those of fluids, and of F only J is kept."""
    water = Law(tait, np.array([100.0]), 100.0, needs_rate=False, is_fluid=True)
    assert formulations.default_fbar(water) == formulations.FBar(r=0.3, s=100.0)
    body, V = box((0.2, 0.2), (0.5, 0.5), water, lambda x: np.array([x[1], 0 * x[0]]))
    sim = simulate(V, {body: water})
    for _ in range(5):
        sim.step()
    assert body["F"][:, 0, 1] == pytest.approx(0.0, abs=1e-15)
    assert body["F"][:, 0, 0] == pytest.approx(np.sqrt(body["J"]))


def test_wrong_sets():
    body, V = box((0.2, 0.2), (0.5, 0.5))
    load = body.select(lambda x: x[0] > 0.4)
    load.add_field("force", (2,))
    _, other = box((0.2, 0.2), (0.5, 0.5))
    nothing = body.select([])
    thin = mesh.create_rectangle(
        MPI.COMM_SELF, [(0, 0), (1, 1)], [20, 5], mesh.CellType.quadrilateral
    )
    large = points.lattice(thin, 0.1, inside=lambda x: x[0] < 0.5)
    formulations.set_initial_state(large, 1.0)
    W = fem.functionspace(thin, ("Lagrange", 1, (2,)))
    body.add_field("force", (2,))
    flat = RigidBody(shapes.Box([0.0] * 3, [0.1] * 3), reach=0.01)
    for space, bodies, options, message in (
        (V, [body], {"loads": [body]}, "given twice"),
        (V, [body], {"loads": [load, load]}, "given twice"),
        (other, [body], {}, "on the mesh of the velocity"),
        (V, [nothing], {}, "no points"),
        (W, [large], {"functions": "gimp"}, "at most half a cell"),
        (V, [body], {"rigid": [flat]}, "has 3 dimensions, but the mesh has 2"),
        (V, [body], {"gravity": -9.81}, "body force must be 2 finite numbers"),
        (V, [body], {"gravity": (0.0, np.nan)}, "body force must be 2 finite numbers"),
    ):
        with pytest.raises(ValueError, match=message):
            simulate(space, dict.fromkeys(bodies, RUBBER), **options)
    sim = simulate(V, {body: RUBBER, nothing: RUBBER})
    sim.step()
    assert len(nothing) == 0


def test_a_share_of_the_wave_s_time_above_one_is_warned_of(said):
    body, V = box((0.2, 0.2), (0.5, 0.5))
    simulate(V, {body: RUBBER}, cfl=3.0)
    assert any("above the limit of stability, about" in line for line in said)
