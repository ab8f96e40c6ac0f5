# SPDX-License-Identifier: MIT
"""Time series are read again with the right times and numbers, also after a restart."""

import errno
import os
from types import SimpleNamespace

from mpi4py import MPI

import numpy as np
import pytest
import pyvista
from dolfinx import fem, mesh

import fenicsmpm
from fenicsmpm import io
from fenicsmpm.points import fill

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


def read(path, field):
    """Times, and the values of a field at each of them."""
    comm.barrier()
    reader = pyvista.PVDReader(path)
    values = []
    for time in reader.time_values:
        reader.set_active_time_value(time)
        values.append(np.array(reader.read()[0][field]))
    comm.barrier()
    return reader.time_values, values


def names(directory):
    comm.barrier()
    found = sorted(file.name for file in directory.iterdir())
    comm.barrier()
    return found


@pytest.mark.mpi
def test_points_are_read_as_written(points, directory):
    path = directory / "new" / "cook.pvd"
    times = [0.0, 0.1, 0.1 + 0.2, 1e3]
    series = io.Series(path, points, {"E [Pa]": 250.0})
    for time in times:
        points["u"] = time * points.x
        series.write(time)
    assert series.times == times
    found, values = read(path, "u")
    assert found == times
    x = pyvista.read(directory / "new" / "cook" / "cook_00002.vtp").points
    for time, u in zip(times, values, strict=True):
        np.testing.assert_allclose(u, time * x, rtol=1e-7, atol=1e-7)
    file = pyvista.read(directory / "new" / "cook" / "cook_00002.vtp")
    assert file.n_points == points.size_global == 32
    assert file.field_data["TimeValue"][0] == 0.1 + 0.2
    assert file.field_data["E [Pa]"][0] == 250.0
    assert file.field_data["fenicsmpm version"][0] == fenicsmpm.__version__
    assert names(directory / "new") == ["cook", "cook.pvd"]


@pytest.mark.mpi
def test_functions_are_read_as_written(directory):
    domain = mesh.create_unit_square(comm, 3, 3)
    p = fem.Function(fem.functionspace(domain, ("Lagrange", 1)), name="p")
    q = fem.Function(p.function_space, name="q")
    series = io.Series(directory / "grid.pvd", [p, q])
    for time in (0.5, 1.0):
        p.x.array[:] = time
        q.x.array[:] = -time
        series.write(time)
    for name, sign in (("p", 1.0), ("q", -1.0)):
        times, values = read(directory / "grid.pvd", name)
        assert times == [0.5, 1.0]
        assert all(
            np.all(v == sign * t) and len(v) == 16 for t, v in zip(times, values, strict=True)
        )
    assert names(directory / "grid") == ["grid_00000.vtu", "grid_00001.vtu"]


@pytest.mark.mpi
def test_it_can_be_read_meanwhile(points, directory):
    series = io.Series(directory / "a.pvd", points)
    for k in range(3):
        series.write(float(k))
        assert len(read(directory / "a.pvd", "u")[0]) == k + 1


@pytest.mark.mpi
def test_goes_on_after_a_restart(points, directory):
    path = directory / "a.pvd"
    first = io.Series(path, points, append=True)  # nothing there yet
    for k in range(6):
        points["u"] = float(k)
        first.write(0.1 * k)
    # restarted from a checkpoint at t = 0.3, with longer steps
    series = io.Series(path, points, append=True)
    series.begin(SimpleNamespace(time=0.3))
    assert series.times == [0.0, 0.1, 0.2, 0.1 * 3]
    assert len(read(path, "u")[0]) == 6  # as long as there is nothing new
    points["u"] = 9.0
    series.write(0.45)
    times, values = read(path, "u")
    assert times == [0.0, 0.1, 0.2, 0.1 * 3, 0.45]
    assert [u[0, 0] for u in values] == [0.0, 1.0, 2.0, 3.0, 9.0]
    assert len(names(directory / "a")) == 5


@pytest.mark.mpi
def test_a_new_series_takes_the_place_of_the_old_one(points, directory):
    first = io.Series(directory / "a.pvd", points)
    for k in range(4):
        first.write(float(k))
    if comm.rank == 0:
        (directory / "a" / "notes.txt").touch()
    again = io.Series(directory / "a.pvd", points)
    assert len(read(directory / "a.pvd", "u")[0]) == 4
    again.write(0.0)
    assert read(directory / "a.pvd", "u")[0] == [0.0]
    assert names(directory / "a") == ["a_00000.vtp", "notes.txt"]


@pytest.mark.mpi
def test_errors_are_raised_on_all_ranks(points, directory, monkeypatch):
    with pytest.raises(ValueError, match=r"ends in \.pvd"):
        io.Series(directory / "a.vtp", points)
    with pytest.raises(ValueError, match="one or more functions"):
        io.Series(directory / "a.pvd", [])
    series = io.Series(directory / "a.pvd", points)
    series.write(1.0)
    for time in (1.0, 0.5, float("nan")):
        with pytest.raises(ValueError, match=r"must grow: .* after 1\.0 s"):
            series.write(time)
    p = fem.Function(fem.functionspace(points.mesh, ("Lagrange", 1)), name="p")
    with pytest.raises(ValueError, match="lists other files"):
        io.Series(directory / "a.pvd", [p], append=True).write(1.0)
    if comm.rank == 0:
        (directory / "b.pvd").write_text("<VTKFile>")
        (directory / "file").touch()
    comm.barrier()
    with pytest.raises(ValueError, match=r"b\.pvd is no series"):
        io.Series(directory / "b.pvd", points, append=True).write(1.0)
    with pytest.raises(OSError, match="file"):
        io.Series(directory / "file" / "c.pvd", points).write(0.0)

    def full(descriptor):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", full)
        with pytest.raises(OSError, match="No space left"):
            series.write(2.0)
    assert series.times == read(directory / "a.pvd", "u")[0] == [1.0]
    series.write(2.0)
    assert read(directory / "a.pvd", "u")[0] == [1.0, 2.0]
