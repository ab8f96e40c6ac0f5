# SPDX-License-Identifier: MIT
"""Sources and sinks: masses to round-off, and a channel in a steady state."""

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import mesh

from fenicsmpm import ExplicitMPM, ImplicitMPM, basis, points
from fenicsmpm import formulations as fm
from fenicsmpm.cells import ActiveCells, Tying, correct_weights
from fenicsmpm.materials import NewtonianFluid
from fenicsmpm.simulation import Sink, Source

COMM = MPI.COMM_WORLD
LENGTH, HEIGHT, BEYOND = 2.0, 1.0, 0.5  # m


def profile(x):
    """Velocity of the flow between two plates, 1 m/s in the middle."""
    return np.array([4 * x[1] * (HEIGHT - x[1]) / HEIGHT**2, np.zeros(x.shape[1])])


def channel(h, per_side, kind=mesh.CellType.quadrilateral):
    shape = [round((LENGTH + BEYOND) / h), round(HEIGHT / h)]
    domain = mesh.create_rectangle(
        COMM, [(0, 0), (LENGTH + BEYOND, HEIGHT)], shape, kind,
        partitioner=basis.shared_vertex_partitioner,
    )  # fmt: skip
    fluid = points.fill(domain, per_side, inside=lambda x: x[0] < LENGTH)
    # from top to bottom, so that normals point out of the channel
    inlet = points.on_curve(domain, (0, HEIGHT), (0, 0), spacing=h / per_side)
    return domain, fluid, inlet


def mass_of(body):
    return COMM.allreduce(body["mass"].sum())


@pytest.mark.mpi
def test_viscous_flow_between_plates():
    """The profile that flows in stays in a steady state, and no mass is lost."""
    h, per_side, rho, mu = 0.125, 3, 1.0, 0.5
    domain, fluid, inlet = channel(h, per_side)
    fm.set_initial_state(fluid, rho, profile)
    basis.use(fluid, "quadratic")
    z = fm.Unknown(domain, "u", "p")
    z.fix("u", lambda x: np.isclose(x[0], 0), lambda x, t: t * profile(x))
    z.fix("u", lambda x: np.isclose(x[1], 0) | np.isclose(x[1], HEIGHT))
    scheme, cells = fm.BDF2(z, dt=0.02), ActiveCells(fluid)
    law = fm.NewtonianFlow(mu=mu, density=rho, scheme=scheme)
    R = fm.stabilized("cip", z, fluid, law, cells=cells) + scheme.inertia(fluid)
    source = Source(fluid, inlet, rho, profile, h / per_side)
    sink = Sink(fluid, lambda x: x[0] > LENGTH)
    sim = ImplicitMPM(
        R, z, scheme, fluid, taylor=True,
        observers=[source, sink, lambda sim, step: correct_weights(fluid, cells)],
        newton={"tying": Tying(z.space, fluid, cells)},
    )  # fmt: skip
    start, masses, flows = mass_of(fluid), [], []
    for _ in sim.run(1.0):
        masses.append(mass_of(fluid))
        flows.append((source.mass, sink.mass))
        assert masses[-1] == pytest.approx(start + source.mass - sink.mass, rel=1e-13)
    came, went = np.diff(np.array(flows)[[-26, -1]], axis=0)[0]  # within half a second
    rate = rho * 2 / 3 * HEIGHT  # kg/s
    # what comes and goes in whole points is known to a row of them, 1/24 m
    assert came == pytest.approx(0.5 * rate, abs=rho * HEIGHT / 24)
    assert went == pytest.approx(0.5 * rate, abs=rho * HEIGHT / 24)
    assert np.ptp(masses[-26:]) < rho * HEIGHT / 24
    here = (fluid.x[:, 0] > 2 * h) & (fluid.x[:, 0] < LENGTH - 2 * h)
    error = fluid["v"][here] - profile(fluid.x[here].T).T
    squares = COMM.allreduce(np.array([np.sum(error**2), 2 * len(error)]))
    assert np.sqrt(squares[0] / squares[1]) < 0.04  # of 1 m/s


