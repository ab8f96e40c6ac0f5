# SPDX-License-Identifier: MIT
"""Energy and momenta of nearly and fully incompressible bodies are kept."""

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh

from fenicsmpm import ImplicitMPM, diagnostics, formulations, points
from fenicsmpm.forms import evaluate
from fenicsmpm.mapping import ActiveCells, Tying
from fenicsmpm.materials import NeoHookean

COMM = MPI.COMM_WORLD


class Flight:
    """A block that turns, bends and flies through cells."""

    def __init__(self, nu, dim=2, alpha=1.0):
        corners = [(0,) * dim, (3,) * dim]
        if dim == 2:
            domain = mesh.create_rectangle(COMM, corners, [9, 9])
        else:
            domain = mesh.create_box(COMM, corners, [6] * 3)
        spacing = 1 / 12 if dim == 2 else 1 / 6
        self.body = points.lattice(
            domain, spacing, inside=lambda x: np.all(np.abs(x - 1.5) < 0.5, axis=1)
        )
        formulations.set_initial_state(self.body, 2.0, velocity=self.velocity)
        self.law = NeoHookean(100.0, nu)
        space = formulations.mixed_space(domain)
        self.U, self.V = fem.Function(space), ufl.TestFunction(space)
        scheme = formulations.Midpoint(self.U, dt=0.05)
        self.stress = formulations.MixedEnergyMomentum(self.law, self.body, self.U, alpha=alpha)
        w = ufl.split(self.V)[0]
        self.R = self.stress.power(self.V) - ufl.inner(scheme.force(self.body), w) * self.body.dx
        updates = {self.body: self.stress.updates}
        newton = {"rtol": 1e-11, "atol": 1e-12}
        newton["tying"] = Tying(space, self.body, ActiveCells(self.body))
        self.sim = ImplicitMPM(self.R, self.U, scheme, self.body, updates=updates, newton=newton)

    def velocity(self, x):
        x = x - 1.5
        v = np.full_like(x, 0.5)
        v[:, 0] -= 2 * x[:, 1] - x[:, 1] ** 2
        v[:, 1] += 2 * x[:, 0]
        return v

    def isochoric(self):
        """mu/2 (J^(-2/3) tr C - 3) of all points [J], by numpy."""
        F = self.body["F"]
        J = np.linalg.det(F)
        psi = self.law.mu / 2 * (J ** (-2 / 3) * np.sum(F**2, axis=(1, 2)) - 3)
        return COMM.allreduce(float(self.body["V_0"] @ psi))

    def energy(self):
        kinetic = diagnostics.kinetic_energy(self.body)
        return kinetic + self.isochoric() + self.stress.volumetric_energy()


@pytest.mark.mpi
@pytest.mark.parametrize(("nu", "dim"), [(0.5, 2), (0.49, 2), (0.5, 3)])
def test_energy_momenta_and_volume_are_kept(nu, dim):
    flight = Flight(nu, dim)
    body = flight.body
    before = flight.energy()
    momentum, moment = diagnostics.momentum(body), diagnostics.angular_momentum(body)
    volume = body.volume
    start = COMM.allreduce(np.abs(body.x).sum())
    strained = 0.0
    for step in flight.sim.run(0.5):
        assert step.newton.iterations <= 5
        assert flight.energy() == pytest.approx(before, rel=1e-11)
        strained = max(strained, flight.isochoric())
    assert strained > 0.002 * before  # it really deforms
    assert abs(COMM.allreduce(np.abs(body.x).sum()) - start) > 0.2 * body.size_global
    assert np.allclose(diagnostics.momentum(body), momentum, rtol=0, atol=1e-12)
    assert np.allclose(diagnostics.angular_momentum(body), moment, rtol=0, atol=1e-11)
    if nu == 0.5:
        assert body.volume == pytest.approx(volume, rel=1e-11)
    else:
        assert flight.stress.volumetric_energy() > 0


def test_pressure_is_that_of_the_law():
    """A motion of uniform volume strain: p is kappa times its mean over the step."""
    flight = Flight(0.4, alpha=0.0)
    body, law, stress = flight.body, flight.law, flight.stress
    stretch = fem.Function(flight.U.function_space.sub(0).collapse()[0])
    stretch.interpolate(lambda x: 0.01 * x[:2])
    flight.U.sub(0).interpolate(stretch)
    mean = law.kappa * (1.01**2 - 1) / 2
    flight.U.sub(1).interpolate(lambda x: np.full(x.shape[1], mean))
    assert np.allclose(evaluate(stress.updates["theta"], body), 1.01**2 - 1, rtol=1e-12)
    K = evaluate(stress.algorithmic_stress, body) - 0.0
    C = np.diag([1.01**2, 1.01**2, 1.0])
    power = np.einsum("pij,ij->p", K, C - np.eye(3)) / 2
    iso = law.mu / 2 * (1.01 ** (-4 / 3) * (2 * 1.01**2 + 1) - 3)
    assert np.allclose(power, iso + mean * (1.01**2 - 1), rtol=1e-8)


def test_bad_input():
    domain = mesh.create_unit_square(MPI.COMM_SELF, 2, 2)
    body = points.lattice(domain, 0.25)
    formulations.set_initial_state(body, 1.0)
    U = fem.Function(formulations.mixed_space(domain))
    law = NeoHookean(1.0, 0.5)
    with pytest.raises(ValueError, match="volumetric='quadratic' only"):
        formulations.MixedEnergyMomentum(NeoHookean(1.0, 0.5, "miehe"), body, U)
    with pytest.raises(ValueError, match="alpha must be"):
        formulations.MixedEnergyMomentum(law, body, U, alpha=-1.0)
    displacements = fem.Function(fem.functionspace(domain, ("Lagrange", 1, (2,))))
    with pytest.raises(ValueError, match="mixed space"):
        formulations.MixedEnergyMomentum(law, body, displacements)
    assert "S" not in body
    assert "theta" not in body
