# SPDX-License-Identifier: MIT
"""Studies of the VMS paper on coarse meshes: Cook's membrane, bending beam, twisting column."""

import runpy
from pathlib import Path

import numpy as np
import pytest

pytestmark = pytest.mark.once

ROOT = Path(__file__).parents[1]
MEMBRANE = runpy.run_path(str(ROOT / "studies" / "cooks_membrane.py"))
DYNAMIC = runpy.run_path(str(ROOT / "studies" / "cooks_membrane_dynamic.py"))
TIPS = {  # m, an independent prototype
    ("asgs", 8): 0.2105,
    ("osgs", 8): 0.1951,
    ("asgs", 16): 0.2489,
    ("osgs", 16): 0.2416,
}


@pytest.fixture
def columns():
    pytest.importorskip("gmsh")
    return runpy.run_path(str(ROOT / "studies" / "columns.py"))


def reference(name):
    return np.loadtxt(ROOT / "benchmarks" / "references" / f"{name}.csv", delimiter=",").T


@pytest.mark.mpi
@pytest.mark.parametrize(("name", "n"), TIPS)
def test_cooks_membrane(name, n):
    _, tip, iterations = MEMBRANE["solve"](n, name)
    assert tip == pytest.approx(TIPS[name, n], abs=6e-5)
    assert iterations <= 4


def test_pressure_jumps_only_without_stabilization():
    def jumps(name):
        p = MEMBRANE["solve"](8, name)[0].x.array
        return np.percentile(p, 90) - np.percentile(p, 10)

    # the applied traction is 0.0625 Pa
    assert jumps("none") > 1.0
    for name in ("ppp", "asgs", "osgs"):
        assert jumps(name) < 0.3


@pytest.mark.parametrize(
    ("case", "until"),
    [
        ({"h": 0.2, "per_cell": 12, "stabilization": "osgs"}, 0.25),
        ({"h": 0.2, "per_cell": 12, "tied": True}, 0.5),
        # with the subscales of VMS, which have no inertia, Newton's method fails at 0.04 s
        ({"h": 0.3, "per_cell": 16, "dt": 0.0025, "transient": True, "tied": True}, 0.15),
        ({**DYNAMIC["SMOOTH"], "h": 0.4}, 0.5),
        ({**DYNAMIC["SMOOTH"], "h": 0.3, "dt": 0.0025, "transient": True}, 0.1),
    ],
    ids=["OSGS", "tied", "tied, short steps", "smooth", "smooth, short steps"],
)
def test_dynamic_cooks_membrane(case, until):
    t, _, expected = reference("cook_dynamic")
    time, u_y, _ = DYNAMIC["run"](until, "Cook's membrane", **case)
    assert time[-1] == pytest.approx(until)
    assert np.abs(u_y - np.interp(time, t, expected)).max() < 0.02 * expected.max()


def test_turning_points():
    """Those that benchmarks/references/README.md names; the curve has turns of noise, too."""
    t, _, u_y = reference("cook_dynamic")
    (first, peak), (second, minimum), *_ = DYNAMIC["turning_points"](t, u_y)
    assert (first, second) == pytest.approx((1.36, 2.76), abs=0.005)
    assert (peak, minimum) == pytest.approx((1.177, 0.121), abs=5e-4)


@pytest.mark.parametrize("tied", [False, True])
@pytest.mark.parametrize(
    ("name", "component", "share"), [("bending_beam", 0, 0.01), ("twisting_column", 1, 0.05)]
)
def test_columns(name, component, share, tied, columns, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    case = {"h": 0.5, "per_cell": 12, "dt": 0.002, "tied": tied, "transient": tied}
    history, body, _ = columns["run"](name, 0.02, "column", **case)
    t, *expected = reference(name)
    found = np.interp(t, history["t [s]"], history[f"u_{'xyz'[component]} [m]"])
    error = np.abs(found - expected[component])[t <= 0.02].max()
    assert error < share * np.abs(np.array(expected)[:, t <= 0.02]).max()
    assert history["energy [J]"][-1] <= history["energy [J]"][0]
    assert body["J"].mean() == pytest.approx(1.0, abs=0.01)
    assert (tmp_path / "output" / "column.vtkhdf").exists()


@pytest.mark.parametrize("case", ["smooth", "energy"])
@pytest.mark.parametrize(
    ("name", "h", "dt", "until"),
    [("bending_beam", 0.5, 0.002, 0.04), ("twisting_column", 0.25, 0.001, 0.015)],
)
def test_smooth_columns(name, h, dt, until, case, columns, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    options = columns["CASES"][case] | {"h": h, "dt": dt}
    history, _, halved = columns["run"](name, until, "column", **options)
    t, *expected = reference(name)
    component = 0 if name == "bending_beam" else 1
    found = np.interp(t, history["t [s]"], history[f"u_{'xyz'[component]} [m]"])
    error = np.abs(found - expected[component])[t <= until].max()
    assert error < 0.03 * np.abs(np.array(expected)[:, t <= until]).max()
    energy = history["energy [J]"] / history["energy [J]"][0]
    assert np.abs(energy - 1).max() < (1e-7 if case == "energy" else 0.01)
    assert not halved


def test_restart(columns, tmp_path, monkeypatch):
    """A run that goes on from its checkpoint, after 6 of 8 steps, is the one without a break."""
    monkeypatch.chdir(tmp_path)
    case = {"h": 0.5, "per_cell": 6, "dt": 0.002, "saves": 3}
    whole, *_ = columns["run"]("bending_beam", 0.016, "column", **case)
    (tmp_path / "output" / "column.csv").unlink()
    rest, *_ = columns["run"]("bending_beam", 0.016, "column", restart=True, **case)
    assert rest["t [s]"] == pytest.approx([0.012, 0.014, 0.016])
    for title in whole.titles:
        assert rest[title] == pytest.approx(whole[title][-3:], rel=1e-8)


@pytest.mark.parametrize("per_cell", [7, 17])
@pytest.mark.parametrize("name", ["bending_beam", "twisting_column"])
def test_columns_are_filled(name, per_cell, columns):
    """Points reach from wall to wall, whatever their spacing."""
    body = columns["build"](name, h=0.5, per_cell=per_cell)[0].bodies[0]
    assert body.volume() == pytest.approx(6.0)
