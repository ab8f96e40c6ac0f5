# SPDX-License-Identifier: MIT
"""Series are read again by VTK with the right times and numbers, whatever happened meanwhile."""

import errno
import fcntl
import os
import resource
import shutil
import signal
import subprocess
import sys
from contextlib import contextmanager
from types import SimpleNamespace

from mpi4py import MPI

import h5py
import numpy as np
import pytest
import pyvista
from dolfinx import fem, mesh
from vtkmodules.vtkCommonExecutionModel import vtkStreamingDemandDrivenPipeline

import fenicsmpm
from fenicsmpm import io
from fenicsmpm.io import growing, vtkhdf
from fenicsmpm.points import MaterialPoints, fill

pytestmark = pytest.mark.ranks

comm = MPI.COMM_WORLD


@pytest.fixture
def directory(tmp_path):
    """The same directory on all ranks."""
    return comm.bcast(tmp_path)


@pytest.fixture
def points():
    result = fill(mesh.create_unit_square(comm, 4, 4), 1)
    result.add_field("u", (2,))
    return result


def read_here(path):
    """Times, and what VTK reads at each of them, on this rank."""
    with open(path, "rb") as stream, h5py.File(stream) as file:
        times = file["VTKHDF/Steps/Values"][:].tolist()
    reader = pyvista.HDFReader(path).reader
    reader.UpdateInformation()
    found = reader.GetOutputInformation(0).Get(vtkStreamingDemandDrivenPipeline.TIME_STEPS())
    assert found == (tuple(times) if len(times) > 1 else None)  # VTK sees no series in one time
    grids = []
    for time in times:
        reader.UpdateTimeStep(time)
        grids.append(pyvista.wrap(reader.GetOutput()).copy())
    return times, grids


def read(path):
    """The same when all ranks have come here."""
    comm.barrier()
    result = read_here(path)
    comm.barrier()
    return result


def by_id(grid, name):
    return grid[name][np.argsort(grid["id"])]


def firsts(grids, name):
    """Values that are the same at all points."""
    for grid in grids:
        assert np.all(grid[name] == grid[name][0])
    return [grid[name].flat[0] for grid in grids]


def names(directory):
    comm.barrier()
    found = sorted(file.name for file in directory.iterdir())
    comm.barrier()
    return found


@pytest.mark.mpi
def test_points_are_read_as_written(points, directory):
    path = directory / "new" / "cook.vtkhdf"
    points.add_field("F", (3, 3))
    points.add_field("f", (2, 2), np.array([[1.0, 2.0], [3.0, 4.0]]))
    points.add_field("a/b", ())
    points.add_field("state", (0,))
    times = [0.0, 0.1, 0.1 + 0.2, 1e3]
    parameters = {"E [Pa]": 250.0, "law": "Mooney–Rivlin", "steps": 3, "rho [kg/m^3]": 1.5}
    series = io.Series(path, points, parameters)
    cloud = io.gather_points(points)
    for time in times:
        points["u"] = time * points.x
        points["F"] = time * np.arange(9.0).reshape(3, 3)
        series.write(time)
    assert series.times == times
    found, grids = read(path)
    assert found == times
    for time, grid in zip(times, grids, strict=True):
        assert grid.n_points == grid.n_cells == points.size_global == 32
        assert set(grid.point_data.keys()) == {"id", "tag", "weight", "u", "F", "f", "a_b"}
        assert np.array_equal(grid["u"], time * grid.points)
        assert np.array_equal(grid["F"], np.tile(time * np.arange(9.0), (32, 1)))
        assert np.array_equal(grid["f"], np.tile([1.0, 2, 0, 3, 4, 0, 0, 0, 0], (32, 1)))
        assert [cell.point_ids for cell in grid.cell] == [[i] for i in range(32)]
        if comm.rank == 0:
            assert np.array_equal(grid.points[np.argsort(grid["id"])], cloud.points)
            assert np.array_equal(by_id(grid, "weight"), cloud["weight"])
        data = grid.field_data
        assert data["fenicsmpm version"][0] == fenicsmpm.__version__
        assert (data["E [Pa]"][0], data["steps"][0], data["rho [kg_m^3]"][0]) == (250.0, 3, 1.5)
        assert data["law"][0] == "Mooney–Rivlin"
    assert names(directory / "new") == ["cook.vtkhdf"]


