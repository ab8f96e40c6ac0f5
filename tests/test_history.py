# SPDX-License-Identifier: MIT
"""Histories keep their rows; what is recorded in them agrees with numbers found by hand."""

import os
import signal
import subprocess
import sys
from types import SimpleNamespace

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import mesh

import fenicsmpm
from fenicsmpm import ExplicitMPM, ImplicitMPM, MaterialPoints, diagnostics, io
from fenicsmpm.formulations import Newmark, Unknown, body_force, set_initial_state
from fenicsmpm.materials import NeoHookean
from fenicsmpm.points import fill

pytestmark = pytest.mark.ranks

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


def at(time):
    """What a history sees of a simulation."""
    return SimpleNamespace(time=time)


COLUMNS = {'tip, "vertical" [m]': lambda sim: np.float64(sim.time / 3), "n": lambda sim: 0}


@pytest.mark.mpi
def test_history_is_read_as_written(directory):
    path = directory / "new" / "a.csv"
    history = io.History(COLUMNS, path, {"E [Pa]": 250.0, "law": "neo-\nHooke"})
    times = [0.0, 0.1, 0.1 + 0.2, 1e-300]
    for time in times:
        history.write(at(time))
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
    assert list(columns) == history.titles == ["t [s]", *COLUMNS]
    for title, values in columns.items():
        assert np.array_equal(history[title], values)
    assert np.array_equal(columns["t [s]"], times)
    assert np.array_equal(columns['tip, "vertical" [m]'], np.array(times) / 3)
    history = io.History({"u": lambda sim: -np.inf}, directory / "b.csv")
    history.write(at(float("nan")))
    comm.barrier()
    assert np.isnan(io.read_history(directory / "b.csv")["t [s]"][0])
    assert io.read_history(directory / "b.csv")["u"][0] == history["u"][0] == -np.inf


@pytest.mark.mpi
def test_history_without_rows(directory):
    history = io.History(COLUMNS, directory / "a.csv")
    comm.barrier()
    assert history["n"].shape == (0,) and not (directory / "a.csv").exists()


@pytest.mark.mpi
@pytest.mark.parametrize("explicit", [False, True])
def test_loops_record_the_beginning_and_each_step(explicit, directory):
    """Free fall."""
    domain = mesh.create_rectangle(comm, [(0, -1), (1, 1)], [2, 4], mesh.CellType.quadrilateral)
    body = fill(domain, 2)
    set_initial_state(body, 3.0)
    z = Unknown(domain, "v" if explicit else "u")
    gravity = (0.0, -2.0)
    columns = {"v_y [m/s]": lambda sim: diagnostics.momentum(body)[1] / 6.0}
    history = io.History(columns, directory / "fall.csv")
    series = io.Series(directory / "fall.vtkhdf", body, every=0.1)
    options = {"observers": [history, series], "on_exit": "delete"}
    if explicit:
        R = body_force(z.test.v, body, gravity)
        sim = ExplicitMPM(R, z, body, dt=0.05, **options)
        steps = sim.run(0.2, 0.05)
    else:
        scheme = Newmark(z, dt=0.05)
        R = body_force(z.test.u, body, gravity) + scheme.inertia(body)
        sim = ImplicitMPM(R, z, scheme, body, **options)
        steps = sim.run(0.2)
    assert len(list(steps)) == 4
    np.testing.assert_allclose(history["t [s]"], 0.05 * np.arange(5), atol=1e-12)
    np.testing.assert_allclose(history["v_y [m/s]"], -0.1 * np.arange(5), atol=1e-9)
    assert series.times == pytest.approx([0.0, 0.1, 0.2])
    io.plot(directory / "fall.png", history, reference={"exact": ([0.0, 0.2], [0.0, -0.4])})
    io.plot(directory / "fall.png", {"fall": history}, ylabel="v [m/s]")
    with pytest.raises(KeyError, match="no column 'v'; there are t"):
        history["v"]
    # goes on from a checkpoint: what it begins with is known
    kept = io.History(columns, directory / "fall.csv", append=True)
    sim.time = 0.1
    kept.begin(sim)
    assert len(kept["t [s]"]) == 3
    sim.time = 0.2
    kept.begin(sim)
    assert len(kept["t [s]"]) == 4
    two = io.History({**columns, "n": lambda sim: 1})
    with pytest.raises(ValueError, match="'fall' is a history of several columns: choose one"):
        io.plot(directory / "fall.png", {"fall": two})


