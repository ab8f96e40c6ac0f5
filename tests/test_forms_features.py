# SPDX-License-Identifier: MIT
"""What forms over points offer beyond plain integrals: tags, averages, conditions, evaluation."""

from mpi4py import MPI
from petsc4py import PETSc

import basix.ufl
import numpy as np
import pytest
import ufl
from dolfinx import fem, la, mesh
from dolfinx.fem import petsc
from forms_table import CELLS, make_mesh, smooth

from fenicsmpm import forms, points

pytestmark = pytest.mark.ranks

RULE = 4


def dx(domain):
    return ufl.dx(domain=domain, metadata={"quadrature_degree": RULE})


def owned_array(vector):
    vector.scatter_reverse(la.InsertMode.add)
    return vector.array[: vector.index_map.size_local * vector.block_size]


def close(comm, a, b, tolerance=1e-12):
    """Whether two owned arrays agree, relative to the largest entry of all ranks."""
    scale = max(comm.allgather(float(np.max(np.abs(b), initial=0.0))))
    error = max(comm.allgather(float(np.max(np.abs(a - b), initial=0.0))))
    assert scale > 0
    return error <= tolerance * scale


def petsc_close(A, B, tolerance=1e-12):
    scale = B.norm(PETSc.NormType.FROBENIUS)
    A.axpy(-1.0, B)
    assert scale > 0
    return A.norm(PETSc.NormType.FROBENIUS) <= tolerance * scale


def dolfinx_matrix(a, bcs=()):
    A = petsc.assemble_matrix(fem.form(a), list(bcs))
    A.assemble()
    return A


@pytest.mark.mpi
@pytest.mark.parametrize("cell", CELLS)
def test_average_over_cell(cell):
    domain = make_mesh(cell)
    body = points.quadrature(domain, RULE)
    V = fem.functionspace(domain, ("Lagrange", 1))
    D = fem.functionspace(domain, ("DG", 0))
    f = fem.Function(V)
    f.interpolate(smooth)
    w = ufl.TestFunction(D)
    measure = dx(domain)
    mean, size = fem.Function(D), fem.Function(D)
    fem.assemble_vector(mean.x.array, fem.form(f * w * measure))
    fem.assemble_vector(size.x.array, fem.form(w * measure))
    size.x.array[size.x.array == 0.0] = 1.0  # ghost cells
    mean.x.array[:] /= size.x.array
    v = ufl.TestFunction(V)
    ours = owned_array(forms.assemble_vector(forms.form(2 * ufl.cell_avg(f) * v * body.dx)))
    theirs = owned_array(fem.assemble_vector(fem.form(2 * mean * v * measure)))
    assert close(domain.comm, ours, theirs)

    # (p - p_K, q - q_K) = (p, q) - sum_K (p, 1)_K (q, 1)_K / |K|, as a quadratic form
    def rough(g):
        return g - ufl.cell_avg(g)

    u = ufl.TrialFunction(V)
    A = forms.petsc.assemble_matrix(forms.form(rough(u) * rough(v) * body.dx))
    y = A.createVecLeft()
    A.mult(f.x.petsc_vec, y)
    energy = y.dot(f.x.petsc_vec)
    full = fem.assemble_scalar(fem.form((f**2 - mean**2) * measure))
    assert energy == pytest.approx(domain.comm.allreduce(full), rel=1e-11)
    assert forms.assemble_scalar(forms.form(rough(f) ** 2 * body.dx)) == pytest.approx(energy)


def test_average_of_gradients_fields_and_components():
    domain = make_mesh("quadrilateral")
    body = points.quadrature(domain, RULE)
    body.add_field("s", (), np.arange(len(body)))
    W = fem.functionspace(
        domain,
        basix.ufl.mixed_element(
            [
                basix.ufl.element("Lagrange", "quadrilateral", 2, shape=(2,)),
                basix.ufl.element("Lagrange", "quadrilateral", 1),
            ]
        ),
    )
    U = fem.Function(W)
    U.x.array[:] = np.random.default_rng(0).standard_normal(len(U.x.array))
    u, p = ufl.split(U)
    per_cell = len(body) // domain.topology.index_map(2).size_local

    def mean(values):
        grouped = values.reshape(-1, per_cell, *values.shape[1:])
        weight = body.weight.reshape(-1, per_cell, *(1,) * (values.ndim - 1))
        average = (weight * grouped).sum(axis=1) / weight.sum(axis=1)
        return np.repeat(average, per_cell, axis=0)

    x = ufl.SpatialCoordinate(domain)
    for expression in (ufl.grad(u), p, u, body.field("s"), x, 3 * ufl.div(u) + p / 2):
        plain = forms.evaluate(expression, body)
        averaged = forms.evaluate(ufl.cell_avg(expression), body)
        assert averaged == pytest.approx(mean(plain), rel=1e-12, abs=1e-12)