@pytest.mark.mpi
@pytest.mark.parametrize("cell", ["triangle", "quadrilateral", "tetrahedron", "hexahedron"])
def test_functions_are_read_as_written(cell, directory):
    kind = mesh.CellType[cell]
    if cell in ("triangle", "quadrilateral"):
        domain = mesh.create_unit_square(comm, 3, 3, kind)
    else:
        domain = mesh.create_unit_cube(comm, 3, 3, 3, kind)
    dim = domain.geometry.dim
    p = fem.Function(fem.functionspace(domain, ("Lagrange", 1)), name="p")
    u = fem.Function(fem.functionspace(domain, ("Lagrange", 1, (dim,))), name="u")
    series = io.Series(directory / "grid.vtkhdf", [p, u])
    for time in (0.5, 1.0, 2.0):
        p.interpolate(lambda x, t=time: t + x[0] + 2 * x[1] - x[2])
        u.interpolate(lambda x, t=time: np.stack([t * x[1], 3 * x[0], x[2]][:dim]))
        series.write(time)
    times, grids = read(directory / "grid.vtkhdf")
    assert times == [0.5, 1.0, 2.0]
    for time, grid in zip(times, grids, strict=True):
        assert grid.n_points == 4**dim  # each node once, so that nothing tears
        assert grid.n_cells == domain.topology.index_map(dim).size_global
        measure = ("Area", "Volume")[dim - 2]
        assert np.sum(grid.compute_cell_sizes()[measure]) == pytest.approx(1.0, rel=1e-12)
        x, y, z = grid.points.T
        np.testing.assert_allclose(grid["p"], time + x + 2 * y - z, atol=1e-14)
        np.testing.assert_allclose(grid["u"], np.stack([time * y, 3 * x, z], axis=1), atol=1e-14)


@pytest.mark.mpi
def test_the_mesh_is_written_once(directory):
    domain = mesh.create_unit_square(comm, 64, 64)
    p = fem.Function(fem.functionspace(domain, ("Lagrange", 1)), name="p")
    series, sizes = io.Series(directory / "grid.vtkhdf", p), []
    for time in range(4):
        series.write(float(time))
        comm.barrier()
        sizes.append((directory / "grid.vtkhdf").stat().st_size)
    # 65 x 65 numbers a time
    assert np.diff(sizes).max() < 2 * 8 * 65**2 < 0.2 * sizes[0]


@pytest.mark.mpi
def test_points_come_go_and_move_to_other_ranks(directory):
    domain = mesh.create_unit_square(comm, 8, 8)
    points = fill(domain, 1, inside=lambda x: x[0] < 0.3)  # some ranks may have none
    points.add_field("u", (2,))
    series, expected = io.Series(directory / "a.vtkhdf", points), []
    for time in range(9):
        if 0 < time < 5:
            points.move(points.x + [0.15, 0.0])
        if time == 5:
            points.remove(lambda x: x[0] > 0.7)
        if time == 6:
            points.remove(lambda x: x[0] < 2)
            assert points.size_global == 0
        if time == 8:
            more = fill(domain, 2)
            more.add_field("u", (2,))
            points.add(more)
        points["u"] = 2 * points.x
        series.write(float(time))
        cloud = io.gather_points(points)
        there = cloud and (cloud.points, cloud["id"] if cloud.n_points else [])
        expected.append(comm.bcast(there))
    _, grids = read(directory / "a.vtkhdf")
    for (x, ids), grid in zip(expected, grids, strict=True):
        assert grid.n_points == grid.n_cells == len(ids)
        if len(ids) > 0:
            assert np.array_equal(grid.points[np.argsort(grid["id"])], x)
            assert np.array_equal(np.sort(grid["id"]), ids)
            assert np.array_equal(grid["u"], 2 * grid.points)
    assert [len(ids) for _, ids in expected][-3:] == [0, 0, 512]


@pytest.mark.mpi
def test_no_points_at_first(directory):
    domain = mesh.create_unit_square(comm, 2, 2)
    points = MaterialPoints(domain, np.empty((0, 2)), 1.0)
    series = io.Series(directory / "a.vtkhdf", points)
    series.write(0.0)
    points.add(fill(domain, 1, tag=3))
    series.write(1.0)
    times, grids = read(directory / "a.vtkhdf")
    assert times == [0.0, 1.0]
    assert [grid.n_points for grid in grids] == [0, 8]
    assert np.all(grids[1]["tag"] == 3)


@pytest.mark.mpi
def test_many_chunks(points, directory, monkeypatch):
    """Arrays of many chunks, of which HDF5 has to split the table."""
    monkeypatch.setattr(growing, "LEAST_CHUNK", 5)
    monkeypatch.setattr(growing, "LARGEST_CHUNK", 7)
    series = io.Series(directory / "a.vtkhdf", points)
    for k in range(40):
        points["u"] = k * points.x
        series.write(float(k))
    times, grids = read(directory / "a.vtkhdf")
    assert times == list(range(40))
    for k, grid in enumerate(grids):
        assert np.array_equal(grid["u"], k * grid.points)
        assert np.array_equal(np.sort(grid["id"]), np.arange(32))


