# SPDX-License-Identifier: MIT
"""The study of conserving steps: what methods do to energy and momenta."""

import runpy
from pathlib import Path

import numpy as np
import pytest

pytestmark = pytest.mark.once

STUDY = runpy.run_path(str(Path(__file__).parents[1] / "studies" / "conserving.py"))


def history_of(problem, method, until, **options):
    sim, history, length = STUDY["build"](problem, method, **options)
    steps = list(sim.run(until, step_length=length))
    return history, steps


def test_pic_loses_the_energy_of_the_cantilever():
    """With fewer points, and let go sooner, than in the paper."""
    options = {"per_side": 4, "release": 6.0}
    (conserving, steps), (pic, _) = (
        history_of("cantilever-A", method, 15.0, **options) for method in ("energy-momentum", "pic")
    )
    assert np.abs(STUDY["drift"](conserving, 6.0)).max() < 1e-9
    assert max(step.newton.iterations for step in steps) <= 4
    assert STUDY["drift"](pic, 6.0).min() < -1e-4
    assert conserving["kinetic"][-1] + conserving["strain"][-1] > 100.0  # J


@pytest.mark.mpi
def test_plastic_cylinders_keep_momenta():
    """Until they have met, with fewer points."""
    history, _ = history_of("collision-plastic", "energy-momentum", 3.0, per_side=10)
    assert history["dissipated"][-1] > 5.0  # J
    assert np.all(np.diff(history["dissipated"]) > -1e-12)
    assert history["momentum"].max() < 1e-12 and history["angular"].max() < 1e-10
    assert np.abs(STUDY["drift"](history)).max() < 1e-9


def test_lumped_mass_changes_angular_momentum():
    history, _ = history_of("collision", "lumped", 3.0, per_side=10)
    assert history["momentum"].max() < 1e-12
    assert history["angular"].max() > 0.01
    assert STUDY["drift"](history)[-1] < -0.01