@pytest.mark.mpi
def test_tags_select_points():
    domain = make_mesh("triangle", n=4)
    body = points.quadrature(domain, RULE)
    tdim = domain.topology.dim
    cells = domain.topology.index_map(tdim).size_local
    marks = (np.arange(cells) % 3).astype(np.int32)
    tags = mesh.meshtags(domain, tdim, np.arange(cells, dtype=np.int32), marks)
    V = fem.functionspace(domain, ("Lagrange", 2))
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    f = fem.Constant(domain, 2.0)
    cell_dx = ufl.dx(domain=domain, subdomain_data=tags, metadata={"quadrature_degree": RULE})
    compiled = forms.form(u * v * body.dx(1) + f * u * v * body.dx((0, 2)))
    body["tag"] = marks[body.cell]  # assembled with the tags of now
    theirs = dolfinx_matrix(u * v * cell_dx(1) + f * u * v * cell_dx((0, 2)))
    assert petsc_close(forms.petsc.assemble_matrix(compiled), theirs)


@pytest.mark.mpi
@pytest.mark.parametrize("cell", ["triangle", "hexahedron"])
def test_points_cells_and_facets_in_one_form(cell):
    domain = make_mesh(cell, n=3)
    body = points.quadrature(domain, RULE)
    V = fem.functionspace(domain, ("Lagrange", 1, (domain.geometry.dim,)))
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    f = fem.Function(V)
    f.interpolate(lambda x: x[: domain.geometry.dim] ** 2)
    n = ufl.FacetNormal(domain)

    def a(measure):
        form = ufl.inner(ufl.grad(u), ufl.grad(v)) * measure + ufl.inner(u, v) * ufl.dx(domain)
        form += ufl.inner(ufl.jump(ufl.grad(u), n), ufl.jump(ufl.grad(v), n)) * ufl.dS
        return form + ufl.inner(u, n) * ufl.inner(v, n) * ufl.ds

    def L(measure):
        return ufl.inner(f, v) * measure + ufl.inner(n, v) * ufl.ds

    assert petsc_close(
        forms.petsc.assemble_matrix(forms.form(a(body.dx))), dolfinx_matrix(a(dx(domain)))
    )
    ours = owned_array(forms.assemble_vector(forms.form(L(body.dx))))
    theirs = owned_array(fem.assemble_vector(fem.form(L(dx(domain)))))
    assert close(domain.comm, ours, theirs)
    M = forms.form(ufl.inner(f, f) * body.dx + ufl.inner(f, n) * ufl.ds)
    reference = fem.assemble_scalar(
        fem.form(ufl.inner(f, f) * dx(domain) + ufl.inner(f, n) * ufl.ds)
    )
    assert forms.assemble_scalar(M) == pytest.approx(domain.comm.allreduce(reference), rel=1e-12)


@pytest.mark.mpi
@pytest.mark.parametrize("shapes", [((2,), ()), ((), (2,)), ((2, 2), (2, 2))])
def test_block_sizes_that_differ_or_are_large(shapes):
    domain = make_mesh("triangle", n=3)
    body = points.quadrature(domain, RULE)
    n = ufl.FacetNormal(domain)
    V, Q = (fem.functionspace(domain, ("Lagrange", 1, shape)) for shape in shapes)
    v, q = ufl.TestFunction(V), ufl.TrialFunction(V if shapes[0] == shapes[1] else Q)

    def scalar(f):
        if not f.ufl_shape:
            return f
        return ufl.tr(f) if len(f.ufl_shape) == 2 else ufl.inner(f, n)

    def values(f):
        return sum(f[i] for i in np.ndindex(f.ufl_shape)) if f.ufl_shape else f

    def a(measure):
        return values(v) * values(q) * measure + scalar(v) * scalar(q) * ufl.ds

    computed = forms.petsc.assemble_matrix(forms.form(a(body.dx)))
    assert petsc_close(computed, dolfinx_matrix(a(dx(domain))))


