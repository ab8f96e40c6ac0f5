# SPDX-License-Identifier: MIT
"""A simulation goes on from a checkpoint as if it had not been interrupted."""

import errno
import os
import resource
import signal
import subprocess
import sys

from mpi4py import MPI

import h5py
import numpy as np
import pytest
from dolfinx import mesh

import fenicsmpm
from fenicsmpm import ExplicitMPM, ImplicitMPM, MaterialPoints, basis
from fenicsmpm import formulations as fm
from fenicsmpm.io import checkpoint, skeleton
from fenicsmpm.io.checkpoint import CheckpointError
from fenicsmpm.materials import Hencky, NeoHookean
from fenicsmpm.points import fill, lattice, migration, on_curve

pytestmark = pytest.mark.ranks

comm = MPI.COMM_WORLD


@pytest.fixture
def directory(tmp_path):
    """The same directory on all ranks."""
    return comm.bcast(tmp_path)


def cantilever(
    scheme=fm.Bossak, stabilization="asgs", on=comm, size=2.0, cell=mesh.CellType.triangle, E=250.0
):  # fmt: skip
    """A block of rubber in a coarse mesh, clamped on the left, pulled up on the right."""
    domain = mesh.create_rectangle(on, [(0, 0), (size, 2)], [6, 6], cell)
    body = lattice(domain, 0.15, inside=lambda x: (x[0] < 1.2) & (abs(x[1] - 0.9) < 0.4))
    edge = on_curve(domain, (1.2, 0.5), (1.2, 1.3), spacing=0.1)
    fm.set_initial_state(body, 1.0, velocity=lambda x: np.array([0 * x[0], 2.5 * x[0]]))
    z = fm.Unknown(domain, "u", "p")
    z.fix("u", lambda x: np.isclose(x[0], 0))
    law = NeoHookean(E, 0.5)
    scheme = scheme(z, dt=0.02)
    R = fm.stabilized(stabilization, z, body, law, force=scheme.force(body))
    R += fm.dead_load(z.test.u, edge, (0, 6.0))
    # GMRES, the default for projections, keeps factors from step to step
    newton = {"petsc_options": {"pc_type": "lu"}} if stabilization == "osgs" else {}
    return ImplicitMPM(R, z, scheme, body, carried=[edge], newton=newton)


def advance(sim, steps=3):
    """Steps of different lengths."""
    for _ in range(steps):
        sim.step((0.02, 0.01)[sim.number % 2])
    return sim


def state(sim):
    sets = [*sim.bodies, *sim.carried]
    numbers = (sim.time, sim.number, sim.next_dt, float(sim.scheme.dt.value), sim.memory)
    return numbers, [(points.next_id, points.size_global, points.snapshot()) for points in sets]


def assert_same(one, other):
    """Equal bit by bit, on each rank."""
    assert one[0] == other[0]
    for (id1, size1, arrays1), (id2, size2, arrays2) in zip(one[1], other[1], strict=True):
        assert (id1, size1, list(arrays1)) == (id2, size2, list(arrays2))
        for name in arrays1:
            assert arrays1[name].dtype == arrays2[name].dtype
            assert np.array_equal(arrays1[name], arrays2[name]), name


def by_id(points):
    parts = points.mesh.comm.allgather(points.snapshot())
    arrays = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    order = np.argsort(arrays["id"])
    return {name: a[order] for name, a in arrays.items() if name not in ("cell", "xi")}


def assert_close(one, other):
    """Equal to round-off, whichever rank has the points."""
    for points, others in zip(
        (*one.bodies, *one.carried), (*other.bodies, *other.carried), strict=True
    ):
        assert points.next_id == others.next_id
        mine, theirs = by_id(points), by_id(others)
        for name in mine:
            size = np.max(np.abs(mine[name]), initial=0.0)
            np.testing.assert_allclose(theirs[name], mine[name], rtol=0, atol=1e-9 * size)


@pytest.mark.mpi
@pytest.mark.parametrize(
    "scheme,stabilization", [(fm.Bossak, "asgs"), (fm.BDF2, "asgs"), (fm.Bossak, "osgs")]
)
def test_goes_on_bit_by_bit(scheme, stabilization, directory):
    if stabilization == "osgs" and comm.size > 2:
        pytest.skip("on three ranks MUMPS sums up in the order in which parts arrive")
    path = directory / "new" / "three.h5"
    sim = advance(cantilever(scheme, stabilization))
    sim.bodies[0].remove(sim.bodies[0].id == 7)
    sim.bodies[0].sort()
    sim.next_dt = 0.0125
    checkpoint.save(path, sim)
    saved = state(sim)
    uninterrupted = state(advance(sim))
    assert comm.allreduce(np.abs(sim.bodies[0]["u"]).max(initial=0.0), MPI.MAX) > 0.1

    again = cantilever(scheme, stabilization)
    checkpoint.restore(path, again)
    assert_same(state(again), saved)
    assert_same(state(advance(again)), uninterrupted)
    checkpoint.restore(path, again)  # also back in time
    assert_same(state(again), saved)
    assert [file.name for file in path.parent.iterdir()] == ["three.h5"]


