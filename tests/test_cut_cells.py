# SPDX-License-Identifier: MIT
"""Remedies for cells that the body fills in part: corrected weights, tied nodes."""

import sys
from pathlib import Path

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import pytest
import ufl
from dolfinx import fem, la, mesh
from forms_table import CELLS

from fenicsmpm import ImplicitMPM, MaterialPoints, _compat, basis, forms, points
from fenicsmpm import formulations as fm
from fenicsmpm.cells import ActiveCells, BalancedWeights, Tying, correct_weights
from fenicsmpm.forms.regions import RegionForm
from fenicsmpm.materials import NeoHookean
from fenicsmpm.solvers import NewtonSolver

sys.path.insert(0, str(Path(__file__).parent.parent / "studies"))

import moved_points

pytestmark = pytest.mark.ranks

COMM = MPI.COMM_WORLD


# --- weights ---------------------------------------------------------------------------------


def disc(comm):
    """Random points with random weights in a disc; the same on any number of ranks."""
    domain = mesh.create_unit_square(comm, 10, 10)
    rng = np.random.default_rng(4)
    x = rng.random((6000, 2))
    x = x[np.linalg.norm(x - 0.5, axis=1) < 0.42]
    weight = rng.uniform(0.5, 1.5, len(x)) / 6000
    here = slice(None) if comm.rank == 0 else slice(0)
    body = MaterialPoints(domain, x[here], weight[here])
    fm.set_initial_state(body, 2.0)
    return domain, body


def by_id(body, name):
    comm = body.mesh.comm
    order = np.argsort(np.concatenate(comm.allgather(body.id)))
    return np.concatenate(comm.allgather(body[name]))[order]


def test_weights_of_full_interior_cells_sum_to_their_volume():
    domain, body = disc(MPI.COMM_SELF)
    before, mass = body.weight.copy(), body["mass"].copy()
    cells = ActiveCells(body)
    correct_weights(body, cells)
    active = np.bincount(body.cell, minlength=200) > 0
    corners = domain.geometry.x[domain.geometry.dofmap]
    sums, old = (np.bincount(body.cell, w, minlength=200) for w in (body.weight, before))
    expected = 0
    for cell in range(200):
        # cells that share a vertex with this one
        distance = np.linalg.norm(corners[:, :, None] - corners[cell], axis=3)
        near = (distance < 1e-9).any(axis=(1, 2))
        if active[near].all() and 0.5 <= old[cell] * 200 <= 1.5:
            assert sums[cell] == pytest.approx(1 / 200, rel=1e-14)
            expected += 1
        else:
            assert sums[cell] == old[cell]
    assert 60 < expected < np.sum(active) - 30
    cut = np.isin(body.cell, cells.cut_cells())
    assert cut.any() and np.array_equal(body.weight[cut], before[cut])
    assert np.array_equal(body["mass"], mass)
    # points of a cell keep their shares
    inner = body.cell == np.argmax(active & (sums != old))
    ratio = body.weight[inner] / before[inner]
    assert ratio == pytest.approx(ratio[0])


@pytest.mark.mpi
def test_weights_do_not_depend_on_the_ranks():
    weights = []
    for comm in (COMM, MPI.COMM_SELF):
        _, body = disc(comm)
        edge = MaterialPoints(body.mesh, [(0.5, 0.05)] if comm.rank == 0 else np.empty((0, 2)), 1)
        correct_weights(body, ActiveCells(body, edge))
        weights.append(by_id(body, "weight"))
    assert weights[0] == pytest.approx(weights[1], rel=1e-14)


@pytest.mark.mpi
def test_ways_of_loads_to_the_body_are_empty():
    weights = []
    for load in (False, True):
        domain, body = disc(COMM)
        edge = MaterialPoints(domain, [(0.05, 0.05)] if COMM.rank == 0 else np.empty((0, 2)), 1)
        cells = ActiveCells(body, loads=[edge] if load else [])
        correct_weights(body, cells)
        weights.append((by_id(body, "weight"), COMM.allreduce(len(cells.cells()), MPI.SUM)))
    (without, few), (with_load, many) = weights
    assert many > few + 1
    assert np.array_equal(without, with_load)


