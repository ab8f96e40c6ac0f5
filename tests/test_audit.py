# SPDX-License-Identifier: MIT
"""What the stages of a step change, and lengths of steps."""

from functools import partial

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import mesh
from energy_bodies import DENSITY, MATERIALS, block, simulation

from fenicsmpm import (
    ExplicitMPM,
    ImplicitMPM,
    MaterialPoints,
    basis,
    diagnostics,
    formulations,
    points,
)
from fenicsmpm.materials import Hencky
from fenicsmpm.simulation import Audit
from fenicsmpm.solvers import CourantStep

pytestmark = pytest.mark.ranks

# --- audit --------------------------------------------------------------------------------------


@pytest.mark.parametrize("flip", [1.0, 0.0])
@pytest.mark.parametrize("lumping", [0.0, 0.4, 1.0])
def test_audit_agrees_with_the_tables(flip, lumping):
    """Conservation paper, tables 1 and 2, with mass matrices made here."""
    body = block()
    watch = Audit()
    kind = partial(ImplicitMPM, observers=[watch])
    sim = simulation(body, MATERIALS["Hencky"], kind=kind, flip=flip, lumping=lumping)
    sim.step()
    nodes = sim.unknown.space.tabulate_dof_coordinates()[:, :2]
    N = shape_functions(body, nodes)
    consistent = N.T @ (body["mass"][:, None] * N)
    difference = np.diag(consistent.sum(axis=1)) - consistent  # lumped - consistent
    T = diagnostics.kinetic_energy(body)
    sim.step()
    audit = watch.last
    v0 = sim.scheme.histories["v"].x.array.reshape(-1, 2)
    u = sim.unknown.U.x.array.reshape(-1, 2)
    v1 = 2 * u / float(sim.scheme.dt.value) - v0
    seen = consistent.any(axis=1)
    v0, v1 = np.where(seen[:, None], v0, 0), np.where(seen[:, None], v1, 0)
    x1 = nodes + u
    K = audit.points_before.kinetic_energy
    assert K == pytest.approx(T)
    size = 2 * DENSITY * 2.0
    changes = audit.changes

    def turn(x, p):
        return np.sum(x[:, 0] * p[:, 1] - x[:, 1] * p[:, 0])

    # table 1
    assert changes["map to the grid"].momentum == pytest.approx(0, abs=1e-12 * size)
    effective = consistent + lumping * difference
    lost = np.sum(v0 * (effective @ v0)) / 2 - K
    assert changes["map to the grid"].kinetic_energy == pytest.approx(lost, abs=1e-12 * K)
    assert lost < 1e-12 * K
    assert changes["map to the grid"].angular_momentum == pytest.approx(0, abs=1e-12 * size)
    # table 2: what points gain in the step less what the grid gains in it
    gain = audit.points_after - audit.points_before - (audit.grid_after - audit.grid_before)
    assert gain.momentum == pytest.approx(0, abs=1e-12 * size)
    dv = v1 - v0
    moved = dv if flip else v1
    expected = -lumping * turn(x1, difference @ moved)
    assert gain.angular_momentum == pytest.approx(expected, abs=1e-12 * size)
    if flip:
        expected = -lumping / 2 * np.sum(dv * (difference @ dv))
    else:
        expected = np.sum(v0 * (consistent @ v0)) / 2 - K
        expected -= lumping / 2 * np.sum(dv * (difference @ (v1 + v0)))
    assert gain.kinetic_energy == pytest.approx(expected, abs=1e-12 * K)
    assert "map to the points" in str(audit)


@pytest.mark.mpi
def test_audit_in_space_and_on_several_ranks():
    audits = []
    for comm in (MPI.COMM_SELF, MPI.COMM_WORLD):
        body = block(3, comm=comm, per_cell=3)
        before = diagnostics.angular_momentum(body)
        audit = Audit()
        kind = partial(ImplicitMPM, observers=[audit])
        sim = simulation(body, MATERIALS["Hencky"], kind=kind)
        sim.step()
        audits.append(audit.last)
        whole = audit.last.changes["whole step"]
        turned = diagnostics.angular_momentum(body) - before
        assert whole.angular_momentum == pytest.approx(turned, abs=1e-12)
        assert whole.angular_momentum == pytest.approx(np.zeros(3), abs=1e-11)
    for stage, change in audits[0].changes.items():
        other = audits[1].changes[stage]
        for name in ("momentum", "angular_momentum", "kinetic_energy"):
            assert getattr(other, name) == pytest.approx(getattr(change, name), abs=1e-9), stage