@pytest.mark.mpi
def test_goes_on_within_run(directory):
    sim = cantilever()
    for step in sim.run(0.12):
        if step.number == 3:
            checkpoint.save(directory / "run.h5", sim)
    again = cantilever()
    checkpoint.restore(directory / "run.h5", again)
    assert [step.number for step in again.run(0.12)] == [4, 5, 6]
    assert_same(state(again), state(sim))


def test_the_longest_step_is_kept(directory):
    """A run whose greatest length was set goes on with it, also after steps that were cut."""
    sim = cantilever()
    steps = list(sim.run(0.03, step_length=lambda: 0.01))
    assert [step.dt for step in steps] == pytest.approx([0.01] * 3)
    sim.next_dt = 0.0025
    checkpoint.save(directory / "run.h5", sim)
    again = cantilever()
    checkpoint.restore(directory / "run.h5", again)
    lengths = [[step.dt for step in s.run(0.0675)] for s in (sim, again)]
    assert lengths[0] == pytest.approx([0.0025, 0.005, 0.01, 0.01, 0.01])
    assert lengths[1] == lengths[0]


@pytest.mark.mpi
def test_the_start_is_a_state_too(directory):
    sim = cantilever()
    checkpoint.save(directory / "start.h5", sim)
    again = advance(cantilever(), 1)
    checkpoint.restore(directory / "start.h5", again)
    assert_same(state(advance(again, 2)), state(advance(sim, 2)))


@pytest.mark.mpi
@pytest.mark.parametrize("writer", ["one rank", "all ranks"])
def test_goes_on_with_another_number_of_ranks(writer, directory, monkeypatch):
    monkeypatch.setattr(migration, "_AT_A_TIME", 7)  # points that all ranks look for
    alone = {"one rank": MPI.COMM_SELF, "all ranks": comm}[writer]
    sim = advance(cantilever(on=alone))
    mine = directory / (f"{comm.rank}.h5" if writer == "one rank" else "0.h5")
    checkpoint.save(mine, sim)
    comm.barrier()
    again = cantilever(on=comm if writer == "one rank" else MPI.COMM_SELF)
    checkpoint.restore(directory / "0.h5", again)
    body = again.bodies[0]
    assert np.all(body.cell < body.mesh.topology.index_map(2).size_local)
    assert_close(sim, again)
    assert_close(advance(sim), advance(again))
    assert again.time == sim.time


@pytest.mark.mpi
def test_goes_on_with_another_distribution(directory, monkeypatch):
    sim, take = advance(cantilever()), checkpoint.take

    def of_others(sim):
        """Points in another order, in cells that mean nothing here."""
        result = take(sim)
        for points in result.sets:
            points.arrays["cell"] = np.full_like(points.arrays["cell"], -9)
            points.arrays = {name: array[::-1] for name, array in points.arrays.items()}
        return result

    with monkeypatch.context() as patch:
        patch.setattr(checkpoint, "take", of_others)
        patch.setattr(checkpoint, "layout", lambda mesh: ["of others"] * comm.size)
        checkpoint.save(directory / "a.h5", sim)
    again = cantilever()
    checkpoint.restore(directory / "a.h5", again)
    assert_close(sim, again)
    assert_close(advance(sim), advance(again))


@pytest.mark.mpi
def test_ids_of_new_points_go_on(directory):
    sim = cantilever()
    body = sim.bodies[0]
    body.remove(body.id >= body.next_id - 5)
    checkpoint.save(directory / "a.h5", sim)
    again = cantilever()
    checkpoint.restore(directory / "a.h5", again)
    for points in (body, again.bodies[0]):
        points.add(points.select(points.id == 3))
    assert_same(state(again), state(sim))
    assert len(np.unique(by_id(body)["id"])) == body.size_global


def refuse(path, sim, match, kind=CheckpointError):
    """It does not restore, says why on all ranks, and leaves the simulation as it was."""
    before = state(sim)
    with pytest.raises(kind, match=match):
        checkpoint.restore(path, sim)
    assert_same(state(sim), before)


