# SPDX-License-Identifier: MIT
"""Splines and uGIMP on lattices: sums, derivatives, forms over them, and what they refuse."""

from mpi4py import MPI

import basix.ufl
import numpy as np
import pytest
import ufl
from dolfinx import fem, la, mesh

from fenicsmpm import MaterialPoints, basis, forms, points
from fenicsmpm.basis import lines
from fenicsmpm.mapping import ActiveCells, FilledFraction, p2g, project
from fenicsmpm.materials import NeoHookean

COMM = MPI.COMM_WORLD
LOWER, UPPER = np.array([1.0, -2.0, 0.5]), np.array([2.5, -0.8, 1.3])
SHAPE = (6, 5, 4)
NAMES = ("linear", "quadratic", "cubic", "gimp")
HALF = np.array([0.06, 0.05, 0.03])
EVERYWHERE = pytest.mark.parametrize("dim", [2, 3])
EACH = pytest.mark.parametrize("name", NAMES)


def lattice(dim, comm=COMM, shape=SHAPE):
    partitioner = basis.shared_vertex_partitioner
    corners = [LOWER[:dim], UPPER[:dim]]
    if dim == 2:
        kind = mesh.CellType.quadrilateral
        return mesh.create_rectangle(comm, corners, shape[:2], kind, partitioner=partitioner)
    kind = mesh.CellType.hexahedron
    return mesh.create_box(comm, corners, shape, kind, partitioner=partitioner)


def use(body, name):
    basis.use(body, name, half_size=HALF[: body.x.shape[1]] if name == "gimp" else None)
    return body


