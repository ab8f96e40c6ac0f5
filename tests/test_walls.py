# SPDX-License-Identifier: MIT
"""Walls and supports on boundary points against closed solutions."""

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh

from fenicsmpm import ImplicitMPM, basis, points
from fenicsmpm import formulations as fm
from fenicsmpm.cells import ActiveCells, Tying
from fenicsmpm.diagnostics import momentum, resultant
from fenicsmpm.materials import NeoHookean
from fenicsmpm.simulation import Resultant

COMM = MPI.COMM_WORLD
ANGLE, GRAVITY = np.pi / 6, 9.81


def lattice(upper, shape):
    return mesh.create_rectangle(
        COMM, [(0, 0), upper], shape, mesh.CellType.quadrilateral,
        partitioner=basis.shared_vertex_partitioner,
    )  # fmt: skip


@pytest.mark.mpi
@pytest.mark.parametrize("steps", [5, 20])
def test_stretched_block_by_nitsche(steps):
    """An incompressible block, drawn to 1.2 times its length by boundary points off the grid."""
    n, E = 10, 3.0
    domain = lattice((2.0, 1.3), [2 * n, 13])
    body = points.lattice(domain, 1 / n / 6, inside=lambda x: (x[0] < 1.05) & (x[1] < 0.95))
    fm.set_initial_state(body, 1.0)
    end = points.on_curve(domain, (1.05, 0), (1.05, 0.95), spacing=1 / n / 6)
    for p in (body, end):
        basis.use(p, "quadratic")
    fm.set_normals(end, (1.0, 0.0))
    z = fm.Unknown(domain, "u", "p")
    for k in range(2):
        z.fix("u", lambda x, k=k: np.isclose(x[k], 0), component=k)
    law, scheme = NeoHookean(E, 0.5), fm.QuasiStatic(z, dt=1 / steps)
    cells, g = ActiveCells(body, loads=[end]), fem.Constant(domain, (0.0, 0.0))
    support = fm.nitsche_dirichlet(z, end, law, g, slip=True)  # free to become thinner
    R = fm.stabilized("cip", z, body, law, cells=cells) + support
    pull = Resultant(z, support)

    def data(start, now):
        g.value[0] = 0.2 * 1.05 * now

    sim = ImplicitMPM(
        R, z, scheme, body, carried=[end], data=data, observers=[pull],
        newton={"tying": Tying(z.space, body, cells)},
    )  # fmt: skip
    for _ in sim.run(1.0):
        pass
    stress = E / 3 * (1.2**2 - 1.2**-2)  # Cauchy, plane strain
    assert pull.value[0] == pytest.approx(stress * 0.95 / 1.2, rel=0.005)
    assert abs(pull.value[1]) < 1e-3 * pull.value[0]
    assert np.abs(end["u"][:, 0] - 0.21).max(initial=0) < 2e-3


def test_wall_presses_and_does_not_pull():
    """Pressure k d where points are in the wall, nothing outside; a two-sided one holds both."""
    domain = lattice((1.0, 1.0), [5, 5])
    edge = points.on_curve(domain, (0.1, 0.52), (0.9, 0.52), spacing=0.1)
    z, height = fm.Unknown(domain, "u"), fem.Constant(domain, 0.5)
    k = 30 * 7.0 / 0.2
    for two_sided in (False, True):
        R = fm.wall(z, edge, 7.0, lambda x: x[1] - height, two_sided=two_sided)
        for top, depth in ((0.5, -0.02), (0.53, 0.01)):
            height.value = top
            expected = k * depth * 0.8 if depth > 0 or two_sided else 0.0
            assert resultant(z, R) == pytest.approx([0.0, expected], abs=1e-12)


