# SPDX-License-Identifier: MIT
"""Energy and momenta of nearly and fully incompressible bodies are kept."""

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import mesh

from fenicsmpm import ImplicitMPM, basis, diagnostics, formulations, points
from fenicsmpm.cells import ActiveCells, Tying
from fenicsmpm.forms import evaluate
from fenicsmpm.materials import NeoHookean

COMM = MPI.COMM_WORLD
CELLS = [
    getattr(mesh.CellType, n) for n in ("triangle", "quadrilateral", "tetrahedron", "hexahedron")
]


class Flight:
    """A block that turns, bends and flies through cells."""

    def __init__(self, nu, dim=2, alpha=None, functions="linear"):
        corners = [(0,) * dim, (3,) * dim]
        create, shape = (mesh.create_rectangle, [9, 9]) if dim == 2 else (mesh.create_box, [6] * 3)
        simplex, box = (CELLS[2 * dim - 4], CELLS[2 * dim - 3])
        kind = simplex if functions == "linear" else box
        domain = create(COMM, corners, shape, kind, partitioner=basis.shared_vertex_partitioner)
        spacing = 1 / 12 if dim == 2 else 1 / 6
        self.body = points.lattice(
            domain, spacing, inside=lambda x: np.all(np.abs(x[:dim] - 1.5) < 0.5, axis=0)
        )
        if functions != "linear":
            basis.use(self.body, functions)
        formulations.set_initial_state(self.body, 2.0, velocity=self.velocity)
        self.law = NeoHookean(100.0, nu)
        self.z = z = formulations.Unknown(domain, "u", "p")
        scheme = formulations.Midpoint(z, dt=0.05)
        self.stress = formulations.MixedEnergyMomentum(self.law, self.body, z, alpha=alpha)
        R = self.stress.power() + scheme.inertia(self.body)
        newton = {"rtol": 1e-11, "tying": Tying(z.space, self.body, ActiveCells(self.body))}
        self.sim = ImplicitMPM(R, z, scheme, self.body, newton=newton)

    def velocity(self, x):
        x = x[: self.body.mesh.geometry.dim] - 1.5
        v = np.full_like(x, 0.5)
        v[0] -= 2 * x[1] - x[1] ** 2
        v[1] += 2 * x[0]
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
@pytest.mark.parametrize(
    ("nu", "dim", "functions"),
    [
        (0.5, 2, "linear"),
        (0.49, 2, "linear"),
        (0.5, 3, "linear"),
        (0.5, 2, "quadratic"),
        (0.49, 2, "cubic"),
        (0.5, 3, "quadratic"),
    ],
)
def test_energy_momenta_and_volume_are_kept(nu, dim, functions):
    flight = Flight(nu, dim, functions=functions)
    body = flight.body
    before = flight.energy()
    momentum, moment = diagnostics.momentum(body), diagnostics.angular_momentum(body)
    volume = body.volume()
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
        assert body.volume() == pytest.approx(volume, rel=1e-11)
    assert flight.stress.volumetric_energy() > 1e-6 * before


def test_work_of_the_pressure_is_exact():
    """Uniform volume strain: the work of a step is p Delta J and the isochoric gain."""
    flight = Flight(0.4, alpha=0.0)
    body, law, stress = flight.body, flight.law, flight.stress
    flight.z.U.sub(0).interpolate(lambda x: 0.01 * x[:2])
    mean = law.kappa * (1.01**2 - 1) / 2
    flight.z.U.sub(1).interpolate(lambda x: np.full(x.shape[1], mean))
    assert np.allclose(evaluate(stress.updates["theta"], body), 1.01**2 - 1, rtol=1e-12)
    K = evaluate(stress.algorithmic_stress, body)
    C = np.diag([1.01**2, 1.01**2, 1.0])
    power = np.einsum("pij,ij->p", K, C - np.eye(3)) / 2
    iso = law.mu / 2 * (1.01 ** (-4 / 3) * (2 * 1.01**2 + 1) - 3)
    assert np.allclose(power, iso + mean * (1.01**2 - 1), rtol=1e-8)


