# SPDX-License-Identifier: MIT
"""Each demo runs, and one number of it is right."""

import subprocess
import sys
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
import pyvista

from fenicsmpm import ImplicitMPM
from fenicsmpm.solvers import NewtonError

DEMOS = Path(__file__).parent.parent / "demos"
sys.path.insert(0, str(DEMOS))
cooks_membrane = import_module("cooks_membrane")
cooks_membrane_dynamic = import_module("cooks_membrane_dynamic")
manufactured_solution = import_module("manufactured_solution")
own_stabilization = import_module("own_stabilization")

TIPS = {  # m, an independent prototype
    ("asgs", 8): 0.2105,
    ("osgs", 8): 0.1951,
    ("asgs", 16): 0.2489,
    ("osgs", 16): 0.2416,
}


@pytest.mark.mpi
@pytest.mark.parametrize("n", [8, 16])
def test_cooks_membrane(n):
    solutions = {
        name: cooks_membrane.solve(n, cooks_membrane.METHODS[name], 0.5) for name, _ in TIPS
    }
    for name, solution in solutions.items():
        assert solution.tip == pytest.approx(TIPS[name, n], abs=6e-5)
        assert 3 <= solution.iterations <= 4
    assert solutions["osgs"].iterations <= solutions["asgs"].iterations + 1


def test_pressure_jumps_only_without_stabilization():
    def jumps(name):
        p = cooks_membrane.solve(8, cooks_membrane.METHODS[name], 0.5).p.x.array
        return np.percentile(p, 90) - np.percentile(p, 10)

    # the applied traction is 0.0625 Pa
    assert jumps("none") > 1.0
    for name in ("ppp", "asgs", "osgs"):
        assert jumps(name) < 0.3


def test_cooks_membrane_as_a_program(tmp_path):
    command = [sys.executable, str(DEMOS / "cooks_membrane.py"), "--short", "-v"]
    ran = subprocess.run(
        [*command, "--output", str(tmp_path)], capture_output=True, text=True, check=True
    )
    assert "|R|" in ran.stdout  # a line an iteration
    last = ran.stdout.splitlines()[-2].split()
    assert last[:4] == ["8", "asgs", "0.2105", "0.2105"]
    points, grid = pyvista.read(tmp_path / "points.vtp"), pyvista.read(tmp_path / "grid.vtu")
    assert (points.n_points, grid.n_points) == (3 * 128, 81)
    assert np.sum(points["weight"]) == pytest.approx(1440.0)
    assert points.field_data["stabilization"][0] == "asgs"
    corner = np.argmax(grid.points[:, 1])
    assert grid["displacement"][corner, 1] == pytest.approx(0.2105, abs=6e-5)
    assert (tmp_path / "pressure.png").stat().st_size > 10_000


def test_study_of_cooks_membrane(tmp_path, capsys):
    cooks_membrane.main(["--short", "--study", "--output", str(tmp_path)])
    assert len(capsys.readouterr().out.splitlines()) == 2 + 2 * 4 + 1
    for name in ("pressures.png", "tip_displacement.png"):
        assert (tmp_path / name).stat().st_size > 10_000
    assert pyvista.read(tmp_path / "osgs.vtu").field_data["n"][0] == 16


@pytest.mark.parametrize(
    "arguments",
    ["--nu 0.6", "--stabilization supg", "-n 0", "--study -n 8", "--study --stabilization ppp"],
)
def test_wrong_options(arguments, capsys):
    with pytest.raises(SystemExit) as stopped:
        cooks_membrane.main(arguments.split())
    assert stopped.value.code == 2
    assert arguments.split()[0] in capsys.readouterr().err


@pytest.mark.mpi
@pytest.mark.parametrize(
    "name, of_u, of_p", [("ppp", 1.20e-2, 6.06e-2), ("asgs", 9.10e-3, 4.04e-2),
                         ("osgs", 3.99e-3, 3.73e-2)]
)  # fmt: skip
def test_manufactured_solution(name, of_u, of_p):
    assert manufactured_solution.solve(16, name).errors == pytest.approx((of_u, of_p), rel=0.02)


