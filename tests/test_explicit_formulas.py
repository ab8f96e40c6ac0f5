# SPDX-License-Identifier: MIT
"""Formulas of explicit steps by hand: factors that no exact motion shows."""

import numpy as np
import pytest
from explicit_runs import simulate
from test_explicit import RUBBER, block

from fenicsmpm import RigidBody, shapes
from fenicsmpm.diagnostics import momentum, roughness

pytestmark = pytest.mark.once


def test_pic_flip_and_a_blend():
    """Nothing accelerates: FLIP leaves velocities, PIC takes those of the grid."""
    v = {}
    for flip in (1.0, 0.0, 0.25):
        body, V, _ = block(2, velocity=lambda x: np.sin(40 * x[:2]))
        before = body["v"][np.argsort(body.id)]
        simulate(V, {body: RUBBER}, flip=flip, dt=1e-4, fbar=None).step()
        v[flip] = body["v"][np.argsort(body.id)]
    assert v[1.0] == pytest.approx(before, abs=1e-12)
    assert np.abs(v[0.0] - before).max() > 0.1
    assert v[0.25] == pytest.approx(0.25 * v[1.0] + 0.75 * v[0.0], abs=1e-12)


def test_barrier_of_a_rigid_box():
    """The force on points at a distance d = s r from it is k m r / dt^2 b'(s)."""
    body, V, _ = block(2)
    d, r, k, dt = 0.006, 0.02, 0.1, 1e-4
    lowest = body.x[:, 1].min()
    floor = RigidBody(shapes.Box([-np.inf] * 2, [np.inf, lowest - d]), reach=r, stiffness=k)
    m = body["mass"][np.isclose(body.x[:, 1], lowest)].sum()
    simulate(V, {body: RUBBER}, rigid=[floor], dt=dt).step()
    s = d / r
    expected = k * m * r / dt**2 * (2 * (s - 1) * np.log(s) + (s - 1) ** 2 / s)
    assert floor.force == pytest.approx([0.0, expected], rel=1e-9)


@pytest.mark.parametrize("speed", [100.0, 1e-4])
def test_friction_by_hand(speed):
    """What friction allows, or less: a spring and a damper for the way of the step before."""
    body, V, _ = block(2, velocity=(speed, 0.0))
    dt, lowest = 1e-4, body.x[:, 1].min()
    plane = shapes.Box([-np.inf] * 2, [np.inf, lowest - 0.006])
    floor = RigidBody(plane, reach=0.02, friction=0.3)
    m = body["mass"][np.isclose(body.x[:, 1], lowest)].sum()
    sim = simulate(V, {body: RUBBER}, rigid=[floor], dt=dt)
    sim.step()
    assert floor.force[0] == 0 and floor.force[1] > 0  # no way yet
    sim.step()
    to_hold = 1.25 * m * speed / dt
    assert floor.force[0] == pytest.approx(-min(0.3 * floor.force[1], to_hold), rel=1e-7)
    assert (to_hold > 0.3 * floor.force[1]) == (speed > 1)


def test_loads_and_boxes_that_depend_on_time():
    """They are those of the beginning of each step."""
    dt, steps, times = 1e-3, 4, []
    body, V, _ = block(2)
    load = body.select(lambda x: np.full(x.shape[1], True))
    load.add_field("force", (2,))
    share = load["mass"] / body["mass"].sum()

    def data(time, end):
        assert end == pytest.approx(time + dt)
        times.append(time)
        load["force"] = np.outer(share, (0.0, 3.0 + 1e3 * time))

    far = [-2.0, -2.0], [-1.0, -1.0]
    wall = RigidBody(shapes.Box(*far), reach=0.01, velocity=lambda t: (5.0 * t, 0.0))
    sim = simulate(V, {body: RUBBER}, dt=dt, loads=[load], rigid=[wall], data=data)
    for _ in range(steps):
        sim.step()
    starts = dt * np.arange(steps)
    assert times == pytest.approx(starts)
    assert momentum(body)[1] == pytest.approx(dt * np.sum(3.0 + 1e3 * starts), rel=1e-9)
    assert wall.moved == pytest.approx([5.0 * dt * starts.sum(), 0.0])


def test_the_stable_step_knows_the_speed_of_points():
    body, V, _ = block(2, velocity=(3.0, 4.0))
    still, V_still, _ = block(2)
    c = np.sqrt(RUBBER.wave_speed_modulus / 2.0)
    h = 0.1
    at_rest = simulate(V_still, {still: RUBBER}, cfl=0.3).dt
    moving = simulate(V, {body: RUBBER}, cfl=0.3).dt
    assert at_rest == pytest.approx(0.3 * h / c)
    assert moving == pytest.approx(0.3 * h / (c + 5.0))


def test_roughness_of_a_line_and_of_a_checkerboard():
    body, _, _ = block(2)
    X = np.rint((body.x - body.x.min(axis=0)) / 0.05).astype(int)
    assert roughness(body, body.x @ (3.0, -2.0), 0.05) < 1e-12
    assert roughness(body, 4.0 * (-1.0) ** X.sum(axis=1), 0.05) == pytest.approx(8.0)