@pytest.mark.mpi
def test_holes_piles_and_neighbours_are_left_alone():
    domain = mesh.create_unit_square(COMM, 6, 6)
    body = points.fill(domain, 3)
    assert len(ActiveCells(body).cut_cells()) == 0
    sparse, crowded = body.x[:, 0] < 1 / 3, body.x[:, 0] > 2 / 3
    body["weight"] = body.weight * np.where(sparse, 0.4, np.where(crowded, 1.6, 1.1))
    other = points.fill(domain, 1, inside=lambda x: x[1] > 0.5)
    other.add_field("V_0", (), other.weight)
    probe = points.fill(domain, 1, inside=lambda x: x[1] < 0.2)
    before = body.weight.copy()
    correct_weights(body, ActiveCells(body, other, probe))
    corrected = (body.x[:, 0] > 1 / 3) & (body.x[:, 0] < 2 / 3) & (body.x[:, 1] < 0.5)
    assert np.array_equal(body.weight[~corrected & ~sparse], before[~corrected & ~sparse])
    assert np.array_equal(body.weight[sparse], before[sparse])
    assert body.weight[corrected] == pytest.approx(before[corrected] / 1.1)


@pytest.mark.mpi
def test_loads_where_ranks_do_not_see_their_neighbours():
    """Cells are found, though nobody can tell whether a way leads from loads to bodies."""
    domain = mesh.create_unit_square(COMM, 6, 6, ghost_mode=mesh.GhostMode.none)
    body = points.fill(domain, 2, inside=lambda x: x[0] < 0.5)
    edge = points.on_curve(domain, (0.6, 0.1), (0.6, 0.9), spacing=0.1)
    count = COMM.allreduce(len(ActiveCells(body, loads=[edge]).cells()))
    seen = mesh.create_unit_square(COMM, 6, 6)
    body = points.fill(seen, 2, inside=lambda x: x[0] < 0.5)
    edge = points.on_curve(seen, (0.6, 0.1), (0.6, 0.9), spacing=0.1)
    assert count == COMM.allreduce(len(ActiveCells(body, loads=[edge]).cells())) > 36


def test_weights_of_a_stranger():
    _, body = disc(MPI.COMM_SELF)
    with pytest.raises(ValueError, match="one of the point sets of the active cells"):
        correct_weights(body, ActiveCells(body.copy()))
    with pytest.raises(ValueError, match="one of the point sets of the active cells"):
        BalancedWeights(body, ActiveCells(body.copy()))
    with pytest.raises(ValueError, match=r"equal axis-parallel boxes .* is needed"):
        BalancedWeights(body, ActiveCells(body))


@pytest.mark.mpi
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("functions", ["quadratic", "cubic", "gimp"])
def test_balanced_weights_bear_a_constant_stress(functions, dim):
    """Without forces on nodes inside of a body between walls, whose points fit no cell."""
    make = mesh.create_unit_square if dim == 2 else mesh.create_unit_cube
    kind = mesh.CellType.quadrilateral if dim == 2 else mesh.CellType.hexahedron
    domain = make(COMM, *[8] * dim, kind, partitioner=basis.shared_vertex_partitioner)
    spacing = 1 / 19
    body = points.lattice(domain, spacing, inside=lambda x: x[dim - 1] < 0.8)
    basis.use(body, functions, 0.45 * spacing if functions == "gimp" else None)
    V = fem.functionspace(domain, ("Lagrange", 1, (dim,)))
    form = forms.form(ufl.div(ufl.TestFunction(V)) * body.dx)
    x = V.tabulate_dof_coordinates()[: V.dofmap.index_map.size_local, :dim]
    inside = (x > 1e-9) & (x < 1 - 1e-9) & (x[:, -1:] < 0.8 - 0.38)  # three cells below the top

    def largest():
        sums = forms.assemble_vector(form)
        sums.scatter_reverse(la.InsertMode.add)
        own = sums.array[: inside.size].reshape(inside.shape)
        return COMM.allreduce(np.abs(own[inside]).max(initial=0.0), MPI.MAX)

    before, volumes = largest(), body.weight.copy()
    balance = BalancedWeights(body, ActiveCells(body))
    balance()
    assert before > 1e-3 * 0.125 ** (dim - 1)
    assert largest() < 1e-6 * before
    change = body.weight / volumes - 1
    assert 0.001 < COMM.allreduce(np.abs(change).max(initial=0.0), MPI.MAX) < 0.2
    assert body.volume() == pytest.approx(COMM.allreduce(volumes.sum()), rel=0.01)
    # what is balanced stays as it is
    volumes = body.weight.copy()
    balance()
    assert body.weight == pytest.approx(volumes, rel=1e-6)


