# SPDX-License-Identifier: MIT
"""Rigid bodies and material points in explicit steps."""

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem, mesh

from fenicsmpm import ExplicitMPM, RigidBody, basis, formulations, io, points, shapes
from fenicsmpm.diagnostics import angular_momentum, kinetic_energy, momentum
from fenicsmpm.materials import Hencky, NeoHookean
from fenicsmpm.rigid import inertia_of

pytestmark = pytest.mark.once

COMM, H = MPI.COMM_WORLD, 0.1
SOLID = Hencky(1e4, 0.3)
WAYS = ["kernels", "forms", "triangles"]


def start(inside, rigid, *, way="kernels", upper=(2.0, 1.5), gravity=None, fixed=(), v=(0, 0),
          law=SOLID, comm=COMM, **options):  # fmt: skip
    """A simulation of points that are inside, of density 1000."""
    cells = [round(x / H) for x in upper]
    kind = mesh.CellType.triangle if way == "triangles" else mesh.CellType.quadrilateral
    domain = mesh.create_rectangle(
        comm, [(0, 0), upper], cells, kind, partitioner=basis.shared_vertex_partitioner
    )
    body = points.lattice(domain, H / 2, inside=inside)
    if way != "triangles":
        basis.use(body, "quadratic")
    formulations.set_initial_state(body, 1000.0)
    body["v"] = np.tile(np.array(v, dtype=float), (len(body), 1))
    z = formulations.Unknown(domain, "v")
    for where in fixed:
        z.fix("v", where)
    R = formulations.internal_force(z.test.v, body, law)
    if way == "forms":
        R = fem.Constant(domain, 1.0) * R
    if gravity is not None:
        R += formulations.body_force(z.test.v, body, gravity)
    return ExplicitMPM(R, z, body, rigid=rigid, **options), body


def disc_at(x, y, radius):
    return shapes.SignedDistance(
        lambda p: np.hypot(p[0] - x, p[1] - y) - radius,
        (x - radius, y - radius), (x + radius, y + radius),
    )  # fmt: skip


def square(x):
    return (np.abs(x[0] - 1.0) < 0.3) & (np.abs(x[1] - 0.7) < 0.2)


@pytest.mark.parametrize("way", WAYS)
def test_a_free_disc_hits_a_block(way):
    """Momentum of both is kept to round-off, and angular momentum and energy nearly so."""
    disc = disc_at(0.45, 0.8, 0.2)
    free = RigidBody(
        disc, H / 4, velocity=(2.0, 0.0), angular_velocity=3.0,
        inertia=inertia_of(disc, 2000.0), friction=0.5,
    )  # fmt: skip
    sim, body = start(square, [free], way=way)
    total, moment = momentum(body) + free.momentum, angular_momentum(body) + free.angular_momentum
    energy, way_of_force = free.kinetic_energy, 0.0
    for _ in sim.run(0.25):
        way_of_force += sim.dt * free.force
    assert way_of_force[0] > 0.2 * total[0]  # they have met
    assert momentum(body) == pytest.approx(way_of_force, rel=1e-11, abs=1e-11)
    assert momentum(body) + free.momentum == pytest.approx(total, rel=1e-12, abs=1e-12 * total[0])
    now = angular_momentum(body) + free.angular_momentum
    assert now == pytest.approx(moment, rel=0.02)
    kept = (kinetic_energy(body) + free.kinetic_energy) / energy
    assert 0.5 < kept < 1.0
    assert free.distance(body.x)[0].min() > 0
    assert free.velocity[0] < body["v"][:, 0].mean()


def test_kernels_do_what_forms_do():
    found = []
    for way in ("kernels", "forms"):
        shape = shapes.polygon([(0.8, 1.0), (1.3, 0.95), (1.1, 1.3)])
        free = RigidBody(
            shape, H / 4, velocity=(0.3, -1.5), angular_velocity=1.0, friction=0.4,
            inertia=inertia_of(shape, 1500.0), gravity=(0.0, -9.81),
        )  # fmt: skip
        floor = RigidBody(shapes.Box((-1, -1), (3, 0.49)), H / 4, friction=0.8)
        sim, body = start(square, [floor, free], way=way, gravity=(0.0, -9.81), dt=2e-3)
        for _ in sim.run(0.2, 0.05):
            pass
        order = np.argsort(body.id)
        slip = body["slip on rigid body 0"][order]
        found.append((body["u"][order], slip, free.position, free.rotation, floor.force))
        assert np.abs(slip).max() > 0
    for one, other in zip(*found, strict=True):
        assert one == pytest.approx(other, rel=1e-7, abs=1e-9 * max(1, np.abs(other).max()))


