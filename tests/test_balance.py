# SPDX-License-Identifier: MIT
"""A simulation goes on elsewhere, as if nothing had happened, when its points gather."""

import gc
import resource

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import mesh

from fenicsmpm import ExplicitMPM, ImplicitMPM, RigidBody, _compat, basis, io, shapes
from fenicsmpm import formulations as fm
from fenicsmpm.basis.bisection import bisect
from fenicsmpm.cells import ActiveCells, Tying
from fenicsmpm.io.fingerprint import mesh_fingerprint
from fenicsmpm.materials import Hencky, NeoHookean, NewtonianFluid
from fenicsmpm.points import fill, lattice, on_curve
from fenicsmpm.points.geometry import cell_geometry
from fenicsmpm.simulation import Observer, Rebalanced, Sink, Source, imbalance
from fenicsmpm.simulation.redistribution import Redistribution, cells_on, tags_on

pytestmark = pytest.mark.ranks

comm = MPI.COMM_WORLD
quadrilateral = mesh.CellType.quadrilateral
# Sums over ranks have another order, which changes the last digit (1e-16) of what they sum up. In
# short and stable runs it grows by a few powers of ten; Newton's method ends at 1e-12 of the start.
SAME = 1e-9


def by_id(points):
    """All arrays of all ranks but for cells, in the order of the ids."""
    parts = points.mesh.comm.allgather(points.snapshot())
    arrays = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    order = np.argsort(arrays["id"])
    return {name: a[order] for name, a in arrays.items() if name not in ("cell", "xi")}


def assert_close(one, other, tolerance=SAME):
    """Equal to round-off, whichever rank has the points."""
    assert (one.number, one.method) == (other.number, other.method)
    assert one.time == pytest.approx(other.time, rel=1e-13)
    sets = [[*sim.bodies, *sim.carried] for sim in (one, other)]
    for points, others in zip(*sets, strict=True):
        assert (points.next_id, points.size_global) == (others.next_id, others.size_global)
        mine, theirs = by_id(points), by_id(others)
        assert list(mine) == list(theirs)
        for name in mine:
            size = np.max(np.abs(mine[name]), initial=0.0)
            np.testing.assert_allclose(
                theirs[name], mine[name], rtol=0, atol=tolerance * size, err_msg=name
            )


def assert_at_home(sim):
    for points in (*sim.bodies, *sim.carried):
        geometry = cell_geometry(points.mesh)
        assert np.all(points.cell < geometry.num_owned)
        assert (
            np.abs(geometry.push_forward(points.cell, points.xi) - points.x).max(initial=0) < 1e-12
        )


# --- the partition --------------------------------------------------------------------------------