@pytest.mark.mpi
def test_two_point_sets_in_one_form():
    domain = mesh.create_unit_square(MPI.COMM_WORLD, 5, 4)
    body = points.quadrature(domain, RULE)
    edge = points.on_facets(domain, lambda x: np.isclose(x[0], 1.0), degree=RULE)
    other = points.quadrature(domain, 2)
    other.add_field("s", (), 3.0)
    V = fem.functionspace(domain, ("Lagrange", 1))
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    facets = mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[0], 1.0))
    tags = mesh.meshtags(domain, 1, np.sort(facets), np.full(len(facets), 7, dtype=np.int32))
    ds = ufl.ds(domain=domain, subdomain_data=tags, metadata={"quadrature_degree": RULE})
    a = u * v * body.dx + 5 * u * v * edge.dx + other.field("s") * u * v * other.dx
    A = forms.petsc.assemble_matrix(forms.form(a))
    assert petsc_close(A, dolfinx_matrix(4 * u * v * ufl.dx + 5 * u * v * ds(7)))
    with pytest.raises(ValueError, match="another point set"):
        forms.assemble_vector(forms.form(other.field("s") * v * body.dx))


@pytest.mark.mpi
@pytest.mark.parametrize("cell", ["triangle", "quadrilateral"])
def test_dirichlet_problem_as_in_dolfinx(cell):
    domain = make_mesh(cell, n=4)
    body = points.quadrature(domain, RULE)
    V = fem.functionspace(domain, ("Lagrange", 2, (2,)))
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    x = ufl.SpatialCoordinate(domain)
    g = fem.Function(V)
    g.interpolate(lambda x: np.array([smooth(x), x[0] - x[1]]))
    domain.topology.create_connectivity(1, 2)
    facets = mesh.exterior_facet_indices(domain.topology)
    bc = fem.dirichletbc(g, fem.locate_dofs_topological(V, 1, facets))

    def a(measure):
        return ufl.inner(ufl.sym(ufl.grad(u)), ufl.grad(v)) * measure

    def L(measure):
        return ufl.inner(x, v) * measure

    def solve(A, b):
        ksp = PETSc.KSP().create(domain.comm)
        ksp.setOperators(A)
        ksp.setType("preonly")
        ksp.getPC().setType("lu")
        ksp.getPC().setFactorSolverType("mumps")
        x = b.duplicate()
        ksp.solve(b, x)
        return x.array_r.copy()

    a_cells = fem.form(a(dx(domain)))
    A = petsc.assemble_matrix(a_cells, [bc])
    A.assemble()
    b = petsc.assemble_vector(fem.form(L(dx(domain))))
    petsc.apply_lifting(b, [a_cells], [[bc]])
    b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
    petsc.set_bc(b, [bc])
    reference = solve(A, b)
    a_points, L_points = forms.form(a(body.dx)), forms.form(L(body.dx))
    A = forms.petsc.assemble_matrix(a_points, [bc])
    b = forms.petsc.assemble_vector(L_points)
    forms.petsc.apply_lifting(b, [a_points], [[bc]])
    b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
    forms.petsc.set_bc(b, [bc])
    assert close(domain.comm, solve(A, b), reference, 1e-10)

    # the diagonal entry is free to choose, in PETSc's matrix and in dolfinx' own
    theirs = petsc.assemble_matrix(fem.form(a(dx(domain))), [bc], 3.0)
    theirs.assemble()
    B = forms.assemble_matrix(a_points, [bc], diag=3.0)
    norm = theirs.norm(PETSc.NormType.FROBENIUS)
    assert B.squared_norm() == pytest.approx(norm**2, rel=1e-11)
    assert petsc_close(forms.petsc.assemble_matrix(a_points, [bc], 3.0), theirs)


