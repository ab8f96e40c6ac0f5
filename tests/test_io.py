# SPDX-License-Identifier: MIT
"""Files can be read again with the right numbers, pictures have the right colours."""

import errno
import logging
import os
import subprocess
import sys
import time
import types
from types import SimpleNamespace

from mpi4py import MPI

import matplotlib
import matplotlib.image
import numpy as np
import pytest
import pyvista
from dolfinx import fem, mesh

import fenicsmpm
from fenicsmpm import io
from fenicsmpm.io import pictures
from fenicsmpm.points import fill

pytestmark = pytest.mark.ranks

comm = MPI.COMM_WORLD
CELLS = {
    "triangle": 2,
    "quadrilateral": 2,
    "tetrahedron": 3,
    "hexahedron": 3,
}


@pytest.fixture
def directory(tmp_path):
    """The same directory on all ranks."""
    return comm.bcast(tmp_path)


def unit_mesh(name, n=4):
    cell = mesh.CellType[name]
    if CELLS[name] == 2:
        return mesh.create_unit_square(comm, n, n, cell)
    return mesh.create_unit_cube(comm, n, n, n, cell)


def functions(domain):
    p = fem.Function(fem.functionspace(domain, ("Lagrange", 1)), name="p")
    p.interpolate(lambda x: x[0] + 2 * x[1] - x[2])
    dim = domain.geometry.dim
    u = fem.Function(fem.functionspace(domain, ("Lagrange", 1, (dim,))), name="u")
    u.interpolate(lambda x: np.stack([x[1], 3 * x[0], x[2]][:dim]))
    return p, u


@pytest.mark.mpi
@pytest.mark.parametrize("cell", CELLS)
def test_functions_are_read_as_written(cell, directory):
    domain = unit_mesh(cell)
    io.write(directory / "new" / "grid.vtu", io.gather_functions(functions(domain)), {"E": 7.5})
    comm.barrier()
    grid = pyvista.read(directory / "new" / "grid.vtu")
    dim = CELLS[cell]
    assert grid.n_points == 5**dim
    assert grid.n_cells == domain.topology.index_map(dim).size_global
    # a wrong order of the corners would make cells smaller
    measure = ("Area", "Volume")[dim - 2]
    assert np.sum(grid.compute_cell_sizes()[measure]) == pytest.approx(1.0, rel=1e-12)
    x, y, z = grid.points.T
    np.testing.assert_allclose(grid["p"], x + 2 * y - z, atol=1e-14)
    np.testing.assert_allclose(grid["u"], np.stack([y, 3 * x, z], axis=1), atol=1e-14)
    assert grid.field_data["fenicsmpm version"][0] == fenicsmpm.__version__
    assert grid.field_data["E"][0] == 7.5


@pytest.mark.mpi
def test_points_are_read_as_written(directory):
    points = fill(unit_mesh("triangle"), 2, tag=3)
    points.add_field("p", (), points.x[:, 0] - points.x[:, 1])
    points.add_field("u", (2,), 2 * points.x)
    points.add_field("F", (3, 3), np.arange(9.0).reshape(3, 3))
    points.add_field("f", (2, 2), np.array([[1.0, 2.0], [3.0, 4.0]]))
    path = directory / "points.vtp"
    io.write(path, io.gather_points(points), {"law": "neo-Hooke", "steps": 3, "exact": True})
    comm.barrier()
    read = pyvista.read(path)
    assert read.n_points == points.size_global == 128
    np.testing.assert_array_equal(read["id"], np.arange(128))
    assert np.all(read["tag"] == 3)
    assert np.sum(read["weight"]) == pytest.approx(1.0, rel=1e-14)
    x, y, z = read.points.T
    assert np.all(z == 0.0)
    np.testing.assert_array_equal(read["p"], x - y)
    np.testing.assert_array_equal(read["u"], 2 * read.points)
    np.testing.assert_array_equal(read["F"], np.tile(np.arange(9.0), (128, 1)))
    np.testing.assert_array_equal(read["f"], np.tile([1.0, 2, 0, 3, 4, 0, 0, 0, 0], (128, 1)))
    data = read.field_data
    assert (data["law"][0], data["steps"][0], data["exact"][0]) == ("neo-Hooke", 3, True)


