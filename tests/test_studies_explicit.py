# SPDX-License-Identifier: MIT
"""Studies of explicit steps and of load steps: what averages do, and both beside known values."""

import math
import sys
from pathlib import Path

import numpy as np
import pytest

from fenicsmpm import formulations
from fenicsmpm.simulation import ExplicitMPM

sys.path.insert(0, str(Path(__file__).parent.parent / "studies"))

import bearing_capacity
import explicit
import hertz
import quasi_static

pytestmark = pytest.mark.once


@pytest.mark.parametrize("functions", ["quadratic", "gimp", "linear"])
def test_averages_remove_the_checkerboard(functions):
    _, _, averaged = explicit.membrane(functions, "default", 2.0, 200)
    _, _, standard = explicit.membrane(functions, None, 2.0, 200)
    assert averaged < 0.1 * standard


@pytest.mark.slow
@pytest.mark.parametrize(("functions", "off"), [("gimp", 0.03), ("linear", 0.07)])
def test_averages_prevent_locking(functions, off):
    """In coarse cells, as far as the functions can: without them the panel moves much less."""
    tips = []
    for averages in ("default", None):
        _, history, _ = explicit.membrane(functions, averages, 2.0, 20000, squares=True)
        tips.append(history["tip [m]"][-1])
    assert tips[0] == pytest.approx(explicit.TIP, rel=off)
    assert tips[1] < 0.85 * explicit.TIP


def test_dam_break_with_edges_and_with_cells_beyond_walls():
    """Hydrostatics; the volume; what algorithm 1 loses of J at once, and the default does not."""
    coarse = {"wall": 12.0, "until": 0.1, "h": 0.5, "per_side": 3, "dt": 1e-4}
    history, _, at_rest = explicit.released(("gimp", "default"), **coarse)
    assert at_rest < 0.02
    assert abs(history["V"][-1]) < 1e-3 and history["J to"][-1] - history["J"][-1] < 0.02
    _, _, at_rest = explicit.released(("gimp", formulations.ALGORITHM_1), beyond=2, **coarse)
    assert at_rest < 0.05


def test_shares_of_flip_leave_a_spin():
    """The less, the smaller the share: it is one of each step."""
    left = [explicit.spinning("quadratic", flip, 0.1, 0.25)[1] for flip in (1.0, 0.9, 0.0)]
    assert left[0] > 0.9
    assert left[0] > left[1] > 2 * left[2]


def test_slope_stands_in_space():
    """As in a plane section, with a factor of safety of 1.67."""
    law, sim = explicit.slope("quadratic", "default", 1.0)
    assert isinstance(sim, ExplicitMPM) and law(2.0).parameters[2] == pytest.approx(25e3)
    for _ in sim.run(0.5, 0.25):
        pass
    (body,) = sim.bodies
    assert body.mesh.comm.allreduce(np.abs(body["v"]).max()) < 0.1
    assert body["eps_p"].max() < 0.01


@pytest.mark.parametrize("stabilization", ["asgs", "ppp"])
def test_cooks_membrane_by_load_steps(stabilization):
    tip, steps = quasi_static.cook(2.0, stabilization)
    assert tip == pytest.approx(explicit.TIP, rel=0.02)
    assert steps < 10


def test_footing_by_load_steps():
    """With pressures it comes to the limit load, by h / B above Prandtl's; without it locks."""
    cells = 6
    way, load, _ = quasi_static.footing(cells, "u-p", size=3)
    assert load[-1] == pytest.approx((2 + math.pi) * (1 + 1 / cells), rel=0.05)
    assert np.ptp(np.array(load)[np.array(way) > 0.003]) < 0.01 * load[-1]
    _, locked, _ = quasi_static.footing(cells, "u", size=3)
    assert locked[-1] > 1.5 * load[-1]


@pytest.mark.slow
@pytest.mark.parametrize(
    "factor,friction,rough",
    [("N_c", 20.0, False), ("N_c", 30.0, False), ("N_q", 30.0, False), ("N_q", 30.0, True)],
)
def test_bearing_capacity(factor, friction, rough):
    """Of soil that dilates, with four cells along the footing: Prandtl, Reissner."""
    exact = bearing_capacity.factors(friction)[factor]
    way, load = bearing_capacity.bearing(factor, friction, "cubic", 4, (5.0, 2.0), rough)
    assert load[-1] == pytest.approx(exact, rel=0.05)
    assert np.interp(0.8 * way[-1], way, load) > 0.98 * load[-1]  # a plateau


def test_factors_of_bearing_capacity():
    """As in tables of textbooks."""
    table = {0: (5.14, 1.0), 10: (8.34, 2.47), 20: (14.83, 6.40), 30: (30.14, 18.40)}
    for friction, values in table.items():
        found = bearing_capacity.factors(friction)
        assert [found["N_c"], found["N_q"]] == pytest.approx(values, abs=0.006)


@pytest.mark.slow
@pytest.mark.parametrize("loop", hertz.LOOPS)
def test_hertz(loop):
    """Ten cells in the radius and 1.8 in the half width of the contact: width and peak pressure."""
    found = hertz.compare(*hertz.LOOPS[loop](10, 0.08))
    assert found[1] == pytest.approx(0.18, abs=0.02)
    assert found[3:] == pytest.approx((0.0, 0.0), abs=0.05)
