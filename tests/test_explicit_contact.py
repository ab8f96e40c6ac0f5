# SPDX-License-Identifier: MIT
"""Contact between bodies of explicit steps: they touch, push, rub and part."""

import logging

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem, mesh
from explicit_runs import use

from fenicsmpm import ExplicitMPM, RigidBody, basis, formulations, io, points, shapes
from fenicsmpm.diagnostics import kinetic_energy, momentum, strain_energy
from fenicsmpm.materials import Hencky
from fenicsmpm.simulation import Contact
from fenicsmpm.simulation.contact import share_velocities
from fenicsmpm.transfer import p2g
from fenicsmpm.transfer.multi_field import Interfaces

pytestmark = pytest.mark.once

COMM = MPI.COMM_WORLD
SOFT = Hencky(E=1000.0, nu=0.3)
QUADRILATERAL = mesh.CellType.quadrilateral


def square(n, kind=QUADRILATERAL, comm=COMM, corners=((0, 0), (1, 1))):
    options = {} if kind == mesh.CellType.triangle else {"partitioner": PARTITIONER}
    return mesh.create_rectangle(comm, corners, [n, n], kind, **options)


PARTITIONER = basis.shared_vertex_partitioner


def simulate(bodies, law=SOFT, functions="linear", gravity=None, z=None, **options):
    """A simulation of bodies of one law."""
    domain = bodies[0].mesh
    z = z or formulations.Unknown(domain, "v")
    terms = []
    for body in bodies:
        use(body, functions)
        terms.append(formulations.internal_force(z.test.v, body, law))
        if gravity is not None:
            terms.append(formulations.body_force(z.test.v, body, gravity))
    return ExplicitMPM(sum(terms[1:], terms[0]), z, bodies, **options)


def two_discs(
    functions="linear", per_side=4, comm=COMM, kind=QUADRILATERAL, friction=0.0, **options
):
    """Two discs on their way to each other along the diagonal, and their contact."""
    domain, discs = square(20, kind, comm), []
    for centre, speed in ((0.25, 0.1), (0.75, -0.1)):
        disc = points.lattice(
            domain,
            0.05 / per_side,
            inside=lambda x, c=centre: np.hypot(x[0] - c, x[1] - c) < 0.2,
        )
        formulations.set_initial_state(disc, 1000.0, (speed, speed))
        discs.append(disc)
    contact = Contact(*discs, friction=friction)
    return simulate(discs, functions=functions, contacts=[contact], **options), contact


def centre(body):
    return body.mesh.comm.allreduce(body["mass"] @ body.x) / mass_of(body)


def mass_of(body):
    return body.mesh.comm.allreduce(float(body["mass"].sum()))


@pytest.mark.parametrize("functions", ["linear", "gimp", "quadratic"])
def test_discs_meet_and_part(functions):
    """First force where surfaces meet, no tension, momentum kept, energy kept to 5 percent."""
    sim, contact = two_discs(functions)
    discs, h, radius = sim.bodies, 0.05, 0.2
    along = np.ones(2) / np.sqrt(2)
    energy = sum(map(kinetic_energy, discs))
    scale = mass_of(discs[0]) * 0.1 * np.sqrt(2)
    first = None
    for _ in sim.run(2.8):
        if first is None and contact.force.any():
            # positions at the beginning of the step are those that the contact has seen
            gap = np.linalg.norm(centre(discs[1]) - centre(discs[0])) - 2 * radius
            first = gap / h
        assert contact.force @ along >= 0.0  # on the second disc, which is ahead: no tension
        assert np.abs(sum(map(momentum, discs))).max() < 1e-12 * scale
    assert abs(first) < 0.25
    assert not contact.force.any() and contact.gap > 0
    assert momentum(discs[0]) @ along < -0.8 * scale
    after = sum(kinetic_energy(d) + strain_energy(d, SOFT) for d in discs)
    assert 0.95 < after / energy < 1.01


@pytest.mark.ranks
@pytest.mark.mpi
def test_ranks_do_not_matter():
    """The same on all ranks together as on one, to round-off; triangles, friction, off centre."""
    found = []
    for comm in (COMM, MPI.COMM_SELF):
        sim, contact = two_discs(comm=comm, kind=mesh.CellType.triangle, friction=0.4, dt=0.01)
        sim.bodies[0]["v"] = sim.bodies[0]["v"] + np.array([0.1, 0.0])
        for body, s in zip(sim.bodies, (1.0, -1.0), strict=True):
            body.move(body.x + s * 0.112)
        for _ in range(2):
            sim.step()
        forces = np.abs(sim.contact_forces(contact).x.array).max()
        found.append([contact.force, [contact.gap, comm.allreduce(forces, MPI.MAX)]])
        found[-1] += [momentum(b) for b in sim.bodies]
    assert np.linalg.norm(found[0][0]) > 0.1
    for a, b in zip(*found, strict=True):
        assert a == pytest.approx(b, rel=1e-9, abs=1e-9)


