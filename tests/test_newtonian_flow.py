# SPDX-License-Identifier: MIT
"""Incompressible Newtonian flow: rest, viscosity, free fall, convergence, what it cannot use."""

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh

from fenicsmpm import ImplicitMPM, MaterialPoints, diagnostics, forms, io, points
from fenicsmpm import formulations as fm
from fenicsmpm.materials import NeoHookean
from fenicsmpm.points import PointsOutsideError
from fenicsmpm.solvers import NewtonError

COMM = MPI.COMM_WORLD
G = 9.81
SCHEMES = {
    "Newmark": lambda z, dt: fm.Newmark(z, dt=dt),
    "GeneralizedAlpha": lambda z, dt: fm.GeneralizedAlpha(z, dt=dt),
    "BDF2": lambda z, dt: fm.BDF2(z, dt=dt),
    "Midpoint": lambda z, dt: fm.Midpoint(z, dt=dt, lumping=1.0),
}


def tank(size=(1.0, 1.5), cells=(6, 9), comm=COMM):
    return mesh.create_rectangle(comm, [(0, 0), size], list(cells))


class Flow:
    """Water in a tank, with the lumped mass; the last axis is upwards."""

    def __init__(self, water, scheme="BDF2", dt=0.01, mu=1e-3, density=1e3, g=G, **options):
        self.water = water
        stabilization = options.pop("stabilization", "asgs")
        correction = options.pop("correction", 0.0)
        self.z = z = fm.Unknown(water.mesh, "u", "p")
        options.pop("walls", lambda z: None)(z)
        self.scheme = SCHEMES[scheme](z, dt)
        self.law = fm.NewtonianFlow(mu, density, self.scheme, correction)
        b = fem.Constant(water.mesh, (0.0,) * (water.mesh.geometry.dim - 1) + (-g,))
        R = fm.mixed(z, water, self.law, force=fm.density(water) * b)
        R += self.scheme.lumped(water)
        force = self.scheme.force(water, b)
        self.R = R + getattr(fm, stabilization)(z, water, self.law, force=force)
        self.sim = ImplicitMPM(self.R, z, self.scheme, water, **options)


def sides_and_floor(z):
    z.fix("u", lambda x: np.isclose(x[0], 0) | np.isclose(x[0], 1), component=0)
    z.fix("u", lambda x: np.isclose(x[1], 0), component=1)


@pytest.mark.mpi
@pytest.mark.parametrize("correction", [0.0, 0.1])
@pytest.mark.parametrize(
    ("scheme", "stabilization"),
    [("BDF2", "asgs"), ("BDF2", "osgs"), ("Newmark", "asgs"), ("GeneralizedAlpha", "asgs")],
)
def test_water_at_rest(scheme, stabilization, correction):
    """The pressure at all points is rho g h from the first step on; nothing moves in a second."""
    water = points.quadrature(tank(), 4, inside=lambda x: x[1] < 1)
    fm.set_initial_state(water, 1e3)
    options = {"stabilization": stabilization, "correction": correction, "walls": sides_and_floor}
    flow = Flow(water, scheme, dt=0.02, **options)
    for _ in flow.sim.run(1.0):
        assert np.allclose(water["p"], -1e3 * G * (1 - water.x[:, 1]), atol=1e-6 * 1e3 * G)
        assert np.abs(water["v"]).max(initial=0.0) < 1e-7 * np.sqrt(G)
    assert flow.sim.number == 50


@pytest.mark.mpi
def test_water_at_rest_in_space():
    domain = mesh.create_box(COMM, [(0, 0, 0), (1, 1, 1.5)], [3, 3, 6])
    water = points.quadrature(domain, 2, inside=lambda x: x[2] < 1)
    fm.set_initial_state(water, 1e3)

    def walls(z):
        for k in (0, 1):
            z.fix("u", lambda x, k=k: np.isclose(x[k], 0) | np.isclose(x[k], 1), component=k)
        z.fix("u", lambda x: np.isclose(x[2], 0), component=2)

    flow = Flow(water, dt=0.02, walls=walls)
    for _ in flow.sim.run(0.4):
        assert np.allclose(water["p"], -1e3 * G * (1 - water.x[:, 2]), atol=1e-6 * 1e3 * G)
        assert np.abs(water["v"]).max(initial=0.0) < 1e-7 * np.sqrt(G)


@pytest.mark.parametrize("diagonal", ["right", "crossed"])
@pytest.mark.parametrize("dt", [0.02, 0.1])
def test_water_stays_at_rest(diagonal, dt):
    """Round-off under pressure does not bring points out of order, nor grow."""
    kind = getattr(mesh.DiagonalType, diagonal)
    domain = mesh.create_rectangle(MPI.COMM_SELF, [(0, 0), (1, 1.5)], [6, 9], diagonal=kind)
    water = points.quadrature(domain, 4, inside=lambda x: x[1] < 1)
    fm.set_initial_state(water, 1e3)
    flow = Flow(water, dt=dt, walls=sides_and_floor)
    for _ in flow.sim.run(4.0):
        assert np.abs(water["v"]).max() < 1e-7 * np.sqrt(G)