@pytest.mark.mpi
def test_several_bodies(points, directory):
    other = fill(points.mesh, 2, tag=1)
    other.add_field("u", (2,), (7.0, 7.0))
    other.add_field("p", ())
    series = io.Series(directory / "a.vtkhdf", [points, other])
    series.write(0.0)
    other.remove(lambda x: x[0] < 0.5)
    series.write(1.0)
    _, grids = read(directory / "a.vtkhdf")
    assert [grid.n_points for grid in grids] == [32 + 128, 32 + 64]
    for grid in grids:
        assert set(grid.point_data.keys()) == {"id", "tag", "weight", "u"}
        assert np.all(grid["u"][grid["tag"] == 1, :2] == 7.0)


@pytest.mark.mpi
def test_a_choice_of_fields(points, directory):
    points.add_field("p", (), 5.0)
    series = io.Series(directory / "a.vtkhdf", points, fields=("p",))
    series.write(0.0)
    series.write(1.0)
    assert set(read(directory / "a.vtkhdf")[1][1].point_data.keys()) == {"id", "p"}
    all_of_now = io.Series(directory / "b.vtkhdf", points)
    all_of_now.write(0.0)
    points.add_field("q", ())
    all_of_now.write(1.0)
    there = {"id", "tag", "weight", "u", "p"}
    assert set(read(directory / "b.vtkhdf")[1][1].point_data.keys()) == there
    with pytest.raises(
        ValueError, match="fields s, x do not exist; available are id, tag, weight, u, p, q"
    ):
        io.Series(directory / "c.vtkhdf", points, fields=["s", "p", "x"]).write(0.0)
    assert names(directory) == ["a.vtkhdf", "b.vtkhdf"]


@pytest.mark.mpi
def test_one_simulation_after_the_other(points, directory):
    """As when a run goes on with points and mesh on another partition."""

    def at(time, sets, function):
        function.x.array[:] = time
        return SimpleNamespace(time=time, bodies=[sets], pressure=function)

    def pressure(n):
        domain = mesh.create_unit_square(comm, n, n)
        return fem.Function(fem.functionspace(domain, ("Lagrange", 1)), name="p")

    cloud = io.Series(directory / "a.vtkhdf", lambda sim: sim.bodies[0], every=0.5)
    grid = io.Series(directory / "b.vtkhdf", lambda sim: [sim.pressure])
    one, two = pressure(4), pressure(3)
    for time in (0.0, 1.0):
        sim = at(time, points, one)
        for series in (cloud, grid):
            series.begin(sim)
            series.done(sim, SimpleNamespace(time=sim.time + 0.5))
    assert cloud.times == grid.times == [0.0, 0.5, 1.5]
    fewer = fill(points.mesh, 1, inside=lambda x: x[0] < 0.5)
    fewer.add_field("u", (2,))
    sim = at(2.0, fewer, two)
    for series in (cloud, grid):
        series.begin(sim)
        series.done(sim, SimpleNamespace(time=2.5))
    assert [one.n_points for one in read(directory / "a.vtkhdf")[1]] == [32, 32, 32, 16]
    grids = read(directory / "b.vtkhdf")[1]
    assert [one.n_points for one in grids] == [25, 25, 25, 16]
    assert firsts(grids, "p") == [0.0, 0.0, 1.0, 2.0]
    assert grids[-1].n_cells == 18


@pytest.mark.mpi
def test_it_can_be_read_meanwhile(points, directory):
    path = directory / "a.vtkhdf"
    series = io.Series(path, points)
    series.write(0.0)
    for k in range(1, 4):
        with open(path, "rb") as stream:
            fcntl.flock(stream, fcntl.LOCK_SH)  # as ParaView does
            series.write(float(k))
        assert len(read(path)[0]) == k + 1