def test_study_of_the_manufactured_solution(tmp_path, capsys):
    manufactured_solution.main(["--short", "--output", str(tmp_path)])
    assert "Orders of convergence" in capsys.readouterr().out
    points = pyvista.read(tmp_path / "points.vtp")
    assert points.n_points == 12 * 2 * 16**2  # the random ones
    difference = points["pressure"] - points["exact pressure"]
    scale = np.linalg.norm(points["exact pressure"])
    assert np.linalg.norm(difference) / scale == pytest.approx(4.2e-2, rel=0.1)
    for name in ("pressure.png", "errors.png"):
        assert (tmp_path / name).stat().st_size > 10_000


def test_own_stabilization(tmp_path):
    own_stabilization.main(["--short", "--output", str(tmp_path)])
    tip = {
        name: pyvista.read(tmp_path / f"{name}.vtu")["displacement"][:, 1].max()
        for name in own_stabilization.METHODS
    }
    assert tip["asgs"] == pytest.approx(0.2489, abs=6e-5)
    assert tip["least_squares"] == pytest.approx(tip["asgs"], rel=1e-4)
    assert tip["brezzi_pitkaranta"] == pytest.approx(tip["asgs"], rel=0.05)
    assert tip["gradient_jumps"] == pytest.approx(tip["asgs"], rel=0.02)


@pytest.mark.parametrize(
    "case",
    [
        cooks_membrane_dynamic.Case(h=0.2, per_cell=12),
        cooks_membrane_dynamic.Case(h=0.2, per_cell=12, tied=True),
        cooks_membrane_dynamic.Case(h=0.2, dt=0.0025, transient=True, tied=True),
    ],
    ids=["ghost penalty", "tied", "tied, short steps"],
)
def test_dynamic_cooks_membrane(case, tmp_path):
    _, history = cooks_membrane_dynamic.run(case, 0.5, tmp_path)
    reference = np.loadtxt(cooks_membrane_dynamic.REFERENCE, delimiter=",")
    expected = np.interp(history[:, 0], reference[:, 0], reference[:, 2])
    assert history[-1, 2] == pytest.approx(0.5, abs=0.02)
    assert np.abs(history[:, 2] - expected).max() < 0.02 * 1.177  # its first peak


def test_dynamic_cooks_membrane_as_a_program(tmp_path, capsys):
    cooks_membrane_dynamic.main(["--short", "--movie", "--output", str(tmp_path)])
    assert "ASGS, h = 0.5 m" in capsys.readouterr().out
    for name in ("pressure.png", "tip.png", "cooks_membrane_dynamic.gif"):
        assert (tmp_path / name).stat().st_size > 10_000
    assert pyvista.read(tmp_path / "points.vtp").field_data["scheme"][0] == "Bossak"


@pytest.mark.parametrize(
    "arguments",
    [
        "--size 0.3",
        "--size 0",
        "--until 0",
        "--dt 0",
        "--points 0",
        "--scheme Euler",
        "--study 6a --size 0.1",
        "--tied --ghost 1",
    ],
)
def test_wrong_options_of_the_dynamic_membrane(arguments, capsys):
    with pytest.raises(SystemExit) as stopped:
        cooks_membrane_dynamic.main(arguments.split())
    assert stopped.value.code == 2
    assert arguments.split()[0][2:] in capsys.readouterr().err


def test_a_membrane_that_ends_before_its_first_frame(tmp_path, capsys, monkeypatch):
    def fail(*arguments):
        raise NewtonError("diverged", "as asked for", [])

    monkeypatch.setattr(ImplicitMPM, "step", fail)
    cooks_membrane_dynamic.main(["--short", "--movie", "--output", str(tmp_path)])
    assert "it ends at t = 0.000 s" in capsys.readouterr().out
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "points.vtp",
        "pressure.png",
        "tip.png",
    ]


@pytest.mark.parametrize(
    "arguments",
    [
        "--until 0",
        "--dt 0",
        "--size -1",
        "--points 0",
        "--short --size 0.5",
        "--short --full 1",
        "--full 1 --dt 0.002",
        "--full --points 3",
    ],
)
def test_wrong_options_of_the_columns(arguments, capsys):
    pytest.importorskip("gmsh")
    bending_beam = import_module("bending_beam")
    with pytest.raises(SystemExit) as stopped:
        bending_beam.main(arguments.split())
    assert stopped.value.code == 2
    assert arguments.split()[0] in capsys.readouterr().err