@pytest.mark.mpi
def test_dofs_without_points_are_taken_out():
    domain = mesh.create_unit_square(MPI.COMM_WORLD, 8, 8)
    body = points.fill(domain, 2, inside=lambda x: x[0] < 0.5)
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    a = forms.form(ufl.inner(u, v) * body.dx)
    coordinates = V.tabulate_dof_coordinates()[: V.dofmap.index_map.size_local]
    empty = np.repeat(coordinates[:, 0] > 0.5 + 1e-10, 2)
    assert np.array_equal(forms.inactive_dofs(a), np.flatnonzero(empty))
    A = forms.petsc.assemble_matrix(a)
    diagonal = A.getDiagonal().array_r
    assert np.all(diagonal[empty] == 1.0)
    assert np.all(diagonal[~empty] < 0.1)
    ones = A.createVecRight()
    ones.set(1.0)
    result = A.createVecLeft()
    A.mult(ones, result)
    assert np.all(result.array_r[empty] == 1.0)
    # a ghost penalty on some facets reaches more dofs than the points do
    facets = mesh.locate_entities(domain, 1, lambda x: np.isclose(x[0], 0.625))
    tags = mesh.meshtags(domain, 1, np.sort(facets), np.full(len(facets), 1, dtype=np.int32))
    dS = ufl.dS(domain=domain, subdomain_data=tags)
    jump = ufl.inner(ufl.jump(ufl.grad(u)), ufl.jump(ufl.grad(v)))
    both = forms.form(ufl.inner(u, v) * body.dx + jump * dS(1))
    x, y = coordinates[:, 0], coordinates[:, 1]
    # right of the facets are triangles with two nodes on them and one up to the right
    beyond = np.repeat((x > 0.75 + 1e-10) | ((x > 0.75 - 1e-10) & (y < 1e-10)), 2)
    assert np.array_equal(forms.inactive_dofs(both), np.flatnonzero(beyond))


@pytest.mark.mpi
def test_values_are_read_at_assembly():
    domain = mesh.create_unit_cube(MPI.COMM_WORLD, 3, 3, 3)
    body = points.quadrature(domain, 2)
    body.add_field("s", (), 1.0)
    V = fem.functionspace(domain, ("Lagrange", 1))
    f, c = fem.Function(V), fem.Constant(domain, 1.0)
    M = forms.form(c * f * body.field("s") * ufl.SpatialCoordinate(domain)[0] * body.dx)
    f.x.array[:] = 2.0
    c.value = 3.0
    body["s"] = 5.0
    assert forms.assemble_scalar(M) == pytest.approx(15.0, rel=1e-12)
    body.move(0.5 * np.asarray(body.x))
    assert forms.assemble_scalar(M) == pytest.approx(7.5, rel=1e-12)
    body.remove(lambda x: x[1] < 0.25)
    expected = 30.0 * domain.comm.allreduce(float(body.weight @ body.x[:, 0]))
    assert forms.assemble_scalar(M) == pytest.approx(expected, rel=1e-12)


@pytest.mark.mpi
@pytest.mark.parametrize("cell", CELLS)
def test_same_result_on_any_number_of_ranks(cell):
    """Random points: the distributed matrix and vector against those of one rank alone."""

    def assemble(comm):
        kind = CELLS[cell]
        if cell in ("triangle", "quadrilateral"):
            domain = mesh.create_unit_square(comm, 5, 4, kind)
        else:
            domain = mesh.create_unit_cube(comm, 3, 2, 3, kind)
        body = points.random(domain, 3, seed=5)
        V = fem.functionspace(domain, ("Lagrange", 2))
        f = fem.Function(V)
        f.interpolate(smooth)
        u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
        L = forms.form(f**2 * v * body.dx)
        a = forms.form((u * v + ufl.exp(f) * ufl.inner(ufl.grad(u), ufl.grad(v))) * body.dx)
        b = owned_array(forms.assemble_vector(L))
        A = forms.petsc.assemble_matrix(a)
        y = A.createVecLeft()
        A.mult(f.x.petsc_vec, y)
        x = V.tabulate_dof_coordinates()[: len(b)]
        rows = comm.gather(np.column_stack([x, b, y.array_r]), root=0)
        return None if rows is None else np.vstack(rows)

    def by_coordinates(rows):
        return rows[np.lexsort(np.round(rows[:, :3], 8).T)]

    distributed = assemble(MPI.COMM_WORLD)
    alone = assemble(MPI.COMM_SELF)
    if MPI.COMM_WORLD.rank == 0:
        a, b = by_coordinates(distributed), by_coordinates(alone)
        assert a == pytest.approx(b, rel=1e-12, abs=1e-13 * np.abs(b).max())