@pytest.mark.mpi
def test_other_simulations_are_refused(directory):
    path = directory / "a.h5"
    sim = advance(cantilever(), 1)
    checkpoint.save(path, sim)
    refuse(path, cantilever(size=2.1), r"its mesh is 72 cells \(triangle\), 49 nodes, checksum")
    refuse(path, cantilever(cell=mesh.CellType.quadrilateral), r"here it is 36 cells \(quad")
    refuse(path, cantilever(fm.BDF2), "its scheme is Bossak, here it is BDF2")

    more = cantilever()
    more.bodies[0].add_field("damage")
    refuse(path, more, "point set 0 lacks fields that are here: damage.*with the script")
    checkpoint.save(directory / "more.h5", more)
    refuse(directory / "more.h5", cantilever(), "point set 0 has fields that are missing here: dam")
    other = cantilever()
    other.bodies[0].add_field("damage", (2,))
    refuse(directory / "more.h5", other, r"'damage' of shape \(\), here it is \(2,\)")

    more = cantilever()
    more.carried.append(MaterialPoints(more.bodies[0].mesh, np.empty((0, 2)), 1.0))
    refuse(path, more, "it has 2 point sets, here are 3")


@pytest.mark.mpi
def test_other_formats_are_refused(directory):
    path = directory / "a.h5"
    sim = cantilever()
    checkpoint.save(path, sim)
    if comm.rank == 0:
        with h5py.File(path, "r+") as file:
            assert file.attrs["fenicsmpm"] == fenicsmpm.__version__
            file.attrs["format"] = 99
            file.attrs["fenicsmpm"] = "7.0"
    comm.barrier()
    refuse(path, sim, r"format 99 \(fenicsmpm 7.0\).*reads format 3: restore it with the version")


