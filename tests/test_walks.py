# SPDX-License-Identifier: MIT
# Copyright (c) The fenicsmpm developers
"""Three walks of a newcomer along the pages, with the changes to which the pages invite.

The code is that of the pages. Tutorial: each "Your turn" is done. A body from Gmsh: the file is the
reader's own. A stabilization: the reader's own function and its table.
"""

import re
import subprocess
import sys
from pathlib import Path

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from dolfinx import mesh

from fenicsmpm import formulations, points, solvers

DOCS = Path(__file__).parents[1] / "docs"
TUTORIAL = DOCS / "tutorial"
BLOCK = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)

pytestmark = pytest.mark.once


def run(text, path, namespace=None):
    """Execute a text that stands for a script; its names afterwards."""
    namespace = {"__name__": "__main__"} if namespace is None else namespace
    exec(compile(text, path, "exec"), namespace)
    return namespace


def blocks(page):
    """The Python blocks of a page, each with the heading above it."""
    text = (DOCS / page).read_text()
    for match in BLOCK.finditer(text):
        heading = re.findall(r"^## (.*)$", text[: match.start()], re.MULTILINE)
        yield (heading[-1] if heading else ""), match[1]


# --- first run, changed ---------------------------------------------------------------------------


class Step:
    """A step of the tutorial and what its last section suggests."""

    def __init__(self, number):
        [self.path] = TUTORIAL.glob(f"{number}_*.py")
        self.text = self.path.read_text()
        _, _, turn = self.text.partition("# ## Your turn\n")
        assert turn
        self.turn = re.sub(r"^# ?", "", turn, flags=re.MULTILINE)

    def changed(self, *changes):
        """The script after replacements, whose new text (or the text to go) the page names."""
        text, _, _ = self.text.partition("# ## Your turn\n")
        said = " ".join(self.turn.split())
        for old, new in changes:
            assert " ".join((new or old).split()) in said, f"not on the page: {new or old}"
            assert text.count(old) == 1, f"not once in the script: {old}"
            text = text.replace(old, new)
        return text

    def run(self, *changes):
        """What the script defines after replacements."""
        return run(self.changed(*changes), self.path)


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    """Scripts write pictures and files to the present directory."""
    monkeypatch.chdir(tmp_path)


def test_more_points_do_not_help_but_smaller_cells_do():
    step = Step(1)

    def difference(*changes):
        names = step.run(*changes)
        # the velocities that the points had, 3 x, before they were overwritten
        return np.abs(names["back"][:, 0] - 3.0 * names["body"].x[:, 0]).max()

    many = "per_cell=10", "per_cell=1000"
    cells = "create_unit_square(MPI.COMM_WORLD, 1, 1", "create_unit_square(MPI.COMM_WORLD, 2, 2"
    ten, thousand, finer = difference(), difference(many), difference(many, cells)
    assert thousand == pytest.approx(1.0, abs=0.05) and ten == pytest.approx(1.0, abs=0.3)
    assert finer == pytest.approx(0.5 * thousand, rel=0.05)  # proportional to the cell


def test_conductivity_depends_on_temperature():
    step = Step(2)
    linear = step.run()
    names = step.run(
        ('k = body.field("k")', 'k = body.field("k") * (1 + z.T)'),
        ("exact = 9 / np.log(10)", "exact = 1.5 * 9 / np.log(10)"),
    )  # asserts the flux
    assert linear["result"].iterations == 1 < names["result"].iterations


def test_finer_mesh_and_another_energy():
    step = Step(3)
    first = step.run()
    finer = step.run(("[20, 16]", "[40, 32]"), ("H = 0.25", "H = 0.125"))
    assert first["tip"] < finer["tip"] < finer["beam"]
    other = step.run(("lmbda / 2 * ufl.ln(J) ** 2", "lmbda / 2 * (J - 1) ** 2"))
    assert other["tip"] == pytest.approx(first["tip"], rel=0.01)
    assert other["tip"] != first["tip"]