@pytest.mark.mpi
def test_gathered_mesh_does_not_depend_on_the_ranks():
    grid = io.gather_functions(functions(unit_mesh("triangle")))
    assert (grid is None) == (comm.rank > 0)
    alone = mesh.create_unit_square(MPI.COMM_SELF, 4, 4)
    expected = io.gather_functions(functions(alone))
    if grid is not None:
        np.testing.assert_array_equal(grid.points, expected.points)
        np.testing.assert_array_equal(np.sort(grid.cells), np.sort(expected.cells))


@pytest.mark.mpi
def test_files_that_cannot_be_written_raise_on_all_ranks(directory):
    data = io.gather_points(fill(unit_mesh("triangle"), 1))
    with pytest.raises(ValueError, match=r"needs the suffix \.vtp"):
        io.write(directory / "points.vtu", data)
    (directory / "file").touch()
    comm.barrier()
    with pytest.raises(OSError, match="file"):
        io.write(directory / "file" / "points.vtp", data)


def test_functions_that_cannot_be_gathered():
    domain = unit_mesh("triangle")
    p, _ = functions(domain)
    with pytest.raises(ValueError, match="different names"):
        io.gather_functions([p, p])
    quadratic = fem.Function(fem.functionspace(domain, ("Lagrange", 2)), name="q")
    with pytest.raises(ValueError, match="'q' is not continuous P1"):
        io.gather_functions([quadratic])
    broken = fem.Function(fem.functionspace(domain, ("DG", 1)), name="d")
    with pytest.raises(ValueError, match="'d' is not continuous P1"):
        io.gather_functions([broken])
    with pytest.raises(ValueError, match="another mesh"):
        io.gather_functions([p, functions(unit_mesh("triangle"))[1]])
    with pytest.raises(ValueError, match="no functions"):
        io.gather_functions([])


def painted(path, value):
    """Share of a picture that has the colour of a value between 0 and 1."""
    assert path.read_bytes().startswith(b"\x89PNG")
    image = matplotlib.image.imread(path)[..., :3]
    color = matplotlib.colormaps["viridis"](value)[:3]
    return float(np.mean(np.all(np.abs(image - color) < 0.02, axis=-1)))


@pytest.mark.mpi
def test_picture_has_the_colours_of_the_values(directory):
    domain = unit_mesh("triangle", 8)
    p, u = functions(domain)
    p.x.array[:] = 0.25
    u.x.array[:] = 0.0
    points = fill(domain, 2)
    points.add_field("v", (2,), np.array([0.0, 0.75]))
    # a function, and points of now
    points.add_field("p", (), 0.75)
    both = {"grid": io.gather_functions([p]), "points": points}
    io.picture(directory / "two.png", both, "p", "p [Pa]", limits=(0.0, 1.0))
    moved = io.gather_functions([p, u])
    io.picture(directory / "moved.png", moved, "p", displacement="u", limits=(0.0, 1.0))
    io.picture(directory / "p.png", p, limits=(0.0, 1.0))
    limits = {"limits": (-1.0, 1.0)}
    io.picture(directory / "component.png", points, "v", "v [m/s]", component=0, **limits)
    left, right = (fill(domain, 2) for _ in range(2))
    left.remove(lambda x: x[0] > 0.5)
    right.remove(lambda x: x[0] < 0.5)
    for body, value in ((left, 0.25), (right, 0.75)):
        body.add_field("q", (), value)
    io.picture(directory / "bodies.png", [left, right], "q", limits=(0.0, 1.0))
    comm.barrier()
    assert painted(directory / "two.png", 0.25) > 0.2
    assert painted(directory / "two.png", 0.75) > 0.08
    assert painted(directory / "moved.png", 0.25) > 0.2
    assert painted(directory / "p.png", 0.25) > 0.4
    assert painted(directory / "component.png", 0.5) > 0.15
    for value in (0.25, 0.75):
        assert painted(directory / "bodies.png", value) > 0.1


