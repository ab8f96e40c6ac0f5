# SPDX-License-Identifier: MIT
"""Walls and supports on boundary points against closed solutions."""

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh

from fenicsmpm import ExplicitMPM, ImplicitMPM, basis, points
from fenicsmpm import formulations as fm
from fenicsmpm.cells import ActiveCells, Tying
from fenicsmpm.diagnostics import momentum, resultant
from fenicsmpm.forms import evaluate
from fenicsmpm.materials import Hencky, NeoHookean
from fenicsmpm.simulation import Resultant, Source

COMM = MPI.COMM_WORLD
ANGLE, GRAVITY = np.pi / 6, 9.81


def lattice(upper, shape, comm=COMM):
    return mesh.create_rectangle(
        comm, [(0, 0), upper], shape, mesh.CellType.quadrilateral,
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
    assert mean_stress(law, body) == pytest.approx(stress, rel=0.005)  # 0.7456 Pa


def mean_stress(law, body):
    """Cauchy stress along x [Pa], averaged over the volume."""
    sigma = evaluate(law.deviatoric_stress(body.field("F"))[0, 0] + body.field("p"), body)
    sums = COMM.allreduce(np.array([np.sum(sigma * body.weight), np.sum(body.weight)]))
    return sums[0] / sums[1]


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("kind", "slip", "symmetric"),
    [
        ("quadratic", True, False),
        ("quadratic", False, True),
        ("quadratic", False, False),
        ("triangle", True, True),
        ("triangle", False, False),
        ("hexahedron", True, True),
        ("hexahedron", False, False),
    ],
)
def test_variants_of_nitsche(kind, slip, symmetric):
    """An incompressible block of few cells, drawn to 1.1 times its length in plane strain."""
    h, E, stretch = 0.25, 3.0, 1.1
    if kind == "hexahedron":
        domain = mesh.create_box(
            COMM, [(0, 0, 0), (1.5, 1.25, h)], [6, 5, 1], mesh.CellType.hexahedron
        )
        place = (np.arange(8) + 0.5) / 8
        y, across = (a.ravel() for a in np.meshgrid(place, h * place, indexing="ij"))
        x = np.column_stack([np.ones_like(y), y, across])
        end = points.MaterialPoints(domain, x if COMM.rank == 0 else x[:0], h / len(x))
        fm.set_normals(end, (1.0, 0.0, 0.0))
    else:
        cell = mesh.CellType.triangle if kind == "triangle" else mesh.CellType.quadrilateral
        domain = mesh.create_rectangle(
            COMM, [(0, 0), (1.5, 1.25)], [6, 5], cell,
            partitioner=basis.shared_vertex_partitioner,
        )  # fmt: skip
        end = points.on_curve(domain, (1.0, 0), (1.0, 1.0), spacing=h / 6)
    body = points.fill(domain, 4, inside=lambda x: (x[0] < 1) & (x[1] < 1))
    fm.set_initial_state(body, 1.0)
    if kind == "quadratic":
        for p in (body, end):
            basis.use(p, "quadratic")
    dim, area = domain.geometry.dim, h if kind == "hexahedron" else 1.0
    z = fm.Unknown(domain, "u", "p")
    for k in range(2):
        z.fix("u", lambda x, k=k: np.isclose(x[k], 0), component=k)
    if dim == 3:
        z.fix("u", lambda x: np.full(x.shape[1], True), component=2)
    # one step for linear functions, as points integrate kinks exactly only where they begin
    steps = 2 if kind == "quadratic" else 1
    law, scheme = NeoHookean(E, 0.5), fm.QuasiStatic(z, dt=1 / steps)
    cells, g = ActiveCells(body, loads=[end]), fem.Constant(domain, (0.0, 0.0))
    end.add_field("height", (), end.x[:, 1])
    value = ufl.as_vector([g[0], g[1] * end.field("height"), 0][:dim])
    support = fm.nitsche_dirichlet(z, end, law, value, slip=slip, symmetric=symmetric)
    pull = Resultant(z, support)

    def data(start, now):
        g.value[:] = (stretch - 1) * now, 1 / (1 + (stretch - 1) * now) - 1

    sim = ImplicitMPM(
        fm.stabilized("cip", z, body, law, cells=cells) + support, z, scheme, body, carried=[end],
        data=data, observers=[pull], newton={"tying": Tying(z.space, body, cells)},
    )  # fmt: skip
    for _ in sim.run(1.0):
        pass
    stress = E / 3 * (stretch**2 - stretch**-2)
    rel = 0.005 if kind == "quadratic" else 1e-7
    assert pull.value[0] == pytest.approx(stress * area / stretch, rel=rel)
    assert mean_stress(law, body) == pytest.approx(stress, rel=rel)
    assert np.abs(end["u"][:, 0] - (stretch - 1)).max(initial=0) < 1e-3
    if not slip:
        thinner = (1 / stretch - 1) * end["height"]
        assert np.abs(end["u"][:, 1] - thinner).max(initial=0) < 1e-3


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


