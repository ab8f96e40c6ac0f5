# SPDX-License-Identifier: MIT
"""Contact of deformable bodies in implicit and quasi-static steps."""

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from dolfinx import fem, la, mesh

from fenicsmpm import ImplicitMPM, MaterialPoints, basis, forms, io, points, shapes
from fenicsmpm import formulations as fm
from fenicsmpm.cells import ActiveCells, Tying
from fenicsmpm.diagnostics import kinetic_energy, momentum, strain_energy
from fenicsmpm.materials import Hencky, NeoHookean
from fenicsmpm.simulation import Audit, Observer, Reaction, Resultant

COMM = MPI.COMM_WORLD
PARTITIONER = basis.shared_vertex_partitioner
LAW = Hencky(E=1e5, nu=0.3)


def box(upper, cells, lower=None, comm=COMM):
    """Background mesh of squares or cubes."""
    corners = [lower or (0,) * len(upper), upper]
    if len(cells) == 2:
        kind, create = mesh.CellType.quadrilateral, mesh.create_rectangle
    else:
        kind, create = mesh.CellType.hexahedron, mesh.create_box
    return create(comm, corners, cells, kind, partitioner=PARTITIONER)


def face(domain, lower, upper, height, up, spacing):
    """Points on a horizontal face of a block, whose normal points up (1) or down (-1)."""
    lower, upper = np.array(lower, dtype=float), np.array(upper, dtype=float)
    n = np.rint((upper - lower) / spacing).astype(int)
    axes = [a + (np.arange(k) + 0.5) * (b - a) / k for a, b, k in zip(lower, upper, n, strict=True)]
    x = np.stack(np.meshgrid(*axes, [height], indexing="ij"), axis=-1).reshape(-1, len(n) + 1)
    normal = np.zeros_like(x)
    normal[:, -1] = up
    x, normal = (v if domain.comm.rank == 0 else v[:0] for v in (x, normal))
    return MaterialPoints(domain, x, np.prod((upper - lower) / n), fields={"normal": normal})


class Pair:
    """Two bodies with surfaces and an unknown for each, and all that a simulation needs."""

    def __init__(self, bodies, edges, functions="linear", density=1000.0, velocities=(None, None)):
        self.domain, self.bodies, self.edges = bodies[0].mesh, bodies, edges
        self.z = fm.coupled_unknowns(self.domain, ["u"], ["u"])
        for body, velocity in zip(bodies, velocities, strict=True):
            fm.set_initial_state(body, density, *([] if velocity is None else [velocity]))
        if functions != "linear":
            for some in (*bodies, *edges):
                basis.use(some, functions)
        self.cells = [
            ActiveCells(bodies[0], loads=[edges[0]]),
            ActiveCells(bodies[1], loads=[edges[1]], touching=[edges[0]]),
        ]

    def simulate(
        self, scheme=fm.QuasiStatic, dt=0.1, gravity=None, law=LAW, observers=(), **options
    ):
        (a, b), (edge, surface) = self.z, self.edges
        schemes = [scheme(z, dt=dt) for z in self.z]
        R = self.contact = fm.contact(a, edge, b, surface, law, **options)
        for z, body, s in zip(self.z, self.bodies, schemes, strict=True):
            P = fm.Response(law, body, fm.Kinematics(z.u, body).F).P
            R += fm.stress_power(P, z.test.u, body)
        self.forces = R
        for z, body, s in zip(self.z, self.bodies, schemes, strict=True):
            if scheme is not fm.QuasiStatic:
                R += s.inertia(body)
            if gravity is not None:
                R -= fm.density(body) * ufl.inner(gravity, z.test.u) * body.dx
        self.force = Resultant(b, self.contact)  # on the second body
        newton = {"tying": Tying.of_each(self.z, self.bodies, self.cells)}
        newton |= {"line_search": "friction" in options}
        return ImplicitMPM(
            R, self.z, schemes, self.bodies, carried=[[e] for e in self.edges],
            observers=[self.force, *observers], newton=newton,
        )  # fmt: skip


