# SPDX-License-Identifier: MIT
"""Implicit dynamics on several ranks: the same history as on one."""

import sys
from pathlib import Path

from mpi4py import MPI

import numpy as np
import pytest

from fenicsmpm import ImplicitMPM, MaterialPoints, formulations, points
from fenicsmpm.cells import ActiveCells, correct_weights
from fenicsmpm.diagnostics import probe
from fenicsmpm.materials import NeoHookean

MESHES = Path(__file__).parent.parent / "meshes"
sys.path.insert(0, str(MESHES))
pytest.importorskip("gmsh")
from background import read  # noqa: E402

pytestmark = pytest.mark.ranks


def beam_history(comm, stabilization="asgs", scheme=formulations.Bossak, steps=20):
    """Displacements of the corner of a coarse bending beam."""
    domain, _ = read(MESHES / "column_coarse.msh", 3, comm)

    def inside(x):
        return (np.abs(x[:2]).max(axis=0) < 0.5) & (x[2] > 0) & (x[2] < 6)

    # many points lie on facets, also between ranks: they must go to the same cells on any number
    body = points.lattice(domain, 1 / 6, inside=inside)
    formulations.set_initial_state(body, 1100.0, lambda x: np.outer((5 / 3, 0, 0), x[2]))
    tip = MaterialPoints(domain, [(0.5, 0.5, 6.0)] if comm.rank == 0 else np.empty((0, 3)), 1.0)
    law = NeoHookean(1.7e7, 0.5)
    z = formulations.Unknown(domain, "u", "p")
    z.fix("u", lambda x: np.isclose(x[2], 0))
    time = scheme(z, dt=0.005)
    R = formulations.stabilized(stabilization, z, body, law, force=time.force(body))
    cells = ActiveCells(body, loads=[tip])
    R += formulations.ghost_penalty(z, cells, law)
    sim = ImplicitMPM(
        R, z, time, body, carried=[tip], newton={"rtol": 1e-12},
        observers=[lambda sim, step: correct_weights(body, cells)],
    )  # fmt: skip
    history = []
    for _ in range(steps):
        sim.step()
        history.append(probe(tip, "u"))
    return np.array(history)


@pytest.mark.mpi
@pytest.mark.parametrize("stabilization", ["asgs", "osgs"])
def test_history_of_the_coarse_beam(stabilization):
    alone = beam_history(MPI.COMM_SELF, stabilization)
    together = beam_history(MPI.COMM_WORLD, stabilization)
    assert np.abs(alone[-1, 0]) > 0.5  # it moves by more than a cell
    assert np.abs(together - alone).max() <= 1e-9 * np.abs(alone).max()