ALONG, UP = np.array([np.cos(ANGLE), -np.sin(ANGLE)]), np.array([np.sin(ANGLE), np.cos(ANGLE)])
FOOT = np.array([0.2, 1.4])  # of the block, at its upper end


def block_on_an_incline(h, rho, comm=COMM):
    """The block and its lower edge; nothing of the incline is along the grid."""
    domain = lattice((2.4, 2.0), [round(2.4 / h), round(2.0 / h)], comm)

    def inside(x):
        s, d = (x[:2].T - FOOT) @ ALONG, (x[:2].T - FOOT) @ UP
        return (s > 0) & (s < 0.6) & (d > 0) & (d < 0.3)

    body = points.lattice(domain, h / 4, inside=inside)
    fm.set_initial_state(body, rho)
    edge = points.on_curve(domain, FOOT, FOOT + 0.6 * ALONG, spacing=h / 5)
    for p in (body, edge):
        basis.use(p, "quadratic")
    return domain, body, edge


def incline(x):
    """Distance from it [m]."""
    return (x[0] - FOOT[0]) * UP[0] + (x[1] - FOOT[1]) * UP[1]


def check_incline(sim, body, force, friction, until, after):
    """It slides with g (sin a - mu cos a), or rests."""
    mass = COMM.allreduce(body["mass"].sum())
    weight, speeds, times, forces, places = mass * GRAVITY, [], [], [], []
    for step in sim.run(until):
        times.append(step.time)
        speeds.append(momentum(body) @ ALONG / mass)
        forces.append(force.value)
        places.append(COMM.allreduce(np.sum(body["u"] @ ALONG)) / body.size_global)
    late = np.array(times) > after
    if friction < np.tan(ANGLE):
        slope = np.polyfit(np.array(times)[late], np.array(speeds)[late], 1)[0]
        expected = GRAVITY * (np.sin(ANGLE) - friction * np.cos(ANGLE))
        assert slope == pytest.approx(expected, rel=0.01)
    else:
        # it swings by hundredths of a millimetre; free, it would slide by half a metre meanwhile
        assert np.ptp(np.array(places)[late]) < 1e-4
    mean = np.mean(np.array(forces)[late], axis=0)
    assert mean @ UP == pytest.approx(weight * np.cos(ANGLE), rel=0.01)
    assert -mean @ ALONG == pytest.approx(
        weight * min(np.sin(ANGLE), friction * np.cos(ANGLE)), rel=0.02
    )


@pytest.mark.parametrize("friction", [pytest.param(0.3, marks=pytest.mark.mpi), 0.6])
def test_block_on_an_incline(friction):
    E = 1e6
    domain, body, edge = block_on_an_incline(0.1, rho=1000.0)
    z = fm.Unknown(domain, "u")
    law, scheme = NeoHookean(E, 0.3), fm.BDF2(z, dt=0.01)
    cells = ActiveCells(body, loads=[edge])
    floor = fm.wall(z, edge, law, incline, friction=friction, factor=10.0)
    R = fm.stress_power(elastic(z, body, law), z.test.u, body) + scheme.inertia(body) + floor
    g = fem.Constant(domain, (0.0, 0.0))
    R -= ufl.inner(fm.density(body) * g, z.test.u) * body.dx

    def data(start, end):
        g.value[1] = -GRAVITY * min(end / 0.1, 1.0)

    force = Resultant(z, floor)
    sim = ImplicitMPM(
        R, z, scheme, body, carried=[edge], observers=[force], taylor=True, data=data,
        newton={"tying": Tying(z.space, body, cells)},
    )  # fmt: skip
    check_incline(sim, body, force, friction, until=0.4, after=0.15)


def elastic(z, body, law):
    """First Piola-Kirchhoff stress of a compressible law in UFL [Pa]."""
    energy = lambda F: law.energy(F, ufl.det(F)) + law.kappa / 2 * (ufl.det(F) - 1) ** 2  # noqa: E731
    return fm.Response(energy, body, fm.Kinematics(z.u, body).F).P


