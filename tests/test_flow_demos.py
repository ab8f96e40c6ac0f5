# SPDX-License-Identifier: MIT
"""The demos of incompressible flow."""

import sys
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent.parent / "demos"))


@pytest.mark.slow
@pytest.mark.parametrize(("h", "scheme"), [(0.1, "BDF2"), (0.1, "Bossak"), (0.2, "Bossak")])
def test_dam_break_implicit(h, scheme):
    """The meshes of the slides, until the front is at 3.5 a: front, residual height, volume."""
    demo = import_module("dam_break_implicit")
    table, panels = demo.run(demo.Case(h, 2e-3, scheme), 0.72, (0.25, 0.5))
    front, foremost, height = demo.deviations(table)
    assert front < 0.08 and height < 0.05
    assert foremost < (0.08 if scheme == "BDF2" else 0.12)
    assert np.abs(table[:, 4]).max() < 1e-10
    assert table[:, 5].max() < 0.1
    assert table[-1, 2] > 3.5
    assert len(panels) == 2


def test_wave_on_block(tmp_path):
    table = import_module("wave_on_block").main(["--short", "--output", str(tmp_path)])
    assert table["t [s]"][-1] == pytest.approx(0.02)
    assert np.abs(table["change of the water's volume"]).max() < 1e-8
    assert (tmp_path / "wave_on_block_deflection.png").exists()


def test_taylor_green():
    """Second order while points move by more than a cell."""
    demo = import_module("taylor_green")
    coarse, fine = (demo.error(demo.Case(), n, demo.POINTS[n]) for n in (8, 16))
    assert np.log2(coarse[0] / fine[0]) > 1.9
    assert np.abs(fine[1]["u"]).max() > 1 / 16


@pytest.mark.parametrize(
    ("name", "arguments"),
    [
        ("dam_break_implicit", "--until 0"),
        ("dam_break_implicit", "--size 0.3"),
        ("dam_break_implicit", "--size 0.125"),
        ("taylor_green", "--viscosity 0"),
        ("wave_on_block", "--until -1"),
        ("wave_on_block", "--size 0.15"),
        ("wave_on_block", "--size 0.08"),
    ],
)
def test_wrong_options(name, arguments, capsys):
    with pytest.raises(SystemExit) as stopped:
        import_module(name).main(arguments.split())
    assert stopped.value.code == 2
    assert "error: " in capsys.readouterr().err