@pytest.mark.mpi
def test_goes_on_after_a_restart(points, directory):
    path = directory / "a.vtkhdf"
    first = io.Series(path, points, append=True)  # nothing there yet
    for k in range(6):
        points["u"] = float(k)
        first.write(0.1 * k)
    comm.barrier()
    size = path.stat().st_size
    # restarted from a checkpoint at t = 0.3, with longer steps
    series = io.Series(path, points, append=True)
    series.begin(SimpleNamespace(time=0.3))
    assert series.times == [0.0, 0.1, 0.2, 0.1 * 3]
    assert len(read(path)[0]) == 6  # as long as there is nothing new
    points["u"] = 9.0
    points.add_field("of the first step", ())
    series.write(0.45)
    times, grids = read(path)
    assert times == [0.0, 0.1, 0.2, 0.1 * 3, 0.45]
    assert [grid["u"][0, 0] for grid in grids] == [0.0, 1.0, 2.0, 3.0, 9.0]
    assert path.stat().st_size == size  # in the place of what was dropped
    io.Series(path, points, append=True).write(0.01)
    assert read(path)[0] == [0.0, 0.01]
    io.Series(path, points, append=True).write(0.0)
    assert read(path)[0] == [0.0]
    assert names(directory) == ["a.vtkhdf"]


@pytest.mark.mpi
def test_a_new_series_takes_the_place_of_the_old_one(points, directory):
    first = io.Series(directory / "a.vtkhdf", points)
    for k in range(4):
        first.write(float(k))
    again = io.Series(directory / "a.vtkhdf", points, fields=("u",))
    assert len(read(directory / "a.vtkhdf")[0]) == 4
    again.write(0.0)
    assert read(directory / "a.vtkhdf")[0] == [0.0]
    assert names(directory) == ["a.vtkhdf"]


@pytest.mark.mpi
def test_errors_are_raised_on_all_ranks(points, directory):
    with pytest.raises(ValueError, match=r"needs the suffix \.vtkhdf"):
        io.Series(directory / "a.pvd", points)
    with pytest.raises(ValueError, match="one or more functions"):
        io.Series(directory / "a.vtkhdf", [])
    p = fem.Function(fem.functionspace(points.mesh, ("Lagrange", 1)), name="p")
    with pytest.raises(TypeError, match="point sets or functions"):
        io.Series(directory / "a.vtkhdf", [points, p])
    series = io.Series(directory / "a.vtkhdf", points)
    series.write(1.0)
    for time in (1.0, 0.5, float("nan")):
        with pytest.raises(ValueError, match=r"must grow: .* after 1\.0 s"):
            series.write(time)
    with pytest.raises(ValueError, match=r"has the fields .*u \[3\].*, not p: choose another name"):
        io.Series(directory / "a.vtkhdf", [p], append=True).write(2.0)
    if comm.rank == 0:
        (directory / "b.vtkhdf").write_text("<VTKFile>")
        (directory / "file").touch()
    comm.barrier()
    with pytest.raises(ValueError, match=r"b\.vtkhdf is no series"):
        io.Series(directory / "b.vtkhdf", points, append=True).write(1.0)
    with pytest.raises(OSError, match=r"file/c\.vtkhdf"):
        io.Series(directory / "file" / "c.vtkhdf", points).write(0.0)
    assert read(directory / "a.vtkhdf")[0] == [1.0]


def many_points():
    """So many that each time needs more room in the file."""
    points = fill(mesh.create_unit_square(comm, 40, 40), 1)
    points.add_field("u", (2,))
    return points


def first_values(grids):
    return [grid["u"][0, 0] for grid in grids]


@pytest.mark.mpi
def test_a_file_that_cannot_grow_is_as_it_was(directory):
    """The system's own error, as for a full disk, errno apart."""
    points, path = many_points(), directory / "a.vtkhdf"
    series = io.Series(path, points)
    points["u"] = 1.0
    series.write(1.0)
    comm.barrier()
    before, limits = path.read_bytes(), resource.getrlimit(resource.RLIMIT_FSIZE)
    points["u"] = 2.0
    for other, size in ((series, len(before) + 1000), (io.Series(path, points), 10_000)):
        comm.barrier()
        try:
            resource.setrlimit(resource.RLIMIT_FSIZE, (size, limits[1]))
            with pytest.raises(OSError, match=r"t = 2 s .*File too large; make room.*a\.vtkhdf"):
                other.write(2.0)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        comm.barrier()
        assert path.read_bytes() == before
        assert names(directory) == ["a.vtkhdf"]
    series.write(2.0)
    times, grids = read(path)
    assert series.times == times == [1.0, 2.0]
    assert first_values(grids) == [1.0, 2.0]


@contextmanager
def full_disk(stage, monkeypatch):
    """No room while tables or rows are written; one rank alone finds out, amid its rows."""
    rest, write = [3], growing.Place.write

    def full(*arguments):
        rest[0] -= 1
        if stage == "tables" or rest[0] < 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return write(*arguments)

    with monkeypatch.context() as patch:
        if stage == "tables":
            patch.setattr(vtkhdf, "_put", full)
        elif comm.rank == comm.size - 1:
            patch.setattr(growing.Place, "write", full)
        yield


