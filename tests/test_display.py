# SPDX-License-Identifier: MIT
"""Facts are printed as lines and shown by notebooks as tables, by one rank alone if need be."""

import html
import re

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh

from fenicsmpm import ExplicitMPM, _display, formulations, points
from fenicsmpm.forms import form
from fenicsmpm.materials import NeoHookean
from fenicsmpm.simulation import Step
from fenicsmpm.solvers import NewtonResult

WORLD = MPI.COMM_WORLD


def facts_in(table):
    """Names and texts in the rows of a table of HTML."""
    rows = re.findall(r"<tr><th[^>]*>([^<]*)</th><td[^>]*>([^<]*)</td></tr>", table)
    assert len(rows) == table.count("<tr") and table.startswith("<table>")
    return [(html.unescape(name), html.unescape(text)) for name, text in rows]


class Strange(_display.Described):
    def _facts(self):
        return [("a < b", "<script>"), ("c", "1 & 2")]


def test_text_and_table_say_the_same_and_markup_is_escaped():
    assert str(Strange()) == "Strange\n  a < b  <script>\n  c      1 & 2"
    table = Strange()._repr_html_()
    assert facts_in(table) == [("a < b", "<script>"), ("c", "1 & 2")]
    assert "<script>" not in table and "1 &amp; 2" in table


def body_and_unknown():
    domain = mesh.create_unit_square(WORLD, 3, 3, mesh.CellType.quadrilateral)
    body = points.fill(domain, 2, tag=3)
    z = formulations.Unknown(domain, "v")
    z.fix("v", lambda x: np.isclose(x[0], 0))
    return body, z


@pytest.mark.mpi
def test_forms_say_where_they_are_integrated_and_what_they_read():
    body, z = body_and_unknown()
    body.add_field("p")
    q = fem.Function(fem.functionspace(body.mesh, ("P", 1)), name="q")
    v = z.test.v
    F = body.field("p") * ufl.div(v) * body.dx + body.field("weight") * v[0] * body.dx(3)
    compiled = form(F + q * v[1] * ufl.dx + q * v[1] * ufl.ds)
    n = len(body)
    first, *rest = facts_in(compiled._repr_html_())  # UFL sorts the integrals of each kind
    assert first == ("form", "vector of 32 values")
    assert sorted(rest) == [
        (f"over {n} points", "p"),
        (f"over {n} points with tag 3", "weight"),
        ("over cells or facets of the mesh", "q"),
    ]
    where = ", ".join(name.removeprefix("over ") for name, _ in rest)
    assert repr(compiled) == f"Form(vector, integrals over {where})"
    assert "over 0 values" not in str(form(1.0 * body.dx))


@pytest.mark.mpi
def test_one_rank_alone_can_be_printed():
    body, z = body_and_unknown()
    formulations.set_initial_state(body, 1000.0)
    R = formulations.internal_force(z.test.v, body, NeoHookean(1e6, 0.3))
    sim = ExplicitMPM(R, z, body)
    compiled = form(body.field("J") * body.dx)
    if WORLD.rank == 0:
        for thing in (body, z, sim, compiled):
            facts = facts_in(thing._repr_html_())
            assert facts == thing._facts() and len(str(thing).splitlines()) == 1 + len(facts)
        assert ("v", "vector, grid, 32 degrees of freedom") in z._facts()
        assert ("conditions on", "v") in z._facts()
        assert ("body", "36 points of " + repr(sim.laws[body])) in sim._facts()


def test_results_say_what_was_unusual():
    newton = NewtonResult(2, 0, 2, [1.0, 1e-3, 1e-9], [1.0, 1.0])
    newton.seconds.add("assembly", 0.25)
    newton.seconds.add("linear solver", 1.5)
    assert newton._facts() == [
        ("Newton iterations", "2"),
        ("tangents", "2"),
        ("residuals", "1, 0.001, 1e-09"),
        ("time spent", "linear solver 1.5 s, assembly 0.25 s"),
    ]
    newton.step_lengths[0], newton.linear_iterations = 0.5, 30
    names = [name for name, _ in Step(3, 0.3, 0.05, newton, attempts=2, removed=1)._facts()]
    assert names == [
        *("step", "time", "length", "attempts", "points that left the mesh"),
        *("Newton iterations", "tangents", "residuals", "step lengths", "Krylov iterations"),
        "time spent",
    ]
    assert [name for name, _ in Step(1, 0.1, 0.1)._facts()] == ["step", "time", "length"]