@pytest.mark.mpi
def test_damaged_files_are_refused(directory):
    path = directory / "a.h5"
    sim = cantilever()
    checkpoint.save(path, sim)
    if comm.rank == 0:
        whole = path.read_bytes()
        for name, cut in (("empty", 0), ("head", 50), ("half", len(whole) // 2), ("last", -1)):
            (directory / f"{name}.h5").write_bytes(whole[:cut])
        (directory / "text.h5").write_text("t [s],u [m]\n" * 1000)
        with h5py.File(directory / "hdf5.h5", "w") as file:
            file["x"] = np.ones(3)
        for name, change in (
            ("rows", lambda f: f["points/1"].attrs.update(counts=[1])),
            ("names", lambda f: f.attrs.__delitem__("layout")),
            ("sets", lambda f: f.__delitem__("points")),
            ("time", lambda f: f.attrs.__setitem__("time", 1.0)),
        ):
            (directory / f"{name}.h5").write_bytes(whole)
            with h5py.File(directory / f"{name}.h5", "r+") as file:
                change(file)
    comm.barrier()
    for name in ("empty", "head", "half", "last", "text", "names", "sets"):
        refuse(directory / f"{name}.h5", sim, f"{name}.h5 is no checkpoint or is incomplete")
    refuse(directory / "hdf5.h5", sim, "no checkpoint of fenicsmpm")
    refuse(directory / "time.h5", sim, "is damaged: its checksum is wrong")
    refuse(directory / "rows.h5", sim, "is damaged: it has 8 values of 'cell' for 1 points")
    refuse(directory / "none.h5", sim, "none.h5", FileNotFoundError)


def test_a_file_too_large_leaves_the_older_one(directory):
    """The system's own error, in the middle of the file: as for a full disk, errno apart."""
    path = directory / "a.h5"
    sim = cantilever()
    checkpoint.save(path, sim)
    before = path.read_bytes()
    advance(sim, 1)
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (len(before) // 2, limits[1]))
        with pytest.raises(OSError, match=r"t = 0.02 s could not be written.*a\.h5") as caught:
            checkpoint.save(path, sim)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert caught.value.errno == errno.EFBIG
    assert [file.name for file in directory.iterdir()] == ["a.h5"]
    assert path.read_bytes() == before


@pytest.mark.mpi
def test_a_full_disk_leaves_the_older_one(directory, monkeypatch):
    path = directory / "a.h5"
    sim = cantilever()
    checkpoint.save(path, sim)
    saved = state(sim)
    advance(sim, 1)

    def full(descriptor):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", full)
        with pytest.raises(OSError, match="No space left on device; make room") as caught:
            checkpoint.save(path, sim)
    assert caught.value.errno == errno.ENOSPC
    assert [file.name for file in directory.iterdir()] == ["a.h5"]
    again = cantilever()
    checkpoint.restore(path, again)
    assert_same(state(again), saved)


KILLED = """
import resource, signal, sys
sys.path.insert(0, sys.argv[1])
from test_checkpoint import advance, cantilever, checkpoint
sim = advance(cantilever(), 1)
checkpoint.save(sys.argv[2], sim)
advance(sim, 1)
signal.signal(signal.SIGXFSZ, signal.SIG_DFL)  # the system kills who writes more than that
resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, 10_000))
checkpoint.save(sys.argv[2], sim)
"""


def test_a_run_killed_while_writing_leaves_the_older_one(directory):
    path = directory / "a.h5"
    command = [sys.executable, "-c", KILLED, os.path.dirname(__file__), str(path)]
    assert subprocess.run(command).returncode == -signal.SIGXFSZ
    unfinished = directory / "a.h5.tmp"
    assert 0 <= unfinished.stat().st_size <= 10_000
    sim = cantilever()
    checkpoint.restore(path, sim)
    assert sim.number == 1
    checkpoint.save(path, advance(sim, 1))
    assert not unfinished.exists()
    again = cantilever()
    checkpoint.restore(path, again)
    assert_same(state(again), state(sim))


@pytest.mark.mpi
def test_directories_that_cannot_be_made(directory):
    (directory / "file").touch()
    comm.barrier()
    with pytest.raises(OSError, match="could not be written"):
        checkpoint.save(directory / "file" / "a.h5", cantilever())


@pytest.mark.mpi
def test_a_flipped_byte_is_noticed(directory):
    path = directory / "a.h5"
    sim = advance(cantilever(), 1)
    checkpoint.save(path, sim)
    if comm.rank == 0:
        whole = bytearray(path.read_bytes())
        value = sim.bodies[0]["F"][:1].tobytes()
        at = whole.find(value)
        assert at > 0
        whole[at + 3] ^= 1
        (directory / "flipped.h5").write_bytes(whole)
    comm.barrier()
    refuse(directory / "flipped.h5", sim, "is damaged: its checksum is wrong")


def test_skeletons_take_no_room_for_numbers(directory):
    """Tables of HDF5 lie among the numbers, which are written beside it."""
    pages, numbers = skeleton.Pages(), np.arange(30_000.0)
    with h5py.File(pages, "w") as file:
        places = [
            skeleton.add_dataset(file, "large", (10**6, 1000, 9), np.float64),
            skeleton.add_dataset(file.create_group("some"), "numbers", (10_000, 3), np.float64),
            skeleton.add_dataset(file, "none", (0, 3), np.int32),
        ]
        file.attrs["what"] = "text"
    assert sum(map(len, pages._pages.values())) < 100_000
    path = directory / "holes.h5"
    pages.copy_to(path)
    with open(path, "r+b") as stream:
        skeleton.write_at(stream.fileno(), places[1], numbers)
    status = path.stat()
    assert status.st_size > 72e9 and 512 * status.st_blocks < 1e6
    with h5py.File(path) as file:
        assert file["large"].shape == (10**6, 1000, 9) and file["none"].shape == (0, 3)
        assert np.array_equal(file["some/numbers"][()], numbers.reshape(-1, 3))
        assert file.attrs["what"] == "text"


def block(nu=0.3, functions="quadratic", averages=None):
    domain = mesh.create_unit_square(comm, 4, 4, mesh.CellType.quadrilateral)
    body = fill(domain, 2)
    basis.use(body, functions)
    fm.set_initial_state(body, 1.0)
    z = fm.Unknown(domain, "v")
    return ExplicitMPM(fm.internal_force(z.V, body, Hencky(10.0, nu), fbar=averages), z, body)


@pytest.mark.mpi
def test_what_was_chosen_otherwise_is_said(directory, said):
    path = directory / "a.h5"
    checkpoint.save(path, block())
    checkpoint.restore(path, block())
    assert not said
    checkpoint.restore(path, block(nu=0.2, functions="cubic"))
    if comm.rank == 0:
        functions, law = said
        assert "the law of body 0 Hencky(E=10 Pa, nu=0.3); here it is Hencky(E=10 Pa, nu=0.2" in law
        assert "grid functions of point set 0 quadratic; here it is cubic" in functions
    said.clear()
    for scheme in (fm.Bossak, fm.Newmark):
        checkpoint.save(path, cantilever(scheme))
        checkpoint.restore(path, cantilever(scheme))
    assert not said
    stiff = cantilever(fm.Newmark, E=260.0)
    checkpoint.restore(path, stiff)
    if comm.rank == 0:
        (line,) = said
        assert "the residual of digest" in line