def test_plot_shows_curves_and_references(directory):
    t = np.linspace(0, 1, 50)
    path = directory / "new" / "plot.png"
    io.plot(path, {"a": (t, t**2)}, "t [s]", "u [m]", reference={"b": (t, t), "c": 0.5})
    if MPI.COMM_WORLD.rank == 0:
        image = 255 * matplotlib.image.imread(path)[:, :, :3]
        assert image.shape == (720, 1120, 3)
        blue = (np.abs(image - (31, 119, 180)) < 40).all(axis=2)
        black = (image < 60).all(axis=2)
        assert blue.sum() > 800 and black.sum() > 3000
    with pytest.raises(ValueError):
        io.plot(path, {"a": (t, t[1:])}, "t [s]", "u [m]")
    with pytest.raises(ValueError, match="axes need a text"):
        io.plot(path, {"a": (t, t)}, "t [s]")
    with pytest.raises(OSError):
        io.plot("/proc/none/plot.png", {"a": (t, t)}, "t [s]", "u [m]")


@pytest.mark.mpi
def test_notebooks_show_what_was_drawn(directory):
    points = fill(unit_mesh("triangle"), 1)
    points.add_field("p", (), 0.5)
    path = directory / "p.png"
    drawn = io.picture(path, points, "p")
    t = np.linspace(0, 1, 3)
    curve = io.plot(directory / "t.svg", {"a": (t, t)}, "t [s]", "u [m]")
    inline = io.picture(None, points, "p")
    movie = io.animate(directory / "p.gif", [drawn, path])
    comm.barrier()
    assert str(drawn) == os.fspath(drawn) == str(path) and repr(drawn) == f"Picture({str(path)!r})"
    assert drawn._repr_png_() == path.read_bytes() and drawn._repr_html_() is None
    assert curve._repr_png_() is None and '<img src="data:image/svg+xml' in curve._repr_html_()
    assert movie._repr_png_() is None
    assert movie._repr_html_().startswith('<img src="data:image/gif;base64,R0lGODlh')
    assert inline._repr_png_() == (path.read_bytes() if comm.rank == 0 else None)
    assert str(inline) == "picture without a file" and inline._repr_html_() is None
    with pytest.raises(ValueError, match=r"give io\.picture a path"):
        os.fspath(inline)


@pytest.mark.mpi
def test_points_plot_themselves(directory):
    points = fill(unit_mesh("quadrilateral", 2), 1)
    points.remove(lambda x: x[0] + x[1] > 1.2)
    points.add_field("p", (), 0.5)
    io.picture(directory / "p.png", points, "p", "p [Pa]", limits=(0.0, 1.0))
    io.picture(directory / "plain.png", points)
    coloured, plain = points.plot("p", "p [Pa]", limits=(0.0, 1.0)), points.plot()
    comm.barrier()
    if comm.rank == 0:
        assert coloured._repr_png_() == (directory / "p.png").read_bytes()
        assert plain._repr_png_() == (directory / "plain.png").read_bytes()
    # a point in three of four cells, whose edges cross the whole mesh, and no colour bar
    image = (255 * matplotlib.image.imread(directory / "plain.png")[..., :3]).astype(int)
    silver = (np.abs(image - 192) < 30).all(axis=-1)
    assert (np.abs(image - (31, 119, 180)) < 40).all(axis=-1).mean() > 0.02
    inside = image.shape[1] // 2
    assert (silver[:, inside - 200 : inside + 200].mean(axis=1) > 0.8).sum() >= 3
    with pytest.raises(ValueError, match="no field 'q'"):
        points.plot("q")
    with pytest.raises(ValueError, match="which field should be drawn"):
        io.picture(None, {"points": points, "grid": functions(unit_mesh("triangle"))[0]})