def test_blocks_part_without_tension():
    """Pressed together and pulled apart at 0.1 m/s: forces push, then there are none."""
    domain = square(10)
    lower = points.lattice(domain, 0.05, inside=lambda x: x[1] < 0.5)
    upper = points.lattice(domain, 0.05, inside=lambda x: abs(x[1] - 0.7) < 0.2)
    z = formulations.Unknown(domain, "v")
    z.fix("v", lambda x: np.isclose(x[1], 0))
    z.fix("v", lambda x: np.isclose(x[0] * (1 - x[0]), 0), component=0)
    speed = [-0.1]
    z.fix("v", lambda x: x[1] > 0.85, lambda t: (0.0, speed[0]))
    for body in (lower, upper):
        formulations.set_initial_state(body, 1000.0)
    contact = Contact(lower, upper)
    sim = simulate([lower, upper], Hencky(E=1e5, nu=0.3), z=z, contacts=[contact])
    pushed = []
    for _ in sim.run(0.2):
        pushed.append(contact.force[1])
    # 2 cm are 2.4 percent of what is free, on which the waves of the start swing
    assert 0.5 < pushed[-1] / (1e5 * 0.7 / (1.3 * 0.4) * 0.02 / 0.85) < 1.5
    speed[0] = 0.1
    for _ in sim.run(0.7):
        pushed.append(contact.force[1])
    assert min(pushed) >= 0.0 and not any(pushed[-10:])
    gap = COMM.allreduce(upper.x[:, 1].min(initial=1), MPI.MIN)
    gap -= COMM.allreduce(lower.x[:, 1].max(initial=0), MPI.MAX)
    assert 0.07 < gap < 0.11  # from the middles of points 0.05 apart, pulled by 3 cm


def sliding_block(mu, functions="linear", per_side=2, off=0.0):
    """A block at rest on a slab of the same material under gravity; both are deformable."""
    domain = mesh.create_rectangle(
        COMM, [(0, 0), (1.2, 0.5)], [24, 10], QUADRILATERAL, partitioner=PARTITIONER
    )
    slab = points.lattice(domain, 0.05 / per_side, inside=lambda x: x[1] < 0.2 + off)
    block = points.lattice(
        domain,
        0.05 / per_side,
        inside=lambda x: (abs(x[1] - 0.3 - off) < 0.1) & (abs(x[0] - 0.4) < 0.2),
    )
    z = formulations.Unknown(domain, "v")
    z.fix("v", lambda x: np.isclose(x[1], 0))
    z.fix("v", lambda x: np.isclose(x[0], 0) | np.isclose(x[0], 1.2), component=0)
    for body in (slab, block):
        formulations.set_initial_state(body, 1000.0)
    contact, gravity = Contact(slab, block, friction=mu), fem.Constant(domain, (0.0, -10.0))
    law, options = Hencky(E=1e6, nu=0.3), {"contacts": [contact], "damping": 0.3}
    sim = simulate([slab, block], law, functions, gravity, z, **options)
    for _ in sim.run(0.15):
        pass
    assert contact.force[1] == pytest.approx(10.0 * mass_of(block), rel=0.02)  # its weight
    sim.damping = 0.0
    return sim, contact, gravity


@pytest.mark.parametrize(
    ("functions", "per_side", "off"), [("linear", 2, 0.0), ("gimp", 4, 0.0125)]
)
def test_block_slides_by_coulombs_law(functions, per_side, off):
    """Deceleration mu g within 2 percent, and so is the ratio of forces."""
    mu = 0.3
    sim, contact, _ = sliding_block(mu, functions, per_side, off)
    block = sim.bodies[1]
    block["v"] = block["v"] + np.array([1.0, 0.0])
    times, speeds, forces = [], [], []
    for step in sim.run(sim.time + 0.16):
        times.append(step.time)
        speeds.append(momentum(block)[0] / mass_of(block))
        forces.append(contact.force)
    assert np.polyfit(times, speeds, 1)[0] == pytest.approx(-mu * 10.0, rel=0.02)
    along, normal = np.sum(forces, axis=0)
    assert -along / normal == pytest.approx(mu, rel=0.01)