def blocks(dim=2, functions="linear", n=10, off=0.0, comm=COMM):
    """A block on another one of the same width, from wall to wall; the upper one comes first."""
    h, width = 1 / n, (0.4,) * (dim - 1)
    domain = box((*width, 1.0), [round(0.4 * n)] * (dim - 1) + [n], comm=comm)
    middle = 0.5 + off * h
    # points fill the cells below and above the middle
    upper = points.lattice(domain, h / 2, inside=lambda x: x[dim - 1] > middle)
    lower = points.lattice(domain, h / 2, inside=lambda x: x[dim - 1] < middle)
    edges = [face(domain, (0,) * (dim - 1), width, middle, up, h / 3) for up in (-1, 1)]
    pair = Pair([upper, lower], edges, functions)
    for z in pair.z:
        for k in range(dim - 1):
            z.fix("u", lambda x, k=k: np.isclose(x[k] * (0.4 - x[k]), 0), component=k)
    pair.z[1].fix("u", lambda x: np.isclose(x[dim - 1], 0), component=dim - 1)
    return pair, h


def confined(law):
    """Modulus of small strains without sideways ones [Pa]."""
    return law.E * (1 - law.nu) / ((1 + law.nu) * (1 - 2 * law.nu))


@pytest.mark.parametrize(
    ("dim", "functions"),
    [
        pytest.param(2, "linear", marks=pytest.mark.mpi),
        (2, "quadratic"),
        pytest.param(3, "linear", marks=pytest.mark.mpi),
    ],
)
def test_pressure_goes_through(dim, functions):
    """Blocks pressed together are one bar with a soft layer of h / factor."""
    pair, h = blocks(dim, functions, n=10 if dim == 2 else 5)
    way, factor = 1e-3, 20.0
    top = pair.z[0].fix(
        "u", lambda x: np.isclose(x[dim - 1], 1), lambda t: -way * t, component=dim - 1
    )
    hold = Reaction(top)
    step = pair.simulate(dt=1.0, factor=factor, observers=[hold]).step()
    assert step.newton.iterations <= 4
    area = 0.4 ** (dim - 1)
    pressure = way / (1 / confined(LAW) + h / (factor * LAW.E))
    assert pair.force.value[-1] == pytest.approx(-pressure * area, rel=3e-3)
    assert pair.force.value[:-1] == pytest.approx(0.0, abs=1e-9 * pressure)
    assert hold.value[-1] == pytest.approx(pair.force.value[-1], rel=1e-8)
    # points have gone with their own bodies; what overlaps has the force of the penalty
    y = [np.concatenate(COMM.allgather(edge.x[:, -1])) for edge in pair.edges]
    assert max(np.ptp(y[0]), np.ptp(y[1])) < 3e-4 * way
    overlap = -pair.force.value[-1] / area * h / (factor * LAW.E)
    assert y[1].mean() - y[0].mean() == pytest.approx(overlap, rel=1e-6)


@pytest.mark.once
@pytest.mark.parametrize("scheme", [fm.QuasiStatic, fm.Bossak, fm.Newmark, fm.BDF2])
def test_blocks_part_without_tension(scheme):
    """Pressed together and pulled apart at 0.1 m/s: forces push, then there are none."""
    pair, _ = blocks()
    pair.z[0].fix("u", lambda x: np.isclose(x[1], 1), lambda t: -0.1 * min(t, 0.4 - t), component=1)
    sim, found = pair.simulate(scheme, dt=0.02), []
    for step in sim.run(0.5):
        found.append((step.time, -pair.force.value[1]))
    times, forces = np.array(found).T
    assert forces.min() >= 0.0 and forces[times > 0.42].max() == 0.0
    most = 0.02 * 0.4 * confined(LAW)
    assert forces.max() == pytest.approx(most, rel=0.1 if scheme is fm.QuasiStatic else 0.5)
    low = COMM.allreduce(pair.edges[0].x[:, 1].min(initial=9), MPI.MIN)
    high = COMM.allreduce(pair.edges[1].x[:, 1].max(initial=-9), MPI.MAX)
    assert low - high == pytest.approx(0.01, abs=0.002 if scheme is fm.QuasiStatic else 0.008)


