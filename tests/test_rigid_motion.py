# SPDX-License-Identifier: MIT
"""Rigid bodies by themselves: distance, inertia, motion, wrong input."""

import numpy as np
import pytest

from fenicsmpm import RigidBody, shapes
from fenicsmpm.rigid import Inertia, inertia_of

pytestmark = pytest.mark.once

TRIANGLE = [(0.0, 0.0), (2.0, 0.0), (0.0, 1.0)]
CUBE = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
SIDES = [
    (0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1), (2, 3, 7), (2, 7, 6),
    (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3),
]  # fmt: skip


def disc(x):
    return np.hypot(x[0] - 0.3, x[1] - 0.4) - 0.2


def ball(x):
    return np.sqrt(np.sum((x - np.array([[0.1], [0.2], [0.3]])) ** 2, axis=0)) - 0.5


def drift(body, time, dt):
    """Let a body move by itself; its energies."""
    energies = []
    for k in range(round(time / dt)):
        body.begin(k * dt)
        body.move(k * dt, dt, np.zeros(8))
        body.end(dt, np.zeros(8))
        energies.append(body.kinetic_energy)
    return np.array(energies)


def test_distance_of_a_turned_box_is_exact():
    plane = RigidBody(
        shapes.Box((-np.inf, -np.inf), (np.inf, 0.0)), 0.1, centre=(1.0, 0.0), rotation=np.pi / 6
    )
    up = np.array([-np.sin(np.pi / 6), np.cos(np.pi / 6)])
    x = np.random.default_rng(1).uniform(-1, 1, (20, 2))
    d, n = plane.distance(x)
    assert d == pytest.approx((x - (1.0, 0.0)) @ up, abs=1e-14)
    assert n == pytest.approx(np.tile(up, (20, 1)), abs=1e-14)
    corner = RigidBody(shapes.Box((0, 0, 0), (1, 1, 1)), 0.1)
    d, n = corner.distance([(2.0, 3.0, 3.0), (0.5, 0.9, 0.5)])
    assert d == pytest.approx([3.0, -0.1]) and n == pytest.approx(
        np.array([(1 / 3, 2 / 3, 2 / 3), (0, 1, 0)])
    )


@pytest.mark.parametrize(
    "shape, order",
    [
        (shapes.SignedDistance(disc, (0.1, 0.2), (0.5, 0.6)), 2),
        (shapes.SignedDistance(ball, (-0.4, -0.3, -0.2), (0.6, 0.7, 0.8)), 2),
        (shapes.polygon(TRIANGLE), 1),  # at its corners
        (shapes.surface(CUBE, SIDES), 1),
    ],
)
def test_error_of_sampled_distances(shape, order):
    """It is at most what the body says, and of second order but for edges."""
    errors = []
    for spacing in (0.02, 0.01):
        body = RigidBody(shape, 0.04, spacing=spacing)
        lower, upper = shape.bounds()
        x = np.random.default_rng(2).uniform(lower - 0.03, upper + 0.03, (4000, body.dim))
        exact = shape.distance(np.pad(x, ((0, 0), (0, 3 - body.dim))).T)
        near = np.abs(exact) < 0.04
        found, normals = body.distance(x[near])
        assert np.abs(found - exact[near]).max() <= 1.5 * body.error
        assert np.linalg.norm(normals, axis=1) == pytest.approx(1.0)
        errors.append(body.error)
    assert errors[1] < errors[0] / 2**order * 1.2
    assert errors[1] < {1: 0.5 * 0.01, 2: 0.01**2 / (4 * 0.15)}[order]


def test_inertia_against_closed_forms():
    rho, a = 3.0, 0.2
    found = inertia_of(shapes.SignedDistance(disc, (0.1, 0.2), (0.5, 0.6)), rho)
    assert found.mass == pytest.approx(rho * np.pi * a**2, rel=1e-4)
    assert found.centre == pytest.approx([0.3, 0.4])
    assert found.tensor == pytest.approx(found.mass * a**2 / 2, rel=1e-4)
    found = inertia_of(shapes.surface(CUBE * (1.0, 2.0, 3.0), SIDES), rho)
    box = inertia_of(shapes.Box((0, 0, 0), (1, 2, 3)), rho)
    expected = 18 / 12 * np.diag([4 + 9, 1 + 9, 1 + 4])
    for one in (found, box):
        assert one.mass == pytest.approx(18.0) and one.centre == pytest.approx([0.5, 1, 1.5])
        assert one.tensor == pytest.approx(expected, abs=1e-12)
    found = inertia_of(shapes.polygon(TRIANGLE), rho)
    assert found.centre == pytest.approx([2 / 3, 1 / 3])
    assert found.tensor == pytest.approx(rho * 1.0 * (4 + 1) / 18)  # m (b^2 + h^2) / 18