def test_block_sticks_below_the_limit():
    """Pulled by less than friction can hold it sways on the slab, and does not creep."""
    sim, contact, gravity = sliding_block(0.3)
    block, start = sim.bodies[1], centre(sim.bodies[1])[0]
    gravity.value[0] = 1.2  # doubled at most, since it comes at once
    ways = []
    for _ in sim.run(sim.time + 0.25):
        ways.append(centre(block)[0] - start)
        assert np.hypot(*contact.force) > 0
    # shear of block and slab, not a way of 1.2 / 2 * 0.25^2 = 38 mm
    assert max(np.abs(ways)) < 1e-3
    assert abs(ways[-1]) < 1.2 * max(np.abs(ways[: len(ways) // 2]))


@pytest.mark.mpi
def test_gap_and_normal_are_those_of_the_points():
    """Two layers of points with a gap, seen by the same nodes, and turned with the mesh."""
    for cell in (QUADRILATERAL, mesh.CellType.triangle):
        domain = square(16, cell)
        normal = np.array([-0.6, 0.8])
        tangent, spacing, gap = np.array([0.8, 0.6]), 0.025, 0.03
        bodies = []
        for side in (-1, 1):
            s, t = np.meshgrid(
                np.arange(0.5, 6.0) * spacing + gap / 2, np.arange(-12, 13) * spacing
            )
            x = 0.5 + side * s.ravel()[:, None] * normal + t.ravel()[:, None] * tangent
            mine = x if COMM.rank == 0 else x[:0]
            body = points.MaterialPoints(domain, mine, weight=spacing**2)
            formulations.set_initial_state(body, 1.0)
            bodies.append(body)
        V = fem.functionspace(domain, ("Lagrange", 1))
        masses = [p2g(body, body["mass"], V, positive=True).array for body in bodies]
        meeting = Interfaces(V).between(([bodies[0]], [bodies[1]]), tuple(masses))
        near = meeting.meets & (
            np.linalg.norm(V.tabulate_dof_coordinates()[:, :2] - 0.5, axis=1) < 0.25
        )
        assert COMM.allreduce(int(near.sum())) > 2
        assert meeting.gap[near] == pytest.approx(gap, abs=0.1 * spacing)
        assert meeting.normal[near] @ normal == pytest.approx(1.0, abs=0.02)
        assert (meeting.gap[meeting.meets] > 0).all()


def test_cubes_in_space():
    """Momentum in space, and a fall onto another body that is at rest."""
    kind = mesh.CellType.hexahedron
    domain = mesh.create_box(COMM, [(0, 0, 0), (1, 1, 1)], [6, 6, 6], kind, partitioner=PARTITIONER)
    cubes = [
        points.lattice(
            domain, 1 / 12, inside=lambda x, z=z: np.abs(x - [[0.5], [0.5], [z]]).max(axis=0) < 0.17
        )
        for z in (0.25, 0.67)
    ]
    for cube, speed in zip(cubes, (0.0, -0.3), strict=True):
        formulations.set_initial_state(cube, 1000.0, (0.0, 0.0, speed))
    contact = Contact(*cubes)
    sim = simulate(cubes, functions="gimp", contacts=[contact])
    total, largest = sum(map(momentum, cubes)), 0.0
    for _ in sim.run(0.6):
        largest = max(largest, contact.force[2])
        assert contact.force[2] >= 0
    assert largest > 0
    assert sum(map(momentum, cubes)) == pytest.approx(total, abs=1e-12 * abs(total[2]))
    assert momentum(cubes[0])[2] < 0.4 * total[2]


@pytest.mark.mpi
def test_without_contact_bodies_stick_and_frictions_are_kept():
    """Groups of bodies that share velocities, and what restarts and other features need."""
    sim, contact = two_discs()
    third = points.lattice(
        sim.bodies[0].mesh, 0.025, inside=lambda x: np.hypot(x[0] - 0.2, x[1] - 0.8) < 0.1
    )
    formulations.set_initial_state(third, 1000.0)
    a, b = sim.bodies
    pairs = [Contact(a, b), Contact(third, b)]
    assert share_velocities([a, b, third], pairs) == [[a, third], [b]]
    assert share_velocities([a, b, third], [*pairs, Contact(a, third)]) == [[a], [b], [third]]
    assert share_velocities([a, b, third], []) == [[a, b, third]]
    assert "friction=0" in repr(contact) and repr(contact) in repr(sim)
    assert sim.parameters["friction of contact 0"] == "0.0"


@pytest.mark.mpi
def test_three_bodies_at_a_node():
    """Three blocks around an edge push each other pairwise, and momentum is kept."""
    domain = square(8)
    places = [
        lambda x: (x[0] < 0.5) & (x[1] < 0.5),
        lambda x: (x[0] > 0.5) & (x[1] < 0.5),
        lambda x: x[1] > 0.5,
    ]
    blocks = [
        points.lattice(
            domain, 1 / 16, inside=lambda x, i=i: i(x) & (abs(x[:2] - 0.5).max(axis=0) < 0.3)
        )
        for i in places
    ]
    for block, v in zip(blocks, ((0.1, 0.1), (-0.1, 0.1), (0.0, -0.1)), strict=True):
        formulations.set_initial_state(block, 1000.0, v)
    contacts = [Contact(blocks[i], blocks[j], friction=0.5) for i, j in ((0, 1), (0, 2), (1, 2))]
    sim = simulate(blocks, contacts=contacts)
    total = sum(map(momentum, blocks))
    for _ in sim.run(0.3):
        pass
    assert sum(map(momentum, blocks)) == pytest.approx(total, abs=1e-12 * mass_of(blocks[0]))
    assert all(np.linalg.norm(c.force) > 0 for c in contacts)
    gaps = [c.gap for c in contacts]
    assert min(gaps) > -0.25 / 8


@pytest.mark.mpi
def test_boxes_loads_exits_and_averages(tmp_path, caplog):
    """What else there is in explicit steps works beside contacts, and a restart is the same."""
    path = COMM.bcast(tmp_path) / "contact.h5"

    def made():
        sim, _ = two_discs(friction=0.2)
        discs, domain = sim.bodies, sim.bodies[0].mesh
        for disc, s in zip(discs, (1, -1), strict=True):
            disc.move(disc.x + s * 0.112)
        load = points.MaterialPoints(domain, discs[0].x[:3].copy(), weight=1.0)
        z = formulations.Unknown(domain, "v")
        w = z.test.v
        R = sum(
            (formulations.internal_force(w, d, SOFT, fbar=formulations.FBar()) for d in discs[1:]),
            formulations.internal_force(w, discs[0], SOFT, fbar=formulations.FBar()),
        ) + formulations.dead_load(w, load, (0.1, 0.0))
        box = RigidBody(shapes.Box((-1, -1), (2, 0.15)), reach=0.02)
        options = {"carried": [load], "rigid": [box], "on_exit": "delete", "dt": 0.01}
        return ExplicitMPM(R, z, discs, contacts=[Contact(*discs, 0.2)], **options)

    sim = made()
    for _ in range(10):
        sim.step()
        if sim.number == 5:
            io.checkpoint.save(path, sim)
    assert np.linalg.norm(sim.contacts[0].force) > 0
    again = made()
    with caplog.at_level(logging.WARNING):
        io.checkpoint.restore(path, again)
    assert "friction" not in caplog.text
    for _ in range(5):
        again.step()
    assert again.contacts[0].force == pytest.approx(sim.contacts[0].force, rel=1e-12)
    for a, b in zip(again.bodies, sim.bodies, strict=True):
        assert np.array_equal(np.sort(a.id), np.sort(b.id))
        assert momentum(a) == pytest.approx(momentum(b), rel=1e-12)


def test_wrong_contacts():
    """Each error says what is wrong with a contact."""
    sim, _ = two_discs()
    a, b = sim.bodies
    other = points.lattice(a.mesh, 0.05)
    formulations.set_initial_state(other, 1.0)
    for friction in (-0.1, float("nan")):
        with pytest.raises(ValueError, match=f"friction.*{friction}"):
            Contact(a, b, friction)
    with pytest.raises(ValueError, match=r"must be one number .* friction = '0.3'"):
        Contact(a, b, "0.3")
    for stiffness in (0.0, float("inf"), float("nan")):
        with pytest.raises(ValueError, match=f"stiffness.*{stiffness}"):
            Contact(a, b, stiffness=stiffness)
    with pytest.raises(ValueError, match="itself"):
        Contact(a, a)
    with pytest.raises(ValueError, match="bodies 0 and 1 have two contacts"):
        simulate([a, b], contacts=[Contact(a, b), Contact(b, a, 0.1)])
    with pytest.raises(ValueError, match="needs bodies of this simulation"):
        simulate([a, b], contacts=[Contact(a, other)])
    with pytest.raises(ValueError, match="carried points have no mass"):
        simulate([a, b], contacts=[Contact(a, other)], carried=[other])
    with pytest.raises(ValueError, match=r"share velocities with the bodies \[2\]"):
        simulate([a, b, other], contacts=[Contact(a, b)])
    with pytest.raises(ValueError, match=r"frictions 0\.0 and 0\.3"):
        simulate([a, b, other], contacts=[Contact(a, b), Contact(other, b, 0.3)])
    left = points.lattice(a.mesh, 0.025, inside=lambda x: x[0] < 0.5)
    right = points.lattice(a.mesh, 0.025, inside=lambda x: x[0] > 0.3)
    for body in (left, right):
        formulations.set_initial_state(body, 1.0)
    with pytest.raises(ValueError, match=r"overlap by a cell or more: .* 1\.00 and 1\.00 by them"):
        simulate([left, right], contacts=[Contact(left, right)])
    with pytest.raises(ValueError, match="does not have the contact"):
        sim.contact_forces(Contact(a, b))