def test_a_free_block_rests_on_a_body():
    """It falls on an elastic one, and the force is its weight."""
    shape = shapes.Box((0.85, 0.62), (1.15, 0.82))
    free = RigidBody(
        shape, H / 4, inertia=inertia_of(shape, 3000.0), gravity=(0, -9.81), friction=0.5
    )
    sim, body = start(
        lambda x: (np.abs(x[0] - 1) < 0.5) & (x[1] < 0.6), [free], damping=0.1,
        law=Hencky(1e6, 0.3), gravity=(0.0, -9.81),
        fixed=[lambda x: np.isclose(x[1], 0)],
    )  # fmt: skip
    sim.damping, forces = 0.3, []
    for step in sim.run(2.5):
        if step.time > 1.5:
            forces.append(free.force)
    weight = 3000.0 * 0.06 * 9.81
    mean = np.mean(forces, axis=0)
    assert mean == pytest.approx([0.0, -weight], abs=0.005 * weight)
    assert np.abs(free.velocity).max() < 0.02 and abs(free.angular_velocity) < 0.02
    assert sim.reaction[1] == pytest.approx(weight + body["mass"].sum() * 9.81, rel=0.02)


def test_a_disc_is_pressed_into_a_block_and_drawn_out():
    """The block gives back the work, and most of it is there as force times way in between."""
    c = np.sqrt(SOLID.wave_speed_modulus / 1000.0)
    speed, turn = 0.005 * c, 16.0 / c
    disc = RigidBody(
        disc_at(1.0, 0.88, 0.25), H / 4, velocity=lambda t: (0.0, -speed if t < turn else speed)
    )
    sim, body = start(
        lambda x: (np.abs(x[0] - 1) < 0.5) & (x[1] < 0.6), [disc],
        fixed=[lambda x: np.isclose(x[1], 0)],
    )  # fmt: skip
    work, largest = 0.0, 0.0
    for _ in sim.run(2.5 * turn):
        work += sim.dt * disc.force @ disc.velocity
        largest = max(largest, work)
    assert disc.force == pytest.approx([0, 0], abs=1e-9)  # it is away
    assert largest > 0
    assert work == pytest.approx(kinetic_energy(body), abs=0.05 * largest)


@pytest.mark.parametrize("way", ["kernels", "triangles"])
def test_a_paddle_turns_points(way):
    """Its torque is the rate of their angular momentum."""
    centre = np.array([1.0, 0.7])
    arm = np.array([(-0.5, -0.04), (0.5, -0.04), (0.5, 0.04), (-0.5, 0.04)])
    paddle = RigidBody(
        shapes.polygon(centre + arm), H / 4, centre=centre, angular_velocity=2.0, friction=0.3
    )

    def inside(x):
        return (np.abs(x[0] - 1.35) < 0.15) & (np.abs(x[1] - 0.95) < 0.15)

    sim, body = start(inside, [paddle], way=way, upper=(2.0, 2.0))
    moment = impulse = 0.0
    for _ in sim.run(0.4):
        impulse += sim.dt * paddle.torque
        moment += sim.dt * (centre[0] * paddle.force[1] - centre[1] * paddle.force[0])
    assert impulse > 10.0
    assert angular_momentum(body) == pytest.approx(impulse + moment, rel=0.03)
    assert paddle.distance(body.x)[0].min() > 0


@pytest.mark.parametrize("friction", [0.8, np.inf])
def test_a_block_sticks_on_an_incline(friction):
    """Gravity is turned by 30 degrees; then the block rests below 1e-7 m/s on any step length.

    Steps get shorter at the end, to meet the times of output. This must not push the block.
    """
    h, g = 1 / 16, 9.81
    domain = mesh.create_rectangle(
        MPI.COMM_SELF, [(0, 0), (2, 1)], [32, 16], mesh.CellType.quadrilateral
    )
    for cfl in (0.4, 0.2):
        body = points.lattice(domain, h / 2, inside=shapes.Box((0.5, 0.5), (1.0, 0.75)))
        basis.use(body, "quadratic")
        formulations.set_initial_state(body, 1000.0)
        z, b = formulations.Unknown(domain, "v"), fem.Constant(domain, (0.0, 0.0))
        R = formulations.internal_force(z.test.v, body, NeoHookean(1e6, 0.3))
        R += formulations.body_force(z.test.v, body, b)
        floor = RigidBody(shapes.Box((-10, -10), (10, 0.5)), h / 4, friction=friction)
        sim = ExplicitMPM(R, z, body, rigid=[floor], damping=0.5, cfl=cfl)

        def data(t, end, b=b):
            angle = np.clip((t - 0.1) / 0.3, 0, 1) * np.pi / 6
            b.value[:] = g * np.sin(angle), -g * np.cos(angle)

        sim.data = data
        for _ in sim.run(0.9, 0.9):
            pass
        sim.damping, places, times, forces, longest = 0.0, [], [], [], sim.dt
        lowest = np.sort(body.id[body.x[:, 1] < body.x[:, 1].min() + 0.1 * h])
        for step in sim.run(1.4, 0.05):
            places.append(body["u"][np.isin(body.id, lowest), 0].mean())
            times.append(step.time)
            forces.append(floor.force / (body["mass"].sum() * g))
        assert sim.dt < 0.999 * longest
        assert abs(np.polyfit(times, places, 1)[0]) < 1e-7
        assert np.array(forces) == pytest.approx(np.tile([-0.5, np.sqrt(0.75)], (10, 1)), rel=1e-3)


