# SPDX-License-Identifier: MIT
"""Warnings of carried points that have lost their body."""

import contextlib
import logging

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh

from fenicsmpm import ExplicitMPM, ImplicitMPM, basis, points
from fenicsmpm import formulations as fm
from fenicsmpm.cells import ActiveCells, Tying
from fenicsmpm.materials import Hencky, NeoHookean
from fenicsmpm.simulation import Contact

COMM = MPI.COMM_WORLD


def warnings(caplog):
    """Those that were logged of carried points."""
    return [r.getMessage() for r in caplog.records if "half a cell away" in r.getMessage()]


@pytest.mark.mpi
@pytest.mark.parametrize(("functions", "by_forms"), [("linear", False), ("quadratic", True)])
def test_explicit_steps_warn_once(functions, by_forms, caplog):
    """Of points that lose the body in the course of a run, whatever the way of the steps."""
    domain = mesh.create_unit_square(
        COMM, 10, 10, mesh.CellType.quadrilateral, partitioner=basis.shared_vertex_partitioner
    )
    body = points.lattice(domain, 0.05, inside=lambda x: np.abs(x[:2] - 0.5).max(axis=0) < 0.2)
    other = points.lattice(domain, 0.05, inside=lambda x: x[0] < 0.1)
    edge = points.on_curve(domain, (0.3, 0.7), (0.7, 0.7), spacing=0.05)  # between two cells
    bodies = [body, other] if by_forms else [body]
    for some in (*bodies, edge):
        if functions != "linear":
            basis.use(some, functions)
    z = fm.Unknown(domain, "v")
    terms = []
    for some in bodies:
        fm.set_initial_state(some, 1.0)
        terms.append(fm.internal_force(z.test.v, some, Hencky(1.0, 0.3)))
    contacts = [Contact(body, other)] if by_forms else []
    sim = ExplicitMPM(sum(terms[1:], terms[0]), z, bodies, carried=[edge], contacts=contacts)
    with caplog.at_level(logging.WARNING):
        for _ in range(3):
            sim.step()
        edge.move(edge.x + [0.0, 0.12])
        for _ in sim.run(300 * sim.dt, 100 * sim.dt):
            pass
    found = COMM.allreduce(warnings(caplog))
    assert len(found) == 1
    assert "8 of 8 carried points" in found[0] and "cells.Tying" in found[0]


@pytest.mark.mpi
def test_implicit_steps_warn_once(caplog):
    """At the start, of an edge that was seeded beside the body, and not again."""
    domain = mesh.create_unit_square(COMM, 8, 8)
    body = points.fill(domain, 2, inside=lambda x: x[0] < 0.5)
    fm.set_initial_state(body, 1.0)
    z, law = fm.Unknown(domain, "u", "p"), NeoHookean(1.0, 0.3)
    scheme = fm.Bossak(z, dt=0.01)
    R = fm.stabilized("asgs", z, body, law, force=scheme.force(body))
    with caplog.at_level(logging.WARNING):
        for x, expected in ((0.5, 0), (0.72, 1)):
            caplog.clear()
            edge = points.on_curve(domain, (x, 0.1), (x, 0.9), spacing=0.1)
            sim = ImplicitMPM(R, z, scheme, body, carried=[edge])
            for _ in range(2):
                sim.step()
            found = COMM.allreduce(warnings(caplog))
            assert len(found) == expected
            assert all("8 of 8 carried points" in text and "(0.72, " in text for text in found)


@pytest.mark.parametrize("tied", [False, True])
def test_an_edge_that_tears_off(tied, caplog):
    """Many steps with a ghost penalty, which resists increments only; tied nodes hold."""
    domain = mesh.create_rectangle(COMM, [(0, 0), (1.5, 0.5)], [12, 4])
    body = points.fill(domain, 3, inside=lambda x: x[0] < 1)
    fm.set_initial_state(body, 1.0)
    edge = points.on_curve(domain, (1, 0), (1, 0.5), spacing=1 / 32)
    law, z, way = NeoHookean(E=3.0, nu=0.3), fm.Unknown(domain, "u", "p"), fem.Constant(domain, 0.0)
    z.fix("u", lambda x: np.isclose(x[0], 0), component=0)
    z.fix("u", lambda x: np.isclose(x[1] * (0.5 - x[1]), 0), component=1)
    scheme, cells = fm.QuasiStatic(z, dt=1 / 80), ActiveCells(body, loads=[edge])
    R = fm.stabilized("asgs", z, body, law)
    R += fm.penalty_dirichlet(z, edge, law, ufl.as_vector((way, 0.0)))
    if tied:
        newton = {"tying": Tying(z.space, body, cells)}
    else:
        newton, R = {}, R + fm.ghost_penalty(z, cells, law)

    def pull(start, end):
        way.value = 0.3 * end

    sim = ImplicitMPM(R, z, scheme, body, carried=[edge], data=pull, newton=newton)
    # what has gone farther is an error, with which a run ends
    lost = pytest.raises(ValueError, match="too far from the bodies")
    with caplog.at_level(logging.WARNING), contextlib.nullcontext() if tied else lost:
        for _ in sim.run(1.0):
            pass
    assert (edge.x[:, 0].mean() - body.x[:, 0].max() > 0.1) is not tied
    assert len(warnings(caplog)) == (0 if tied else 1)
