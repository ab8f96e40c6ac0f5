# SPDX-License-Identifier: MIT
"""Rigid bodies that boundary points touch in implicit steps."""

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh

from fenicsmpm import ImplicitMPM, RigidBody, basis, io, points, shapes
from fenicsmpm import formulations as fm
from fenicsmpm.cells import ActiveCells, Tying
from fenicsmpm.materials import NeoHookean
from fenicsmpm.rigid import inertia_of
from fenicsmpm.simulation import Resultant

COMM, H, RADIUS, SPEED = MPI.COMM_WORLD, 0.1, 0.4, -0.04
TOP, LAW = 0.62, NeoHookean(1000.0, 0.3)


def pressed(distance, *, friction=None, move=None):
    """Load steps of a block under something that touches its upper edge."""
    domain = mesh.create_rectangle(
        COMM, [(0, 0), (1, 1)], [10, 10], mesh.CellType.quadrilateral,
        partitioner=basis.shared_vertex_partitioner,
    )  # fmt: skip
    body = points.lattice(domain, H / 4, inside=shapes.Box((0.1, -1), (0.9, TOP)))
    fm.set_initial_state(body, 1.0)
    edge = points.on_curve(domain, (0.1, TOP), (0.9, TOP), spacing=H / 6)
    for p in (body, edge):
        basis.use(p, "quadratic")
    z = fm.Unknown(domain, "u")
    z.fix("u", lambda x: np.isclose(x[1], 0))
    cells, scheme = ActiveCells(body, loads=[edge]), fm.QuasiStatic(z, dt=0.25)
    energy = lambda F: LAW.energy(F, ufl.det(F)) + LAW.kappa / 2 * (ufl.det(F) - 1) ** 2  # noqa: E731
    P = fm.Response(energy, body, fm.Kinematics(z.u, body).F).P
    contact = fm.wall(z, edge, LAW, distance, friction=friction, factor=10.0)
    force = Resultant(z, contact)
    sim = ImplicitMPM(
        fm.stress_power(P, z.test.u, body) + contact, z, scheme, body, carried=[edge],
        data=move, observers=[force], newton={"tying": Tying(z.space, body, cells)},
    )  # fmt: skip
    return sim, body, force, domain


def disc(**options):
    centre = (0.5, TOP + RADIUS)
    shape = shapes.SignedDistance(
        lambda x: np.hypot(x[0] - centre[0], x[1] - centre[1]) - RADIUS,
        (centre[0] - RADIUS, centre[1] - RADIUS), (centre[0] + RADIUS, centre[1] + RADIUS),
    )  # fmt: skip
    return RigidBody(shape, H / 4, velocity=(0.0, SPEED), **options)


@pytest.mark.mpi
def test_a_sampled_disc_is_one_of_ufl(tmp_path):
    """The same as with the formula of the distance; a restart goes on."""
    height = []

    def distance(x):
        domain = ufl.domain.extract_unique_domain(x)
        if not height:
            height.append(fem.Constant(domain, TOP + RADIUS))
        return ufl.sqrt((x[0] - 0.5) ** 2 + (x[1] - height[0]) ** 2) - RADIUS

    def move(start, end):
        height[0].value = TOP + RADIUS + SPEED * end

    found = []
    for way in ("formula", "sampled"):
        if way == "formula":
            sim, body, force, _ = pressed(distance, move=move)
        else:
            sim, body, force, _ = pressed(rigid := disc())
            assert sim.rigid == [rigid]
        path = COMM.bcast(tmp_path) / "pressed.h5"
        for k, _ in enumerate(sim.run(1.0)):
            if k == 1 and way == "sampled":
                io.checkpoint.save(path, sim)
        found.append((force.value, force.torque, np.sort(body.id), body["u"][np.argsort(body.id)]))
    assert rigid.moved == pytest.approx([0.0, SPEED])
    (one, moment, _, u), (other, other_moment, _, v) = found
    assert one[1] < -10
    assert other == pytest.approx(one, rel=2e-3, abs=1e-3 * abs(one[1]))
    assert other_moment == pytest.approx(0.5 * one[1], rel=5e-3)
    assert moment == pytest.approx(other_moment, rel=5e-3)
    assert np.abs(u - v).max(initial=0) < 2e-3 * abs(SPEED)
    again, _, force, _ = pressed(disc())
    io.checkpoint.restore(path, again)
    assert again.rigid[0].moved == pytest.approx([0.0, SPEED / 2])
    for _ in again.run(1.0):
        pass
    assert force.value == pytest.approx(other, rel=1e-6, abs=1e-6 * abs(other[1]))


def test_a_rigid_plate_drags_points():
    """What sticks goes with a plate that moves sideways; what slides bears its limit."""
    for friction, drag in ((50.0, None), (0.1, 0.1)):
        plate = RigidBody(
            shapes.Box((-5, TOP), (5, 5)), H / 4, friction=friction,
            velocity=lambda t: (0.0, -0.02) if t < 0.5 else (0.02, 0.0),
        )  # fmt: skip
        sim, body, force, _ = pressed(plate)
        for _ in sim.run(1.0):
            pass
        top = body.x[:, 1] > body.x[:, 1].max() - H / 8
        if drag is None:
            assert body["u"][top, 0].mean() == pytest.approx(0.01, rel=0.15)
        else:
            assert force.value[0] == pytest.approx(-drag * force.value[1], rel=1e-3)


def test_wrong_rigid_walls():
    shape = shapes.Box((0, TOP), (1, 1))
    free = RigidBody(shape, 0.1, inertia=inertia_of(shape, 1.0))
    with pytest.raises(ValueError, match="is free: implicit steps"):
        pressed(free)
    with pytest.raises(ValueError, match="3 dimensions, but the mesh has 2"):
        pressed(RigidBody(shapes.Box((0, 0, 0), (1, 1, 1)), 0.1))
    with pytest.raises(ValueError, match="finite and not negative: inf"):
        pressed(RigidBody(shape, 0.1, friction=np.inf))
    domain = mesh.create_unit_square(MPI.COMM_SELF, 4, 4)
    z = fm.Unknown(domain, "v")
    edge = points.on_curve(domain, (0.1, 0.5), (0.9, 0.5), spacing=0.1)
    with pytest.raises(ValueError, match=r"ExplicitMPM\(.., rigid"):
        fm.wall(z, edge, LAW, RigidBody(shape, 0.1))
