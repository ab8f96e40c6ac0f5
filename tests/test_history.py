# SPDX-License-Identifier: MIT
"""Histories keep their rows; what is recorded in them agrees with numbers found by hand."""

import os
import signal
import subprocess
import sys

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import mesh

import fenicsmpm
from fenicsmpm import MaterialPoints, diagnostics, io
from fenicsmpm.formulations import set_initial_state
from fenicsmpm.materials import NeoHookean
from fenicsmpm.points import fill

comm = MPI.COMM_WORLD


@pytest.fixture
def directory(tmp_path):
    """The same directory on all ranks."""
    return comm.bcast(tmp_path)


def text(path):
    comm.barrier()
    result = path.read_text()
    comm.barrier()
    return result


COLUMNS = {"t [s]": lambda t: t, 'tip, "vertical" [m]': lambda t: np.float64(t / 3), "n": int}


@pytest.mark.mpi
def test_history_is_read_as_written(directory):
    path = directory / "new" / "a.csv"
    history = io.History(path, COLUMNS, {"E [Pa]": 250.0, "law": "neo-\nHooke"})
    times = [0.0, 0.1, 0.1 + 0.2, 1e-300, float("nan")]
    for time in times[:-1]:
        history.write(time)
    history = io.History(directory / "b.csv", {"t": lambda: times[-1], "u": lambda: -np.inf})
    history.write()
    assert text(path).splitlines() == [
        f"# fenicsmpm {fenicsmpm.__version__}",
        "# E [Pa] = 250.0",
        "# law = neo- Hooke",
        't [s],"tip, ""vertical"" [m]",n',
        "0,0,0",
        "0.1,0.03333333333333333,0",
        "0.30000000000000004,0.10000000000000002,0",
        "1e-300,3.3333333333333334e-301,0",
    ]
    columns = io.read_history(path)
    assert list(columns) == list(COLUMNS)
    assert np.array_equal(columns["t [s]"], times[:-1])
    assert np.array_equal(columns['tip, "vertical" [m]'], np.array(times[:-1]) / 3)
    assert np.isnan(io.read_history(directory / "b.csv")["t"][0])
    assert io.read_history(directory / "b.csv")["u"][0] == -np.inf


@pytest.mark.mpi
def test_history_without_rows(directory):
    io.History(directory / "a.csv", COLUMNS)
    comm.barrier()
    assert [len(values) for values in io.read_history(directory / "a.csv").values()] == [0, 0, 0]


