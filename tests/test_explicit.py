# SPDX-License-Identifier: MIT
"""Explicit dynamics: exact motions, conservation, averages of J, failures that leave no trace."""

import math
import tracemalloc

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from explicit_runs import simulate

from fenicsmpm import ExplicitMPM, RigidBody, UnstableError, basis, formulations, io, points, shapes
from fenicsmpm.diagnostics import mean_stress, momentum, roughness
from fenicsmpm.materials import (
    Hencky,
    Law,
    NeoHookean,
    NewtonianFluid,
    VonMises,
    compiled,
    stress,
)

COMM = MPI.COMM_WORLD
BASES = ["linear", "gimp", "quadratic", "cubic"]
# in space, one kind of functions is enough to see that another numba compiles the loops
every_basis = pytest.mark.parametrize(
    "basis,dim",
    [
        pytest.param(
            basis, dim, marks=[pytest.mark.once] if dim == 3 and basis != "quadratic" else []
        )
        for dim in (2, 3)
        for basis in BASES
    ],
)
RUBBER = NeoHookean(E=100.0, nu=0.4).pointwise()
SHIFT = np.array([0.3, -0.2, 0.1])


def lattice(dim, n=10, comm=COMM, size=1.0):
    """A box of n cells a side, shifted, whose cells are no cubes."""
    upper = size * np.array([1.0, 1.2, 0.9])
    if dim == 2:
        corners = [SHIFT[:2], SHIFT[:2] + upper[:2]]
        return mesh.create_rectangle(comm, corners, [n, n], mesh.CellType.quadrilateral)
    return mesh.create_box(comm, [SHIFT, SHIFT + upper], [n] * 3, mesh.CellType.hexahedron)


def block(dim, law=RUBBER, velocity=None, comm=COMM, n=10, spacing=0.05):
    """A block in the middle of the box, without a corner: kernels work on eight points at once."""
    domain = lattice(dim, n, comm)
    centre = SHIFT[:dim] + 0.5

    def inside(x):
        from_centre = x[:dim] - centre[:, None]
        return (np.abs(from_centre).max(axis=0) < 0.2) & (from_centre.sum(axis=0) < 0.16 * dim)

    body = points.lattice(domain, spacing, inside=inside)
    formulations.set_initial_state(body, 2.0, velocity)
    return body, fem.functionspace(domain, ("Lagrange", 1, (dim,))), centre


def in_order(body, name):
    """Values of all points, in the order of where they were at the start."""
    values = np.concatenate(body.mesh.comm.allgather(body[name]))
    start = np.concatenate(body.mesh.comm.allgather(body.x - body["u"]))
    return values[np.lexsort(np.round(start, 8).T)]


@pytest.mark.mpi
@every_basis
def test_momentum_of_a_free_block(basis, dim):
    def velocity(x):
        return 0.05 * np.sin(7 * x[:dim][::-1]) + 0.5

    body, V, _ = block(dim, velocity=velocity)
    sim = simulate(V, {body: RUBBER}, functions=basis)
    before = momentum(body)
    for _ in sim.run(20.5 * sim.dt, 10 * sim.dt):
        pass
    assert sim.number >= 20
    assert COMM.allreduce(np.abs(body["sigma"]).max(initial=0.0), MPI.MAX) > 0.02
    assert momentum(body) == pytest.approx(before, rel=1e-12)