def test_stabilization_parameters():
    """The docstring's formulas, with the velocity and the pressure of the points."""
    water = points.fill(tank((1, 1), (2, 2), MPI.COMM_SELF), 2)
    fm.set_initial_state(water, 5.0, velocity=(3.0, 4.0))
    water.add_field("p", (), -30.0)
    flow = Flow(water, "Newmark", dt=0.1, mu=0.7, density=5.0)
    flow.scheme.begin()
    h_squared, r_v, r_a = 1 / 8, 2 / 0.1, 4 / 0.1**2
    expected = (
        1 / (5.0 * r_a + 2 * 0.7 * r_v / h_squared),
        (2 * 0.7 + 5.0 * np.sqrt(25 + 30 / 5.0) * np.sqrt(h_squared)) * r_v,
    )
    for tau, value in zip(fm.tau(water, flow.law), expected, strict=True):
        assert forms.assemble_scalar(forms.form(tau * water.dx)) == pytest.approx(value, rel=1e-12)


@pytest.mark.mpi
def test_water_at_rest_whose_surface_cuts_cells():
    """Half a percent of the pressure at the bottom, wherever the surface is."""
    water = points.fill(tank(), 3, inside=lambda x: x[1] < 0.93)
    fm.set_initial_state(water, 1e3)
    flow = Flow(water, dt=0.02, walls=sides_and_floor)
    surface = water.volume()
    for _ in flow.sim.run(0.2):
        expected = -1e3 * G * (surface - water.x[:, 1])
        assert np.allclose(water["p"], expected, atol=0.005 * 1e3 * G * surface)
        assert np.abs(water["v"]).max(initial=0.0) < 1e-6 * np.sqrt(G)


@pytest.mark.mpi
@pytest.mark.parametrize("scheme", list(SCHEMES))
def test_single_drops_fall_freely(scheme):
    """One point in a cell, and a pair that is far away: no forces, however small the masses."""
    domain = tank((1, 3), (4, 12))
    x = np.array([[0.13, 2.6], [0.71, 2.62], [0.73, 2.63]]) if COMM.rank == 0 else np.empty((0, 2))
    drops = MaterialPoints(domain, x, weight=1e-5)
    fm.set_initial_state(drops, 1e3, velocity=(0.05, 0.0))
    start = COMM.allreduce(drops.x[:, 1].sum())
    flow = Flow(drops, scheme)
    for _ in flow.sim.run(0.4):
        assert np.allclose(drops["v"][:, 0], 0.05, atol=1e-10)
        assert np.allclose(drops["v"][:, 1], -G * flow.sim.time, rtol=1e-8)
    fallen = (start - COMM.allreduce(drops.x[:, 1].sum())) / 3
    assert fallen == pytest.approx(G * 0.4**2 / 2, rel=1e-8 if scheme != "BDF2" else 0.02)
    assert np.allclose(drops["dilation"], 0, atol=1e-9)


def test_viscous_power():
    """In a uniform motion, 2 mu sym(grad v) : grad v per present volume."""
    water = points.fill(tank((1, 1), (2, 2), MPI.COMM_SELF), 2)
    fm.set_initial_state(water, 1.0)
    flow = Flow(water, dt=0.1, mu=3.0, density=1.0)
    flow.scheme.begin()
    L = np.array([[0.4, 1.0], [-0.2, -0.3]])
    z = flow.z
    z.U.sub(0).interpolate(lambda x: 0.1 * L @ x[:2])
    power = flow.law.deviatoric_power(fm.Kinematics(z.u, water), z.U, z.U)
    f = np.eye(2) + 0.1 * L
    gradient = L @ np.linalg.inv(f)
    rate = (gradient + gradient.T) / 2
    expected = 2 * 3.0 * np.linalg.det(f) * np.sum(rate * gradient) * 0.1
    found = forms.assemble_scalar(forms.form(power * water.dx))
    assert found == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("scheme", list(SCHEMES))
def test_rates_are_those_of_the_scheme(scheme):
    domain = tank((1, 1), (1, 1), MPI.COMM_SELF)
    water = points.fill(domain, 1)
    fm.set_initial_state(water, 1.0)
    flow = Flow(water, scheme, dt=0.1, density=1.0)
    flow.scheme.begin()
    z = flow.z
    for value, rate in zip(
        (flow.scheme.velocity(), flow.scheme.acceleration), flow.scheme.rates, strict=True
    ):
        change = ufl.derivative(value[0] * water.dx, z.U, z.V)
        found = forms.assemble_vector(forms.form(change)).array
        expected = forms.assemble_vector(forms.form(rate * z.test.u[0] * water.dx)).array
        assert np.any(expected)
        assert np.allclose(found, expected, rtol=1e-12)


