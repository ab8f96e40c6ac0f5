# SPDX-License-Identifier: MIT
"""The studies of incompressible flow."""

import runpy
from pathlib import Path

import numpy as np
import pytest

STUDIES = Path(__file__).parents[1] / "studies"


@pytest.mark.slow
def test_dam_break_with_bossak():
    """The coarse mesh of the slides, until the front is at 3.5 a: front, height, volume."""
    study = runpy.run_path(str(STUDIES / "dam_break_implicit.py"))
    sim, history = study["build"](0.2, 3e-3, "Bossak")
    for _ in sim.run(0.72):
        pass
    off = study["deviations"](history)
    assert off["front"] < 0.08 and off["foremost"] < 0.12 and off["height"] < 0.05
    assert np.abs(history["volume"]).max() < 1e-10
    assert history["crowded"].max() < 0.1
    assert history["foremost"][-1] > 3.5


@pytest.mark.slow
def test_order_of_the_vortex():
    """Second order while points move by more than a cell."""
    study = runpy.run_path(str(STUDIES / "taylor_green.py"))
    (coarse, _), (fine, fluid) = (study["error"](n, study["POINTS"][n]) for n in (8, 16))
    assert np.log2(coarse / fine) > 1.9
    assert np.abs(fluid["u"]).max() > 1 / 16
