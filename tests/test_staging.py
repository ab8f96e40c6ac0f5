# SPDX-License-Identifier: MIT
"""Bodies and points that come and go between the steps of all loops."""

from types import SimpleNamespace

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh

from fenicsmpm import ExplicitMPM, ImplicitMPM, MaterialPoints, io, points
from fenicsmpm import formulations as fm
from fenicsmpm.forms import evaluate
from fenicsmpm.materials import Hencky, MohrCoulomb, NeoHookean, energy, stress
from fenicsmpm.simulation import Rebalanced, add_points, remove_points

pytestmark = pytest.mark.ranks

COMM = MPI.COMM_WORLD
G, DENSITY, K0 = 9.81, 2000.0, 0.5
SOIL, RUBBER = Hencky(E=50e6, nu=0.2), NeoHookean(E=50e6, nu=0.2)
HEIGHT, WIDTH = 8.0, 2.0
AT_REST = fm.k0_state(HEIGHT, DENSITY, K0)


def ground_and_bank(law):
    """Ground at rest under its own weight, and a bank of another law on it."""
    return on_box(tall_box(), law)


def tall_box():
    return mesh.create_rectangle(COMM, [(0, 0), (WIDTH, 12)], [2, 12], mesh.CellType.quadrilateral)


def on_box(domain, law):
    ground = points.fill(domain, 2, inside=lambda x: x[1] < HEIGHT)
    bank = points.fill(domain, 2, inside=lambda x: (x[1] > HEIGHT) & (x[1] < 10))
    for body in (ground, bank):
        fm.set_initial_state(body, DENSITY)
    fm.initial_stress(ground, law, AT_REST)
    return ground, bank


def supported(z, part):
    z.fix(part, lambda x: np.isclose(x[1], 0), component=1)
    z.fix(part, lambda x: np.isclose(x[0] * (WIDTH - x[0]), 0), component=0)
    return z


def explicit(bodies, fused=True, law=SOIL, **options):
    z = supported(fm.Unknown(bodies[0].mesh, "v"), "v")
    w = z.test.v
    R = sum((fm.internal_force(w, body, law) for body in bodies[1:]),
            fm.internal_force(w, bodies[0], law))  # fmt: skip
    if not fused:
        R = fem.Constant(bodies[0].mesh, 1.0) * R
    for body in bodies:
        R += fm.body_force(w, body, (0, -G))
    return ExplicitMPM(R, z, bodies, **options)


def implicit(bodies, scheme="QuasiStatic", kind="points", dt=0.1, law=SOIL):
    z = fm.Unknown(bodies[0].mesh, *(["u", "p"] if kind == "mixed" else ["u"]))
    supported(z, "u")
    time = getattr(fm, scheme)(z, dt=dt)
    R = 0
    for body in bodies:
        f = time.force(body, ufl.as_vector((0, -G)))
        if kind == "mixed":
            R += fm.stabilized("osgs", z, body, RUBBER, force=f)
            continue
        if kind == "energy":
            R += fm.EnergyMomentum(SOIL, body, z).power()
        else:
            P = fm.Response(law, body, fm.Kinematics(z.u, body).F).P
            R += fm.stress_power(P, z.test.u, body)
        R -= ufl.inner(f, z.test.u) * body.dx
    return ImplicitMPM(R, z, time, bodies)


def lowest(body, sigma, component):
    """Mean of a stress in the lowest row of points, over all ranks."""
    row = body.x[:, 1] < 0.5
    total = COMM.allreduce(np.array([sigma[row, component, component].sum(), row.sum()]))
    return total[0] / total[1]


def run(sim, until):
    for _ in sim.run(until):
        pass


LOOPS = [
    lambda bodies: explicit(bodies),
    lambda bodies: explicit(bodies, fused=False),
    lambda bodies: implicit(bodies),
    lambda bodies: implicit(bodies, "Newmark"),
    lambda bodies: implicit(bodies, "Midpoint", "energy"),
    lambda bodies: implicit(bodies, "Bossak", "mixed"),
]
NAMES = ["kernels", "forms", "quasi-static", "Newmark", "energy-momentum", "mixed"]