@pytest.mark.mpi
def test_water_and_block_fall_together():
    """Two point sets in one form, in one cell: the whole keeps its momentum, and its shape."""
    domain = tank((1, 3), (4, 12))
    water, block = (
        points.lattice(domain, 1 / 12, inside=lambda x, m=m: np.abs(x[:2].T - m).max(axis=1) < 0.18)
        for m in ((0.3, 2.4), (0.7, 2.4))
    )
    for body, density in ((water, 1e3), (block, 2e3)):
        fm.set_initial_state(body, density)
    z = fm.Unknown(domain, "u", "p")
    scheme = fm.BDF2(z, dt=0.01)
    flow = fm.NewtonianFlow(1e-3, 1e3, scheme)
    b = fem.Constant(domain, (0.0, -G))
    R = 0
    for body, law in ((water, flow), (block, NeoHookean(1e5, 0.45))):
        R += fm.mixed(z, body, law, force=fm.density(body) * b) + scheme.lumped(body)
        R += fm.asgs(z, body, law, force=scheme.force(body, b))
    sim = ImplicitMPM(R, z, scheme, [water, block])
    mass = sum(COMM.allreduce(float(body["mass"].sum())) for body in (water, block))
    for _ in sim.run(0.2):
        momentum = sum(diagnostics.momentum(body) for body in (water, block))
        assert momentum == pytest.approx([0.0, -mass * G * sim.time], abs=1e-9 * mass * G)
        for body in (water, block):
            assert np.allclose(body["dilation"] if body is water else body["J"] - 1, 0, atol=1e-8)
            assert np.allclose(body["v"], [0, -G * sim.time], atol=1e-8)


def falling_column(comm, scheme="BDF2", dt=0.01, **options):
    water = points.fill(
        tank((3, 1.2), (30, 12), comm), 2, inside=lambda x: (x[0] < 0.6) & (x[1] < 1)
    )
    fm.set_initial_state(water, 1e3)

    def walls(z):
        z.fix("u", lambda x: np.isclose(x[0], 0) | np.isclose(x[0], 3), component=0)
        z.fix("u", lambda x: np.isclose(x[1], 0))

    return Flow(water, scheme, dt=dt, walls=walls, newton={"rtol": 1e-12}, **options)


def collapse(comm, steps=40):
    """Front, height, momentum and kinetic energy of a column that falls to one side."""
    flow = falling_column(comm)
    water, history = flow.water, []
    for _ in range(steps):
        flow.sim.step()
        energy = diagnostics.kinetic_energy(water)
        history.append([*water.bounds()[1], *diagnostics.momentum(water) / 1e3, energy / 1e3])
    return np.array(history)


@pytest.mark.ranks
@pytest.mark.mpi
def test_a_column_falls_on_several_ranks_as_on_one():
    alone, together = collapse(MPI.COMM_SELF), collapse(COMM)
    assert alone[-1, 0] > 1.2  # it moves by six cells
    assert np.abs(together - alone).max() <= 1e-9 * np.abs(alone).max()


def change_of_volume(water):
    return water["dilation"] @ water["V_0"] / water.volume()


@pytest.mark.parametrize("scheme", ["BDF2", "Newmark", "GeneralizedAlpha"])
def test_volume_is_kept(scheme):
    """That of the whole step, also where equations hold within it."""
    flow = falling_column(MPI.COMM_SELF, scheme)
    for _ in range(30):
        flow.sim.step()
        assert abs(change_of_volume(flow.water)) < 1e-13
    assert np.array_equal(flow.water.weight, flow.water["V_0"])


def test_volume_is_corrected():
    """Each step takes back a share of what has gathered."""
    flow = falling_column(MPI.COMM_SELF, correction=0.1)
    flow.water["dilation"] = 0.01
    for n in range(1, 6):
        flow.sim.step()
        assert change_of_volume(flow.water) == pytest.approx(0.01 * 0.9**n, rel=1e-9)


def test_checkpoint_of_a_fluid(tmp_path):
    """A run that is taken up again gives the same bits."""
    flow, again = (falling_column(MPI.COMM_SELF, correction=0.1) for _ in range(2))
    for _ in range(5):
        flow.sim.step()
    io.checkpoint.save(tmp_path / "water.h5", flow.sim)
    io.checkpoint.restore(tmp_path / "water.h5", again.sim)
    for _ in range(3):
        flow.sim.step()
        again.sim.step()
    assert np.any(flow.water["dilation"])
    for name, array in flow.sim.bodies[0].snapshot().items():
        assert np.array_equal(again.sim.bodies[0][name], array), name