@pytest.mark.parametrize("share", [0.1, 0.01, 1e-9])
def test_points_that_begin_close_to_a_body(share):
    """The force is finite, and what it does is small."""
    lowest = start(square, [])[1].x[:, 1].min()
    floor = RigidBody(shapes.Box((-1, -1), (3, lowest - share * H / 4)), H / 4)
    sim, body = start(square, [floor])
    for _ in sim.run(0.1):
        assert 0.8 < body["J"].min() and body["J"].max() < 1.25
    assert body.x[:, 1].min() > lowest


@pytest.mark.ranks
@pytest.mark.mpi
def test_the_same_on_any_number_of_ranks(tmp_path):
    """A free polygon on a block on a plane, with friction; and a restart of it."""

    def run(comm, again=None):
        shape = shapes.polygon([(0.8, 1.0), (1.3, 0.95), (1.1, 1.3)])
        free = RigidBody(
            shape, H / 4, velocity=(0.3, -1.5), angular_velocity=1.0, friction=0.4,
            inertia=inertia_of(shape, 1500.0), gravity=(0.0, -9.81),
        )  # fmt: skip
        floor = RigidBody(shapes.Box((-1, -1), (3, 0.49)), H / 4, friction=0.8)
        sim, body = start(square, [floor, free], gravity=(0.0, -9.81), comm=comm)
        if again is not None:
            io.checkpoint.restore(again, sim)
        for k, _ in enumerate(sim.run(0.2, 0.05)):
            if k == 1 and again is None and comm.size == COMM.size:
                io.checkpoint.save(path, sim)
        start_of = np.concatenate(comm.allgather(body.x - body["u"]))
        order = np.lexsort(np.round(start_of, 8).T)
        u = np.concatenate(comm.allgather(body["u"]))[order]
        return u, free.position, free.rotation, free.angular_momentum, floor.force

    path = COMM.bcast(tmp_path) / "rigid.h5"
    alone, together = run(MPI.COMM_SELF), run(COMM)
    restarted = run(COMM, path)
    for one, other, same in zip(alone, together, restarted, strict=True):
        assert one == pytest.approx(other, rel=1e-8, abs=1e-9 * np.abs(one).max())
        assert np.array_equal(other, same)


def test_a_surface_in_space():
    """A cube of triangles does what a box does; momentum is kept."""
    corners = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]) * 0.3
    sides = [
        (0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1), (2, 3, 7), (2, 7, 6),
        (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3),
    ]  # fmt: skip
    at = np.array((0.35, 0.35, 0.65))
    found = []
    for shape in (shapes.surface(at + corners, sides), shapes.Box(at, at + 0.3)):
        free = RigidBody(
            shape, H / 4, velocity=(0.5, 0.0, -2.0), inertia=inertia_of(shape, 2000.0), friction=0.5
        )
        domain = mesh.create_box(
            MPI.COMM_SELF, [(0, 0, 0), (1, 1, 1)], [10] * 3, mesh.CellType.hexahedron
        )
        body = points.lattice(domain, H / 2, inside=shapes.Box((0.25,) * 3, (0.75, 0.75, 0.6)))
        basis.use(body, "quadratic")
        formulations.set_initial_state(body, 1000.0)
        z = formulations.Unknown(domain, "v")
        sim = ExplicitMPM(formulations.internal_force(z.test.v, body, SOLID), z, body, rigid=[free])
        total = free.momentum
        for _ in sim.run(0.1, 0.05):
            pass
        assert momentum(body)[2] < -1
        assert momentum(body) + free.momentum == pytest.approx(total, rel=1e-11, abs=1e-11 * 108)
        found.append((free.velocity, free.angular_velocity))
    for one, other in zip(*found, strict=True):
        assert one == pytest.approx(other, abs=0.05)


def test_wrong_use():
    for rigid, message in (
        ([RigidBody(shapes.Box((0, 0, 0), (1, 1, 1)), 0.1)], "3 dimensions, but the mesh has 2"),
        ([RigidBody(shapes.Box((0, 0), (1, 0.1)), 0.1)] * 2, "given twice"),
    ):
        with pytest.raises(ValueError, match=message):
            start(square, rigid)
    for way in WAYS:
        for name in (None, "ram"):
            ram = RigidBody(disc_at(1.0, 0.7, 0.1), H / 4, name=name)
            sim, _ = start(square, [ram], way=way)
            with pytest.raises(Exception, match=f"inside of the rigid body {name or 'Signed'}"):
                sim.step()
    late = RigidBody(
        disc_at(0.2, 0.2, 0.1), H / 4, velocity=lambda t: (0 if t < 0.1 else np.nan, 0)
    )
    sim, _ = start(square, [late])
    with pytest.raises(ValueError, match=r"velocity .* must be finite.* at t = 0\.1"):
        for _ in sim.run(1.0):
            pass