@pytest.mark.mpi
@pytest.mark.parametrize("build", LOOPS, ids=NAMES)
def test_a_bank_comes_and_goes(build):
    """Equilibrium before, motion with it; mass and energy are what the points have."""
    bodies = ground, bank = ground_and_bank(RUBBER if build is LOOPS[-1] else SOIL)
    sim = build([ground, bank])
    waiting = remove_points(sim, bank)
    assert bank.size_global == 0 and waiting.count == waiting.points.size_global == 2 * 2 * 4
    assert waiting.mass == pytest.approx(2 * WIDTH * DENSITY)
    assert waiting.volume == pytest.approx(2 * WIDTH)
    run(sim, 0.2)
    assert np.abs(ground["v"]).max(initial=0) < 1e-12  # at rest without the bank
    came = add_points(sim, bank, waiting.points)
    assert (came.count, came.mass) == (waiting.count, pytest.approx(waiting.mass))
    assert came.time == sim.time == pytest.approx(0.2)
    assert came.kinetic_energy == 0 and np.all(came.momentum == 0)
    run(sim, 0.21 if isinstance(sim, ExplicitMPM) else 0.3)
    fall = COMM.allreduce(bank["u"][:, 1].max(initial=-np.inf), MPI.MAX)
    settlement = 2 * DENSITY * G * HEIGHT / (SOIL.kappa + 4 / 3 * SOIL.mu)
    assert -3 * settlement < fall < 0
    masses = [COMM.allreduce(body["mass"].sum()) for body in bodies]
    top = remove_points(sim, bank, lambda x: x[1] > 9)
    rest = remove_points(sim, bank, bank.x[:, 1] > 0)
    assert top.mass + rest.mass == pytest.approx(masses[1])
    assert top.count == rest.count == 8
    v, m = top.points["v"], top.points["mass"]
    assert top.momentum == pytest.approx(COMM.allreduce(m @ v))
    assert top.kinetic_energy == pytest.approx(COMM.allreduce(m @ np.sum(v**2, axis=1)) / 2)
    if build is LOOPS[-1]:
        assert top.strain_energy is None
    else:
        psi = COMM.allreduce(top.points["V_0"] @ energy(SOIL, top.points["F"]))
        assert top.strain_energy == pytest.approx(psi) and psi > 0
    assert COMM.allreduce(ground["mass"].sum()) == pytest.approx(masses[0])
    run(sim, sim.time + (0.01 if isinstance(sim, ExplicitMPM) else 0.1))


@pytest.mark.mpi
@pytest.mark.parametrize("kind", ["points", "mixed"])
def test_lifts_and_an_excavation_by_load_steps(kind):
    """The lowest stress is the weight of what is above, after each stage."""
    law = SOIL if kind == "points" else RUBBER
    ground, bank = ground_and_bank(law)
    sim = implicit([ground, bank], kind=kind)

    def pressed(height):
        run(sim, sim.time + 0.1)
        if kind == "points":
            sigma = stress(SOIL, ground["F"])
        else:
            p = ground.field("p") * ufl.Identity(3)
            sigma = evaluate(RUBBER.deviatoric_stress(ground.field("F")) + p, ground)
        row = COMM.allreduce(ground.x[:, 1].min(initial=np.inf), MPI.MIN)
        exact = -DENSITY * G * (height - row)
        assert lowest(ground, sigma, 1) == pytest.approx(exact, rel=2e-3)

    waiting = remove_points(sim, bank).points
    first = waiting.select(waiting.x[:, 1] < 9)
    second = waiting.select(waiting.x[:, 1] > 9)
    pressed(8)
    add_points(sim, bank, first)
    pressed(9)
    add_points(sim, bank, second)
    pressed(10)
    remove_points(sim, bank)
    pressed(8)
    gone = remove_points(sim, ground, lambda x: x[1] > 6)
    assert gone.mass == pytest.approx(2 * WIDTH * DENSITY)
    pressed(6)