@every_basis
def test_homogeneous_deformation(basis, dim):
    """All nodes are moved: points follow exactly, whatever is averaged; the paper's eq. 14."""
    rate = np.array([[0.3, -0.8, 0.2], [0.5, -0.2, 0.1], [-0.3, 0.4, 0.1]])[:dim, :dim]
    for fbar in (
        None,
        formulations.FBar(),
        formulations.ALGORITHM_1,
        formulations.TRUE_J,
        formulations.FBar(0.1, 0.1),
    ):
        centre = SHIFT[:dim] + 0.5
        body, V, _ = block(dim, velocity=lambda x: rate @ (x[:dim] - centre[:, None]))
        value = fem.Function(V)
        value.interpolate(lambda x: rate @ (x[:dim] - centre[:, None]))
        everything = np.arange(V.dofmap.index_map.size_local, dtype=np.int32)
        sim = simulate(
            V, {body: RUBBER}, functions=basis, dt=1e-3, fbar=fbar,
            bcs=[fem.dirichletbc(value, everything)],
        )  # fmt: skip
        X = in_order(body, "x")
        for _ in range(3):
            sim.step()
        step = np.eye(dim) + sim.dt * rate
        F = np.eye(3)
        F[:dim, :dim] = np.linalg.matrix_power(step, 3)
        n = len(body)
        assert body["F"] == pytest.approx(np.tile(F, (n, 1, 1)), abs=1e-13)
        moved = centre + (X - centre) @ F[:dim, :dim].T
        assert in_order(body, "x") == pytest.approx(moved, abs=1e-13)
        assert in_order(body, "u") == pytest.approx(moved - X, abs=1e-13)
        J = np.full(n, np.linalg.det(F))
        assert body["J"] == pytest.approx(J, rel=1e-13)
        assert fbar is None or body["J_bar"] == pytest.approx(J, rel=1e-12)
        assert body.weight == pytest.approx(J * body["V_0"], rel=1e-13)
        expected = stress(RUBBER, body["F"])
        assert body["sigma"] == pytest.approx(expected, abs=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("dim", [2, 3])
def test_rigid_rotation(dim):
    """F grows by (spin dt)^2 a step where all nodes turn; a free body's surface bends a little."""
    spin = 0.5

    def velocity(x):
        v = np.zeros((dim, x.shape[1]))
        v[:2] = -spin * (x[1] - 0.3), spin * (x[0] - 0.8)
        return v

    for free in (False, True):
        body, V, _ = block(dim, velocity=velocity)
        value = fem.Function(V)
        value.interpolate(velocity)
        everything = np.arange(V.dofmap.index_map.size_local, dtype=np.int32)
        bcs = [] if free else [fem.dirichletbc(value, everything)]
        sim = simulate(V, {body: RUBBER}, cfl=0.1, bcs=bcs)
        for _ in sim.run(0.2, 0.1):
            pass
        angle = spin * sim.time
        turned = np.eye(3)
        turned[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
        growth = spin**2 * sim.dt * sim.time
        ones = np.ones(len(body))
        assert body["J"] == pytest.approx(ones, abs=1e-2 if free else 1.1 * growth)
        assert free or np.abs(body["F"] - turned).max() < 2 * growth


@pytest.mark.parametrize("dim", [2, 3])
def test_load_and_gravity(dim):
    """A free body gets the momentum of its loads and its weight."""
    body, V, centre = block(dim)
    load = body.select(lambda x: np.abs(x[:dim] - centre[:, None]).max(axis=0) < 0.06)
    load.add_field("force", (dim,), np.arange(1.0, dim + 1))
    start = load.x.copy()
    g = np.array([0.0, -3.0, 1.0])[:dim]
    sim = simulate(V, {body: RUBBER}, gravity=g, loads=[load])
    for _ in range(5):
        sim.step()
    force = load["force"].sum(axis=0) + g * body["mass"].sum()
    assert momentum(body) == pytest.approx(sim.time * force, rel=1e-12)
    assert load["u"] == pytest.approx(load.x - start, abs=1e-15)
    assert np.abs(load["u"]).max() > 0


def test_reaction_of_a_support():
    """What holds a body at rest on the floor is its weight, once it has settled."""
    corners = [(0, 0), (0.125, 1)]
    domain = mesh.create_rectangle(COMM, corners, [8, 64], mesh.CellType.quadrilateral)
    body = points.lattice(domain, 1 / 128, inside=lambda x: x[1] < 0.5)
    formulations.set_initial_state(body, 2.0)
    z = formulations.Unknown(domain, "v")
    z.fix("v", lambda x: np.isclose(x[0] * (0.125 - x[0]), 0), component=0)
    z.fix("v", lambda x: np.isclose(x[1], 0), component=1)
    sim = simulate(z, {body: RUBBER}, gravity=(0, -1), damping=0.7)
    for _ in sim.run(2.0, 1.0):
        pass
    weight = body["mass"].sum()
    assert sim.reaction[1] == pytest.approx(weight, rel=1e-3)
    height = 0.5 - (body.x[:, 1] - body["u"][:, 1])
    modulus = RUBBER.wave_speed_modulus
    assert body["sigma"][:, 1, 1] == pytest.approx(-2.0 * height, abs=0.05)
    assert body["u"][:, 1].min() == pytest.approx(-2.0 * 0.5**2 / (2 * modulus), rel=0.1)


@compiled
def viscous(F, L, parameters, state, sigma):
    """A law of one's own, which resists the rate only."""
    for i in range(3):
        for j in range(3):
            sigma[i, j] = parameters[0] * (L[i, j] + L[j, i])


@pytest.mark.parametrize(
    "law",
    [
        Law(viscous, [0.1], 100.0),
        Hencky(100.0, 0.3),
        VonMises(100.0, 0.3, sigma_y=2.0),
        NewtonianFluid(100.0, 0.1),
    ],
)
@pytest.mark.parametrize("dim", [2, pytest.param(3, marks=pytest.mark.once)])
def test_materials_in_a_shear_flow(law, dim):
    rate = np.zeros((dim, dim))
    rate[0, 1] = 2.0
    centre = SHIFT[:dim] + 0.5
    body, V, _ = block(dim, law, velocity=lambda x: rate @ (x[:dim] - centre[:, None]))
    value = fem.Function(V)
    value.interpolate(lambda x: rate @ (x[:dim] - centre[:, None]))
    everything = np.arange(V.dofmap.index_map.size_local, dtype=np.int32)
    sim = simulate(V, {body: law}, dt=1e-3, bcs=[fem.dirichletbc(value, everything)])
    F, L, state = np.eye(3)[None], np.zeros((1, 3, 3)), law.initial_state(1)
    L[0, :dim, :dim] = rate
    for _ in range(10):
        F = F + sim.dt * L @ F
        expected = stress(law, F, L, state)
    for _ in sim.run(0.01, 0.005):
        pass
    n = len(body)
    assert n % 8 != 0 and sim.number == 10
    assert body["sigma"] == pytest.approx(np.tile(expected, (n, 1, 1)), abs=1e-9)
    for name in law.state:
        assert body[name][0] == pytest.approx(law.state_field(state, name)[0], abs=1e-12)
        assert np.ptp(body[name], axis=0).max() < 1e-12


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("speed", [0.5, 50.0])
def test_a_rigid_box_is_not_entered(speed, dim):
    """Slowly the barrier holds, fast the last resort; forces are what momentum changes by."""
    down = np.zeros(dim)
    down[-1] = -speed
    body, V, centre = block(dim, velocity=down)
    top = centre[-1] - 0.21
    lower, upper = np.full(dim, -np.inf), np.full(dim, np.inf)
    upper[-1] = top
    floor = RigidBody(shapes.Box(lower, upper), reach=0.02)
    sim = simulate(V, {body: RUBBER}, rigid=[floor], dt=2e-4 if speed > 1 else None)
    before, impulse = momentum(body), np.zeros(dim)
    for _ in range(20 if speed > 1 else 60):
        try:
            sim.step()
        except UnstableError:  # crushed, but not pushed through
            assert speed > 1
            break
        impulse += sim.dt * floor.force
        assert body.x[:, -1].min() >= top
    assert impulse[-1] > 0
    assert momentum(body) == pytest.approx(before + impulse, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("friction", [0.0, 0.3, np.inf])
def test_friction_of_a_rigid_box(friction):
    """A block that slides on a moving floor: without slip it goes with it."""
    body, V, centre = block(2)
    upper = np.array([np.inf, centre[1] - 0.2])
    floor = RigidBody(
        shapes.Box([-np.inf, -np.inf], upper),
        reach=0.02,
        velocity=lambda t: (0.3, 0.0),
        friction=friction,
    )
    sim = simulate(V, {body: RUBBER}, rigid=[floor], gravity=(0.0, -2.0), flip=0.95, fbar=None)
    normal, tangential = 0.0, 0.0
    for _ in range(150):
        sim.step()
        assert floor.force[1] >= 0 and body.x[:, 1].min() > upper[1]
        assert abs(floor.force[0]) <= min(friction, 1e9) * floor.force[1] * (1 + 1e-9) + 1e-12
        normal += floor.force[1]
        tangential += floor.force[0]
    assert normal > 0
    v = body["v"][:, 0].mean()
    if friction == 0:
        assert abs(v) < 1e-10
    elif friction < 1:
        assert tangential == pytest.approx(friction * normal, rel=0.3)
    else:
        assert v == pytest.approx(0.3, abs=0.15)


@compiled
def counting(F, L, parameters, state, sigma):
    state[0] += 1
    sigma[:, :] = 0.0


def test_a_law_with_a_state_and_without_branches():
    """Would be compiled for eight points, of which each has a state of its own."""
    law = Law(counting, np.zeros(0), 1.0, state={"calls": ((), 0.0)}, needs_rate=False)
    body, V, _ = block(2, law)
    sim = simulate(V, {body: law}, dt=1e-3)
    for _ in sim.run(5e-3):
        pass
    assert np.all(body["calls"] == 5)


def test_a_law_may_change_its_parameters_only():
    body, V, _ = block(2, VonMises(100.0, 0.3, sigma_y=2.0))
    sim = simulate(V, {body: VonMises(100.0, 0.3, sigma_y=2.0)})
    sim.laws[body] = VonMises(100.0, 0.3, sigma_y=1.0)
    sim.step()
    sim.laws[body] = Hencky(100.0, 0.3)
    with pytest.raises(ValueError, match="only the parameters of"):
        sim.step()


def test_averages_remove_a_checkerboard():
    rng = np.random.default_rng(1)
    body, V, _ = block(2, NeoHookean(E=1.0, nu=0.499).pointwise(), n=20, spacing=0.025)
    F = np.tile(np.eye(3), (len(body), 1, 1))
    F[:, :2, :2] *= (1 + 1e-3 * rng.standard_normal(len(body)))[:, None, None]
    body["F"], body["J"] = F, np.linalg.det(F)
    body.add_field("J_0", (), 1.0)  # the checkerboard is none of the initial state
    law = NeoHookean(E=1.0, nu=0.499).pointwise()
    rough = {}
    for name, fbar in (("standard", None), ("averaged", formulations.TRUE_J)):
        copy = body.copy()
        simulate(V, {copy: law}, fbar=fbar, dt=1e-6).step()
        p = mean_stress(copy["sigma"])
        rough[name] = roughness(copy, p, 0.025)
    assert rough["averaged"] < 0.2 * rough["standard"]


@pytest.mark.ranks
@pytest.mark.mpi
def test_the_same_on_any_number_of_ranks(tmp_path):
    def run(comm):
        def velocity(x):
            return np.array([0 * x[0] + 1.0, np.sin(5 * x[0])])

        body, V, _ = block(2, velocity=velocity, comm=comm, n=12)
        sim = simulate(V, {body: RUBBER}, flip=0.98)
        for _ in sim.run(0.15, 0.05):
            pass
        return in_order(body, "x"), in_order(body, "sigma")

    alone, together = run(MPI.COMM_SELF), run(COMM)
    for a, b in zip(alone, together, strict=True):
        assert b == pytest.approx(a, abs=1e-9 * np.abs(a).max())


@pytest.mark.mpi
def test_restart_goes_on_bit_by_bit(tmp_path):
    path = COMM.bcast(tmp_path) / "state.h5"

    def start():
        body, V, _ = block(2, velocity=lambda x: np.sin(7 * x[:2]))
        return simulate(V, {body: RUBBER}, fbar=formulations.FBar()), body

    sim, body = start()
    for _ in range(60):
        sim.step()
    io.checkpoint.save(path, sim)
    for _ in range(60):
        sim.step()
    again, copy = start()
    io.checkpoint.restore(path, again)
    for _ in range(60):
        again.step()
    assert again.number == 120 and again.time == sim.time
    for name in ("x", "v", "F", "sigma", "J_bar"):
        assert np.array_equal(body[name], copy[name]), name


def test_what_fails_leaves_the_points_as_they_were(said):
    body, V, _ = block(2, velocity=lambda x: np.sin(20 * x[:2]))
    sim = simulate(V, {body: RUBBER}, dt=1.0)
    assert any("above the limit of stability, about" in line for line in said)
    before = body.snapshot()
    with pytest.raises(UnstableError, match=r"^step \d+, t = .* point \d+ .* J = .* smaller ones$"):
        list(sim.run(200.0, 50.0))
    for name, array in before.items():
        assert np.array_equal(body[name], array), name
    assert (sim.time, sim.number) == (0.0, 0)

    body, V, _ = block(2, velocity=(5.0, 0.0))
    sim = simulate(V, {body: RUBBER})
    with pytest.raises(UnstableError, match="leaves the lattice"):
        for _ in sim.run(1.0, 0.01):
            assert body.x[:, 0].max() <= SHIFT[0] + 1.0


@compiled
def no_number(F, L, parameters, state, sigma):
    sigma[0, 0] = sigma[1, 1] = sigma[2, 2] = sigma[0, 1] = sigma[1, 0] = parameters[0] - math.inf


def test_what_is_not_finite_is_seen_where_all_nodes_are_held():
    law = Law(no_number, np.array([1.0]), 1.0, needs_rate=False)
    body, V, _ = block(2, law)
    everything = np.arange(V.dofmap.index_map.size_local, dtype=np.int32)
    bc = fem.dirichletbc(np.zeros(2), everything, V)
    sim = simulate(V, {body: law}, dt=1e-3, bcs=[bc])
    with pytest.raises(UnstableError, match=r"^step 1, .* is not finite .* shorter: lower cfl$"):
        for _ in range(3):
            sim.step()
    assert np.all(body["v"] == 0)


def test_wrong_input():
    body, V, _ = block(2)
    triangles = mesh.create_unit_square(MPI.COMM_SELF, 4, 4)
    with pytest.raises(ValueError, match="axis-parallel boxes"):
        basis.use(points.fill(triangles, 1), "quadratic")
    new = points.fill(V.mesh, 1)
    with pytest.raises(ValueError, match=r"without the fields F, J, mass, V_0 .*set_initial_state"):
        simulate(V, {new: RUBBER})
    v, w = fem.Function(V), ufl.TestFunction(V)
    with pytest.raises(ValueError, match="needs a body"):
        ExplicitMPM(formulations.internal_force(w, body, RUBBER), formulations.Unknown(v, "v"), [])
    with pytest.raises(ValueError, match="linear Lagrange space with 2 components"):
        simulate(fem.functionspace(V.mesh, ("Lagrange", 2, (2,))), {body: RUBBER})
    with pytest.raises(ValueError, match="unknown grid functions 'quartic'"):
        basis.use(points.fill(V.mesh, 1), "quartic")
    with pytest.raises(ValueError, match="r of F-bar"):
        formulations.FBar(r=-0.1)
    sim = simulate(V, {body: RUBBER})
    for until, interval in ((np.inf, None), (1.0, 0.0)):
        with pytest.raises(ValueError, match="end of a run must be finite"):
            next(sim.run(until, interval))
    assert "points of " in repr(sim) and "step length" in repr(sim)


def test_the_paper_s_time_step():
    """F-bar, section 4.1: 0.3 h / c is 2.773 ms for cells of 1 m."""
    domain = mesh.create_rectangle(COMM, [(0, 0), (8, 8)], [8, 8], mesh.CellType.quadrilateral)
    body = points.fill(domain, 2, inside=lambda x: x[0] < 4)
    law = NeoHookean(E=70.0, nu=0.499).pointwise()
    formulations.set_initial_state(body, 1.0)
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    assert simulate(V, {body: law}, cfl=0.3).dt == pytest.approx(2.773e-3, rel=5e-4)


@pytest.mark.once
def test_memory_in_a_large_room():
    """Five times the block's side costs at most a fifth more memory per point, plus dolfinx."""
    used = []
    for room in (1, 5):
        n = 8
        around = (round((room - 1) * n) + 4) // 2
        domain = mesh.create_box(
            COMM, [[-around] * 3, [n + around] * 3], [n + 2 * around] * 3, mesh.CellType.hexahedron
        )
        tracemalloc.start()
        try:
            body = points.lattice(domain, 0.25, inside=lambda x: np.all((x > 0) & (x < n), axis=0))
            basis.use(body, "quadratic")
            formulations.set_initial_state(body, 1.0)
            z = formulations.Unknown(domain, "v")
            R = formulations.internal_force(z.test.v, body, RUBBER, fbar=formulations.FBar())
            sim = ExplicitMPM(R, z, body, dt=1e-3)
            for _ in sim.run(2e-3, 2e-3):
                pass
            used.append(tracemalloc.get_traced_memory()[1] / len(body))
        finally:
            tracemalloc.stop()
    assert used[1] < 1.2 * used[0]


def test_memory_of_points_in_space():
    """All arrays at once, also while points are sorted; of a grid with far fewer nodes."""
    body, V, _ = block(3)
    simulate(V, {body: RUBBER}).step()  # compiles
    tracemalloc.start()
    try:
        body, V, _ = block(3, spacing=0.0125)
        sim = simulate(V, {body: RUBBER})
        tracemalloc.reset_peak()
        for _ in sim.run(sim.time + 110 * sim.dt, 110 * sim.dt):
            pass
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert len(body) > 30000
    assert peak / len(body) < 600