@pytest.mark.parametrize("cell", ["triangle", "hexahedron"])
def test_taylor_of_derivative(cell):
    """R(U + h dU) - R(U) - h J dU is of second order in h."""
    from fenicsmpm import formulations
    from fenicsmpm.materials import NeoHookean

    domain = make_mesh(cell)
    body = points.random(domain, 5, seed=3)
    body.add_field("F", (3, 3), np.eye(3) + 0.1 * np.arange(9).reshape(3, 3) / 9)
    for stabilization in ("ppp", "asgs"):
        z = formulations.Unknown(domain, "u", "p")
        law = NeoHookean(E=2.0, nu=0.45, volumetric="miehe")
        R = formulations.mixed(z, body, law)
        R += getattr(formulations, stabilization)(z, body, law)
        residual, tangent = forms.form(R), forms.form(ufl.derivative(R, z.U))
        rng = np.random.default_rng(2)
        z.U.x.array[:] = start = 0.05 * rng.standard_normal(len(z.U.x.array))
        direction = rng.standard_normal(len(start))
        r0 = forms.assemble_vector(residual).array.copy()
        J = forms.assemble_matrix(tangent).to_scipy()
        linear = J @ direction
        linear[forms.inactive_dofs(tangent)] = 0.0
        steps = np.array([1e-2, 5e-3, 2.5e-3, 1.25e-3])
        errors = []
        for h in steps:
            z.U.x.array[:] = start + h * direction
            r = forms.assemble_vector(residual).array
            errors.append(np.linalg.norm(r - r0 - h * linear))
        slope = np.polyfit(np.log(steps), np.log(errors), 1)[0]
        assert 1.9 < slope < 2.1, (stabilization, slope)


@pytest.mark.mpi
def test_evaluate_expressions():
    domain = make_mesh("tetrahedron")
    body = points.random(domain, 4, seed=1)
    body.add_field("F", (3, 3), np.arange(9.0).reshape(3, 3))
    V = fem.functionspace(domain, ("Lagrange", 2, (3,)))
    u = fem.Function(V)
    u.interpolate(lambda x: np.array([x[0] * x[1], x[2] ** 2, x[0] + 2 * x[1]]))
    x = body.x
    zero, one = np.zeros(len(x)), np.ones(len(x))
    gradient = np.stack(
        [[x[:, 1], x[:, 0], zero], [zero, zero, 2 * x[:, 2]], [one, 2 * one, zero]], axis=0
    ).transpose(2, 0, 1)
    assert forms.evaluate(ufl.grad(u), body) == pytest.approx(gradient, abs=1e-12)
    product = forms.evaluate(ufl.grad(u) * body.field("F"), body)
    assert product == pytest.approx(gradient @ body["F"], abs=1e-11)
    assert forms.evaluate(ufl.div(u), body) == pytest.approx(x[:, 1], abs=1e-12)
    assert forms.evaluate(ufl.SpatialCoordinate(domain), body) == pytest.approx(x, abs=1e-12)
    assert forms.evaluate(0, body) == pytest.approx(zero)
    second = forms.evaluate(ufl.grad(ufl.grad(u))[1, 2, 2], body)
    assert second == pytest.approx(2 * one, abs=1e-10)
    partly_zero = forms.evaluate(ufl.as_vector([0, u[2], 0]), body)
    assert partly_zero[:, 1] == pytest.approx(x[:, 0] + 2 * x[:, 1], abs=1e-12)
    assert not partly_zero[:, [0, 2]].any()
    body["F"] = forms.evaluate(ufl.Identity(3) + ufl.grad(u), body)
    assert body["F"] == pytest.approx(np.eye(3) + gradient, abs=1e-12)


@pytest.mark.mpi
def test_copies_have_fields_of_their_own():
    domain = make_mesh("triangle")
    body = points.quadrature(domain, 2)
    body.add_field("s", (), 2.0)
    body.field("s")
    for twin in (body.copy(), body.select(lambda x: x[0] < 0.5)):
        twin["s"] = 3.0
        integral = forms.assemble_scalar(forms.form(twin.field("s") * twin.dx))
        assert integral == pytest.approx(3 * twin.volume(), rel=1e-12)


@pytest.mark.mpi
def test_cell_sizes_follow_the_mesh():
    domain = mesh.create_unit_square(MPI.COMM_WORLD, 2, 2)
    for side in (1.0, 3.0):
        domain.geometry.x[:] *= side
        body = points.quadrature(domain, 2)
        M = forms.form(ufl.CellVolume(domain) * ufl.Circumradius(domain) * body.dx)
        expected = side**2 * side**2 / 8 * side * np.sqrt(2) / 4
        assert forms.assemble_scalar(M) == pytest.approx(expected, rel=1e-12)


def test_a_tag_without_points_is_a_warning(said):
    body = points.quadrature(make_mesh("triangle"), 2)
    M = forms.form(fem.Constant(body.mesh, 1.0) * body.dx(7))
    (line,) = said
    assert "no point has the tag 7" in line
    assert forms.assemble_scalar(M) == 0.0


