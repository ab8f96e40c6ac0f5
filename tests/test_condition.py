# SPDX-License-Identifier: MIT
"""Condition numbers of mass and stiffness where points hardly fill a cell."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent.parent / "studies"))

from condition_numbers import condition


@pytest.mark.parametrize("what", ["mass", "tangent"])
@pytest.mark.parametrize("kind", ["linear", "gimp"])
def test_condition_number_of_cut_cells(kind, what):
    """Mass and stiffness fall with powers of the share that are those of the functions."""
    shares = (1e-1, 1e-2, 1e-3)
    without, ghost, tied = (
        [condition(remedy, share, kind, what) for share in shares]
        for remedy in ("none", "ghost", "tying")
    )
    growth = {"linear": {"mass": 1e3, "tangent": 10}, "gimp": {"mass": 1e4, "tangent": 100}}
    assert without[2] / without[1] == pytest.approx(growth[kind][what], rel=0.03)
    assert max(ghost) < 1.1 * min(ghost) < 200
    assert max(tied) < 1.1 * min(tied) < 200