@pytest.mark.mpi
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("parts", [("u", "p"), ("u",)])
@pytest.mark.parametrize("cell", CELLS)
def test_matrices_of_facets_are_those_of_dolfinx(cell, parts, degree, monkeypatch):
    dim = 2 if cell in ("triangle", "quadrilateral") else 3
    make = mesh.create_unit_square if dim == 2 else mesh.create_unit_cube
    domain = make(COMM, *[3] * dim, CELLS[cell])
    x = domain.geometry.x
    x[:, :dim] += 0.03 * np.sin(7 * x[:, :dim][:, ::-1])
    body = points.fill(domain, 2, inside=lambda x: np.linalg.norm(x, axis=0) < 0.8)
    z = fm.Unknown(domain, *parts, degree=degree)
    z.fix("u", lambda x: x[0] < 0.1)
    R = fm.ghost_penalty(z, ActiveCells(body), NeoHookean(1.0, 0.3))
    R += ufl.inner(z.u, z.test.u) * body.dx
    a = forms.form(ufl.derivative(R, z.U))
    assert all(form._facet_kernels is not None for form in a.region_forms)
    own = forms.assemble_matrix(a, z.bcs).data
    monkeypatch.setattr(RegionForm, "add_facets", lambda *arguments: False)
    assert own == pytest.approx(forms.assemble_matrix(a, z.bcs).data, rel=1e-13, abs=1e-13)


# --- tying -----------------------------------------------------------------------------------


def block(cell="triangle", n=8):
    """A block that fills the lower half, and points in the layer of cells above."""
    dim = 2 if cell in ("triangle", "quadrilateral") else 3
    make = mesh.create_unit_square if dim == 2 else mesh.create_unit_cube
    domain = make(COMM, *[n] * dim, CELLS[cell])
    body = points.quadrature(domain, 2, inside=lambda x: x[dim - 1] < 0.5)
    above = points.fill(domain, 1, inside=lambda x: abs(x[dim - 1] - 0.5 - 0.5 / n) < 0.5 / n)
    return domain, body, above


def linear(space):
    """Function of a space, all of whose components are linear."""
    f = fem.Function(space)
    gradient = np.array([[0.3, -0.2, 0.5], [1.0, 0.7, -0.4], [0.2, 0.6, 0.1]])
    if space.num_sub_spaces == 0 or space.dofmap.index_map_bs > 1:
        size = space.dofmap.index_map_bs
        f.interpolate(lambda x: (gradient @ x + 1)[:size])
    else:
        for i in range(space.num_sub_spaces):
            size = max(space.sub(i).num_sub_spaces, 1)
            f.sub(i).interpolate(lambda x, size=size, i=i: (gradient @ x + i)[:size])
    return f


def spaces(domain):
    dim = domain.geometry.dim
    yield fem.functionspace(domain, ("Lagrange", 1)), 1
    yield fem.functionspace(domain, ("Lagrange", 1, (dim,))), dim
    yield fm.Unknown(domain, "u", "p").space, dim + 1
    yield (
        fm.Unknown(domain, "u", "p", fm.Part("T"), fm.Part("w", is_vector=True)).space,
        2 * dim + 2,
    )


@pytest.mark.mpi
@pytest.mark.parametrize("cell", CELLS)
def test_linear_functions_are_extended_exactly(cell):
    n = 4
    domain, body, above = block(cell, n)
    nodes = (n + 1) ** (domain.geometry.dim - 1)  # in the plane above
    for space, components in spaces(domain):
        tying = Tying(space, body, ActiveCells(body, above))
        x, diagonal = tying.matrix.createVecs()
        tying.matrix.getDiagonal(diagonal)
        tied = diagonal.array_r == 0.0
        assert COMM.allreduce(int(tied.sum()), MPI.SUM) == nodes * components
        expected = linear(space).x.array[: len(tied)]
        x.array_w[:] = np.where(tied, 1e3, expected)
        tying.extend(x)
        assert x.array_r == pytest.approx(expected, abs=1e-12)