def test_a_column_that_ends_before_its_first_frame(tmp_path, capsys, monkeypatch):
    pytest.importorskip("gmsh")
    bending_beam = import_module("bending_beam")

    def fail(*arguments):
        raise NewtonError("diverged", "as asked for", [])

    monkeypatch.setattr(ImplicitMPM, "step", fail)
    bending_beam.main(["--short", "--movie", "--output", str(tmp_path)])
    assert "nothing to compare" in capsys.readouterr().out
    for name in ("bending_beam.png", "bending_beam_tip.png"):
        assert (tmp_path / name).stat().st_size > 10_000


@pytest.mark.parametrize("tied", [False, True])
@pytest.mark.parametrize(
    "name, component, share", [("bending_beam", "u_x", 0.01), ("twisting_column", "u_y", 0.05)]
)
def test_columns(name, component, share, tied, tmp_path, capsys):
    pytest.importorskip("gmsh")
    bending_beam = import_module("bending_beam")
    make = bending_beam.beam if name == "bending_beam" else import_module(name).twist
    case = make(h=0.5, per_cell=12, dt=0.002, tied=tied, transient=tied)
    sim, history = bending_beam.run(case, 0.02, tmp_path)
    deviations = bending_beam.compare(case, history)
    assert deviations[component] < share
    assert sim.bodies[0]["J"].mean() == pytest.approx(1.0, abs=0.01)
    times = pyvista.PVDReader(tmp_path / f"{case.files()}.pvd").time_values
    assert times == pytest.approx([0.02])


@pytest.mark.parametrize("per_cell", [7, 12, 17])
@pytest.mark.parametrize("name", ["bending_beam", "twisting_column"])
def test_columns_are_filled(name, per_cell):
    """Points reach from wall to wall, whatever their spacing."""
    pytest.importorskip("gmsh")
    bending_beam = import_module("bending_beam")
    make = bending_beam.beam if name == "bending_beam" else import_module(name).twist
    sim = bending_beam.build(make(h=0.5, per_cell=per_cell))
    assert sim.bodies[0].volume == pytest.approx(6.0)


@pytest.mark.parametrize(
    ("name", "arguments"),
    [
        ("cooks_membrane_explicit", "--size 0.3"),
        ("cooks_membrane_explicit", "--steps 0"),
        ("cooks_membrane_explicit", "--full --averages F-bar"),
        ("cooks_membrane_explicit", "--full --steps 5"),
        ("strip_footing", "--cells 0"),
        ("strip_footing", "--full --cells 10"),
        ("strip_footing", "--full --short"),
        ("dam_break", "--wall 5.1"),
        ("dam_break", "--until 0"),
        ("dam_break", "--full --until 0.5"),
        ("landslide", "--until -1"),
        ("landslide", "--short --full"),
    ],
)
def test_wrong_options_of_explicit_demos(name, arguments, capsys):
    with pytest.raises(SystemExit) as stopped:
        import_module(name).main(arguments.split())
    assert stopped.value.code == 2
    assert "error: " in capsys.readouterr().err


@pytest.mark.parametrize("name", ["strip_footing", "landslide"])
def test_explicit_demos(name, tmp_path, capsys):
    import_module(name).main(["--short", "--output", str(tmp_path)])
    assert "material points" in capsys.readouterr().out
    assert (tmp_path / f"{name}.png").exists()


@pytest.mark.slow
def test_strip_footing():
    """The load that clay bears: near Prandtl's on a coarse grid, far above without averages."""
    demo = import_module("strip_footing")
    averaged, standard = (
        demo.plateau(demo.run(demo.Case(averages=averages, cells=10))[1]) / demo.PRANDTL
        for averages in ("F-bar", "standard")
    )
    assert averaged == pytest.approx(1.0, abs=0.08)
    assert standard > 1.15


def test_cooks_membrane_explicit(tmp_path):
    """Sooner or later at rest: here only that averages remove the checkerboard."""
    demo = import_module("cooks_membrane_explicit")
    bases = ["--basis", "quadratic", "linear"]
    averaged, standard, *on_triangles = demo.main(["--short", *bases, "--output", str(tmp_path)])
    assert averaged["tip"] > 1.02 * standard["tip"]
    assert averaged["roughness"] < 0.1 * standard["roughness"]
    averaged, standard = on_triangles
    assert averaged["roughness"] < 0.1 * standard["roughness"]