@pytest.mark.mpi
@pytest.mark.parametrize("kind", ["kernels", "forms"])
def test_plug_of_fluid_through_a_channel(kind):
    """Explicit steps: what flows in at 1 m/s flows out so, and points stay in rows."""
    h, per_side, rho = 0.25, 2, 1000.0
    domain, fluid, inlet = channel(h, per_side)
    fm.set_initial_state(fluid, rho, (1.0, 0.0))
    if kind == "kernels":
        basis.use(fluid, "quadratic")
    z = fm.Unknown(domain, "v")
    z.fix("v", lambda x: np.isclose(x[0], 0), (1.0, 0.0))
    z.fix("v", lambda x: np.isclose(x[1], 0) | np.isclose(x[1], HEIGHT), component=1)
    R = fm.internal_force(z.test.v, fluid, NewtonianFluid(kappa=1e4, mu=1.0))
    spacing = h / per_side
    source = Source(fluid, inlet, rho, (1.0, 0.0), spacing)
    sink = Sink(fluid, lambda x: x[0] > LENGTH)
    sim = ExplicitMPM(
        R, z, fluid, observers=[source, sink], on_exit="error" if kind == "kernels" else "delete"
    )
    start = mass_of(fluid)
    for step in sim.run(1.5, interval=0.01):
        assert mass_of(fluid) == pytest.approx(start + source.mass - sink.mass, rel=1e-13)
        assert abs(source.mass - rho * HEIGHT * step.time) <= rho * HEIGHT * spacing * (1 + 1e-9)
    assert source.mass == sink.mass == pytest.approx(rho * HEIGHT * 1.5)
    assert fluid["v"] == pytest.approx(np.tile([1.0, 0.0], (len(fluid), 1)), abs=1e-9)
    rows = np.unique(np.round(fluid.x[:, 0] / spacing - sim.time / spacing - 0.5, 6) % 1)
    assert np.all((rows < 1e-5) | (rows > 1 - 1e-5))


def test_what_cannot_be():
    domain, fluid, inlet = channel(0.25, 2)
    fm.set_initial_state(fluid, 1.0)
    basis.use(fluid, "quadratic")  # as above, for which the loops are compiled
    for spacing in (0.0, -1.0, np.nan):
        with pytest.raises(ValueError, match="must be positive"):
            Source(fluid, inlet, 1.0, (1.0, 0.0), spacing)
    with pytest.raises(ValueError, match="flows out with 2 m/s"):
        Source(fluid, inlet, 1.0, (-2.0, 0.0), 0.1)
    for density in (0.0, np.nan):
        with pytest.raises(ValueError, match="density of what flows in must be positive"):
            Source(fluid, inlet, density, (1.0, 0.0), 0.1)
    with pytest.raises(ValueError, match=r"shape \(2,\), not \(3,\)"):
        Source(fluid, inlet, 1.0, (1.0, 0.0, 0.0), 0.1)
    for velocity in ((np.nan, 0.0), lambda x: np.full_like(x[:2], np.inf)):
        with pytest.raises(ValueError, match="velocities of a source must be finite"):
            Source(fluid, inlet, 1.0, velocity, 0.1)
    with pytest.raises(ValueError, match="field 'normal'"):
        Source(fluid, points.at(domain, (0.1, 0.5)), 1.0, (1.0, 0.0), 0.1)
    with pytest.raises(ValueError, match=r"must be a marker, .* not 0\.5"):
        Sink(fluid, 0.5)
    z = fm.Unknown(domain, "v")
    z.fix("v", lambda x: np.isclose(x[0], 0))
    R = fm.internal_force(z.test.v, fluid, NewtonianFluid(kappa=1e2, mu=1.0))
    source = Source(fluid, inlet, 1.0, (1.0, 0.0), 0.125)  # but nothing flows away
    sim = ExplicitMPM(R, z, fluid, dt=0.01, observers=[source])
    with pytest.raises(ValueError, match="adds points where there is matter already"):
        for _ in sim.run(1.0):
            pass