@pytest.mark.mpi
def test_nothing_to_tie():
    domain, body, _ = block()
    W = fm.Unknown(domain, "u", "p").space
    T = Tying(W, body, ActiveCells(body)).matrix
    x, y = T.createVecs()
    x.setRandom()
    T.mult(x, y)
    assert np.array_equal(x.array_r, y.array_r)


@pytest.mark.mpi
@pytest.mark.parametrize("cell", ["triangle", "tetrahedron"])
def test_prescribed_homogeneous_deformation(cell):
    """Data on the lower and left sides, constrained nodes among those that are tied from."""
    domain, body, above = block(cell, n=2)
    dim = domain.geometry.dim
    z = fm.Unknown(domain, "u", "p")
    law = NeoHookean(E=3.0, nu=0.3)
    gradient = np.array([[0.1, 0.05, 0.0], [0.02, -0.08, 0.1], [0.0, 0.1, 0.05]])[:dim, :dim]
    J = np.linalg.det(np.eye(dim) + gradient)
    exact = fem.Function(z.space)
    exact.sub(0).interpolate(lambda x: gradient @ x[:dim])
    exact.sub(1).interpolate(lambda x: np.full(x.shape[1], law.kappa * (J - 1)))
    # full cells' nodes and, on the left, some that would be tied otherwise
    z.fix("u", lambda x: np.isclose(x[0], 0), lambda x: gradient @ x[:dim])
    z.fix("u", lambda x: np.isclose(x[dim - 1], 0), lambda x: gradient @ x[:dim])
    # loads that keep it in equilibrium: its residual
    R = fm.mixed(z, body, law)
    forcing = ufl.replace(R, {z.U: exact})
    cells = ActiveCells(body, above)
    solver = NewtonSolver(R - forcing, z.U, z.bcs, tying=Tying(z.space, body, cells))
    result = solver.solve()
    assert result.iterations <= 6
    assert solver.solve().iterations <= 1  # data of several ranks may differ by round-off
    touched = np.unique(z.space.dofmap.list[cells.cells()])
    owned = touched[touched < z.space.dofmap.index_map.size_local]
    assert z.U.x.array[owned] == pytest.approx(exact.x.array[owned], abs=1e-9)


@pytest.mark.mpi
@pytest.mark.parametrize("thickness", [1e-6, 0.3])
def test_sliver_follows_the_block(thickness):
    """Load points above the last full cells, where no other node than the tied ones has any mass.

    Uniaxial plane strain: a linear displacement, up to the lever of the load's position.
    """
    n, E, nu, t = 8, 1e3, 0.3, -1.0
    domain, body, _ = block(n=n)
    y = 0.5 + thickness / n
    edge = points.on_curve(domain, (0, y), (1, y), spacing=0.5 / n)
    z = fm.Unknown(domain, "u", "p")
    law = NeoHookean(E, nu)
    cells = ActiveCells(body, edge)
    R = fm.stabilized("asgs", z, body, law) + fm.dead_load(z.test.u, edge, (0.0, t))
    for axis in (0, 1):
        z.fix("u", lambda x, a=axis: np.isclose(x[a], 0), component=axis)
    result = NewtonSolver(R, z.U, z.bcs, tying=Tying(z.space, body, cells)).solve()
    assert result.iterations <= 5
    exact = fem.Function(z.space)
    stiffness = E / (1 - nu**2)
    exact.sub(0).interpolate(lambda x: t / stiffness * np.array([-nu / (1 - nu) * x[0], x[1]]))
    dofs = np.unique(z.space.sub(0).dofmap.list[cells.cells()])
    scale = abs(t) / stiffness
    # the linear theory is exact up to the strain; the load's lever counts where it stands
    assert z.U.x.array[dofs] == pytest.approx(
        exact.x.array[dofs], abs=scale * (5e-3 if thickness < 0.1 else 0.15)
    )