def test_body_that_turns_about_its_middle_axis():
    """It flips again and again (Dzhanibekov): energy swings without drift, of second order."""
    swings = []
    for dt in (0.02, 0.01):
        body = RigidBody(
            shapes.Box((-1, -1, -1), (1, 1, 1)), 0.1, velocity=(0.3, 0.0, -0.2),
            angular_velocity=(1e-3, 5.0, 0.0),
            inertia=Inertia(2.0, np.diag([1.0, 2.0, 3.0]), (0, 0, 0)),
        )  # fmt: skip
        before = body.angular_momentum, body.kinetic_energy
        first = drift(body, 25.0, dt)
        second = drift(body, 25.0, dt)
        y = body.rotation[1, 1]
        assert abs(y) <= 1
        assert body.angular_momentum == pytest.approx(before[0], rel=1e-12, abs=1e-11)
        assert body.position == pytest.approx([15.0, 0.0, -10.0])
        swing = [np.abs(e - before[1]).max() / before[1] for e in (first, second)]
        assert swing[1] < 1.1 * swing[0]
        swings.append(swing[0])
    assert swings[1] < swings[0] / 3.5 and swings[1] < 2e-3


def test_symmetric_top():
    """Its axis goes around the angular momentum at the rate L / I_1 (Landau and Lifshitz, 33)."""
    body = RigidBody(
        shapes.Box((-1, -1, -1), (1, 1, 1)), 0.1, angular_velocity=(1.0, 0.0, 2.0),
        inertia=Inertia(1.0, np.diag([1.0, 1.0, 1.8]), (0, 0, 0)),
    )  # fmt: skip
    L = body.angular_momentum
    axis, rate = L / np.linalg.norm(L), np.linalg.norm(L) / 1.0
    energy = body.kinetic_energy
    e = body.rotation[:, 2]
    assert drift(body, 2 * np.pi / rate / 4, 2 * np.pi / rate / 400) == pytest.approx(energy)
    quarter = (e @ axis) * axis + np.cross(axis, e)
    assert body.rotation[:, 2] == pytest.approx(quarter, abs=1e-4)


def test_loads_on_a_free_body_in_the_plane():
    mass, I, dt = 2.0, 0.5, 1e-3  # noqa: E741
    body = RigidBody(
        shapes.Box((0, 0), (1, 1)), 0.1, inertia=Inertia(mass, I, (0.5, 0.5)), rotation=0.1,
        gravity=(0.0, -9.81), force=lambda t: (3.0 * t, 0.0), torque=0.25, angular_velocity=1.0,
    )  # fmt: skip
    drift(body, 1.0, dt)
    assert body.velocity == pytest.approx([0.75, -9.81], rel=2e-3)
    assert body.angular_velocity == pytest.approx(1.5)
    angle = 0.1 + 1.0 + 0.25
    assert body.rotation[:, 0] == pytest.approx([np.cos(angle), np.sin(angle)], abs=1e-3)
    assert body.momentum == pytest.approx(mass * body.velocity)
    state = body.state
    drift(body, 0.1, dt)
    ahead = body.state
    body.state = state
    assert body.state == state
    drift(body, 0.1, dt)
    assert body.position[1] == pytest.approx(ahead["position 1"])


def test_prescribed_motion():
    body = RigidBody(
        shapes.Box((0, 0, 0), (1, 1, 1)), 0.1, velocity=lambda t: (1.0, 0.0, 2 * t),
        angular_velocity=(0.0, 0.0, np.pi / 2), centre=(0, 0, 0),
    )  # fmt: skip
    dt = 1e-3
    for k in range(1000):
        body.begin(k * dt)
        body.move(k * dt, dt, np.zeros(8))
        body.end(dt, np.zeros(8))
    assert body.moved == pytest.approx([1.0, 0.0, 1.0], abs=2e-3)
    assert body.rotation[:, 0] == pytest.approx([0, 1, 0], abs=1e-12)
    assert body.distance([(1.5, 0.5, 1.5)])[0] == pytest.approx([0.5], abs=2e-3)
    with pytest.raises(ValueError, match="has no mass"):
        _ = body.momentum