def test_pressure_is_that_of_the_law():
    """A compressed block that fills its box: nothing moves, and the pressure is the law's."""
    domain = mesh.create_unit_square(COMM, 4, 4)
    body = points.lattice(domain, 1 / 8)
    formulations.set_initial_state(body, 1.0)
    body["F"] = np.tile(np.diag([0.9, 0.8, 1.0]), (len(body), 1, 1))
    body["J"] = np.full(len(body), 0.72)
    body["V_0"] = body.weight / 0.72
    law = NeoHookean(100.0, 0.4)
    z = formulations.Unknown(domain, "u", "p")
    z.fix("u", lambda x: np.isclose(np.abs(x[:2] - 0.5).max(axis=0), 0.5))
    scheme = formulations.Midpoint(z, dt=0.1)
    stress = formulations.MixedEnergyMomentum(law, body, z)
    R = stress.power() + scheme.inertia(body)
    sim = ImplicitMPM(R, z, scheme, body)
    for _ in range(2):
        sim.step()
        assert np.allclose(evaluate(z.p, body), law.kappa * (0.72 - 1), rtol=1e-9)
        assert np.allclose(body["theta"], 0.72 - 1, rtol=1e-10)
        assert np.allclose(body["v"], 0, atol=1e-10)


@pytest.mark.mpi
@pytest.mark.parametrize("alpha", [1.0, 0.0])
def test_a_wall_that_holds_does_no_work(alpha):
    """Tied nodes next to nodes that a wall holds: the block swings, and keeps its energy."""
    domain = mesh.create_rectangle(COMM, [(0, 0), (3, 3)], [9, 9])
    body = points.lattice(
        domain, 1 / 12, inside=lambda x: (x[0] < 1.8) & (np.abs(x[1] - 1.5) < 0.42)
    )
    formulations.set_initial_state(
        body, 2.0, velocity=lambda x: np.array([0 * x[0], x[0] ** 2 / 4])
    )
    law = NeoHookean(100.0, 0.5, "miehe")
    z = formulations.Unknown(domain, "u", "p")
    z.fix("u", lambda x: np.isclose(x[0], 0))
    scheme = formulations.Midpoint(z, dt=0.05)
    stress = formulations.MixedEnergyMomentum(law, body, z, alpha=alpha)
    R = stress.power() + scheme.inertia(body)
    newton = {"rtol": 1e-11, "tying": Tying(z.space, body, ActiveCells(body))}
    sim = ImplicitMPM(R, z, scheme, body, newton=newton)

    def energy():
        F = body["F"]
        psi = law.mu / 2 * (np.linalg.det(F) ** (-2 / 3) * np.sum(F**2, axis=(1, 2)) - 3)
        strained = COMM.allreduce(float(body["V_0"] @ psi))
        return diagnostics.kinetic_energy(body) + strained + stress.volumetric_energy()

    before, momentum = energy(), diagnostics.momentum(body)
    for _ in sim.run(0.5):
        assert energy() == pytest.approx(before, rel=1e-11)
    assert ("r" in body) == (alpha > 0)
    assert not np.allclose(diagnostics.momentum(body), momentum, rtol=0.1)  # the wall acts


def test_bad_input():
    domain = mesh.create_unit_square(MPI.COMM_SELF, 2, 2)
    body = points.lattice(domain, 0.25)
    formulations.set_initial_state(body, 1.0)
    z = formulations.Unknown(domain, "u", "p")
    law = NeoHookean(1.0, 0.5)
    with pytest.raises(ValueError, match="use volumetric='quadratic'"):
        formulations.MixedEnergyMomentum(NeoHookean(1.0, 0.4, "miehe"), body, z)
    with pytest.raises(ValueError, match="alpha must be"):
        formulations.MixedEnergyMomentum(law, body, z, alpha=-1.0)
    with pytest.raises(ValueError, match=r"needs the parts u, p of the unknown, which has u$"):
        formulations.MixedEnergyMomentum(law, body, formulations.Unknown(domain, "u"))
    body.add_field("r")
    with pytest.raises(ValueError, match="already has a field 'r'"):
        formulations.MixedEnergyMomentum(law, body, z)
    assert "S" not in body
    assert "theta" not in body
