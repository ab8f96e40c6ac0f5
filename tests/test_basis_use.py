# SPDX-License-Identifier: MIT
"""Splines and uGIMP in use: projections, active cells, dynamics; the choice and its errors."""

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from lattices import COMM, EACH, EVERYWHERE, LOWER, SHAPE, UPPER, cloud, lattice, noise, space, use

from fenicsmpm import ImplicitMPM, MaterialPoints, basis, forms, formulations, points
from fenicsmpm.cells import ActiveCells, FilledFraction, Tying
from fenicsmpm.diagnostics import angular_momentum, momentum
from fenicsmpm.materials import NeoHookean
from fenicsmpm.transfer import p2g, project

pytestmark = pytest.mark.ranks

# --- mapping -------------------------------------------------------------------------------------


@pytest.mark.mpi
@EVERYWHERE
@EACH
def test_projection_conserves_and_reproduces_linear_fields(dim, name):
    body = cloud(dim, name)
    slope = np.arange(1.0, dim + 1)
    body.add_field("v", (), body.x @ slope)
    body.add_field("L", (dim,), slope)
    V = space(body.mesh)
    v, linear = fem.Function(V), fem.Function(V)
    project([body], {"v": v}, mass="weight")
    momentum = COMM.allreduce(body.weight @ body["v"])
    mass = p2g(body, body.weight, V)
    n = V.dofmap.index_map.size_local
    assert COMM.allreduce(mass.array[:n] @ v.x.array[:n]) == pytest.approx(momentum, rel=1e-10)
    project([body], {"v": linear}, mass="weight", gradients={"v": "L"})
    exact = V.tabulate_dof_coordinates()[:, :dim] @ slope
    seen = mass.array > 1e-9
    assert linear.x.array[seen] == pytest.approx(exact[seen], rel=1e-7)


@pytest.mark.mpi
@EVERYWHERE
@pytest.mark.parametrize("name", ["quadratic", "cubic", "gimp"])
def test_active_cells_are_those_whose_nodes_are_all_seen(dim, name):
    domain = lattice(dim)
    cells = np.array(SHAPE[:dim])
    h = (UPPER - LOWER)[:dim] / cells
    x = LOWER[:dim] + 2.2 * h  # in the third cell of each direction, 0.2 above its lower face
    n = 1 if COMM.rank == 0 else 0
    body = MaterialPoints(domain, np.tile(x, (n, 1)), 1.0)
    basis.use(body, name, half_size=0.3 * h if name == "gimp" else None)
    active = ActiveCells(body)
    span = {"quadratic": 2, "cubic": 3, "gimp": 2}[name]
    assert COMM.allreduce(len(active.cells())) == span**dim
    middle = mesh.compute_midpoints(domain, dim, active.cells())[:, :dim]
    assert np.all(np.abs(middle - x) < (1.8 if name == "cubic" else 0.8) * h)
    if name == "gimp":  # all of it within the cell
        body.move(body.x + 0.2 * h)
        assert COMM.allreduce(len(active.cells())) == 1
    # the lumped mass is that of all nodes
    fraction = FilledFraction(body)
    a = forms.form(fraction * fraction.vertex_dx)
    assert forms.assemble_scalar(a) == pytest.approx(1, rel=1e-13)


@pytest.mark.mpi
@pytest.mark.parametrize("name", ["quadratic", "cubic", "gimp"])
def test_tied_nodes_follow_linear_fields(name):
    domain = lattice(2, shape=(12, 10))
    body = points.fill(domain, 2, inside=lambda x: (x[0] < 1.9) & (x[1] < -1.1))
    use(body, name)
    V = space(domain)
    tying = Tying(V, body, ActiveCells(body))
    x, diagonal = tying.matrix.createVecs()
    tying.matrix.getDiagonal(diagonal)
    tied = diagonal.array_r == 0.0
    seen = p2g(body, body.weight, V).array[: len(tied)] > 0
    assert COMM.allreduce(int(tied.sum())) > 5
    assert not np.any(tied & ~seen)  # nothing else than what the points see
    exact = fem.Function(V)
    exact.interpolate(lambda x: x[0] - 2 * x[1])
    expected = exact.x.array[: len(tied)]
    x.array_w[:] = np.where(tied, 1e3, expected)
    tying.extend(x)
    assert x.array_r == pytest.approx(expected, abs=1e-11)


# --- dynamics ------------------------------------------------------------------------------------


@pytest.mark.mpi
@pytest.mark.parametrize("name", ["quadratic", "cubic", "gimp"])
def test_flight_of_a_body_keeps_its_momenta(name):
    kind = mesh.CellType.quadrilateral
    domain = mesh.create_rectangle(
        COMM, [(0, 0), (3, 2)], (18, 12), kind, partitioner=basis.shared_vertex_partitioner
    )
    body = points.lattice(domain, 0.8 / 12, inside=lambda x: np.abs(x[:2] - 0.8).max(axis=0) < 0.4)
    basis.use(body, name, 0.8 / 24 if name == "gimp" else None)

    def v0(x):
        return np.array([1.0 + 2.0 * (0.8 - x[1]), 0.5 + 2.0 * (x[0] - 0.8)])

    formulations.set_initial_state(body, 2.0, v0)
    z = formulations.Unknown(domain, "u", "p")
    law = NeoHookean(E=1000.0, nu=0.5)
    scheme = formulations.Bossak(z, dt=0.01)
    force, cells = scheme.force(body), ActiveCells(body)
    R = formulations.stabilized("cip", z, body, law, force=force, cells=cells)
    R += formulations.ghost_penalty(z, cells, law)
    sim = ImplicitMPM(R, z, scheme, body, taylor=True)
    start = momentum(body), angular_momentum(body)
    for _ in sim.run(until=0.05):
        pass
    assert momentum(body) == pytest.approx(start[0], rel=1e-8)
    assert angular_momentum(body) == pytest.approx(start[1], rel=2e-3)
    assert np.abs(body["J"] - 1).max(initial=0) < 1e-2