def shares(n, seed=0):
    """Centres of n x n cells and points in them, which a random rank passes."""
    i, j = np.divmod(np.arange(n * n), n)
    middle, points = np.stack([j + 0.5, i + 0.5], axis=1) / n, np.where(i < n // 4, 9, 0)
    mine = np.random.default_rng(seed).integers(0, comm.size, n * n) == comm.rank
    return np.flatnonzero(mine), middle[mine], points[mine]


def whole(cells, owner, n):
    """Rank of each of all cells."""
    result = np.full(n * n, -1)
    for some, ranks in zip(comm.allgather(cells), comm.allgather(owner), strict=True):
        result[some] = ranks
    return result


@pytest.mark.mpi
def test_ranks_get_as_many_points():
    n = 24
    _, middle, points = shares(n)
    owner = bisect(comm, middle, points)
    assert owner.dtype == np.int32
    count = comm.allreduce(np.bincount(owner, points, minlength=comm.size))
    assert count.sum() == 9 * n * n // 4
    # a twentieth is for empty cells, and a cell has 9 points
    assert np.all(np.abs(count - count.mean()) <= 0.05 * count.mean() + 9)
    assert np.all(comm.allreduce(np.bincount(owner, minlength=comm.size)) > 0)


@pytest.mark.mpi
def test_the_partition_does_not_depend_on_who_passes_cells():
    n = 17
    found = []
    for seed in range(3):
        cells, middle, points = shares(n, seed)
        found.append(whole(cells, bisect(comm, middle, points), n))
    assert np.array_equal(found[0], found[1]) and np.array_equal(found[0], found[2])


@pytest.mark.mpi
def test_the_longest_side_of_what_holds_points_is_cut():
    cells, middle, points = shares(20)
    owner = whole(cells, bisect(comm, middle, points), 20).reshape(20, 20)
    filled = owner[:5]  # 20 x 5 cells at the bottom: ranks lie one behind the other
    assert np.all(np.diff(filled, axis=1) >= 0)


@pytest.mark.mpi
def test_no_points_and_no_cells_are_shared_out_too():
    _, middle, points = shares(10)
    owner = bisect(comm, middle, 0 * points)
    count = comm.allreduce(np.bincount(owner, minlength=comm.size))
    assert np.all(np.abs(count - 100 / comm.size) <= 1)
    assert len(bisect(comm, np.empty((0, 3)), np.empty(0, dtype=np.int64))) == 0


@pytest.mark.mpi
@pytest.mark.parametrize("ghosts", ["none", "facets", "vertices"])
@pytest.mark.parametrize("cell", ["triangle", "quadrilateral", "tetrahedron", "hexahedron"])
def test_the_mesh_is_the_same_elsewhere(cell, ghosts):
    partitioner = {
        "none": _compat.cell_partitioner(mesh.GhostMode.none),
        "facets": _compat.cell_partitioner(mesh.GhostMode.shared_facet),
        "vertices": basis.shared_vertex_partitioner,
    }[ghosts]
    kind = mesh.CellType[cell]
    if cell in ("triangle", "quadrilateral"):
        old = mesh.create_unit_square(comm, 6, 5, kind, partitioner=partitioner)
    else:
        old = mesh.create_unit_cube(comm, 4, 3, 3, kind, partitioner=partitioner)
    dim = old.topology.dim
    before = cell_geometry(old)
    middle = before.corners(np.arange(before.num_owned, dtype=np.int32)).mean(axis=1)
    plan = Redistribution(old, np.where(middle[:, 0] < 0.3, 7, 0))
    new = plan.make()
    after = cell_geometry(new)
    assert mesh_fingerprint(new) == mesh_fingerprint(old)
    assert (before.boxes is None) == (after.boxes is None)
    assert plan.points.sum() == comm.allreduce(7 * int((middle[:, 0] < 0.3).sum()))
    if comm.size > 1:
        assert (comm.allreduce(after.num_cells - after.num_owned) > 0) == (ghosts != "none")

    # cells keep their numbers, their nodes and the order of them
    number = cells_on(old, new)
    told = comm.allgather((number, before.key[: before.num_owned], corners(before)))
    number, key, x = (np.concatenate(parts) for parts in zip(*told, strict=True))
    mine = np.argsort(number)[after.first_global : after.first_global + after.num_owned]
    assert np.array_equal(number[mine], after.first_global + np.arange(after.num_owned))
    assert np.array_equal(key[mine], after.key[: after.num_owned])
    assert np.array_equal(x[mine], corners(after))

    # tags go along
    for d in (dim, dim - 1, 0):
        tags = tags_at(old, d)
        moved = tags_on(tags, old, new)
        assert (moved.dim, moved.name) == (d, tags.name)
        assert seen(old, tags) == seen(new, moved)


def corners(geometry):
    return geometry.corners(np.arange(geometry.num_owned, dtype=np.int32))


def tags_at(domain, d):
    """Tags of some entities of dimension d, by where they are."""
    domain.topology.create_connectivity(d, domain.topology.dim)
    found = mesh.locate_entities(domain, d, lambda x: x[0] < 0.6)
    where = np.rint(10 * mesh.compute_midpoints(domain, d, found)[:, 1]).astype(np.int32)
    tags = mesh.meshtags(domain, d, found, where)
    tags.name = "marks"
    return tags


def seen(domain, tags):
    """Midpoints of the tagged entities with their tags, on all ranks, sorted."""
    here = tags.indices < domain.topology.index_map(tags.dim).size_local
    domain.topology.create_connectivity(tags.dim, domain.topology.dim)
    x = mesh.compute_midpoints(domain, tags.dim, tags.indices[here])
    rows = np.column_stack([np.round(x, 9), tags.values[here]])
    return sorted(map(tuple, np.concatenate(comm.allgather(rows)).tolist()))


# --- runs -----------------------------------------------------------------------------------------


def tank(n=16):
    """A tank twice as long as the water, 2 m x 1 m."""
    return mesh.create_rectangle(comm, [(0, 0), (2, 1)], [n, n // 2], quadrilateral)


def dam_break(domain):
    """A column of water in the left half that runs to the right, as by a gale."""
    water = lattice(domain, 1 / 32, inside=lambda x: (x[0] < 1) & (x[1] < 0.5))
    fm.set_initial_state(water, 1000.0, velocity=lambda x: np.array([3 + 0 * x[0], 0 * x[0]]))
    basis.use(water, "quadratic")
    z = fm.Unknown(domain, "v")
    z.fix("v", lambda x: np.isclose(x[0], 0) | np.isclose(x[0], 2), component=0)
    z.fix("v", lambda x: np.isclose(x[1], 0) | np.isclose(x[1], 1), component=1)
    R = fm.internal_force(z.test.v, water, NewtonianFluid(kappa=2e5, mu=1e-3))
    R += fm.body_force(z.test.v, water, (0.0, -9.81))
    return ExplicitMPM(R, z, water, dt=1e-3)


@pytest.mark.mpi
@pytest.mark.parametrize("interval", [None, 0.02])
def test_water_that_runs_through_the_tank(interval):
    alone = dam_break(tank())
    for _ in alone.run(0.3, interval):
        pass
    run, meshes, most = Rebalanced(dam_break, tank(), most=1.19), set(), []
    for step in run.run(0.3, interval=interval):
        meshes.add(run.mesh)
        assert (step.number, run.sim.bodies[0].mesh) == (run.sim.number, run.mesh)
        most.append(imbalance(run.sim))
    _, upper = run.sim.bodies[0].bounds()
    assert upper[0] > 1.9
    assert imbalance(run.sim) < 1.2
    counts = np.array(comm.allgather(len(run.sim.bodies[0])))
    assert np.all(np.abs(counts / counts.mean() - 1) < 0.2)
    assert_at_home(run.sim)
    assert_close(alone, run.sim)
    if comm.size == 1:
        assert len(meshes) == 1 and "rebalance" not in run.sim.seconds
    else:
        assert imbalance(alone) > 1.2
        assert 1 < len(meshes) < 10
        assert run.sim.seconds["rebalance"] > 0


def rubber(domain, inside):
    body = lattice(domain, 0.1, inside=inside)
    fm.set_initial_state(body, 1.0, velocity=lambda x: np.array([0 * x[0], 2.5 * x[0]]))
    return body


def implicit(domain, way, observers=()):
    """A block of rubber, clamped on the left, pulled by its right edge."""
    body = rubber(domain, lambda x: (x[0] < 1.2) & (abs(x[1] - 0.9) < 0.4))
    edge = on_curve(domain, (1.15, 0.55), (1.15, 1.25), spacing=0.1)
    if way == "quadratic":
        basis.use(body, "quadratic")
        basis.use(edge, "quadratic")
    z = fm.Unknown(domain, "u", "p")
    z.fix("u", lambda x: np.isclose(x[0], 0))
    z.fix("u", lambda x: np.isclose(x[1], 2), lambda t: (0.1 * t, 0.0))
    law, scheme, newton = NeoHookean(250.0, 0.5), fm.Bossak(z, dt=0.02), {"rtol": 1e-12}
    cells = ActiveCells(body, loads=[edge])
    name = {"osgs": "osgs", "quadratic": "cip"}.get(way, "asgs")
    R = fm.stabilized(name, z, body, law, force=scheme.force(body), cells=cells)
    R += fm.dead_load(z.test.u, edge, (0, 6.0))
    if way == "tying":
        newton["tying"] = Tying(z.space, body, cells)
    else:
        R += fm.ghost_penalty(z, cells, law)
    return ImplicitMPM(R, z, scheme, body, carried=[edge], newton=newton, observers=observers)


@pytest.mark.mpi
@pytest.mark.parametrize("way", ["ghost penalty", "tying", "quadratic", "osgs"])
def test_implicit_steps(way):
    kind = quadrilateral if way == "quadratic" else mesh.CellType.triangle
    partitioner = basis.shared_vertex_partitioner

    def domain():
        return mesh.create_rectangle(comm, [(0, 0), (2, 2)], [8, 8], kind, partitioner=partitioner)

    alone = implicit(domain(), way)
    run = Rebalanced(lambda domain: implicit(domain, way), domain())
    for k in range(4):
        alone.step((0.02, 0.01)[k % 2])
        run.sim.step((0.02, 0.01)[k % 2])
        run.rebalance()
        assert_at_home(run.sim)
        assert_close(alone, run.sim)
    assert run.sim.next_dt == alone.next_dt
    assert imbalance(run.sim) < 1.25  # two cells more than the mean
    # steps that run tries, after a mesh has changed
    ends = [[step.time for step in sim.run(0.1)] for sim in (alone, run)]
    assert ends[1] == pytest.approx(ends[0])
    assert_close(alone, run.sim)


def by_forms(domain):
    """A block that falls onto the floor of triangles; its edge is pulled."""
    body = rubber(domain, lambda x: (x[0] < 1.0) & (abs(x[1] - 0.9) < 0.4))
    edge = on_curve(domain, (1.0, 0.5), (1.0, 1.3), spacing=0.1)
    z = fm.Unknown(domain, "v")
    z.fix("v", lambda x: np.isclose(x[0], 0))
    R = fm.internal_force(z.test.v, body, Hencky(250.0, 0.3))
    R += fm.dead_load(z.test.v, edge, (0, 6.0))
    return ExplicitMPM(R, z, body, carried=[edge], damping=0.1)


def pushed(domain):
    """A block on a lattice that a rigid box pushes."""
    body = rubber(domain, lambda x: (abs(x[0] - 1.2) < 0.3) & (abs(x[1] - 0.9) < 0.4))
    box = RigidBody(shapes.Box([0.5, 0.2], [0.93, 1.6]), reach=0.05, velocity=(1.0, 0.0))
    z = fm.Unknown(domain, "v")
    return ExplicitMPM(
        fm.internal_force(z.test.v, body, Hencky(250.0, 0.3)), z, body, dt=2e-3, rigid=[box]
    )


@pytest.mark.mpi
@pytest.mark.parametrize("build", [by_forms, pushed])
def test_explicit_steps(build):
    kind = mesh.CellType.triangle if build is by_forms else quadrilateral

    def domain():
        return mesh.create_rectangle(comm, [(0, 0), (2, 2)], [8, 8], kind)

    alone, run = build(domain()), Rebalanced(build, domain())
    assert type(alone._way).__name__ == {by_forms: "ByForms", pushed: "OnLattice"}[build]
    for k in range(3):
        for _ in range(4):
            alone.step()
            run.sim.step()
        alone.settle()  # lengths of steps are found anew there
        run.rebalance()
        assert_at_home(run.sim)
        assert_close(alone, run.sim)
    if alone.rigid:
        assert run.sim.rigid[0].moved == pytest.approx(alone.rigid[0].moved, rel=1e-14)
        assert by_id(alone.bodies[0])["v"][:, 0].max() > 0.5
    assert imbalance(run.sim) < 1.4  # a cell more than the mean


@pytest.mark.mpi
def test_tags_and_observers_go_along(tmp_path):
    path = comm.bcast(tmp_path) / "block.csv"
    history = io.History({"x [m]": lambda sim: sim.bodies[0].bounds()[1][0]}, path)
    series = io.Series(path.with_suffix(".vtkhdf"), lambda sim: sim.bodies[0], fields=["v"])
    known = []

    def build(domain, left, filled):
        body = fill(domain, 2, cells=filled.find(3))
        fm.set_initial_state(body, 1.0, velocity=(1.0, 0.0))
        z = fm.Unknown(domain, "v")
        z.fix("v", left.find(1))
        known.append([seen(domain, tags) for tags in (left, filled)])
        R = fm.internal_force(z.test.v, body, Hencky(10.0, 0.3))
        return ExplicitMPM(R, z, body, dt=1e-2, observers=[history, series])

    domain = mesh.create_unit_square(comm, 6, 6)
    domain.topology.create_connectivity(1, 2)
    facets = mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[0], 0))
    cells = mesh.locate_entities(domain, 2, lambda x: x[0] < 0.51)
    tags = (
        mesh.meshtags(domain, 1, facets, np.full(len(facets), 1, dtype=np.int32)),
        mesh.meshtags(domain, 2, cells, np.full(len(cells), 3, dtype=np.int32)),
    )
    run = Rebalanced(build, domain, *tags, most=10)
    for step in run.run(0.1):
        if step.number in (3, 6):
            run.rebalance()
    assert len(known) == (1 if comm.size == 1 else 3)
    assert all(one == known[0] for one in known) and len(known[0][0]) == 6
    assert len(history["x [m]"]) == len(io.read_history(path)["x [m]"]) == 11
    assert history["t [s]"] == pytest.approx(np.linspace(0, 0.1, 11))
    assert series.times == pytest.approx(np.linspace(0, 0.1, 11))


@pytest.mark.mpi
def test_totals_of_sources_and_sinks_go_on(tmp_path):
    """They are made anew with the mesh, and count all that has come and gone; so in a restart."""
    flows, rho, h = [], 2.0, 0.125

    def build(domain):
        body = fill(domain, 2, inside=lambda x: x[0] < 0.75)
        fm.set_initial_state(body, rho, (1.0, 0.0))
        inlet = on_curve(domain, (0, 1), (0, 0), spacing=h / 2)
        z = fm.Unknown(domain, "v")
        z.fix("v", lambda x: np.isclose(x[0], 0), (1.0, 0.0))
        R = fm.internal_force(z.test.v, body, NewtonianFluid(kappa=1e3, mu=1.0))
        flows.append(
            (Source(body, inlet, rho, (1.0, 0.0), h / 2), Sink(body, lambda x: x[0] > 0.8))
        )
        return ExplicitMPM(R, z, body, dt=5e-3, observers=flows[-1], on_exit="delete")

    def totals():
        return [(w.count, w.mass) for w in flows[-1]]

    def domain():
        return mesh.create_unit_square(comm, 8, 8, quadrilateral)

    run, path = Rebalanced(build, domain(), most=10), comm.bcast(tmp_path) / "flow.h5"
    start = comm.allreduce(run.sim.bodies[0]["mass"].sum())
    for step in run.run(0.5):
        if step.number in (30, 60):
            run.rebalance()
        if step.number == 70:
            io.checkpoint.save(path, run.sim)
    assert len(flows) == (1 if comm.size == 1 else 3)
    (came, mass_in), (went, mass_out) = totals()
    assert came == 8 * 16 and mass_in == pytest.approx(rho * 0.5)
    assert type(came) is int and 16 * 6 < went < 16 * 8
    mass = comm.allreduce(run.sim.bodies[0]["mass"].sum())
    assert mass == pytest.approx(start + mass_in - mass_out)
    again = build(domain())
    io.checkpoint.restore(path, again)
    for _ in again.run(0.5):
        pass
    assert totals() == [pytest.approx(t) for t in [(came, mass_in), (went, mass_out)]]


# --- when it is worth it --------------------------------------------------------------------------


def drop(domain, size=0.1, velocity=0.0, observers=()):
    """A drop within one cell, or a larger one."""
    body = lattice(domain, size / 4, inside=lambda x: abs(x[:2] - 0.125).max(axis=0) < size / 2)
    fm.set_initial_state(body, 1.0, velocity=(velocity, velocity))
    z = fm.Unknown(domain, "v")
    R = fm.internal_force(z.test.v, body, Hencky(10.0, 0.3))
    return ExplicitMPM(R, z, body, dt=1e-2, observers=observers)


@pytest.mark.mpi
def test_it_is_not_tried_again_and_again_in_vain(monkeypatch):
    run = Rebalanced(drop, mesh.create_unit_square(comm, 4, 4, quadrilateral))
    asked, meshes, plan = [], [], Rebalanced._plan

    def planned(self):
        asked.append(self.sim.number)
        return plan(self)

    monkeypatch.setattr(Rebalanced, "_plan", planned)
    for _ in run.run(0.4):
        meshes.append(run.mesh)
    assert imbalance(run.sim) == comm.size
    assert all(m is meshes[0] for m in meshes)
    assert asked == ([] if comm.size == 1 else [0, 2, 5, 10, 19, 36])


@pytest.mark.mpi
def test_few_cells_for_many_ranks():
    """Ranks may get no cell at all."""
    domain = mesh.create_unit_square(comm, 2, 1, quadrilateral)
    run = Rebalanced(drop, domain)
    alone = drop(domain)
    for _ in range(2):
        run.rebalance()
        run.sim.step()
        alone.step()
    assert_close(alone, run.sim)


@pytest.mark.mpi
def test_points_that_were_held_back_are_not_counted_again():
    def build(domain):
        body = lattice(domain, 0.05, inside=lambda x: x[0] > 0.7)
        fm.set_initial_state(body, 1.0, velocity=lambda x: np.array([x[0], 0 * x[0]]))
        z = fm.Unknown(domain, "v")
        R = fm.internal_force(z.test.v, body, Hencky(10.0, 0.3))
        return ExplicitMPM(R, z, body, dt=1e-2, on_exit="clamp")

    run = Rebalanced(build, mesh.create_unit_square(comm, 4, 4, quadrilateral))
    alone = build(mesh.create_unit_square(comm, 4, 4, quadrilateral))
    removed = []
    for _ in range(6):
        removed.append((alone.step().removed, run.sim.step().removed))
        run.rebalance()
    assert max(removed) > (0, 0)
    assert all(one == other for one, other in removed)
    assert_close(alone, run.sim)


# --- wrong use ------------------------------------------------------------------------------------


@pytest.mark.mpi
def test_wrong_use():
    def domain():
        return mesh.create_unit_square(comm, 4, 4, quadrilateral)

    with pytest.raises(ValueError, match="most must be above 1"):
        Rebalanced(drop, domain(), most=1)
    with pytest.raises(ValueError, match="not nan"):
        Rebalanced(drop, domain(), most=float("nan"))
    with pytest.raises(TypeError, match=r"build must return an ImplicitMPM or Ex.*not NoneType"):
        Rebalanced(lambda domain: None, domain())
    with pytest.raises(TypeError, match="not str"):  # on one rank only
        Rebalanced(lambda domain: ("none", drop(domain))[comm.rank > 0], domain())
    other = domain()
    with pytest.raises(ValueError, match="on the mesh that it gets"):
        Rebalanced(lambda domain: drop(other), domain())


class Ear(Observer):
    """Simulations that have started."""

    def __init__(self):
        self.heard = []

    def start(self, sim):
        self.heard.append(sim)


@pytest.mark.mpi
@pytest.mark.parametrize("kind", ["implicit", "explicit"])
def test_observers_hear_of_no_simulation_that_is_refused(kind):
    def build(domain):
        if kind == "implicit":
            return implicit(domain, "ghost penalty", [ear])
        return drop(domain, observers=[ear])

    ear = Ear()
    domains = [mesh.create_rectangle(comm, [(0, 0), (2, 2)], [8, 8]) for _ in range(2)]
    with pytest.raises(ValueError, match="on the mesh that it gets"):
        Rebalanced(lambda domain: build(domains[1]), domains[0])
    assert ear.heard == []
    run = Rebalanced(build, domains[0])
    assert ear.heard == []
    first = run.sim
    for _ in range(2):
        run.sim.step()
    assert ear.heard == [first]
    run.rebalance()
    for _ in run.sim.run(run.sim.time + 0.02):
        pass
    assert ear.heard == ([first] if comm.size == 1 else [first, run.sim])


@pytest.mark.mpi
@pytest.mark.skipif(comm.size == 1, reason="nothing is built anew")
def test_another_simulation_is_refused(said):
    def changing(domain):
        sim = implicit(domain, "ghost penalty") if count else drop(domain)
        for name, shape in fields[len(count)]:
            sim.bodies[0].add_field(name, shape)
        count.append(1)
        return sim

    def domain():
        return mesh.create_rectangle(comm, [(0, 0), (2, 2)], [4, 4])

    count, fields = [], [[], []]
    run = Rebalanced(changing, domain())
    old = run.sim
    with pytest.raises(ValueError, match="its scheme is ExplicitMPM, here it is Bossak; it has"):
        run.rebalance()
    assert run.sim is old
    run.sim.step()

    for fields, match in (
        ([[("T", ())], []], "point set 0 has fields that are missing here: T. Let build make"),
        ([[], [("T", ())]], "point set 0 lacks fields that are here: T"),
        ([[("T", ())], [("T", (2,))]], r"has 'T' of shape \(\), here it is \(2,\)"),
    ):
        fields, calls = list(fields), []

        def build(domain, fields=fields, calls=calls):
            sim = drop(domain)
            for name, shape in fields[len(calls)]:
                sim.bodies[0].add_field(name, shape)
            calls.append(1)
            return sim

        run = Rebalanced(build, domain())
        with pytest.raises(ValueError, match=match):
            run.rebalance()
    said.clear()
    run = Rebalanced(drop, domain())
    run.sim.damping = 0.3
    run.rebalance()
    assert run.sim.damping == 0.0
    assert said == ["the simulation had the damping 0.3; build has made it 0.0"]


@pytest.mark.mpi
@pytest.mark.parametrize("kind", [pytest.param("implicit", marks=pytest.mark.slow), "explicit"])
def test_nothing_piles_up(kind):
    """Neither communicators, of which MPI has about 2000, nor memory."""

    def build(domain):
        return implicit(domain, "ghost penalty") if kind == "implicit" else dam_break(domain)

    run = Rebalanced(build, mesh.create_rectangle(comm, [(0, 0), (2, 2)], [8, 8], quadrilateral))
    gc.collect()
    before = sum(isinstance(o, ImplicitMPM | ExplicitMPM) for o in gc.get_objects())
    used = []
    for _ in range(30):
        run.sim.step()
        run.rebalance()
        used.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
    gc.collect()
    kept = [o for o in gc.get_objects() if isinstance(o, ImplicitMPM | ExplicitMPM)]
    assert len(kept) <= before + 1
    assert used[-1] - used[9] < 20  # MB