def test_pictures_whose_file_is_gone_or_no_image_show_as_text(directory):
    assert io.Picture(directory / "gone.png")._repr_png_() is None
    (directory / "plot.pdf").write_bytes(b"%PDF")
    assert io.Picture(directory / "plot.pdf")._repr_html_() is None
    (directory / "<b>.gif").write_bytes(b"GIF")
    assert 'alt="' in (shown := io.Picture(directory / "<b>.gif")._repr_html_())
    assert "&lt;b&gt;" in shown and "<b>" not in shown


def test_what_is_not_a_number_is_grey(directory):
    points = fill(unit_mesh("triangle", 8), 2)
    points.add_field("q", (), np.where(points.x[:, 0] < 0.5, points.x[:, 1], np.nan))
    io.picture(directory / "half.png", points, "q")
    image = matplotlib.image.imread(directory / "half.png")[..., :3]
    assert (np.abs(image - 169 / 255) < 0.01).all(axis=2).mean() > 0.1  # pyvista's "darkgray"
    assert painted(directory / "half.png", 0.5) > 0  # colours are for the range of the numbers


def test_picture_in_space(directory):
    domain = unit_mesh("hexahedron", 2)
    p, _ = functions(domain)
    p.x.array[:] = 1.0
    io.picture(directory / "space.png", p, label="p [Pa]")
    image = matplotlib.image.imread(directory / "space.png")[..., :3]
    assert len(np.unique((255 * image).astype(int).reshape(-1, 3), axis=0)) > 10


def test_picture_leaves_no_server_behind(directory, monkeypatch):
    started = []

    class Recorded(subprocess.Popen):
        def __init__(self, *args, **kwargs):
            super().__init__(*args, **kwargs)
            started.append(self)

    monkeypatch.setattr(subprocess, "Popen", Recorded)
    monkeypatch.delenv("DISPLAY", raising=False)
    p, _ = functions(unit_mesh("triangle"))
    for name in ("first.png", "second.png"):
        io.picture(directory / name, p, label="p [Pa]")
        assert painted(directory / name, 0.5) > 0.001
    assert len(started) == (2 if pictures._needs_x_server() else 0)
    assert all(server.poll() is not None for server in started)


@pytest.mark.mpi
def test_pictures_that_cannot_be_drawn_raise_on_all_ranks(directory, monkeypatch):
    p, _ = functions(unit_mesh("triangle"))
    data = io.gather_functions([p])
    path = directory / "no.png"
    with pytest.raises(ValueError, match="no field 'q'"):
        io.picture(path, data, "q")
    with pytest.raises(ValueError, match="no field 'u'"):
        io.picture(path, data, "p", displacement="u")
    with pytest.raises(ValueError, match="which field should be drawn"):
        io.picture(path, data)
    with pytest.raises(ValueError, match="nothing to draw"):
        io.picture(path, {}, "p")
    points = fill(unit_mesh("triangle"), 1)
    points.add_field("v", (2,))
    with pytest.raises(ValueError, match=r"component 3 does not exist: .* components 0 to 2"):
        io.picture(path, points, "v", component=3)
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.setattr(pictures, "_needs_x_server", lambda: True)
    monkeypatch.setattr(pictures.shutil, "which", lambda name: None)
    with pytest.raises(RuntimeError, match="Install Xvfb"):
        io.picture(path, data, "p")


def test_colour_range_cuts_singular_values():
    data = pyvista.PolyData(np.random.default_rng(1).random((1000, 3)))
    data["p"] = np.linspace(0.0, 1.0, 1000)
    data["p"][0] = -1e6
    values = [pictures._Panel("", data, "p").values()]
    assert pictures._colour_range(values)[0] == -1e6
    assert pictures._colour_range(values, cut=1) == pytest.approx((0.01, 0.99), abs=1e-3)