@pytest.mark.mpi
def test_heave_of_an_excavation():
    """What is left rises by its own unloading, in closed form with confined logarithmic strain."""
    ground, bank = ground_and_bank(SOIL)
    sim = implicit([ground, bank])
    remove_points(sim, bank)
    remove_points(sim, ground, lambda x: x[1] > 4)
    run(sim, 0.1)
    modulus = SOIL.kappa + 4 / 3 * SOIL.mu
    rise = COMM.allreduce(ground["u"][:, 1].max(initial=0), MPI.MAX)
    assert rise == pytest.approx(DENSITY * G * 4 * 3.75 / modulus, rel=5e-3)


SAND = MohrCoulomb(E=50e6, nu=0.2, cohesion=1e4, friction=30.0)


def embankment(domain, scheme):
    """Sand at rest and a bank of it, with averages of J in explicit steps."""
    ground, bank = on_box(domain, SAND)
    if scheme != "explicit":
        return implicit([ground, bank], scheme, law=SAND)
    return explicit([ground, bank], law=SAND, dt=1e-3)


@pytest.mark.mpi
@pytest.mark.parametrize("scheme", ["explicit", "QuasiStatic"])
def test_stages_on_cells_that_are_shared_out_anew(scheme):
    """Points wait on the mesh of before, and are put on the new one."""
    run, alone = (
        kind(lambda domain: embankment(domain, scheme), tall_box())
        for kind in (Rebalanced, lambda build, domain: SimpleNamespace(sim=build(domain)))
    )
    found = []
    for stages in (run, alone):
        rebalance = getattr(stages, "rebalance", lambda: None)
        waiting = remove_points(stages.sim, stages.sim.bodies[1]).points
        stages.sim.step()
        rebalance()
        sim = stages.sim
        ground, bank = sim.bodies
        assert bank.size_global == 0 and np.abs(ground["v"]).max(initial=0) < 1e-9
        came = add_points(sim, bank, points.from_mesh(ground.mesh, waiting))
        assert came.mass == pytest.approx(2 * WIDTH * DENSITY)
        for _ in range(3):
            sim.step()
        rebalance()
        sim = stages.sim
        gone = remove_points(sim, sim.bodies[1], lambda x: x[1] > 9)
        sim.step()
        rebalance()
        body = stages.sim.bodies[0]
        order = np.argsort(np.concatenate(COMM.allgather(body.id)))
        values = [np.concatenate(COMM.allgather(body[n]))[order] for n in ("F", "v", "eps_p")]
        found.append((gone.mass, *values))
    for one, other in zip(*found, strict=True):
        assert other == pytest.approx(one, rel=1e-9, abs=1e-9 * np.abs(one).max())


@pytest.mark.mpi
def test_new_points():
    """Made between steps, with what the loop has added to the body."""
    ground, bank = ground_and_bank(SOIL)
    for sim in (explicit([ground.copy(), bank.copy()]), implicit([ground, bank], "Newmark")):
        body = sim.bodies[1]
        new = points.fill(body.mesh, 2, inside=lambda x: (x[1] > 10) & (x[1] < 11))
        fm.set_initial_state(new, 1500.0)
        fm.initial_stress(new, SOIL, -1e4 * np.eye(3))
        before = new.field_names
        came = add_points(sim, body, new)
        assert came.mass == pytest.approx(WIDTH * 1500.0) and new.field_names == before
        assert set(came.points.field_names) == set(body.field_names) > set(before)
        if "sigma" in body:
            sigma = came.points["sigma"]
            assert sigma == pytest.approx(np.tile(-1e4 * np.eye(3), (len(sigma), 1, 1)), abs=1e-6)
        sim.step()