@pytest.mark.parametrize("friction", [0.3, 0.6])
def test_block_on_an_incline(friction):
    """It slides with g (sin a - mu cos a), or rests; the plane is not along the grid."""
    h, E, rho = 0.1, 1e6, 1000.0
    domain = lattice((2.4, 2.0), [24, 20])
    along = np.array([np.cos(ANGLE), -np.sin(ANGLE)])
    up = np.array([np.sin(ANGLE), np.cos(ANGLE)])
    foot = np.array([0.2, 1.4])  # of the block, at its upper end

    def local(x):
        return (x[:2].T - foot) @ along, (x[:2].T - foot) @ up

    def inside(x):
        s, d = local(x)
        return (s > 0) & (s < 0.6) & (d > 0) & (d < 0.3)

    body = points.lattice(domain, h / 4, inside=inside)
    fm.set_initial_state(body, rho)
    edge = points.on_curve(domain, foot, foot + 0.6 * along, spacing=h / 5)
    for p in (body, edge):
        basis.use(p, "quadratic")
    z = fm.Unknown(domain, "u")
    law, scheme = NeoHookean(E, 0.3), fm.BDF2(z, dt=0.01)
    cells = ActiveCells(body, loads=[edge])
    energy = lambda F: law.energy(F, ufl.det(F)) + law.kappa / 2 * (ufl.det(F) - 1) ** 2  # noqa: E731
    P = fm.Response(energy, body, fm.Kinematics(z.u, body).F).P
    floor = fm.wall(
        z, edge, law, lambda x: (x[0] - foot[0]) * up[0] + (x[1] - foot[1]) * up[1],
        friction=friction, factor=10.0,
    )  # fmt: skip
    R = fm.stress_power(P, z.test.u, body) + scheme.inertia(body) + floor
    g = fem.Constant(domain, (0.0, 0.0))
    R -= ufl.inner(fm.density(body) * g, z.test.u) * body.dx

    def data(start, end):
        g.value[1] = -GRAVITY * min(end / 0.1, 1.0)

    force = Resultant(z, floor)
    sim = ImplicitMPM(
        R, z, scheme, body, carried=[edge], observers=[force], taylor=True, data=data,
        newton={"tying": Tying(z.space, body, cells)},
    )  # fmt: skip
    mass = body["mass"].sum()
    weight, speeds, times, forces, places = mass * GRAVITY, [], [], [], []
    for step in sim.run(0.4):
        times.append(step.time)
        speeds.append(momentum(body) @ along / mass)
        forces.append(force.value)
        places.append(np.mean(body["u"] @ along))
    late = np.array(times) > 0.15
    slope = np.polyfit(np.array(times)[late], np.array(speeds)[late], 1)[0]
    if friction < np.tan(ANGLE):
        assert slope == pytest.approx(
            GRAVITY * (np.sin(ANGLE) - friction * np.cos(ANGLE)), rel=0.01
        )
    else:
        # it swings by hundredths of a millimetre; free, it would slide by half a metre meanwhile
        assert np.ptp(np.array(places)[late]) < 1e-4
    mean = np.mean(np.array(forces)[late], axis=0)
    assert mean @ up == pytest.approx(weight * np.cos(ANGLE), rel=0.01)
    assert -mean @ along == pytest.approx(
        weight * min(np.sin(ANGLE), friction * np.cos(ANGLE)), rel=0.02
    )


def test_bad_input():
    domain = lattice((1.0, 1.0), [4, 4])
    edge = points.on_curve(domain, (0.1, 0.5), (0.9, 0.5), spacing=0.1)
    z, law = fm.Unknown(domain, "u", "p"), NeoHookean(1.0, 0.5)

    def floor(x):
        return x[1]

    for options, message in (
        ({"friction": -0.1}, "finite and not negative: -0.1"),
        ({"friction": np.nan}, "finite and not negative: nan"),
        ({"friction": 0.1, "two_sided": True}, "friction needs a pressure"),
        ({"factor": 0.0}, "factor of the penalty must be positive"),
    ):
        with pytest.raises(ValueError, match=message):
            fm.wall(z, edge, law, floor, **options)
    with pytest.raises(ValueError, match="a distance is a scalar"):
        fm.wall(z, edge, law, lambda x: x)
    with pytest.raises(ValueError, match="without normals"):
        fm.nitsche_dirichlet(z, edge, law)
    fm.set_normals(edge, (0.0, -1.0))
    with pytest.raises(ValueError, match="needs the parts u, p"):
        fm.nitsche_dirichlet(fm.Unknown(domain, "u"), edge, law)
    with pytest.raises(ValueError, match="factor of the penalty must be positive"):
        fm.nitsche_dirichlet(z, edge, law, factor=-1.0)
    nobody = points.on_curve(domain, (0.1, 0.5), (0.9, 0.5), spacing=0.1)
    nobody.remove(lambda x: x[0] > 0)
    with pytest.raises(ValueError, match="on no points"):
        fm.wall(z, nobody, law, floor)