def cloud(dim, name, comm=COMM, n=400, shape=SHAPE):
    """Random points, some of them on walls, nodes and knots; the same on any number of ranks."""
    domain = lattice(dim, comm, shape)
    rng = np.random.default_rng(3)
    cells = np.array(shape[:dim])
    t = rng.random((n, dim)) * cells
    t[: n // 2] = np.rint(2 * t[: n // 2]) / 2
    x = LOWER[:dim] + t / cells * (UPPER - LOWER)[:dim]
    weight = rng.uniform(0.5, 1.5, n) / n
    here = slice(None) if comm.rank == 0 else slice(0)
    return use(MaterialPoints(domain, x[here], weight[here]), name)


def inner_cloud(dim, name, n=100):
    """Random points away from the walls."""
    domain = lattice(dim)
    x = np.random.default_rng(5).uniform(0.01, 0.99, (n, dim)) * (UPPER - LOWER)[:dim]
    here = slice(None) if COMM.rank == 0 else slice(0)
    return use(MaterialPoints(domain, (LOWER[:dim] + x)[here], 1.0 / n), name)


def space(domain, *shape):
    return fem.functionspace(domain, ("Lagrange", 1, shape) if shape else ("Lagrange", 1))


def noise(V, seed=0):
    """A function that is the same on any number of ranks."""
    phase = np.random.default_rng(seed).uniform(5.0, 15.0, (V.dofmap.index_map_bs, 3))
    f = fem.Function(V)
    f.interpolate(lambda x: np.sin(phase @ x) if len(phase) > 1 else np.sin(phase @ x)[0])
    return f


def by_id(body, values):
    order = np.argsort(np.concatenate(COMM.allgather(body.id)))
    return np.concatenate(COMM.allgather(values))[order]


# --- one dimension -------------------------------------------------------------------------------


def line(kind, i, t, n, half=0.5):
    """Values and derivatives ``(3, n + 1)`` at the nodes of a line of n cells."""
    found = np.zeros((3, 4))
    first = lines.tabulate_line(kind, i, t, n, half, found)
    result = np.zeros((3, n + 1))
    for k in range(4):
        if 0 <= first + k <= n:
            result[:, first + k] += found[:, k]
        else:
            assert np.all(found[:, k] == 0)
    return result


@pytest.mark.parametrize("half", [0.5, 0.3, 0.02])
def test_ugimp_is_the_average_of_hat_functions_continued_beyond_the_walls(half):
    nodes = np.arange(4)
    rule, weights = np.polynomial.legendre.leggauss(4)
    for t in np.random.default_rng(0).random(30) * 3:
        # between kinks of the hat functions the rule is exact
        ends = np.unique([t - half, *nodes[np.abs(nodes - t) < half], t + half])
        mean = np.zeros(4)
        for a, b in zip(ends[:-1], ends[1:], strict=True):
            for x, w in zip(a + (b - a) * (rule + 1) / 2, weights * (b - a) / 2, strict=True):
                i = min(max(int(x), 0), 2)
                mean[i] += w * (i + 1 - x)
                mean[i + 1] += w * (x - i)
        i = int(t)
        found = line(lines.GIMP, i, t - i, 3, half)[0]
        assert found == pytest.approx(mean / (2 * half), abs=1e-14)


def test_quadratic_splines_are_ugimp_of_points_as_large_as_cells():
    for t in np.linspace(0, 1, 8):  # not at the knot in the middle
        for i in range(3):
            spline, gimp = (line(kind, i, t, 3) for kind in (lines.QUADRATIC, lines.GIMP))
            assert spline == pytest.approx(gimp, abs=1e-15)


def test_cubic_splines_at_the_wall_are_those_of_steffen_kirby_and_berzins():
    for t in np.linspace(0, 1, 7):
        at_wall, next_cell = (line(lines.CUBIC, i, t, 6)[0] for i in (0, 1))
        assert at_wall[0] == pytest.approx(t**3 / 6 - t + 1, abs=1e-15)
        r = t - 1
        assert at_wall[1] == pytest.approx(-(r**3) / 3 - r**2 + 2 / 3, abs=1e-15)
        assert next_cell[0] == pytest.approx((1 - t) ** 3 / 6, abs=1e-15)
        mirrored = line(lines.CUBIC, 5, 1 - t, 6)[0]
        assert mirrored == pytest.approx(at_wall[::-1], abs=1e-15)


@pytest.mark.parametrize("kind", [lines.LINEAR, lines.QUADRATIC, lines.CUBIC, lines.GIMP])
@pytest.mark.parametrize("n", [1, 2, 3, 7])
def test_lines_of_any_length_reproduce_linear_functions_and_are_not_negative(kind, n):
    for i in range(n):
        for t in (0.0, 0.2, 0.5, 0.7, 1.0):
            value, slope, curvature = line(kind, i, t, n, 0.3)
            nodes = np.arange(n + 1)
            assert value.min() >= -1e-15
            assert [value.sum(), value @ nodes] == pytest.approx([1, i + t], abs=1e-14)
            assert [slope.sum(), slope @ nodes] == pytest.approx([0, 1], abs=1e-14)
            assert [curvature.sum(), curvature @ nodes] == pytest.approx([0, 0], abs=1e-14)
    # at a wall only its node counts
    assert line(kind, 0, 0.0, n, 0.3)[0] == pytest.approx(np.eye(n + 1)[0], abs=1e-15)


# --- functions and derivatives -------------------------------------------------------------------


@pytest.mark.mpi
@EVERYWHERE
@EACH
def test_sum_is_one_and_linear_functions_are_reproduced(dim, name):
    body = cloud(dim, name)
    V = space(body.mesh, dim)
    table = basis.stencil_of(body).table(V.ufl_element().sub_elements[0].basix_element, 2)
    assert table[:, 0].sum(axis=1) == pytest.approx(1, abs=1e-13)
    assert np.abs(table[:, 1:].sum(axis=2)).max(initial=0) < 1e-11  # 1/m and 1/m^2
    x = fem.Function(V)
    x.interpolate(lambda x: x[:dim])
    assert forms.evaluate(x, body) == pytest.approx(body.x, abs=1e-13)
    gradient = forms.evaluate(ufl.grad(x), body)
    assert gradient == pytest.approx(np.broadcast_to(np.eye(dim), gradient.shape), abs=1e-13)
    assert np.abs(forms.evaluate(ufl.grad(ufl.grad(x)), body)).max(initial=0) < 1e-11


@pytest.mark.mpi
@EVERYWHERE
@EACH
def test_derivatives_against_finite_differences(dim, name):
    body = inner_cloud(dim, name)
    f = noise(space(body.mesh))
    value, slope = forms.PointExpression(f, body), forms.PointExpression(ufl.grad(f), body)
    curvature = by_id(body, forms.evaluate(ufl.grad(ufl.grad(f)), body))
    gradient = by_id(body, slope.evaluate())
    assert np.abs(curvature).max() > 1
    step = 1e-6
    for k in range(dim):
        ends = []
        for sign in (1, -2):  # from the middle up, and from there down
            body.move(body.x + sign * step * np.eye(dim)[k])
            ends.append((by_id(body, value.evaluate()), by_id(body, slope.evaluate())))
        body.move(body.x + step * np.eye(dim)[k])
        differences = [(up - down) / (2 * step) for up, down in zip(*ends, strict=True)]
        assert gradient[:, k] == pytest.approx(differences[0], abs=1e-8)
        assert curvature[:, k] == pytest.approx(differences[1], abs=1e-6)


@pytest.mark.mpi
@EVERYWHERE
def test_linear_functions_are_those_of_the_finite_elements(dim):
    bodies = inner_cloud(dim, "linear"), None
    bodies = bodies[0], MaterialPoints(bodies[0].mesh, bodies[0].x, bodies[0].weight)
    V = space(bodies[0].mesh, dim)
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    w = noise(V)
    matrices = []
    for body in bodies:
        integrand = ufl.inner(ufl.grad(u), ufl.grad(v)) + ufl.inner(u, ufl.dot(ufl.grad(v), w))
        matrices.append(forms.assemble_matrix(forms.form(integrand * body.dx)).to_scipy().tocsr())
    difference = matrices[0] - matrices[1]
    assert abs(difference).max() < 1e-13 * abs(matrices[1]).max()


# --- forms ---------------------------------------------------------------------------------------


def owned(vector):
    return vector.array[: vector.index_map.size_local * vector.block_size]


def product(a, f):
    """Owned entries of the matrix times a function, zero rows left zero."""
    A = forms.assemble_matrix(a)
    # rows of the identity of unseen nodes are not part of the operator
    rows = A.to_scipy().tocsr()
    n = A.index_map(0).size_local
    columns = A.index_map(1).local_to_global(np.arange(rows.shape[1], dtype=np.int32))
    V = f.function_space
    bs, blocks = V.dofmap.index_map_bs, V.dofmap.index_map
    values = np.zeros(blocks.size_global * bs)
    first = blocks.local_range[0] * bs
    values[first : first + blocks.size_local * bs] = f.x.array[: blocks.size_local * bs]
    COMM.Allreduce(MPI.IN_PLACE, values)
    result = rows[:n] @ values[columns]
    result[forms.inactive_dofs(a)] = 0.0
    return result


@pytest.mark.mpi
@EVERYWHERE
@EACH
def test_row_sums_of_the_mass_are_sums_of_weights(dim, name):
    body = cloud(dim, name)
    V = space(body.mesh)
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    one = fem.Function(V)
    one.x.array[:] = 1
    lumped = p2g(body, body.weight, V)
    mass = product(forms.form(u * v * body.dx), one)
    assert mass == pytest.approx(owned(lumped), abs=1e-15)
    assert COMM.allreduce(owned(lumped).sum()) == pytest.approx(body.volume, rel=1e-14)
    moments = p2g(body, body.weight[:, None] * body.x, V).array.reshape(-1, dim)
    first = COMM.allreduce((body.weight[:, None] * body.x).sum(axis=0))
    n = V.dofmap.index_map.size_local
    assert COMM.allreduce(moments[:n].sum(axis=0)) == pytest.approx(first, rel=1e-13)


@pytest.mark.mpi
@EVERYWHERE
@EACH
def test_stiffness_of_constant_and_linear_fields(dim, name):
    body = cloud(dim, name)
    V = space(body.mesh)
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    a = forms.form(ufl.inner(ufl.grad(u), ufl.grad(v)) * body.dx)
    one, linear = fem.Function(V), fem.Function(V)
    one.x.array[:] = 1
    slope = np.arange(1.0, dim + 1)
    linear.interpolate(lambda x: slope @ x[:dim])
    assert np.abs(product(a, one)).max(initial=0) < 1e-12
    b = forms.assemble_vector(forms.form(ufl.dot(ufl.as_vector(slope), ufl.grad(v)) * body.dx))
    b.scatter_reverse(la.InsertMode.add)
    assert product(a, linear) == pytest.approx(owned(b), abs=1e-12)


def mixed_energy(body, U):
    """Of a hyperelastic solid with its pressure as unknown; any smooth function would do."""
    dim = body.mesh.geometry.dim
    u, p = ufl.split(U)
    gradient = ufl.grad(u)
    F = ufl.as_tensor(
        [
            [float(i == j) + (gradient[i, j] if max(i, j) < dim else 0) for j in range(3)]
            for i in range(3)
        ]
    )
    J = ufl.det(F)
    law = NeoHookean(E=10.0, nu=0.3)
    return (law.energy(F, J) + p * (J - 1) - p**2 / 4) * body.dx


@pytest.mark.mpi
@EVERYWHERE
@pytest.mark.parametrize("name", ["quadratic", "cubic", "gimp"])
def test_tangent_of_a_mixed_hyperelastic_residual_is_its_derivative(dim, name):
    body = cloud(dim, name)
    cell = body.mesh.basix_cell()
    of_u = basix.ufl.element("Lagrange", cell, 1, shape=(dim,))
    W = fem.functionspace(
        body.mesh, basix.ufl.mixed_element([of_u, basix.ufl.element("Lagrange", cell, 1)])
    )

    def function(scale):
        f = fem.Function(W)
        f.sub(0).interpolate(
            lambda x: scale * np.stack([np.sin(3 * x[1] + k) * x[0] for k in range(dim)])
        )
        f.sub(1).interpolate(lambda x: scale * np.cos(2 * x[0] * x[1]))
        return f

    U, dU = function(0.02), function(0.3)
    R = ufl.derivative(mixed_energy(body, U), U)
    residual, tangent = forms.form(R), forms.form(ufl.derivative(R, U))

    def assembled():
        b = forms.assemble_vector(residual)
        b.scatter_reverse(la.InsertMode.add)
        return owned(b).copy()

    start, slope, at = assembled(), product(tangent, dU), U.x.array.copy()
    errors = []
    for h in (1e-2, 5e-3):
        U.x.array[:] = at + h * dU.x.array
        difference = assembled() - start - h * slope
        errors.append(COMM.allreduce(difference @ difference) ** 0.5)
    assert errors[0] > 0
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.05)