def sliding_block(mu, scheme=fm.Bossak, off=0.3):
    """A block at rest on a slab of the same material under gravity; both are deformable."""
    domain = box((1.2, 0.5), [24, 10])
    h, top = 0.05, 0.2 + off * 0.05
    slab = points.lattice(domain, h / 2, inside=lambda x: x[1] < top)
    block = points.lattice(
        domain, h / 2, inside=lambda x: (x[1] > top) & (x[1] < top + 0.2) & (abs(x[0] - 0.4) < 0.2)
    )
    edges = [
        face(domain, (0.2,), (0.6,), top, -1, h / 3),
        face(domain, (0,), (1.2,), top, 1, h / 3),
    ]
    pair = Pair([block, slab], edges)
    pair.z[1].fix("u", lambda x: np.isclose(x[1], 0))
    pair.z[1].fix("u", lambda x: np.isclose(x[0] * (1.2 - x[0]), 0), component=0)
    gravity, law = fem.Constant(domain, (0.0, -10.0)), Hencky(E=1e6, nu=0.3)
    sim = pair.simulate(scheme, 0.01, gravity, law, friction=mu)
    # at rest by steps that damp
    for _ in range(14):
        sim.step()
        for body in pair.bodies:
            for name in ("v", "a"):
                body[name] = np.zeros_like(body[name])
    return sim, pair, gravity


def centre(body):
    return COMM.allreduce(body["mass"] @ body.x) / mass_of(body)


def mass_of(body):
    return COMM.allreduce(float(body["mass"].sum()))


@pytest.mark.once
def test_block_slides_by_coulombs_law():
    """Deceleration mu g within 2 percent, and so is the ratio of forces."""
    mu = 0.3
    sim, pair, _ = sliding_block(mu)
    block = pair.bodies[0]
    weight = 10.0 * mass_of(block)
    assert pair.force.value[1] == pytest.approx(-weight, rel=0.02)
    block["v"] = block["v"] + np.array([1.0, 0.0])
    times, speeds, forces = [], [], []
    for step in sim.run(sim.time + 0.2):
        times.append(step.time)
        speeds.append(momentum(block)[0] / mass_of(block))
        forces.append(pair.force.value)
    assert np.polyfit(times, speeds, 1)[0] == pytest.approx(-mu * 10.0, rel=0.02)
    along, normal = np.sum(forces, axis=0)
    assert -along / normal == pytest.approx(mu, rel=0.01)