# --- bad input -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"mu": 0.0}, "viscosity must be positive"),
        ({"mu": -1.0}, "viscosity must be positive"),
        ({"density": 0.0}, "density must be positive"),
        ({"density": np.nan}, "density must be positive"),
        ({"correction": -0.1}, r"must lie in \[0, 1\]: -0.1"),
        ({"correction": 2}, r"must lie in \[0, 1\]: 2"),
    ],
)
def test_wrong_fluids(change, message):
    domain = tank((1, 1), (1, 1), MPI.COMM_SELF)
    scheme = fm.BDF2(fm.Unknown(domain, "u", "p"), dt=0.1)
    arguments = {"mu": 1e-3, "density": 1e3, "scheme": scheme} | change
    with pytest.raises(ValueError, match=message):
        fm.NewtonianFlow(**arguments)


def test_a_scheme_of_another_unknown_and_inertia_twice():
    water = points.fill(tank((1, 1), (2, 2), MPI.COMM_SELF), 2)
    fm.set_initial_state(water, 1e3)
    flow, other = Flow(water), Flow(water)
    with pytest.raises(ValueError, match="belongs to another unknown"):
        fm.mixed(flow.z, water, other.law)
    with pytest.raises(ValueError, match="already have inertia"):
        fm.stabilized("asgs", flow.z, water, flow.law, scheme=flow.scheme)


def test_the_lumped_mass_is_one_of_vertices():
    domain = tank((1, 1), (2, 2), MPI.COMM_SELF)
    water = points.fill(domain, 2)
    fm.set_initial_state(water, 1e3)
    z = fm.Unknown(domain, "u", "p", degree=2)
    with pytest.raises(ValueError, match="lumped mass needs continuous linear"):
        fm.BDF2(z, dt=0.1).lumped(water)


def test_points_that_would_not_keep_their_volumes_and_other_densities():
    water = points.fill(tank((1, 1), (2, 2), MPI.COMM_SELF), 2)
    fm.set_initial_state(water, 1e3)
    flow = Flow(water)
    with pytest.raises(ValueError, match=r"'dilation' changes in each step, .* pass them to it"):
        ImplicitMPM(flow.R, flow.z, flow.scheme, water.copy())
    with pytest.raises(ValueError, match=r"density 1000 kg/m.d, but the fluid has 900"):
        Flow(water, density=900.0)


def test_points_turned_inside_out_are_seen():
    water = points.fill(tank((1, 1), (2, 2), MPI.COMM_SELF), 2)
    fm.set_initial_state(water, 1e3)
    flow = Flow(water)
    flow.scheme.begin()
    flow.z.U.sub(0).interpolate(lambda x: np.vstack([-2 * (x[0] - 0.5), 0 * x[1]]))
    new = flow.sim.map_to_points()
    before = water.snapshot()
    with pytest.raises(NewtonError, match="J = -1"):
        flow.sim.convect(new)
    for name, array in before.items():
        assert np.array_equal(water[name], array), name


@pytest.mark.mpi
@pytest.mark.parametrize("stabilization", ["asgs", "osgs"])
@pytest.mark.parametrize("size", [(1, 1), (2, 1)])
def test_a_box_full_of_water_has_no_level_of_pressure(stabilization, size):
    """An error, until the pressure is held at one node, also with a mesh that is larger."""

    def walls(z):
        for k in (0, 1):
            z.fix("u", lambda x, k=k: np.isclose(x[k], 0) | np.isclose(x[k], 1), component=k)

    def walls_and_corner(z):
        walls(z)
        z.fix("p", lambda x: np.isclose(x[0], 0) & np.isclose(x[1], 1))

    water = points.fill(tank(size, (4 * size[0], 4)), 3, inside=lambda x: x[0] < 1)
    fm.set_initial_state(water, 1e3)
    flow = Flow(water, stabilization=stabilization, walls=walls)
    before = water.snapshot()
    with pytest.raises(ValueError, match="nothing holds the level of the pressure"):
        flow.sim.step()
    for name, array in before.items():
        assert np.array_equal(water[name], array), name
    flow = Flow(water, stabilization=stabilization, walls=walls_and_corner)
    flow.sim.step()
    assert np.allclose(water["p"], -1e3 * G * (1 - water.x[:, 1]), atol=1.0)


@pytest.mark.mpi
def test_water_that_leaves_the_tank():
    domain = tank((1, 1), (4, 4))
    water = points.fill(domain, 2, inside=lambda x: x[1] < 0.5)
    fm.set_initial_state(water, 1e3)
    flow = Flow(water, dt=0.05)  # nothing holds it
    before = water.snapshot()
    with pytest.raises(PointsOutsideError, match="outside"):
        for _ in flow.sim.run(1.0):
            before = water.snapshot()
    for name, array in before.items():
        assert np.array_equal(water[name], array), name