def test_table_is_aligned(capsys):
    rows = io.Table({"n": "d", "tip [m]": ".4f", "method": "s"})
    rows.row(8, 0.21048, "asgs")
    rows.row(128, None, "osgs")
    title, line, first, second = capsys.readouterr().out.splitlines()
    assert len(title) == len(line) == len(first) == len(second)
    assert first.split() == ["8", "0.2105", "asgs"]
    assert second.split() == ["128", "-", "osgs"]
    with pytest.raises(ValueError, match="2 values for 3 columns"):
        rows.row(1, 2)


def test_log_is_printed_once(capsys):
    logger = logging.getLogger("fenicsmpm")
    before = logger.handlers[:], logger.level, logger.propagate
    try:
        io.show_log(logging.WARNING)
        io.show_log(logging.INFO)
        logger.info("iteration 1")
        assert capsys.readouterr().out == "iteration 1\n"
    finally:
        logger.handlers[:], logger.level, logger.propagate = before


def test_a_bar_says_how_far_a_run_is(capsys, monkeypatch):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    newton = SimpleNamespace(iterations=4)

    def steps():
        for number in (1, 2):
            time.sleep(0.15)  # bars are drawn every 0.1 s at most
            yield SimpleNamespace(number=number, time=0.5 * number, newton=newton)

    assert [step.number for step in io.watch(steps(), 2.0, "beam")] == [1, 2]
    shown = capsys.readouterr().err
    assert "beam:  50%" in shown and "1/2 s" in shown
    assert "step 2, 4 Newton iterations" in shown


def test_a_bar_of_a_notebook_is_markup_and_vanishes(monkeypatch):
    shown = []
    display = types.ModuleType("IPython.display")
    display.HTML = str
    handle = SimpleNamespace(update=shown.append)
    display.display = lambda content, display_id: (shown.append(content), handle)[1]
    ipython = types.ModuleType("IPython")
    ipython.get_ipython = lambda: SimpleNamespace(kernel=None)
    monkeypatch.setitem(sys.modules, "IPython", ipython)
    monkeypatch.setitem(sys.modules, "IPython.display", display)
    for _ in io.progress(range(2), "<b>"):
        time.sleep(0.15)
    if comm.rank == 0:
        assert shown[-1] == ""
        half = next(text for text in shown if "50%" in text)
        assert half.startswith('<code>&lt;b&gt;:  50%</code> <progress value="0.5000"></progress>')
        assert "<code>1/2 [" in half
    shown.clear()
    list(io.progress(iter("ab"), "all"))
    assert (comm.rank > 0) == (not shown) and "value" not in "".join(shown)


def test_progress_goes_through_all(capsys):
    assert list(io.progress(range(3), "steps")) == [0, 1, 2]
    assert list(io.progress(iter("ab"), "steps", total=2)) == ["a", "b"]
    assert capsys.readouterr().out == ""


@pytest.mark.mpi
def test_no_points_and_fields_without_values():
    body = fill(unit_mesh("triangle"), 1)
    body.add_field("state", (0,))
    body.add_field("v", (2,), 1.0)
    for points in (body, body.select([])):
        cloud = io.gather_points(points)
        if comm.rank == 0:
            assert "state" not in cloud.point_data and cloud.n_points == points.size_global
            assert points.size_global == 0 or cloud.point_data["v"].shape[1] == 3


@pytest.mark.mpi
def test_a_full_disk_leaves_no_half_files(directory, monkeypatch):
    points = fill(unit_mesh("triangle"), 1)
    path = directory / "points.vtp"

    def full(descriptor):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    io.write(path, io.gather_points(points), {"n": 1})
    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", full)
        with pytest.raises(OSError, match=r"No space left on device; make room.*points\.vtp"):
            io.write(path, io.gather_points(points), {"n": 2})
    MPI.COMM_WORLD.barrier()
    assert pyvista.read(path).field_data["n"][0] == 1
    assert [file.name for file in directory.iterdir()] == ["points.vtp"]