@pytest.mark.mpi
def test_within_a_block_of_explicit_steps():
    """Points in working arrays come back before they go."""
    results = []
    for interval in (None, 0.05):
        ground, bank = ground_and_bank(SOIL)
        sim = explicit([ground, bank], dt=1e-3)
        for _ in sim.run(0.05, interval):
            pass
        gone = remove_points(sim, bank, lambda x: x[1] > 9)
        for _ in sim.run(0.1, interval):
            pass
        assert sim.number == 100
        results.append([gone.kinetic_energy, gone.strain_energy, *COMM.allreduce(bank["v"].sum(0))])
    assert results[0] == pytest.approx(results[1], rel=1e-10)


@pytest.mark.mpi
def test_a_restart_after_a_stage(tmp_path):
    path = COMM.bcast(tmp_path) / "state.h5"

    def build():
        ground, bank = ground_and_bank(SOIL)
        sim = explicit([ground, bank], dt=1e-3)
        return sim, remove_points(sim, bank).points

    sim, waiting = build()
    add_points(sim, sim.bodies[1], waiting)
    remove_points(sim, sim.bodies[0], lambda x: x[1] < 1)
    run(sim, 0.01)
    io.checkpoint.save(path, sim)
    run(sim, 0.02)
    again, _ = build()
    io.checkpoint.restore(path, again)
    run(again, 0.02)
    for one, other in zip(sim.bodies, again.bodies, strict=True):
        for name, array in one.snapshot().items():
            assert np.array_equal(array, other[name]), name


@pytest.mark.mpi
def test_loads_go_with_the_ground():
    """Carried points may be removed, too: they have no mass."""
    ground, _ = ground_and_bank(SOIL)
    edge = points.on_curve(ground.mesh, (0, 8), (WIDTH, 8), spacing=0.25)
    z = supported(fm.Unknown(ground.mesh, "v"), "v")
    R = fm.internal_force(z.test.v, ground, SOIL) + fm.dead_load(z.test.v, edge, (0.0, -1e3))
    sim = ExplicitMPM(R, z, ground, carried=[edge])
    sim.step()
    gone = remove_points(sim, edge)
    assert gone.count == 8 and gone.mass == gone.kinetic_energy == 0 and gone.strain_energy is None
    sim.step()


@pytest.mark.mpi
def test_what_cannot_come_or_go():
    ground, bank = ground_and_bank(SOIL)
    sim = explicit([ground])
    for change in (lambda: add_points(sim, bank, bank), lambda: remove_points(sim, bank)):
        with pytest.raises(ValueError, match="neither a body nor carried points"):
            change()
    with pytest.raises(ValueError, match=r"call set_initial_state\(points, density\) first"):
        add_points(sim, ground, points.fill(ground.mesh, 2))
    elsewhere = points.fill(mesh.create_unit_square(COMM, 2, 2), 2)
    fm.set_initial_state(elsewhere, 1.0)
    with pytest.raises(ValueError, match="points on another mesh cannot be added"):
        add_points(sim, ground, elsewhere)
    with pytest.raises(ValueError, match="a mask of points needs shape"):
        remove_points(sim, ground, np.array([True]))
    remove_points(sim, ground)
    with pytest.raises(ValueError, match="all bodies are empty"):
        sim.step()


@pytest.mark.mpi
def test_fields_that_are_missing():
    """Those that began with one value for all are filled in; others are not."""
    domain = mesh.create_unit_square(COMM, 2, 2)
    x = [[0.5, 0.5]] if COMM.rank == 0 else np.empty((0, 2))
    body, other = MaterialPoints(domain, x, 1.0), MaterialPoints(domain, x, 1.0)
    body.add_field("A", (2, 2), np.eye(2))
    body.add_field("b", (2,), 3.0)
    copy = body.copy()
    copy.add(other)
    assert np.array_equal(copy["A"], np.tile(np.eye(2), (len(copy), 1, 1))) and np.all(
        copy["b"] == 3
    )
    body.add_field("c", (), np.arange(1.0, 1 + len(body)) if COMM.size == 1 else np.ones(len(body)))
    if COMM.size == 1:
        body.add_field("d", (), np.array([1.0]))
        with pytest.raises(ValueError, match="cannot be added to points with a field"):
            body.add(other)