@pytest.mark.slow
def test_dam_break(tmp_path):
    """Pressure at rest, front, volume; the front of computations with algorithm 1."""
    demo = import_module("dam_break")
    case = demo.Case("gimp", "algorithm-1", wall=12.0, beyond=2)
    _, history, _, at_rest = demo.run(case, 0.4)
    assert at_rest < 0.05
    assert history[-1, 1] == pytest.approx(demo.FRONTS["gimp"][0.4], rel=0.04)
    _, history, _, at_rest = demo.run(demo.Case(), 0.4)
    assert at_rest < 0.02
    assert np.abs(history[:, 3:] - 1).max() < 0.01 and np.abs(history[:, 2]).max() < 0.01


# --- energy conserved --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "arguments"),
    [
        ("cantilever", "--until 0"),
        ("cantilever", "--points 0"),
        ("cantilever", "--study --analysis B"),
        ("cylinder_collision", "--until 0"),
        ("cylinder_collision", "--study --plastic"),
        ("cylinder_collision", "--plastic --method symplectic"),
        ("taylor_bar", "--until -1"),
        ("taylor_bar", "--short --full"),
        ("taylor_bar", "--method symplectic"),
    ],
)
def test_wrong_options_of_the_conserving_demos(name, arguments, capsys):
    with pytest.raises(SystemExit) as stopped:
        import_module(name).main(arguments.split())
    assert stopped.value.code == 2
    assert "error:" in capsys.readouterr().err


def test_cantilever(tmp_path, monkeypatch):
    """With fewer points, and let go sooner, than in the paper."""
    cantilever = import_module("cantilever")
    monkeypatch.setattr(cantilever, "RELEASE", 6.0)
    cases = [
        cantilever.Case(method=method, per_direction=4) for method in ("energy-momentum", "pic")
    ]
    conserving, pic = (cantilever.run(case, 15.0)[0].table() for case in cases)
    assert cantilever.drift(conserving, 6.0) < 1e-9
    assert conserving[:, 5].max() <= 4
    assert cantilever.drift(pic, 6.0) > 1e-4
    assert conserving[-1, 4] > 100.0  # J
    cantilever.main(["--short", "--output", str(tmp_path)])
    assert (tmp_path / "cantilever_energies.png").stat().st_size > 10_000
    assert np.loadtxt(
        tmp_path / "cantilever_A_energy-momentum.csv", delimiter=",", skiprows=3
    ).shape == (6, 6)


@pytest.mark.mpi
def test_cylinder_collision():
    """Plastic, until the cylinders have met, with fewer points."""
    collision = import_module("cylinder_collision")
    case = collision.Case(plastic=True, per_direction=10)
    energies, momenta, _, frames = collision.run(case, 3.0)
    table = energies.table()
    assert list(frames) == ["A", "B"]
    assert table[-1, 3] > 5.0  # J dissipated
    assert momenta.linear < 1e-12 and momenta.angular < 1e-10
    assert collision.drift(table, 0.0) < 1e-9


def test_taylor_bar():
    """The first tenth, on a coarse mesh."""
    taylor = import_module("taylor_bar")
    energies, shapes, frames = taylor.run(taylor.Case(cells=25, dt=7.5e-7), 7.5e-6)
    assert list(frames) == ["a third", "two thirds", "the end"]
    table = energies.table()
    assert taylor.drift(table, 0.0) < 1e-8
    assert table[-1, 3] > 0.1 * table[0, 4]
    assert np.all(np.diff(shapes[:, 1:], axis=0) >= 0)
    assert shapes[-1, 1] == pytest.approx(taylor.SPEED * 7.5e-6, rel=0.01)


def test_tumbling_block():
    block = import_module("tumbling_block")
    rows, _ = block.run("energy-momentum", 0.2)
    total = rows[:, 1:4].sum(axis=1)
    assert np.abs(total / total[0] - 1).max() < 1e-12
    assert np.abs(rows[:, 4] / rows[0, 4] - 1).max() < 1e-12
    assert rows[-1, 2] > 0.005  # J of strain energy