@pytest.mark.mpi
@pytest.mark.parametrize("stabilization", ["asgs", "osgs"])
def test_free_fall_with_tied_nodes_and_corrected_weights(stabilization):
    """All points fall by g t^2 / 2, whatever cells they cut."""
    domain = mesh.create_unit_square(COMM, 12, 12)
    g, dt, steps = np.array([0.1, -0.4]), 0.05, 12
    body = points.lattice(domain, 0.031, inside=lambda x: np.hypot(x[0] - 0.48, x[1] - 0.54) < 0.44)
    fm.set_initial_state(body, 3.0)
    start = by_id(body, "x")
    mass = by_id(body, "mass")
    z = fm.Unknown(domain, "u", "p")
    law = NeoHookean(E=20.0, nu=0.3)
    scheme = fm.GeneralizedAlpha(z, dt=dt)
    force = scheme.force(body, fem.Constant(domain, g))
    cells = ActiveCells(body)
    sim = ImplicitMPM(
        fm.stabilized(stabilization, z, body, law, force=force),
        z,
        scheme,
        body,
        observers=[lambda sim, step: correct_weights(body, cells)],
        newton={"tying": Tying(z.space, body, cells)},
    )
    for _ in range(steps):
        sim.step()
    time = steps * dt
    assert by_id(body, "x") - start == pytest.approx(
        np.broadcast_to(g * time**2 / 2, start.shape), abs=1e-8
    )
    assert np.array_equal(by_id(body, "mass"), mass)


@pytest.mark.mpi
def test_bodies_that_touch_fill_cells_together():
    """Two halves of a disc, between which no cell is full of one, have ties and a flight of one."""
    domain = mesh.create_unit_square(COMM, 12, 12)
    dt, velocity = 0.05, np.array([0.3, 0.2])

    def halves(*sides):
        bodies = []
        for side in sides:
            body = points.lattice(
                domain, 0.031, inside=lambda x: np.hypot(x[0] - 0.45, x[1] - 0.47) < 0.35
            )
            body.remove(lambda x, side=side: side * (x[0] + x[1] / 3 - 0.6) > 0)
            fm.set_initial_state(body, 3.0, velocity)
            bodies.append(body)
        return bodies

    both, whole = halves(1, -1), halves(0)
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    assert Tying(V, both, ActiveCells(*both)).matrix.equal(
        Tying(V, whole, ActiveCells(*whole)).matrix
    )
    z, law = fm.Unknown(domain, "u", "p"), NeoHookean(E=20.0, nu=0.4)
    scheme = fm.Bossak(z, dt=dt)
    R = sum(fm.stabilized("asgs", z, b, law, scheme=scheme) for b in both)
    alone = {"tying": Tying(z.space, both[0], ActiveCells(*both))}
    with pytest.raises(ValueError, match="give Tying all of them"):
        ImplicitMPM(R, z, scheme, both, newton=alone)
    start = [by_id(body, "x") for body in both]
    newton = {"tying": Tying(z.space, both, ActiveCells(*both))}
    sim = ImplicitMPM(R, z, scheme, both, newton=newton)
    for _ in range(4):
        sim.step()
    for body, x in zip(both, start, strict=True):
        expected = np.broadcast_to(4 * dt * velocity, x.shape)
        assert by_id(body, "x") - x == pytest.approx(expected, abs=1e-9)


def test_nodes_are_tied_in_the_space_of_the_unknown():
    domain, body, above = block(n=4)
    V, W = (fem.functionspace(domain, ("Lagrange", 1, (k,))) for k in (1, 2))
    u, v = fem.Function(V), ufl.TestFunction(V)
    tying = Tying(W, body, ActiveCells(body, above))
    with pytest.raises(ValueError, match="another space than that of the unknown"):
        NewtonSolver(ufl.inner(u, v) * body.dx, u, tying=tying)