@pytest.mark.mpi
@EVERYWHERE
@pytest.mark.parametrize("name", ["quadratic", "cubic", "gimp"])
def test_forms_do_not_depend_on_the_number_of_ranks(dim, name):
    sums = []
    for comm in (COMM, MPI.COMM_SELF):
        body = cloud(dim, name, comm)
        V = space(body.mesh, dim)
        u, v, w = ufl.TrialFunction(V), ufl.TestFunction(V), noise(V)
        a = ufl.inner(ufl.grad(u), ufl.grad(v)) + ufl.inner(ufl.dot(ufl.grad(u), w), v)
        compact = forms.create_matrix(forms.form(a * body.dx), compact=True)
        A = forms.assemble_matrix(forms.form(a * body.dx), A=compact)
        A2 = forms.assemble_matrix(forms.form(a * body.dx))
        b = forms.assemble_vector(forms.form(ufl.inner(w, v) * ufl.dot(w, w) * body.dx))
        b.scatter_reverse(la.InsertMode.add)
        squares = [m.squared_norm() for m in (A, A2)] + [comm.allreduce(owned(b) @ owned(b))]
        # these sum over ranks already
        sums.append([*squares, comm.allreduce(len(forms.inactive_dofs(forms.form(a * body.dx))))])
    assert sums[0] == pytest.approx(sums[1], rel=1e-12)
    assert sums[0][0] == pytest.approx(sums[0][1], rel=1e-14)