@pytest.mark.once
def test_block_sticks_below_the_limit():
    """Pulled by less than friction can hold it sways on the slab, and does not creep."""
    sim, pair, gravity = sliding_block(0.3)
    start, ways = centre(pair.bodies[0])[0], []
    gravity.value[0] = 1.2  # doubled at most, since it comes at once
    for _ in sim.run(sim.time + 0.3):
        ways.append(centre(pair.bodies[0])[0] - start)
    # shear of block and slab, not a way of 1.2 / 2 * 0.3^2 = 54 mm
    assert max(np.abs(ways)) < 1e-3
    assert abs(ways[-1]) < 1.2 * max(np.abs(ways[: len(ways) // 2]))


@pytest.mark.once
def test_discs_meet_and_part():
    """Head-on: first force where surfaces meet, no tension, momentum and most energy kept."""
    domain, discs, edges, radius, h = box((1.0, 1.0), [20, 20]), [], [], 0.2, 0.05
    angles = np.linspace(0, 2 * np.pi, 150, endpoint=False)
    for middle in (0.25, 0.75):
        ring = middle + radius * np.column_stack([np.cos(angles), np.sin(angles)])
        discs.append(
            points.lattice(
                domain, h / 4, inside=lambda x, c=middle: np.hypot(x[0] - c, x[1] - c) < radius
            )
        )
        edges.append(points.on_surface(domain, shapes.polygon(ring), h / 4))
    pair = Pair(discs, edges, velocities=((0.1, 0.1), (-0.1, -0.1)))
    law = Hencky(E=1000.0, nu=0.3)
    sim = pair.simulate(fm.Bossak, 0.02, law=law)
    along = np.ones(2) / np.sqrt(2)
    scale = mass_of(discs[0]) * 0.1 * np.sqrt(2)
    energy, first, pushes = sum(map(kinetic_energy, discs)), None, []
    for _ in sim.run(2.8):
        pushes.append(pair.force.value @ along)
        if first is None and pushes[-1] > 0:
            first = (np.linalg.norm(centre(discs[1]) - centre(discs[0])) - 2 * radius) / h
        assert np.abs(sum(map(momentum, discs))).max() < 1e-12 * scale
    assert min(pushes) >= 0.0 and pushes[-1] == 0.0
    assert abs(first) < 0.25
    assert momentum(discs[1]) @ along > 0.8 * scale
    after = sum(kinetic_energy(d) + strain_energy(d, law) for d in discs)
    assert 0.9 < after / energy < 1.0


@pytest.mark.parametrize("scheme", [fm.Bossak, fm.Midpoint])
def test_bodies_without_contact_move_as_if_alone(scheme):
    """Coupled unknowns of bodies that see the same nodes: the same as one simulation of each."""

    def both(together):
        domain, found = box((1.0, 1.0), [8, 8]), []
        parts = [("u", "p"), ("u", "p")]
        z = (
            fm.coupled_unknowns(domain, *parts)
            if together
            else [fm.Unknown(domain, *p) for p in parts]
        )
        bodies, R, schemes, cells, law = [], [], [], [], NeoHookean(E=1000.0, nu=0.45)
        for k, (own, speed) in enumerate(zip(z, (1.0, -1.0), strict=True)):
            body = points.lattice(
                domain,
                1 / 32,
                inside=lambda x, k=k: np.hypot(x[0] - 0.4 - 0.2 * k, x[1] - 0.5) < 0.25,
            )
            fm.set_initial_state(body, 1.0, lambda x, s=speed: s * np.array([x[1], x[0] - 0.3]))
            bodies.append(body)
            schemes.append(scheme(own, dt=0.005))
            cells.append(ActiveCells(body))
            R.append(fm.stabilized("ppp", own, body, law))
            R[-1] += schemes[-1].inertia(body)
            own.fix("u", lambda x: x[0] > 0.9, lambda t: (-0.2 * t, 0.0))
        if together:
            newton = {"tying": Tying.of_each(z, bodies, cells)}
            sims = [ImplicitMPM(R[0] + R[1], z, schemes, bodies, newton=newton)]
        else:
            sims = [
                ImplicitMPM(r, own, s, body, newton={"tying": Tying(own.space, body, c)})
                for r, own, s, body, c in zip(R, z, schemes, bodies, cells, strict=True)
            ]
        for sim in sims:
            for _ in range(3):
                sim.step()
        for body in bodies:
            found += [body[name][np.argsort(body.id)] for name in ("u", "v", "p", "F")]
        return found

    for one, other in zip(both(True), both(False), strict=True):
        scale = np.abs(other).max(initial=1e-12)
        assert one == pytest.approx(other, rel=1e-6, abs=1e-7 * scale)


class Work(Observer):
    """Work of the forces of a form on the motion of a step."""

    def __init__(self, pair):
        self.pair = pair

    def start(self, sim):
        self.form = forms.form(self.pair.forces)

    def solved(self, sim):
        b = forms.assemble_vector(self.form)
        b.scatter_reverse(la.InsertMode.add)
        n = sim.unknown.space.dofmap.index_map.size_local
        self.value = COMM.allreduce(b.array[:n] @ sim.unknown.U.x.array[:n])


@pytest.mark.mpi
@pytest.mark.ranks
def test_an_audit_of_two_bodies():
    """A contact changes no momentum. The grid loses the work of contact and stresses."""
    domain, h = box((1.0, 1.0), [10, 10]), 0.1
    bodies = [
        points.lattice(domain, h / 2, inside=shapes.Box((0.3, low), (0.7, low + 0.25)))
        for low in (0.5, 0.25)
    ]
    edges = [face(domain, (0.3,), (0.7,), 0.5, up, h / 3) for up in (-1, 1)]
    speeds = [lambda x, v=v: np.array([0 * x[0], v + 0 * x[0]]) for v in (-0.01, 0.02)]
    pair, law = Pair(bodies, edges, velocities=speeds), Hencky(E=1e3, nu=0.3)
    audit, work = Audit(), Work(pair)
    sim = pair.simulate(fm.Midpoint, 0.005, law=law, observers=[audit, work])
    scale, energy, pushes = mass_of(bodies[0]) * 0.03, sum(map(kinetic_energy, bodies)), []
    for _ in range(12):
        before = momentum(bodies[0])[1], sum(map(kinetic_energy, bodies))
        sim.step()
        changes = audit.last.changes
        for stage in changes.values():
            assert np.abs(stage.momentum).max() < 1e-12 * scale
        pushes.append(momentum(bodies[0])[1] - before[0])
        kinetic = sum(map(kinetic_energy, bodies)) - before[1]
        assert changes["whole step"].kinetic_energy == pytest.approx(kinetic, abs=1e-12 * energy)
        assert changes["solve"].kinetic_energy == pytest.approx(-work.value, abs=1e-8 * energy)
    assert max(pushes) > 0.01 * scale


@pytest.mark.mpi
@pytest.mark.ranks
def test_ranks_do_not_matter():
    """The same on all ranks together as on one, with friction and splines; blocks end in a cell."""
    found = []
    for comm in (COMM, MPI.COMM_SELF):
        pair, _ = blocks(functions="quadratic", comm=comm, off=0.3)
        pair.z[0].fix("u", lambda x: np.isclose(x[1], 1), lambda t: (0.01 * t, -0.01 * t))
        del pair.z[0].conditions[0]
        sim = pair.simulate(dt=0.5, friction=0.4)
        for _ in range(2):
            sim.step()
        slip = np.abs(pair.edges[0]["slip on surface 0"]).max(initial=0)
        found.append([*pair.force.value, comm.allreduce(slip, MPI.MAX)])
    assert found[1][1] < -10 and found[1][2] > 0
    assert found[0] == pytest.approx(found[1], rel=1e-7)


def test_tangent_is_exact():
    """In the plane, tractions are linear as long as points stay closed, and slip; one case each."""
    for friction in (0.0, 0.3):
        pair, h = blocks()
        (a, b), (edge, surface) = pair.z, pair.edges
        R = fm.contact(a, edge, b, surface, LAW, friction=friction)
        residual, tangent = forms.form(R), forms.form(ufl.derivative(R, a.U))
        rng, x = np.random.default_rng(4), a.U.x.array
        # pressed by 2 percent of a cell, and slips
        x[a.dofs("u")[1::2]] = -0.02 * h
        x[a.dofs("u")[::2]] = 0.02 * h
        direction = 1e-3 * h * rng.standard_normal(len(x))
        before = forms.assemble_vector(residual).array.copy()
        A = forms.assemble_matrix(tangent).to_scipy()
        slope = A @ direction
        slope[forms.inactive_dofs(tangent)] = 0.0
        x += direction
        change = forms.assemble_vector(residual).array - before
        assert np.linalg.norm(change) > 100
        assert change == pytest.approx(slope, abs=1e-9 * np.linalg.norm(change))
        is_symmetric = abs(A - A.T).max() < 1e-9 * abs(A).max()
        assert is_symmetric == (friction == 0)


def test_gaps_are_those_of_the_surfaces():
    """Off a circle in any direction, and none beside the end of a surface."""
    domain = box((1.0, 1.0), [10, 10])
    t = np.linspace(0, 2 * np.pi, 200, endpoint=False)
    circle = shapes.polygon(0.5 + 0.2 * np.column_stack([np.cos(t), np.sin(t)]))
    surface = points.on_surface(domain, circle, 0.01)
    a, b = fm.coupled_unknowns(domain, ["u"], ["u"])
    for radius in (0.17, 0.2, 0.26):
        x = 0.5 + radius * np.column_stack([np.cos(3 * t + 0.01), np.sin(3 * t + 0.01)])
        probe = MaterialPoints(domain, x, 0.01)
        gap = fm.SurfaceGap(a, probe, b, surface)
        assert forms.evaluate(gap.gap, probe) == pytest.approx(radius - 0.2, abs=1e-4)
        out = (probe.x - 0.5) / radius
        assert forms.evaluate(gap.normal, probe) == pytest.approx(out, abs=0.02)
        assert gap.least() == pytest.approx(radius - 0.2, abs=1e-4)
    assert repr(gap) == f"SurfaceGap(of 200 points to a surface of {surface.size_global} points)"
    line = points.on_curve(domain, (0.6, 0.5), (0.2, 0.5), spacing=0.02)  # its normal is up
    line_b = points.on_curve(domain, (0.1, 0.45), (0.9, 0.45), spacing=0.01)
    gap = fm.SurfaceGap(a, line_b, b, line)
    inside = (line_b.x[:, 0] > 0.2) & (line_b.x[:, 0] < 0.6)
    found = forms.evaluate(gap.gap, line_b)
    assert found[inside] == pytest.approx(-0.05)
    assert found[(line_b.x[:, 0] < 0.18) | (line_b.x[:, 0] > 0.62)].min() > 1e9


@pytest.mark.once
def test_a_restart_goes_on(tmp_path):
    """Springs of friction and what two schemes remember are in checkpoints."""

    def simulation():
        pair, _ = blocks()
        pair.z[0].fix("u", lambda x: np.isclose(x[1], 1), lambda t: (0.01 * t, -0.01 * t))
        del pair.z[0].conditions[0]
        return pair.simulate(fm.BDF2, 0.02, friction=0.5), pair

    (sim, pair), path = simulation(), tmp_path / "contact.h5"
    for k in range(4):
        if k == 2:
            io.checkpoint.save(path, sim)
        sim.step()
    again, other = simulation()
    io.checkpoint.restore(path, again)
    for _ in range(2):
        again.step()
    assert other.force.value == pytest.approx(pair.force.value, rel=1e-9)
    assert abs(pair.force.value[0]) > 1e-3


@pytest.mark.mpi
def test_what_cannot_be():
    pair, h = blocks()
    (a, b), (edge, surface) = pair.z, pair.edges
    domain = pair.domain
    for friction in (-0.1, np.nan, np.inf):
        with pytest.raises(ValueError, match="friction must be finite and not negative"):
            fm.contact(a, edge, b, surface, LAW, friction=friction)
    with pytest.raises(ValueError, match=r"must be one number .* friction = '0.3'"):
        fm.contact(a, edge, b, surface, LAW, friction="0.3")
    for factor in (0.0, -1.0, np.nan):
        with pytest.raises(ValueError, match="factor of the penalty must be positive"):
            fm.contact(a, edge, b, surface, LAW, factor=factor)
    with pytest.raises(ValueError, match="modulus must be positive"):
        fm.contact(a, edge, b, surface, -1.0)
    with pytest.raises(ValueError, match="a body with itself"):
        fm.contact(a, edge, a, surface, LAW)
    with pytest.raises(ValueError, match="a body with itself"):
        fm.contact(a, edge, b, edge, LAW)
    with pytest.raises(ValueError, match="coupled_unknowns"):
        fm.contact(fm.Unknown(domain, "u"), edge, b, surface, LAW)
    plain = MaterialPoints(domain, surface.x, surface.weight)
    with pytest.raises(ValueError, match="without normals: call set_normals"):
        fm.contact(a, edge, b, plain, LAW)
    plain.add_field("normal", (2,), 0.0)
    with pytest.raises(ValueError, match="normals are zero or not finite"):
        fm.contact(a, edge, b, plain, LAW)
    nothing = MaterialPoints(domain, np.empty((0, 2)), 1.0)
    with pytest.raises(ValueError, match="contact on no points"):
        fm.contact(a, nothing, b, surface, LAW)
    deep = MaterialPoints(domain, edge.x - [0.0, 1.5 * h], edge.weight)
    with pytest.raises(ValueError, match=r"overlap by 0\.15 m at .* more than a cell \(0\.1 m\)"):
        fm.contact(a, deep, b, surface, LAW)
    # surfaces that nobody moves
    upper, lower = pair.bodies
    R = fm.contact(a, edge, b, surface, LAW)
    for z, body in zip((a, b), (upper, lower), strict=True):
        P = fm.Response(LAW, body, fm.Kinematics(z.u, body).F).P
        R += fm.stress_power(P, z.test.u, body)
    schemes = [fm.QuasiStatic(z, dt=1.0) for z in (a, b)]
    with pytest.raises(ValueError, match="field 'normal' changes in each step, but its points"):
        ImplicitMPM(R, (a, b), schemes, [upper, lower], carried=[[edge], []])
    for z, s, bodies, carried, message in (
        (a, schemes, [upper], [], "several unknowns need several time schemes"),
        ((a, b), schemes[:1], [upper, lower], [], "2 unknowns, 1 time schemes"),
        ((a, b), schemes, [upper], [], "bodies of 1 unknowns"),
        ((a, b), schemes, [upper, [lower, upper]], [], "move by two unknowns"),
        ((a, b), schemes[::-1], [upper, lower], [], "a time scheme of the same unknown"),
        ((a, b), [schemes[0], fm.BDF2(b, dt=1.0)], [upper, lower], [], "schemes of one kind"),
    ):
        with pytest.raises(ValueError, match=message):
            ImplicitMPM(R, z, s, bodies, carried=carried)
    rubbing, _ = blocks()
    with pytest.raises(ValueError, match="friction between bodies is found where"):
        rubbing.simulate(fm.GeneralizedAlpha, friction=0.1)
    with pytest.raises(ValueError, match="2 unknowns, bodies of 1"):
        Tying.of_each((a, b), [upper], pair.cells)
    for parts in ([("u",)], ["u", "u"]):
        with pytest.raises(ValueError, match="parts of two unknowns or more"):
            fm.coupled_unknowns(domain, *parts)