def explicit_block(friction, comm=COMM):
    """Simulation, body and force of the block in explicit steps."""
    E = 1e6
    domain, body, edge = block_on_an_incline(0.1, rho=1000.0, comm=comm)
    z, law = fm.Unknown(domain, "v"), Hencky(E, 0.3)
    floor = fm.wall(z, edge, law, incline, friction=friction, factor=10.0)
    g = fem.Constant(domain, (0.0, 0.0))
    R = fm.internal_force(z.test.v, body, law) + fm.body_force(z.test.v, body, g) + floor

    def data(start, end):
        g.value[1] = -GRAVITY * min(end / 0.1, 1.0)

    force = Resultant(z, floor)
    sim = ExplicitMPM(R, z, body, carried=[edge], data=data, observers=[force], flip=0.99)
    return sim, body, force


@pytest.mark.once
@pytest.mark.parametrize("friction", [0.3, 0.6])
def test_block_on_an_incline_explicit(friction):
    sim, body, force = explicit_block(friction)
    check_incline(sim, body, force, friction, until=0.32, after=0.2)


@pytest.mark.ranks
@pytest.mark.mpi
def test_explicit_wall_on_ranks():
    """The same force and momentum on any number of ranks."""
    found = []
    for comm in (COMM, MPI.COMM_SELF):
        sim, body, force = explicit_block(0.6, comm)
        for _ in range(30):
            sim.step()
        found.append([*force.value, *momentum(body)])
    assert found[0] == pytest.approx(found[1], rel=1e-8)


def disc_on_a_slope(h, E, rho, R=0.2):
    """Disc that touches a plane of 30 degrees, and its edge; the plane's distance."""
    domain = lattice((1.6, 1.2), [round(1.6 / h), round(1.2 / h)])
    along = np.array([np.cos(ANGLE), -np.sin(ANGLE)])
    up = np.array([np.sin(ANGLE), np.cos(ANGLE)])
    foot = np.array([0.3, 0.75])
    centre = foot + R * up
    body = points.lattice(
        domain, h / 4, inside=lambda x: np.hypot(x[0] - centre[0], x[1] - centre[1]) < R
    )
    body.weight[:] *= np.pi * R**2 / body.volume()
    fm.set_initial_state(body, rho)
    n = 6 * round(2 * np.pi * R / h)
    angle = 2 * np.pi * (np.arange(n if COMM.rank == 0 else 0) + 0.5) / n
    x = centre + R * np.column_stack([np.cos(angle), np.sin(angle)])
    edge = points.MaterialPoints(domain, x, 2 * np.pi * R / n)
    distance = lambda x: (x[0] - foot[0]) * up[0] + (x[1] - foot[1]) * up[1]  # noqa: E731
    return domain, body, edge, distance, along, centre


def accelerations(sim, body, along, until, after):
    """Of the body along a line [m/s^2], and of its spin [1/s^2], by lines through late times."""
    mass, times, speeds, spins = COMM.allreduce(body["mass"].sum()), [], [], []
    for step in sim.run(until):
        m, x, v = body["mass"], body.x, body["v"]
        v_c, centre = COMM.allreduce(m @ v) / mass, COMM.allreduce(m @ x) / mass
        arm = x - centre
        turning = COMM.allreduce(m @ (arm[:, 0] * v[:, 1] - arm[:, 1] * v[:, 0]))
        times.append(step.time)
        speeds.append(v_c @ along)
        spins.append(turning / COMM.allreduce(m @ np.sum(arm**2, axis=1)))
    late = np.array(times) > after
    return [np.polyfit(np.array(times)[late], np.array(y)[late], 1)[0] for y in (speeds, spins)]


def of_rigid_cylinder(friction, R=0.2):
    """Accelerations of a rigid cylinder on a slope: along it, and of its spin (clockwise: < 0)."""
    normal = friction * np.cos(ANGLE)
    if friction >= np.tan(ANGLE) / 3:  # it rolls
        a = 2 / 3 * GRAVITY * np.sin(ANGLE)
        return a, -a / R
    return GRAVITY * (np.sin(ANGLE) - normal), -2 * GRAVITY * normal / R