# --- choice and errors ---------------------------------------------------------------------------


def test_copies_keep_the_choice():
    body = cloud(2, "quadratic")
    V = space(body.mesh)
    copy, few = body.copy(), body.select(body.x[:, 0] < 1.8)
    weights = p2g(body, body.weight, V).array
    assert np.array_equal(p2g(copy, copy.weight, V).array, weights)
    assert basis.stencil_of(few).kind == basis.stencil_of(body).kind


def quadrilaterals(n=4, **options):
    kind = mesh.CellType.quadrilateral
    return mesh.create_rectangle(COMM, [(0, 0), (1, 1)], (n, n), kind, **options)


@pytest.mark.mpi
def test_meshes_that_are_no_lattices():
    triangles = mesh.create_unit_square(COMM, 4, 4)
    with pytest.raises(ValueError, match=r"axis-parallel boxes .* not one of triangles"):
        basis.use(points.fill(triangles, 1), "cubic")
    graded = quadrilaterals()
    graded.geometry.x[:, 0] **= 2
    with pytest.raises(ValueError, match="differ in size or are not axis-parallel"):
        basis.use(points.fill(graded, 1), "quadratic")


def test_meshes_with_holes():
    full = quadrilaterals()
    part = mesh.create_submesh(full, 2, np.arange(15, dtype=np.int32))[0]
    with pytest.raises(ValueError, match="4 x 4 cells has 16 cells, but this mesh has 15"):
        basis.use(points.fill(part, 1), "quadratic")


@pytest.mark.mpi
@pytest.mark.skipif(COMM.size == 1, reason="nothing is hidden from one rank")
def test_ranks_that_do_not_see_enough_say_so_together():
    body = points.fill(quadrilaterals(ghost_mode=mesh.GhostMode.none), 1)
    seen = body.copy()
    basis.use(body, "quadratic")
    with pytest.raises(ValueError, match="shared_vertex_partitioner"):
        p2g(body, body.weight, fem.functionspace(body.mesh, ("Lagrange", 1)))
    basis.use(seen, "linear")
    total = p2g(seen, seen.weight, fem.functionspace(seen.mesh, ("Lagrange", 1)))
    owned = total.index_map.size_local
    assert COMM.allreduce(total.array[:owned].sum()) == pytest.approx(seen.volume())


@pytest.mark.parametrize(
    ("name", "half", "message"),
    [
        (
            "spline",
            None,
            "unknown grid functions 'spline': choose one of linear, quadratic, cubic",
        ),
        ("gimp", None, "need half_size"),
        ("cubic", 0.1, "other functions do not take it"),
        ("gimp", 0.2, "at most half a cell"),
        ("gimp", (0.1, 0.0), "above 0"),
        ("gimp", (0.1, 0.1, 0.1), "shape"),
    ],
)
def test_choices_that_make_no_sense(name, half, message):
    body = points.fill(quadrilaterals(), 1)
    with pytest.raises(ValueError, match=message):
        basis.use(body, name, half)
    basis.use(body, "quadratic")  # nothing has happened


def test_choice_after_use():
    body = points.fill(quadrilaterals(), 1)
    p2g(body, body.weight, space(body.mesh))
    with pytest.raises(ValueError, match="used already"):
        basis.use(body, "quadratic")


@pytest.mark.parametrize(("family", "degree"), [("Lagrange", 2), ("DG", 0), ("DG", 1)])
def test_spaces_for_which_splines_do_not_stand(family, degree):
    body = cloud(2, "cubic")
    V = fem.functionspace(body.mesh, (family, degree))
    for part in (ufl.TestFunction(V), fem.Function(V)):
        with pytest.raises(ValueError, match="cubic functions stand for those of a continuous"):
            forms.form(part * body.dx)
    with pytest.raises(ValueError, match="cubic functions stand for those of a continuous"):
        p2g(body, body.weight, V)


def test_averages_over_cells():
    f = noise(space(cloud(2, "cubic").mesh))
    for name in ("linear", "cubic"):
        body = use(points.fill(f.function_space.mesh, 2), name)
        difference = forms.form((f - ufl.cell_avg(f)) * body.dx)
        assert forms.assemble_scalar(difference) == pytest.approx(0, abs=1e-13)
    for name in ("quadratic", "gimp"):
        body = use(points.fill(f.function_space.mesh, 2), name)
        with pytest.raises(forms.UnsupportedFormError, match="cell_avg of"):
            forms.form(ufl.cell_avg(f) * body.dx)
