# SPDX-License-Identifier: MIT
"""Time schemes: order of convergence, moving supports, PIC and FLIP, and a return to the start."""

from itertools import cycle

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import mesh

from fenicsmpm import ImplicitMPM, MaterialPoints, formulations, io, points
from fenicsmpm.formulations import BDF2, Bossak, GeneralizedAlpha, Midpoint, Newmark, Unknown
from fenicsmpm.materials import NeoHookean

SCHEMES = [Newmark, Bossak, GeneralizedAlpha, BDF2]
OMEGA = 2 * np.pi  # 1/s
SPEED = 1e-4  # m/s


def shear_oscillator(scheme, dt):
    """Points at the upper nodes of a row of cells whose lower nodes are clamped.

    They move sideways, all alike, so that mapping between points and nodes is exact. A shear of
    u / h gives the stress mu u / h: an oscillator of omega^2 = mu / (rho h^2) with h = 1 m.
    """
    domain = mesh.create_rectangle(
        MPI.COMM_SELF, [(0, 0), (3, 1)], [3, 1], mesh.CellType.quadrilateral
    )
    x = np.column_stack([np.arange(0.25, 3, 0.5), np.ones(6)])
    body = MaterialPoints(domain, x, weight=0.5)
    formulations.set_initial_state(body, 1.0, (SPEED, 0))
    z = Unknown(domain, "u", "p")
    z.fix("u", lambda x: x[1] < 0.5, component=0)
    z.fix("u", lambda x: x[1] < 1.5, component=1)
    time = scheme(z, dt=dt)
    nu = 0.3
    law = NeoHookean(2 * (1 + nu) * OMEGA**2, nu)
    R = formulations.mixed(z, body, law, force=time.force(body))
    return ImplicitMPM(R, z, time, body)


def error_at_the_end(scheme, steps, shares=(1,)):
    """Relative to the amplitudes, of displacement and velocity after 0.6 periods."""
    end = 0.6
    shares = np.array([share for _, share in zip(range(steps), cycle(shares), strict=False)])
    lengths = end * shares / shares.sum()
    sim = shear_oscillator(scheme, lengths[0])
    for dt in lengths:
        sim.step(dt)
    (body,) = sim.bodies
    assert sim.time == pytest.approx(end)
    assert np.ptp(body["u"], axis=0) == pytest.approx(0, abs=1e-4 * SPEED)
    u = body["u"][0, 0] * OMEGA / SPEED - np.sin(OMEGA * end)
    v = body["v"][0, 0] / SPEED - np.cos(OMEGA * end)
    return np.abs([u, v])


@pytest.mark.parametrize(
    "scheme, shares", [*((scheme, (1,)) for scheme in SCHEMES), (BDF2, (2, 1))]
)
def test_second_order(scheme, shares):
    coarse, fine = (error_at_the_end(scheme, steps, shares) for steps in (24, 48))
    assert np.all(coarse < 0.1)
    assert np.linalg.norm(coarse) / np.linalg.norm(fine) == pytest.approx(4, rel=0.05)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_rigid_motion_with_a_moving_wall(scheme):
    domain = mesh.create_rectangle(MPI.COMM_SELF, [(0, 0), (2, 1)], [8, 4])
    velocity = np.array([1.0, 0.25])
    body = points.lattice(domain, 0.05, inside=lambda x: np.abs(x[:2] - 0.5).max(axis=0) < 0.3)
    formulations.set_initial_state(body, 2.0, velocity)
    z = Unknown(domain, "u", "p")
    z.fix("u", lambda x: x[1] < 0.55, lambda t: velocity * t)
    time = scheme(z, dt=0.04)
    R = formulations.stabilized("asgs", z, body, NeoHookean(100.0, 0.5), force=time.force(body))
    sim = ImplicitMPM(R, z, time, body)
    x0 = body.x.copy()
    for dt in (0.04, 0.02, 0.06, 0.04):
        sim.step(dt)
        assert body.x == pytest.approx(x0 + sim.time * velocity, rel=1e-9)
        assert body["v"] == pytest.approx(np.tile(velocity, (len(body), 1)), rel=1e-9)
        assert body["F"] == pytest.approx(np.tile(np.eye(3), (len(body), 1, 1)), abs=1e-9)


def lumped_midpoint(z, **options):
    return Midpoint(z, lumping=1.0, **options)


@pytest.mark.parametrize("flip", [0.0, 0.25])
@pytest.mark.parametrize("scheme", [*SCHEMES, lumped_midpoint])
def test_pic_flip_and_a_blend(scheme, flip):
    """Dust in one cell of 1 m: nothing accelerates, so FLIP leaves velocities as they were.

    With x = 1/4 and 3/4 m and equal masses, velocities 1 and 0 become 3/4 and 1/4 at the nodes and
    (3/4)^2 + (1/4)^2 and 2 (3/4) (1/4) where the points are.
    """
    domain = mesh.create_unit_square(MPI.COMM_SELF, 1, 1, mesh.CellType.quadrilateral)
    body = points.fill(domain, 2)
    formulations.set_initial_state(body, 1.0, lambda x: np.array([x[0] < 0.5, 0 * x[0]]))
    z = Unknown(domain, "u", "p")
    time = scheme(z, dt=0.1, flip=flip)
    R = formulations.mixed(z, body, NeoHookean(1e-9, 0.0)) + time.inertia(body)
    left = body.x[:, 0] < 0.5
    ImplicitMPM(R, z, time, body).step()
    pic = np.where(left, 0.625, 0.375)
    assert body["v"][:, 0] == pytest.approx(flip * left + (1 - flip) * pic, abs=1e-8)
    assert body["u"][:, 0] == pytest.approx(0.1 * pic, abs=1e-9)


def test_bdf2_goes_back_to_the_start(tmp_path):
    sim = shear_oscillator(BDF2, 0.05)
    io.checkpoint.save(tmp_path / "start.h5", sim)
    results = []
    for _ in range(2):
        for _ in range(3):
            sim.step()
        results.append(sim.bodies[0]["v"].copy())
        io.checkpoint.restore(tmp_path / "start.h5", sim)
    assert np.array_equal(*results)