KILLED = """
import os, signal, sys
from fenicsmpm import io
history = io.History(sys.argv[1], {"t [s]": lambda t: t})
for k in range(5):
    history.write(k)
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_a_killed_run_keeps_its_rows(directory):
    path = directory / "a.csv"
    command = [sys.executable, "-c", KILLED, str(path)]
    assert subprocess.run(command).returncode == -signal.SIGKILL
    with open(path, "a") as stream:
        stream.write("5.12")  # cut short: it was 5.125
    assert np.array_equal(io.read_history(path)["t [s]"], np.arange(5.0))
    io.History(path, {"t [s]": lambda t: t}, append_after=9.0).write(6)
    assert np.array_equal(io.read_history(path)["t [s]"], [0, 1, 2, 3, 4, 6])


@pytest.mark.mpi
def test_history_goes_on_after_a_restart(directory):
    path = directory / "a.csv"
    history = io.History(path, COLUMNS, {"run": 1}, append_after=0.0)  # nothing there yet
    for k in range(6):
        history.write(0.1 * k)
    first = io.read_history(path) if comm.rank == 0 else None
    # restarted from a checkpoint at t = 0.3, with longer steps
    history = io.History(path, COLUMNS, {"run": 2}, append_after=0.3)
    history.write(0.45)
    assert text(path).count("#") == 2 and "# run = 2" in text(path)
    if comm.rank == 0:
        columns = io.read_history(path)
        assert np.array_equal(columns["t [s]"], [0.0, 0.1, 0.2, 0.1 * 3, 0.45])
        for title in COLUMNS:
            assert np.array_equal(columns[title][:4], first[title][:4])
    io.History(path, COLUMNS)
    assert len(text(path).splitlines()) == 2


@pytest.mark.mpi
def test_errors_of_histories_are_raised_on_all_ranks(directory):
    path = directory / "a.csv"
    io.History(path, COLUMNS).write(0.0)
    before = text(path)
    with pytest.raises(ValueError, match=r"has the columns t \[s\].*, not t \[s\], n: choose"):
        io.History(path, {"t [s]": float, "n": int}, append_after=1.0)
    with pytest.raises(ValueError, match="needs columns"):
        io.History(path, {})
    assert text(path) == before
    for value in (None, "fast", np.zeros(2), np.zeros(1)):
        with pytest.raises(TypeError, match="column 'u' needs one number, not"):
            io.History(directory / "b.csv", {"u": lambda v=value: v}).write()
    if comm.rank == 0:
        (directory / "file").touch()
        (directory / "empty.csv").touch()
        (directory / "c.csv").write_text("# c\nt,u\n1,2\n3\n")
    comm.barrier()
    with pytest.raises(OSError, match="file"):
        io.History(directory / "file" / "a.csv", COLUMNS)
    with pytest.raises(ValueError, match=r"empty\.csv is no history"):
        io.read_history(directory / "empty.csv")
    with pytest.raises(ValueError, match="line 4: 1 values for 2 columns"):
        io.read_history(directory / "c.csv")
    with pytest.raises(FileNotFoundError):
        io.read_history(directory / "none.csv")
    os.makedirs(directory / "gone", exist_ok=True)
    comm.barrier()
    history = io.History(directory / "gone" / "a.csv", COLUMNS)
    if comm.rank == 0:
        (directory / "gone" / "a.csv").unlink()
        (directory / "gone").rmdir()
    comm.barrier()
    with pytest.raises(OSError, match="gone"):
        history.write(1.0)


def body_of(dim, velocity):
    """Unit square or cube of density 3, filled with points at which x has the moments 1/2, 1/3."""
    cell = (mesh.CellType.quadrilateral, mesh.CellType.hexahedron)[dim - 2]
    create = (mesh.create_unit_square, mesh.create_unit_cube)[dim - 2]
    body = fill(create(comm, *[2] * dim, cell), 2**dim)
    set_initial_state(body, 3.0, velocity)
    return body


@pytest.mark.mpi
def test_momentum_and_energy_in_the_plane():
    # translation by (1, 2) m/s: p = m v, L = m (c x v), E = m v^2 / 2
    body = body_of(2, lambda x: np.tile([1.0, 2.0], (len(x), 1)))
    np.testing.assert_allclose(diagnostics.momentum(body), [3.0, 6.0], rtol=1e-14)
    assert diagnostics.angular_momentum(body) == pytest.approx(3 * (0.5 * 2 - 0.5 * 1), rel=1e-14)
    assert diagnostics.kinetic_energy(body) == pytest.approx(7.5, rel=1e-14)
    # turning about the origin by 1 rad/s: L = sum m r^2, twice the energy
    body["v"] = body.x[:, ::-1] * (-1.0, 1.0)
    inertia = float(comm.allreduce(np.sum(body["mass"] * np.sum(body.x**2, axis=1))))
    np.testing.assert_allclose(diagnostics.momentum(body), [-1.5, 1.5], rtol=1e-14)
    assert diagnostics.angular_momentum(body) == pytest.approx(inertia, rel=1e-14)
    assert diagnostics.kinetic_energy(body) == pytest.approx(inertia / 2, rel=1e-14)


@pytest.mark.mpi
def test_momentum_and_energy_in_space():
    v = np.array([1.0, 2.0, -4.0])
    body = body_of(3, lambda x: np.tile(v, (len(x), 1)))
    np.testing.assert_allclose(diagnostics.momentum(body), 3 * v, rtol=1e-14)
    # c x v with c = (1, 1, 1) / 2
    expected = 1.5 * np.array([-4.0 - 2.0, 1.0 + 4.0, 2.0 - 1.0])
    np.testing.assert_allclose(diagnostics.angular_momentum(body), expected, rtol=1e-13)
    assert diagnostics.kinetic_energy(body) == pytest.approx(1.5 * 21, rel=1e-14)


@pytest.mark.mpi
@pytest.mark.parametrize("nu", [0.5, 0.3])
def test_strain_energy(nu):
    law = NeoHookean(6.0, nu)
    body = body_of(2, None)
    assert diagnostics.strain_energy(body, law) == 0.0
    # plane stretch by 2 and 3/4: J = 3/2, psi = mu/2 (J^(-2/3) (4 + 9/16 + 1) - 3)
    body["F"] = np.diag([2.0, 0.75, 1.0])
    body["J"] = 1.5
    body["weight"] = 1.5 * body["V_0"]
    expected = law.mu / 2 * (1.5 ** (-2 / 3) * (4 + 9 / 16 + 1) - 3)  # times V_0 = 1
    assert diagnostics.strain_energy(body, law) == pytest.approx(expected, rel=1e-13)


@pytest.mark.mpi
def test_probe():
    domain = mesh.create_unit_square(comm, 3, 3)
    x = [(0.9, 0.1)] if comm.rank == comm.size - 1 else np.empty((0, 2))
    tip = MaterialPoints(domain, x, 1.0)
    tip.add_field("u", (2,), (3.0, 4.0))
    tip.add_field("p", (), 5.0)
    assert np.array_equal(diagnostics.probe(tip, "u"), [3.0, 4.0])
    assert np.array_equal(diagnostics.probe(tip, "x"), [0.9, 0.1])
    assert diagnostics.probe(tip, "p") == 5.0
    diagnostics.probe(tip, "u")[:] = 0.0  # a copy
    assert np.array_equal(diagnostics.probe(tip, "u"), [3.0, 4.0])
    with pytest.raises(ValueError, match="one point, not of 18"):
        diagnostics.probe(fill(domain, 1), "x")
    with pytest.raises(KeyError, match="no field 'q'"):
        diagnostics.probe(tip, "q")