def shape_functions(body, nodes):
    """Bilinear functions of unit cells at the points, ``(n_points, n_nodes)``."""
    distance = np.abs(body.x[:, None] - nodes[None])
    return np.prod(np.maximum(1 - distance, 0), axis=2)


# --- time steps ---------------------------------------------------------------------------------


def test_courant_step_of_full_cells():
    domain = mesh.create_rectangle(
        MPI.COMM_WORLD, [(0, 0), (2, 1)], [8, 2], mesh.CellType.quadrilateral
    )
    body = points.lattice(domain, 0.05)
    formulations.set_initial_state(body, DENSITY)
    law = MATERIALS["Hencky"]
    wave = np.sqrt(law.wave_speed_modulus / DENSITY)
    step = CourantStep({body: law}, factor=5.0)
    assert step() == pytest.approx(5.0 * 0.25 / wave)
    body["weight"] = 2 * body.weight  # half the density
    assert step() == pytest.approx(5.0 * 0.25 / wave / np.sqrt(2))
    assert step.history == pytest.approx([5.0 * 0.25 / wave, 5.0 * 0.25 / wave / np.sqrt(2)])
    assert CourantStep({body: law}, 5.0, smallest=1.0)() == 1.0
    assert CourantStep({body: law.wave_speed_modulus}, 5.0, largest=1e-3)() == 1e-3
    for modulus in (0.0, -1.0, np.nan):
        with pytest.raises(ValueError, match="P-wave modulus must be positive"):
            CourantStep({body: modulus}, 5.0)
    with pytest.raises(ValueError, match="needs a body"):
        CourantStep({}, 5.0)
    body["mass"] = 0.0
    with pytest.raises(ValueError, match="needs points with mass"):
        step()
    for bad in ({"factor": 0.0}, {"factor": 1.0, "smallest": 2.0, "largest": 1.0}):
        with pytest.raises(ValueError, match="factor of the Courant step must be positive"):
            CourantStep({body: law}, **bad)


def test_courant_step_of_two_bodies_in_a_cell():
    """Moduli count by volume: three points of one in a cell, and one of the other."""
    domain = mesh.create_unit_square(MPI.COMM_SELF, 1, 1, mesh.CellType.quadrilateral)
    moduli = {}
    for x, modulus in (([(0.2, 0.2), (0.2, 0.8), (0.8, 0.2)], 8.0), ([(0.8, 0.8)], 40.0)):
        body = MaterialPoints(domain, x, 0.25)
        formulations.set_initial_state(body, DENSITY)
        moduli[body] = modulus
    # the node next to the single point has N = 0.64 of it, 0.16 of two others, 0.04 of the third
    stiffest = 0.64 * 40 + 0.36 * 8
    assert CourantStep(moduli, 1.0)() == pytest.approx(np.sqrt(DENSITY / stiffest))


def test_run_with_steps_of_variable_length():
    body = block()
    sim = simulation(body, MATERIALS["Hencky"], dt=1.0)
    lengths = iter([0.01, 0.03, 0.02, 0.05])
    steps = [step.dt for step in sim.run(0.1, step_length=lambda: next(lengths))]
    assert steps == pytest.approx([0.01, 0.03, 0.02, 0.04])


@pytest.mark.mpi
def test_audit_of_explicit_steps():
    """A free block turns and flies: each stage keeps its momenta."""
    domain = mesh.create_unit_square(MPI.COMM_WORLD, 16, 16, mesh.CellType.quadrilateral)
    body = points.lattice(domain, 1 / 32, inside=lambda x: np.abs(x[:2] - 0.5).max(axis=0) < 0.25)
    basis.use(body, "quadratic")
    formulations.set_initial_state(
        body, 2.0, lambda x: np.array([0.1 - 0.4 * (x[1] - 0.5), 0.4 * (x[0] - 0.5)])
    )
    z = formulations.Unknown(domain, "v")
    audit = Audit()
    R = formulations.internal_force(z.test.v, body, Hencky(E=10.0, nu=0.3))
    sim = ExplicitMPM(R, z, body, dt=1e-3, observers=[audit])
    for _ in range(3):
        sim.step()
        for stage, change in audit.last.changes.items():
            assert change.momentum == pytest.approx(0, abs=1e-14), stage
            # points move by the grid's velocity and keep, by FLIP, some of their own
            if stage in ("map to the grid", "solve"):
                assert change.angular_momentum == pytest.approx(0, abs=1e-14), stage
        energies = [b.kinetic_energy for b in (audit.last.points_before, audit.last.grid_before)]
        assert energies[1] <= energies[0] * (1 + 1e-12)