@pytest.mark.mpi
@EVERYWHERE
@EACH
def test_constants_of_cells_tags_and_geometry_are_those_of_the_points(dim, name):
    body = cloud(dim, name)
    spacing = (UPPER - LOWER)[:dim] / SHAPE[:dim]
    volume = forms.evaluate(ufl.CellVolume(body.mesh), body)
    assert volume == pytest.approx(np.prod(spacing), rel=1e-13)
    J = forms.evaluate(ufl.Jacobian(body.mesh), body)
    assert np.abs(J).sum(axis=2) == pytest.approx(np.tile(spacing, (len(body), 1)), rel=1e-13)
    K = forms.evaluate(ufl.JacobianInverse(body.mesh), body)
    assert J @ K == pytest.approx(np.broadcast_to(np.eye(dim), J.shape), abs=1e-13)
    body["tag"] = body.id % 3
    x = ufl.SpatialCoordinate(body.mesh)
    left = COMM.allreduce((body.weight * body.x[:, 0])[body.tag == 1].sum())
    f = fem.Function(space(body.mesh))
    f.interpolate(lambda x: x[0])
    for first in (x[0], f):
        integral = forms.assemble_scalar(forms.form(first * body.dx(1)))
        assert integral == pytest.approx(left, rel=1e-13)