BOX = shapes.Box((0, 0), (1, 1))


@pytest.mark.parametrize(
    "make, message",
    [
        (lambda: shapes.Box((1, 0), (0, 1)), "lower below upper"),
        (lambda: shapes.Box((0,), (1,)), "2 or 3 numbers"),
        (lambda: RigidBody(BOX, 0.0), "positive reach"),
        (lambda: RigidBody(BOX, 0.1, friction=-1.0), "no negative friction"),
        (lambda: RigidBody(BOX, 0.1, stiffness=0.0), "positive reach and stiffness"),
        (lambda: RigidBody(BOX, 0.1, spacing=-1.0), "spacing of samples"),
        (lambda: RigidBody(BOX, 0.1, velocity=(np.nan, 0)), "velocity .* must be finite"),
        (lambda: RigidBody(BOX, 0.1, velocity=(1, 0, 0)), r"velocity .* shape \(2,\)"),
        (lambda: RigidBody(BOX, 0.1, angular_velocity=(1, 0)), "angular velocity .* shape"),
        (lambda: RigidBody(BOX, 0.1, gravity=(0, -9.81)), "gravity .* has no effect"),
        (lambda: Inertia(0.0, 1.0, (0, 0)), "positive finite mass"),
        (lambda: Inertia(1.0, -1.0, (0, 0)), "positive definite"),
        (lambda: Inertia(1.0, np.diag([1, 1, 0]), (0, 0, 0)), "positive definite"),
        (lambda: Inertia(1.0, np.diag([1, 1, 3]), (0, 0, 0)), "above the sum"),
        (lambda: Inertia(1.0, np.diag([1, 1]), (0, 0, 0)), r"tensor \(3, 3\)"),
        (lambda: Inertia(1.0, np.eye(3) + np.eye(3, k=1), (0, 0, 0)), "symmetric"),
        (lambda: inertia_of(shapes.Box((0, 0), (1, np.inf)), 1.0), "unbounded body has no inertia"),
        (lambda: inertia_of(BOX, 0.0), "density must be positive"),
        (
            lambda: RigidBody(BOX, 0.1, inertia=inertia_of(BOX, 1.0), velocity=lambda t: (t, 0)),
            "not a function of time",
        ),
        (
            lambda: RigidBody(BOX, 0.1, inertia=inertia_of(BOX, 1.0), centre=(0, 0)),
            "centre of a free body",
        ),
        (
            lambda: RigidBody(BOX, 0.1, inertia=Inertia(1.0, np.eye(3), (0, 0, 0))),
            "in 2 dimensions",
        ),
        (lambda: shapes.polygon([(0, 0), (1, 1), (1, 0), (0, 1)]), "crosses itself"),
        (lambda: shapes.surface(CUBE, SIDES[1:]), "open"),
        (
            lambda: RigidBody(
                shapes.SignedDistance(lambda x: x[0] ** 2 + x[1] ** 2 - 4, (-2, -2), (2, 2)), 0.1
            ),
            "slope of a signed distance must be 1",
        ),
        (
            lambda: RigidBody(shapes.SignedDistance(lambda x: -disc(x), (0, 0), (1, 1)), 1e-4),
            "too many",
        ),
        (
            lambda: RigidBody(
                shapes.SignedDistance(lambda x: disc(x) + 5, (0.1, 0.2), (0.5, 0.6)), 0.1
            ),
            "negative inside",
        ),
        (
            lambda: RigidBody(
                shapes.SignedDistance(lambda x: x[0] * np.nan, (0.1, 0.2), (0.5, 0.6)), 0.1
            ),
            "finite numbers",
        ),
        (lambda: shapes.SignedDistance(disc, (0, 0), (np.inf, 1)), "finite numbers"),
    ],
)  # fmt: skip
def test_wrong_input(make, message):
    with pytest.raises(ValueError, match=message):
        make()