def test_grid_crossing():
    step = Step(4)
    names = step.run(("V0, DT = 0.1, 0.02", "V0, DT = 1.0, 0.02"), ("assert error < 0.02\n", ""))
    assert names["error"] > 0.2
    late = np.abs(names["history"][names["t"] > 30]).max()
    assert late < 0.9 * names["history"][0]  # energy is lost, and not gained


@pytest.mark.slow
def test_stabilization_in_place_of_asgs():
    step = Step(5)
    [own] = BLOCK.findall(step.turn)
    line = "R += formulations.asgs(z, body, rubber)"
    names = step.run((line, own.strip().replace("\n", "\n        ")))
    smooth, rough = (names["pressures"][name]["p"].std() for name in ("mixed and ASGS", "mixed"))
    assert smooth < 0.5 * rough


@pytest.mark.slow
def test_functions_in_a_whole_period():
    step = Step(6)
    names = step.run(
        ("swing(functions, quarter)", "swing(functions, 4 * quarter)"),
        ('"linear", "gimp", "quadratic"', '"linear", "gimp", "quadratic", "cubic"'),
    )
    assert names["roughness"]["cubic"] < names["roughness"]["quadratic"]


@pytest.mark.slow
def test_another_stabilization_and_a_flight():
    step = Step(7)
    other = "formulations.asgs(", "formulations.osgs("
    finer = "H, DT = 0.25, 0.02", "H, DT = 0.125, 0.02"
    gap = step.run(other)["lowest"] - step.run()["lowest"]
    assert 0.0 < step.run(other, finer)["lowest"] - step.run(finer)["lowest"] < 0.5 * gap
    flying = step.run(
        ('z.fix("u", lambda x: np.isclose(x[0], 0))\n', ""),
        ("set_initial_state(body, RHO)", "set_initial_state(body, RHO, (1.0, 4.0))"),
        ("for end in 0.5, 1.0, 1.5", "for end in 0.2, 0.4, 0.6"),
    )
    # Bossak's scheme takes a first step with an acceleration of zero
    t, dt, g = flying["sim"].time, flying["DT"], flying["G"]
    path = np.array([2.0 + 1.0 * t, 4.0 * t - g * t**2 / 2])
    assert flying["body"].x.mean(axis=0) == pytest.approx(path, abs=g * dt**2)