KILLED = """
import os, signal, sys
from types import SimpleNamespace
from fenicsmpm import io
history = io.History({"n": lambda sim: 1}, sys.argv[1])
for k in range(5):
    history.write(SimpleNamespace(time=k))
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_a_killed_run_keeps_its_rows(directory):
    path = directory / "a.csv"
    command = [sys.executable, "-c", KILLED, str(path)]
    assert subprocess.run(command).returncode == -signal.SIGKILL
    with open(path, "a") as stream:
        stream.write("5,1")  # cut short: it was 5,12
    assert np.array_equal(io.read_history(path)["t [s]"], np.arange(5.0))
    io.History({"n": lambda sim: 1}, path, append=True).write(at(6))
    assert np.array_equal(io.read_history(path)["t [s]"], [0, 1, 2, 3, 4, 6])


@pytest.mark.mpi
def test_history_goes_on_after_a_restart(directory):
    path = directory / "a.csv"
    history = io.History(COLUMNS, path, {"run": 1}, append=True)  # nothing there yet
    for k in range(6):
        history.write(at(0.1 * k))
    first = io.read_history(path) if comm.rank == 0 else None
    # restarted from a checkpoint at t = 0.3, with longer steps
    history = io.History(COLUMNS, path, {"run": 2}, append=True)
    history.begin(at(0.3))
    history.write(at(0.45))
    assert np.array_equal(history["t [s]"], [0.0, 0.1, 0.2, 0.1 * 3, 0.45])
    assert text(path).count("#") == 2 and "# run = 2" in text(path)
    if comm.rank == 0:
        columns = io.read_history(path)
        assert np.array_equal(columns["t [s]"], [0.0, 0.1, 0.2, 0.1 * 3, 0.45])
        for title in columns:
            assert np.array_equal(columns[title][:4], first[title][:4])
    io.History(COLUMNS, path).begin(at(0.0))
    assert len(text(path).splitlines()) == 3


@pytest.mark.mpi
def test_errors_of_histories_are_raised_on_all_ranks(directory):
    path = directory / "a.csv"
    io.History(COLUMNS, path).write(at(0.0))
    before = text(path)
    with pytest.raises(ValueError, match=r"has the columns t \[s\].*, not t \[s\], n: choose"):
        io.History({"n": int}, path, append=True).begin(at(1.0))
    with pytest.raises(ValueError, match="needs columns"):
        io.History({}, path)
    assert text(path) == before
    for value in (None, "fast", np.zeros(2), np.zeros(1)):
        with pytest.raises(TypeError, match="column 'u' needs one number, not"):
            io.History({"u": lambda sim, v=value: v}, directory / "b.csv").write(at(0.0))
    if comm.rank == 0:
        (directory / "file").touch()
        (directory / "empty.csv").touch()
        (directory / "c.csv").write_text("# c\nt,u\n1,2\n3\n")
    comm.barrier()
    with pytest.raises(OSError, match="file"):
        io.History(COLUMNS, directory / "file" / "a.csv").begin(at(0.0))
    with pytest.raises(ValueError, match=r"empty\.csv is no history"):
        io.read_history(directory / "empty.csv")
    with pytest.raises(ValueError, match="line 4: 1 values for 2 columns"):
        io.read_history(directory / "c.csv")
    with pytest.raises(FileNotFoundError):
        io.read_history(directory / "none.csv")
    os.makedirs(directory / "gone", exist_ok=True)
    comm.barrier()
    history = io.History(COLUMNS, directory / "gone" / "a.csv")
    history.write(at(0.0))
    if comm.rank == 0:
        (directory / "gone" / "a.csv").unlink()
        (directory / "gone").rmdir()
    comm.barrier()
    with pytest.raises(OSError, match="gone"):
        history.write(at(1.0))


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
    body = body_of(2, (1.0, 2.0))
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
    body = body_of(3, v)
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