@pytest.mark.mpi
def test_conditions_and_lifting():
    """Rows without conditions of A x, from the matrix without and with lifting of a condition."""
    body = cloud(2, "cubic")
    V = space(body.mesh)
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    a = forms.form((ufl.inner(ufl.grad(u), ufl.grad(v)) + u * v) * body.dx)
    g = noise(V)
    dofs = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[0], LOWER[0]))
    bc = fem.dirichletbc(g, dofs)
    at_wall, inside = fem.Function(V), fem.Function(V)
    at_wall.x.array[dofs] = g.x.array[dofs]
    at_wall.x.scatter_forward()
    inside.x.array[:] = g.x.array - at_wall.x.array
    lifted = la.vector(V.dofmap.index_map, 1)
    lifted.array[:] = 0
    forms.apply_lifting(lifted.array, [a], [[bc]])
    lifted.scatter_reverse(la.InsertMode.add)
    free = np.setdiff1d(np.arange(V.dofmap.index_map.size_local), dofs)
    expected = product(a, g)[free] - product(a, inside)[free]
    assert -owned(lifted)[free] == pytest.approx(expected, abs=1e-13)
    assert np.abs(COMM.allreduce(np.abs(expected).sum())) > 0.1


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
    assert COMM.allreduce(len(active.cells)) == span**dim
    middle = mesh.compute_midpoints(domain, dim, active.cells)[:, :dim]
    assert np.all(np.abs(middle - x) < (1.8 if name == "cubic" else 0.8) * h)
    if name == "gimp":  # all of it within the cell
        body.move(body.x + 0.2 * h)
        assert COMM.allreduce(len(active.cells)) == 1
    # the lumped mass is that of all nodes
    fraction = FilledFraction(body)
    a = forms.form(fraction * fraction.vertex_dx)
    assert forms.assemble_scalar(a) == pytest.approx(1, rel=1e-13)


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
    with pytest.raises(ValueError, match="axis-parallel boxes .* not one of triangles"):
        basis.use(points.fill(triangles, 1), "cubic")
    graded = quadrilaterals()
    graded.geometry.x[:, 0] **= 2
    with pytest.raises(ValueError, match="differ in size or are not axis-parallel"):
        basis.use(points.fill(graded, 1), "quadratic")


def test_meshes_with_holes():
    full = quadrilaterals()
    part = mesh.create_submesh(full, 2, np.arange(15, dtype=np.int32))[0]
    with pytest.raises(ValueError, match="15 cells where a box of 4 x 4 cells has 16"):
        basis.use(points.fill(part, 1), "quadratic")


@pytest.mark.mpi
@pytest.mark.skipif(COMM.size == 1, reason="nothing is hidden from one rank")
def test_ranks_that_do_not_see_enough_say_so_together():
    body = points.fill(quadrilaterals(ghost_mode=mesh.GhostMode.none), 1)
    with pytest.raises(ValueError, match="shared_vertex_partitioner"):
        basis.use(body, "quadratic")
    basis.use(body, "linear")


@pytest.mark.parametrize(
    ("name", "half", "message"),
    [
        ("spline", None, "no grid functions 'spline': there are linear, quadratic, cubic, gimp"),
        ("gimp", None, "which needs it"),
        ("cubic", 0.1, "for nothing else"),
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