@pytest.mark.parametrize("friction", [0.1, 0.5])
def test_cylinder_rolls_and_slips(friction):
    """On a plane of 30 degrees that is not along the grid, beside the rigid cylinder."""
    h, E, rho = 0.05, 4e6, 1000.0
    domain, body, edge, distance, along, _ = disc_on_a_slope(h, E, rho)
    for p in (body, edge):
        basis.use(p, "quadratic")
    z, law = fm.Unknown(domain, "u"), NeoHookean(E, 0.3)
    scheme, cells = fm.Bossak(z, dt=0.005), ActiveCells(body, loads=[edge])
    R = fm.stress_power(elastic(z, body, law), z.test.u, body) + scheme.inertia(body)
    R += fm.wall(z, edge, law, distance, friction=friction, factor=10.0)
    g = fem.Constant(domain, (0.0, 0.0))
    R -= ufl.inner(fm.density(body) * g, z.test.u) * body.dx

    def data(start, end):
        g.value[1] = -GRAVITY * min(end / 0.1, 1.0)

    sim = ImplicitMPM(
        R, z, scheme, body, carried=[edge], taylor=True, data=data,
        newton={"tying": Tying(z.space, body, cells)},
    )  # fmt: skip
    found = accelerations(sim, body, along, until=0.5, after=0.15)
    assert found == pytest.approx(of_rigid_cylinder(friction), rel=0.03)


@pytest.mark.mpi
@pytest.mark.parametrize("value", [0.0, np.nan, np.inf])
def test_normals_that_are_none(value):
    """One bad normal on one rank is an error on all ranks."""
    domain = lattice((1.0, 1.0), [4, 4])
    edge = points.on_curve(domain, (0.1, 0.5), (0.9, 0.5), spacing=0.1)
    bad = np.flatnonzero(edge.id == edge.size_global - 1)
    edge["normal"][bad] = value
    z, law = fm.Unknown(domain, "u", "p"), NeoHookean(1.0, 0.5)
    body = points.fill(domain, 2)
    fm.set_initial_state(body, 1.0)
    said = "1 of .* normals are zero or not finite, first at .*: give outer unit normals by set_"
    for make in (
        lambda: fm.nitsche_dirichlet(z, edge, law),
        lambda: fm.follower_pressure(z, edge, 1.0),
        lambda: Source(body, edge, 1.0, (0.0, 0.0), 0.1),
    ):
        with pytest.raises(ValueError, match=said):
            make()
    # these have no need of them
    fm.penalty_dirichlet(z, edge, law)
    fm.wall(z, edge, law, lambda x: x[1])


def test_bad_input():
    domain = lattice((1.0, 1.0), [4, 4])
    edge = points.on_curve(domain, (0.1, 0.5), (0.9, 0.5), spacing=0.1)
    z, law = fm.Unknown(domain, "u", "p"), NeoHookean(1.0, 0.5)

    def floor(x):
        return x[1]

    for options, message in (
        ({"friction": -0.1}, "finite and not negative: -0.1"),
        ({"friction": np.nan}, "finite and not negative: nan"),
        ({"friction": "0.3"}, "must be one number .* friction = '0.3'"),
        ({"factor": "a"}, "must be one number .* factor = 'a'"),
        ({"friction": 0.1, "two_sided": True}, "friction needs a pressure"),
        ({"factor": 0.0}, "factor of the penalty must be positive"),
    ):
        with pytest.raises(ValueError, match=message):
            fm.wall(z, edge, law, floor, **options)
    with pytest.raises(ValueError, match="a distance must be a scalar"):
        fm.wall(z, edge, law, lambda x: x)
    with pytest.raises(ValueError, match="without normals"):
        fm.nitsche_dirichlet(z, points.at(domain, (0.5, 0.5)), law)
    with pytest.raises(ValueError, match="needs the parts u, p"):
        fm.nitsche_dirichlet(fm.Unknown(domain, "u"), edge, law)
    with pytest.raises(ValueError, match="factor of the penalty must be positive"):
        fm.nitsche_dirichlet(z, edge, law, factor=-1.0)
    for gamma in ("a", np.inf, np.nan, 0.0):
        body = points.fill(domain, 2)
        fm.set_initial_state(body, 1.0)
        cells = ActiveCells(body)
        for form in (
            lambda gamma=gamma, cells=cells: fm.ghost_penalty(z, cells, law, gamma=gamma),
            lambda gamma=gamma, cells=cells: fm.interior_penalty(z, cells, law, gamma=gamma),
        ):
            with pytest.raises(ValueError, match=f"gamma = '?{gamma}"):
                form()
    nobody = points.on_curve(domain, (0.1, 0.5), (0.9, 0.5), spacing=0.1)
    nobody.remove(lambda x: x[0] > 0)
    with pytest.raises(ValueError, match="on no points"):
        fm.wall(z, nobody, law, floor)