@pytest.mark.mpi
def test_reduced_matrix_is_made_once_and_nothing_is_left_behind(capfd):
    """PETSc keeps dropped objects of several ranks until a collective call collects them."""
    domain, body, above = block(n=4)
    V = fem.functionspace(domain, ("Lagrange", 1))
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    form = forms.form((u * v + 0.1 * ufl.inner(ufl.grad(u), ufl.grad(v))) * body.dx)
    A = forms.petsc.assemble_matrix(form)
    b, y, expected = (forms.petsc.create_vector(forms.form(v * body.dx)) for _ in range(3))
    bc = fem.dirichletbc(0.0, fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[1], 0)), V)
    cells = ActiveCells(body, above)
    tying, other = Tying(V, body, cells), Tying(V, body, cells)
    for _ in range(2):
        tying.update(_compat.fixed_dofs([bc]), forms.inactive_dofs(form))
        first = tying.reduce(A, b)
        A.scale(2.0)
        again = tying.reduce(A, b)
        assert again is first
        other.update(_compat.fixed_dofs([bc]), forms.inactive_dofs(form))
        b.setRandom()
        again.mult(b, y)
        other.reduce(A, b.copy(expected)).mult(b, expected)
        assert y.array_r == pytest.approx(expected.array_r, abs=1e-14)
        assert np.all(again.getDiagonal(expected).array_r > 0)
    PETSc.garbage_view(domain.comm)
    lines = [line for line in capfd.readouterr().out.splitlines() if "entries" in line]
    assert all(line.endswith("Total entries: 0") for line in lines)
    assert COMM.size == 1 or COMM.allreduce(len(lines)) == COMM.size


@pytest.mark.mpi
def test_what_cannot_be_tied():
    domain, body, above = block()
    cells = ActiveCells(body, above)
    W = fm.Unknown(domain, "u", "p").space
    with pytest.raises(ValueError, match="no cell is filled to 2"):
        Tying(W, body, cells, threshold=2.0)
    with pytest.raises(ValueError, match="must be positive, not 0"):
        Tying(W, body, cells, threshold=0.0)
    with pytest.raises(ValueError, match="belong to the active cells"):
        Tying(W, body.copy(), cells)
    discontinuous = (fem.functionspace(domain, ("DG", degree)) for degree in (0, 1))
    for space in (fm.Unknown(domain, "u", "p", degree=2).space, *discontinuous):
        with pytest.raises(ValueError, match="tying needs linear functions"):
            Tying(space, body, cells)
    # a threshold that only full cells reach changes nothing here
    assert Tying(W, body, cells, 1 - 1e-9).matrix.equal(Tying(W, body, cells).matrix)


def test_nodes_without_load_or_mass_stay():
    """The identity rows of nodes that nothing reaches do not enter the equations of others."""
    domain, body, above = block(n=4)
    V = fem.functionspace(domain, ("Lagrange", 1))
    u, v = fem.Function(V), ufl.TestFunction(V)
    R = (u * v - v) * body.dx - 0.5 * v * above.dx
    solver = NewtonSolver(R, u, tying=Tying(V, body, ActiveCells(body, above)))
    result = solver.solve()
    assert result.iterations == 1  # a linear problem
    # the constant function is in the space: the integrals of both sides are equal
    left = forms.assemble_scalar(forms.form(u * body.dx))
    assert left == pytest.approx(body.volume() + 0.5 * above.volume())


def test_tied_nodes_of_functions_that_reach_beyond_active_cells():
    """uGIMP: a node that points see by less than a thousandth follows the filled cells, too."""
    domain = mesh.create_rectangle(
        MPI.COMM_SELF, [(0, 0), (4, 4)], [4, 4], mesh.CellType.quadrilateral
    )
    body = points.lattice(domain, 0.5, inside=lambda x: np.all(x < 2, axis=0))
    basis.use(body, "gimp", 0.25)
    body.move(body.x + (1e-5, 0))
    space = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    tying = Tying(space, body, ActiveCells(body))
    x = tying.matrix.createVecRight()
    X = space.tabulate_dof_coordinates()
    linear = 1 + X[:, 0] - 2 * X[:, 1]
    inside = np.all(X[:, :2] < 2.1, axis=1)
    x.array_w[:] = np.repeat(np.where(inside, linear, 0), 2)
    tying.extend(x)
    seen = (X[:, 0] < 3.1) & (X[:, 1] < 2.1)
    assert x.array_r[::2][seen] == pytest.approx(linear[seen])


@pytest.mark.slow
@pytest.mark.parametrize("steps", [10, 20])
def test_a_stretched_block_needs_corrected_weights(steps):
    """Force and stretch of an incompressible block pulled by its edge, whatever the steps are."""
    force, stretch, _ = moved_points.stretched("linear", True, steps)
    assert force == pytest.approx(1.0, abs=0.01)
    assert stretch == pytest.approx(1.2, rel=2e-3)