@pytest.mark.mpi
@pytest.mark.parametrize("stage", ["rows", "tables"])
def test_a_disk_that_is_full_later_leaves_what_was_there(stage, directory, monkeypatch):
    """Where room cannot be had in advance."""
    points, path = many_points(), directory / "a.vtkhdf"
    series = io.Series(path, points)
    points["u"] = 1.0
    series.write(1.0)
    points["u"] = 2.0
    message = r"t = 2 s .*No space left.*a\.vtkhdf"
    with full_disk(stage, monkeypatch), pytest.raises(OSError, match=message) as caught:
        series.write(2.0)
    assert caught.value.errno == errno.ENOSPC
    times, grids = read(path)
    assert series.times == times == first_values(grids) == [1.0]
    points["u"] = 3.0
    series.write(3.0)
    times, grids = read(path)
    assert times == first_values(grids) == [1.0, 3.0]


@pytest.mark.mpi
@pytest.mark.parametrize("stage", ["rows", "tables"])
def test_a_series_that_cannot_go_on_keeps_its_later_times(stage, directory, monkeypatch):
    """A restart writes over them, but not before its first time is there as a whole."""
    points, path = many_points(), directory / "a.vtkhdf"
    first = io.Series(path, points)
    for k in range(4):
        points["u"] = float(k)
        first.write(float(k))
    comm.barrier()
    before = path.read_bytes()
    points["u"] = 9.0
    series = io.Series(path, points, append=True)
    with full_disk(stage, monkeypatch), pytest.raises(OSError, match="No space left"):
        series.write(1.5)
    comm.barrier()
    assert path.read_bytes() == before
    assert names(directory) == ["a.vtkhdf"]
    series.write(1.5)
    times, grids = read(path)
    assert times == [0.0, 1.0, 1.5] and first_values(grids) == [0.0, 1.0, 9.0]
    assert path.stat().st_size == len(before)  # in the place of what was dropped


def test_a_run_killed_at_any_write_leaves_what_was_there(directory, monkeypatch):
    """What is on the disk before each write to it, also those that split a table of chunks."""
    monkeypatch.setattr(growing, "LEAST_CHUNK", 8)
    monkeypatch.setattr(growing, "LARGEST_CHUNK", 8)
    points = fill(mesh.create_unit_square(comm, 3, 3), 1)
    points.add_field("u", (2,))
    path, states, pwrite = directory / "a.vtkhdf", [], os.pwrite

    def write(descriptor, content, address):
        states.append(directory / f"{len(states)}.vtkhdf")
        shutil.copy(path, states[-1])
        if len(content) > 4096:  # the system writes less at once
            pwrite(descriptor, content[: len(content) // 2], address)
            states.append(directory / f"{len(states)}.vtkhdf")
            shutil.copy(path, states[-1])
        return pwrite(descriptor, content, address)

    series = io.Series(path, points)
    for k in range(100):
        points["u"] = float(k)
        with monkeypatch.context() as patch:
            if k in (1, 2, 28, 29, 99):  # two nodes split at 29
                patch.setattr(os, "pwrite", write)
            series.write(float(k))
        for state in states:
            times, grids = read_here(state)
            assert len(times) in (k, k + 1), state
            assert times[:k] == first_values(grids[:k]) == list(range(k))
            state.unlink()
        states.clear()


KILLED = """
import os, signal, sys
from mpi4py import MPI
from dolfinx import mesh
from fenicsmpm import io
from fenicsmpm.points import fill
points = fill(mesh.create_unit_square(MPI.COMM_WORLD, 20, 20), 1)
points.add_field("u", (2,))
series = io.Series(sys.argv[1], points)
pwrite = os.pwrite

def killed(descriptor, content, address):
    pwrite(descriptor, content[:len(content) // 2], address)
    os.kill(os.getpid(), signal.SIGKILL)

for k in range(5):
    points["u"] = float(k)
    if k == 4:
        os.pwrite = killed
    series.write(float(k))
"""


def test_a_killed_run_leaves_its_times(directory):
    path = directory / "a.vtkhdf"
    command = [sys.executable, "-c", KILLED, str(path)]
    assert subprocess.run(command).returncode == -signal.SIGKILL
    times, grids = read_here(path)
    assert times == first_values(grids) == [0.0, 1.0, 2.0, 3.0]
    points = many_points()
    points["u"] = 9.0
    io.Series(path, points, append=True).write(2.5)
    times, grids = read_here(path)
    assert times == [0.0, 1.0, 2.0, 2.5]
    assert first_values(grids) == [0.0, 1.0, 2.0, 9.0]