@pytest.mark.slow
def test_ranks_and_a_restart(tmp_path):
    step = Step(8)
    head, series, restart = re.split("(?=^# ## A )", step.changed(), flags=re.MULTILINE)
    [say] = re.findall(r"`(io\.say\(.*?\))`", step.turn)

    def printed(text, ranks):
        (tmp_path / "script.py").write_text(text)
        command = ["mpirun", "-n", str(ranks), sys.executable, "script.py"]
        done = subprocess.run(command, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        [found] = re.findall(r"momentum .*?\[(.*?)\]", done.stdout)
        return np.array(found.split(), dtype=float)

    one = step.run()["end"]
    two = printed(head + series, 2)
    three = printed(head + restart.split("difference = ")[0] + say, 3)
    assert two == pytest.approx(one, rel=1e-6, abs=1e-3)
    assert three == pytest.approx(two, rel=1e-6, abs=1e-3)


# --- a body of one's own from Gmsh ----------------------------------------------------------------


def write_own_file(dim):
    """A file that the page does not know: a short beam with a square bar through it."""
    gmsh = pytest.importorskip("gmsh")
    gmsh.initialize(interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    occ = gmsh.model.occ
    if dim == 2:
        outer = occ.addRectangle(0, -0.15, 0, 0.8, 0.3)
        inner = occ.addRectangle(0.5, -0.06, 0, 0.12, 0.12)
    else:
        outer = occ.addBox(0, -0.15, -0.1, 0.8, 0.3, 0.2)
        inner = occ.addBox(0.5, -0.06, -0.1, 0.12, 0.12, 0.2)
    (bar, matrix), _ = occ.fragment([(dim, inner)], [(dim, outer)])
    occ.synchronize()
    gmsh.model.addPhysicalGroup(dim, [bar[1]], name="bar")
    gmsh.model.addPhysicalGroup(dim, [matrix[1]], name="matrix")
    gmsh.option.setNumber("Mesh.MeshSizeMax", 0.1)
    gmsh.model.mesh.generate(dim)
    gmsh.write("mine.msh")
    gmsh.finalize()


@pytest.mark.slow
def test_own_body_from_gmsh():
    """In the plane and in space, with names of the file and of the groups changed in the text."""
    page = [*blocks("howto/gmsh.md")]
    names = {"__name__": "__main__"}
    for heading, text in page:
        if "gmsh.initialize" in text:
            write_own_file(3 if heading == "In three dimensions" else 2)
            continue
        for old, new in ("beam3d.msh", "mine.msh"), ("beam.msh", "mine.msh"):
            text = text.replace(f'"{old}"', f'"{new}"')
        text = text.replace('"core"', '"bar"').replace('"shell"', '"matrix"')
        run(text, "howto/gmsh.md", names)
        if heading == "Put points into the groups":
            before = names["core"].x[:, 1].mean()
            area = [names[name].volume() for name in ("core", "shell")]
            assert area == pytest.approx([0.12**2, 0.8 * 0.3 - 0.12**2])
        elif heading == "Run it":
            assert names["core"].x[:, 1].mean() < before - 0.01
            assert Path("beam.png").stat().st_size > 10_000
    assert names["core"].x.shape[1] == 3
    assert names["core"]["V_0"].sum() == pytest.approx(0.12**2 * 0.2)
    assert names["core"]["v"][:, 1].mean() < -0.1


# --- a stabilization of one's own -----------------------------------------------------------------


@pytest.mark.slow
def test_own_stabilization_and_its_table(capsys):
    """The test problem of the page, with a function that the page does not have."""
    script = "".join(
        text
        for heading, text in blocks("howto/own_stabilization.md")
        if heading.startswith("Step 1")
    )
    names = run(script, "howto/own_stabilization.md")

    def mine(z, body, force):
        """Pressure less its mean in a cell, a building block that the page lists."""
        p, q = z.p - ufl.cell_avg(z.p), z.test.p - ufl.cell_avg(z.test.p)
        return -1 / (2 * names["law"].mu) * p * q * body.dx

    assert "`ufl.cell_avg(z.p)`" in (DOCS / "howto/own_stabilization.md").read_text()
    table = names["study"](mine, sizes=(8, 16, 32))
    rows = capsys.readouterr().out.splitlines()
    assert "order of u" in rows[0] and len(rows) == 5
    assert table.orders()["u"] > 1.7 and table.orders()["p"] > 1.2


# --- slips on the way -----------------------------------------------------------------------------


def test_slips_are_explained():
    """What a newcomer mixes up on these walks raises an error that names it."""
    domain = mesh.create_unit_square(MPI.COMM_SELF, 2, 2)
    body = points.fill(domain, 2)
    z = formulations.Unknown(domain, "u", "p")
    scheme = formulations.Bossak(z, dt=0.1)
    with pytest.raises(ValueError, match=r"no density: call set_initial_state\(points, density\)"):
        scheme.force(body)
    formulations.set_initial_state(body, density=1.0)
    with pytest.raises(ValueError, match=r"2 finite numbers, not \(0.0, 0.0, -9.81\)"):
        scheme.force(body, (0.0, 0.0, -9.81))
    with pytest.raises(ValueError, match=r"must have shape \(2,\), not \(3,\)"):
        scheme.force(body, ufl.as_vector((0.0, 0.0, -9.81)))
    with pytest.raises(TypeError, match=r"dolfinx function, such as z.U, not"):
        solvers.NewtonSolver(scheme.inertia(body), z.u, z.bcs)
    for make in points.in_solid, points.on_surface:
        with pytest.raises(TypeError, match=r"a solid is needed, as from read_solid.*Mesh"):
            make(domain, domain, 0.1)
    with pytest.raises(TypeError, match=r"needs a mesh, such as read_cells returns, not 'b.msh'"):
        points.in_cells(domain, "b.msh", 0.1)