@pytest.mark.mpi
@pytest.mark.parametrize("cell", CELLS)
def test_ranks_without_points(cell):
    domain = make_mesh(cell)
    here = domain.comm.rank == 0
    x = np.full((1, domain.geometry.dim), 0.2) if here else np.empty((0, domain.geometry.dim))
    body = points.MaterialPoints(domain, x, 2.0)
    V = fem.functionspace(domain, ("Lagrange", 2))
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    b = forms.assemble_vector(forms.form(ufl.cell_avg(v) * body.dx))
    total = domain.comm.allreduce(float(owned_array(b).sum()))
    assert total == pytest.approx(2.0)
    forms.petsc.assemble_matrix(forms.form(ufl.inner(ufl.grad(u), ufl.grad(v)) * body.dx))
    body.remove(np.arange(len(body)))
    assert forms.assemble_scalar(forms.form(fem.Constant(domain, 1.0) * body.dx)) == 0.0


@pytest.mark.mpi
def test_average_with_uniform_factors():
    domain = make_mesh("triangle")
    body = points.random(domain, 4, seed=1)
    V = fem.functionspace(domain, ("Lagrange", 1))
    f, c = fem.Function(V), fem.Constant(domain, 3.0)
    k = fem.Constant(domain, (1.0, 2.0))
    f.interpolate(smooth)
    size = ufl.CellVolume(domain)
    for inside, outside in (
        (c * f, c * ufl.cell_avg(f)),
        (f / c, ufl.cell_avg(f) / c),
        (size * f, size * ufl.cell_avg(f)),
        (ufl.dot(k, ufl.grad(f)), ufl.dot(k, ufl.cell_avg(ufl.grad(f)))),
    ):
        a = forms.evaluate(ufl.cell_avg(inside), body)
        assert a == pytest.approx(forms.evaluate(outside, body), rel=1e-13, abs=1e-14)


@pytest.mark.mpi
def test_projection_follows_the_points():
    """The lumped mass of OSGS is that of the points as they are at assembly."""
    from fenicsmpm import formulations, materials

    domain = mesh.create_unit_square(MPI.COMM_WORLD, 4, 4)
    body = points.quadrature(domain, 2)
    z = formulations.Unknown(domain, "u", "p")
    z.U.x.array[:] = 0.01
    law = materials.NeoHookean(E=1.0, nu=0.5)
    R = forms.form(formulations.osgs(z, body, law))
    forms.assemble_vector(R)
    body.move(0.7 * np.asarray(body.x))
    body["weight"] = 0.49 * body.weight
    moved = owned_array(forms.assemble_vector(R))
    anew = owned_array(forms.assemble_vector(forms.form(formulations.osgs(z, body, law))))
    assert close(domain.comm, moved, anew)


def test_points_on_edges_do_not_see_the_functions_behind():
    domain = mesh.create_unit_square(MPI.COMM_SELF, 4, 4, mesh.CellType.quadrilateral)
    edge = points.on_facets(domain, lambda x: np.isclose(x[0], 0.0), degree=2)
    V = fem.functionspace(domain, ("Lagrange", 1))
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    a = forms.form(u * v * edge.dx)
    seen = np.setdiff1d(np.arange(25), forms.inactive_dofs(a))
    assert np.allclose(V.tabulate_dof_coordinates()[seen, 0], 0.0) and len(seen) == 5
    assert np.linalg.matrix_rank(forms.assemble_matrix(a).to_dense()) == 25
    # but their gradients are seen
    b = forms.form(ufl.inner(ufl.grad(u), ufl.grad(v)) * edge.dx)
    assert len(forms.inactive_dofs(b)) == 15


def test_matrices_and_vectors_of_other_forms():
    domain = make_mesh("triangle")
    body = points.quadrature(domain, 2)
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    on_boundary = forms.create_matrix(forms.form(ufl.inner(u, v) * ufl.ds))
    a = forms.form(ufl.inner(u, v) * body.dx)
    with pytest.raises(ValueError, match="matrix made for another form"):
        forms.assemble_matrix(a, A=on_boundary)
    blocked = fem.create_matrix(fem.form(ufl.inner(u, v) * ufl.dx))
    with pytest.raises(ValueError, match=r"block sizes \[2, 2\]"):
        forms.assemble_matrix(a, A=blocked)
    with pytest.raises(ValueError, match="vector of 3 entries"):
        forms.apply_lifting(np.zeros(3), [a], [[]])
