# SPDX-License-Identifier: MIT
"""Explicit steps on lattices keep points in arrays of their own until somebody looks at them."""

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem, mesh
from explicit_runs import simulate

from fenicsmpm import UnstableError, formulations, io, points
from fenicsmpm.materials import NeoHookean, VonMises

pytestmark = pytest.mark.once

COMM = MPI.COMM_WORLD
RUBBER = NeoHookean(E=100.0, nu=0.4).pointwise()
CLAY = VonMises(100.0, 0.4, sigma_y=1.0)


def block(law=RUBBER, speed=(0.5, 0.2)):
    domain = mesh.create_unit_square(COMM, 10, 10, mesh.CellType.quadrilateral)
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    body = points.lattice(domain, 0.05, inside=lambda x: np.abs(x[:2] - 0.4).max(axis=0) < 0.2)
    mean = np.reshape(speed, (2, 1))
    formulations.set_initial_state(body, 2.0, lambda x: 0.5 * np.sin(9 * x[1::-1]) + mean)
    return simulate(V, {body: law}, dt=2e-3), body


def fields(body):
    order = np.argsort(np.concatenate(COMM.allgather(body.id)))
    names = [*body.field_names, "x", "weight"]
    return {name: np.concatenate(COMM.allgather(body[name]))[order] for name in names}


def check(found, expected):
    for name, value in expected.items():
        scale = max(np.abs(value).max(), 1e-3)
        assert found[name] == pytest.approx(value, rel=0, abs=1e-11 * scale), name


@pytest.mark.mpi
@pytest.mark.parametrize("law", [RUBBER, CLAY])
def test_looking_changes_nothing(law):
    """The same run by intervals, step by step, and with somebody who looks at fields meanwhile."""
    expected = None
    for look in ("at the end", "never", "at one", "at all", "at cells"):
        sim, body = block(law)
        if look == "at the end":
            for _ in sim.run(0.3, 0.3):
                pass
        for step in sim.run(0.3):
            if look == "at one" and step.number % 3 == 0:
                assert np.isfinite(body["sigma"]).all()
            if look == "at all" and step.number % 40 == 0:
                fields(body)
            if look == "at cells" and step.number % 50 == 0:
                here = points.MaterialPoints(body.mesh, body.x, body.weight)
                assert np.array_equal(np.sort(here.cell), np.sort(body.cell))
        assert sim.number == 150
        found = fields(body)
        expected = expected or found
        check(found, expected)


@pytest.mark.mpi
def test_what_is_written_counts():
    """Assigned, written in place, points removed: the next step goes on from there."""
    runs = []
    for fresh in (False, True):
        sim, body = block()
        for step in sim.run(0.1):
            if fresh:  # everything goes back to the points after each step
                sim.settle()
            if step.number == 10:
                body["v"][:, 0] *= -1.0
            if step.number == 20:
                body["v"] = body["v"] + (0.0, 0.3)
            if step.number == 30:
                body.remove(lambda x: x[0] < 0.3)
        runs.append(fields(body))
    check(*runs)
    assert len(runs[0]["x"]) < 64


@pytest.mark.mpi
def test_laws_and_conditions_may_be_replaced():
    runs = []
    for fresh in (False, True):
        sim, body = block(CLAY)
        for step in sim.run(0.1):
            if fresh:
                sim.settle()
            if step.number == 10:
                sim.laws[body] = VonMises(100.0, 0.4, sigma_y=0.2)
            if step.number == 20:
                z = formulations.Unknown(sim.velocity, "v")
                sim.bcs = [z.fix("v", lambda x: x[0] < 0.35, component=0).bc]
        runs.append(fields(body))
    check(*runs)


def test_a_step_that_fails_goes_back_to_where_somebody_looked():
    sim, body = block(speed=(30.0, 0.0))
    seen, time = body.snapshot(), 0.0
    with pytest.raises(UnstableError, match="leaves the lattice"):
        for step in sim.run(1.0):
            if step.number % 5 == 0:
                seen, time = body.snapshot(), sim.time
    assert sim.time == time > 0
    assert all(np.array_equal(body[name], array) for name, array in seen.items())


@pytest.mark.mpi
def test_a_restart_from_within_a_block(tmp_path):
    path = COMM.bcast(tmp_path) / "state.h5"
    sim, body = block()
    for step in sim.run(0.2):
        if step.number == 33:
            io.checkpoint.save(path, sim)
    again, copy = block()
    io.checkpoint.restore(path, again)
    for _ in again.run(0.2):
        pass
    assert again.number == sim.number == 100
    for name in body.snapshot():
        assert np.array_equal(body[name], copy[name]), name


def test_a_shear_out_of_the_plane():
    """Kernels in the plane would lose it; forms keep it."""
    sim, body = block()
    body["F"][:, 0, 2] = 0.1
    with pytest.raises(ValueError, match="without out-of-plane shear"):
        sim.step()
