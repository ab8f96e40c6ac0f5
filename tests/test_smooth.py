# SPDX-License-Identifier: MIT
"""Pressures by stabilizations that suit smooth functions, and what else splines and uGIMP need."""

import itertools
import sys
from pathlib import Path

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from dolfinx import fem, la, mesh
from lattices import COMM, LOWER, UPPER, by_id, lattice, noise, product, use
from numba import cfunc, types

from fenicsmpm import ImplicitMPM, MaterialPoints, _compat, basis, diagnostics, forms, points
from fenicsmpm import formulations as fm
from fenicsmpm.cells import ActiveCells, Tying, correct_weights
from fenicsmpm.forms import assembly, matrix_loops
from fenicsmpm.formulations import Bossak, QuasiStatic, Unknown
from fenicsmpm.io import checkpoint
from fenicsmpm.materials import NeoHookean
from fenicsmpm.solvers import NewtonError, NewtonSolver
from fenicsmpm.solvers.projected_tangent import ProjectedTangent
from fenicsmpm.transfer import p2g

sys.path.insert(0, str(Path(__file__).parent.parent / "studies"))

import moved_points

QUADRILATERAL = mesh.CellType.quadrilateral
SMOOTH = "cip", "hessian", "split_osgs"
GAMMA, MU = 0.3, 0.7
HALF = np.array([0.06, 0.05, 0.03])  # that of lattices.use


def rectangle(upper, cells, comm=COMM, lower=(0, 0)):
    partitioner = basis.shared_vertex_partitioner
    return mesh.create_rectangle(
        comm, [lower, upper], list(cells), QUADRILATERAL, partitioner=partitioner
    )


def tangent(R, z):
    return forms.form(ufl.derivative(R, z.U))


def residual(R):
    return forms.assemble_vector(forms.form(R)).array


# --- interior penalty ----------------------------------------------------------------------------


def numbers(domain, shape, x):
    """Lattice coordinates of positions, in cells from the lower corner."""
    dim = domain.geometry.dim
    return (x[:, :dim] - LOWER[:dim]) / (UPPER - LOWER)[:dim] * shape[:dim]


def expected_cells(body, shape, name):
    """Mask of cells, all of whose nodes some point sees; by the definition of the functions."""
    t = np.concatenate(COMM.allgather(numbers(body.mesh, shape, body.x)))
    half = HALF[: t.shape[1]] / (UPPER - LOWER)[: t.shape[1]] * shape
    below, above = {
        "linear": (np.floor(t), np.floor(t)),
        "quadratic": (np.rint(t) - 1, np.rint(t)),
        "cubic": (np.floor(t) - 1, np.floor(t) + 1),
        "gimp": (np.floor(t - half), np.floor(t + half)),
    }[name]
    active = np.zeros(shape, dtype=bool)
    for first, last in zip(below.astype(int), above.astype(int), strict=True):
        first, last = np.maximum(first, 0), np.minimum(last, np.array(shape) - 1)
        active[tuple(slice(a, b + 1) for a, b in zip(first, last, strict=True))] = True
    return active


def jumps_squared(active, h):
    """Matrix of the sum of integrals of [dn p] [dn q] over facets between active cells.

    Second differences of nodal values over h are the jumps, linear along each facet.
    """
    shape = np.array(active.shape)
    node = np.arange(np.prod(shape + 1)).reshape(shape + 1)
    result = np.zeros((node.size, node.size))
    for axis in range(len(shape)):
        mass = np.ones((1, 1))
        for k in np.delete(h, axis):
            mass = np.kron(mass, k / 6 * np.array([[2.0, 1.0], [1.0, 2.0]]))
        one = np.eye(len(shape), dtype=int)[axis]
        for cell in itertools.product(*map(range, shape - one)):
            if not (active[cell] and active[tuple(cell + one)]):
                continue
            corners = [range(c, c + 2) if k != axis else [c] for k, c in enumerate(cell)]
            lines = [
                [node[tuple(corner + j * one)] for j in range(3)]
                for corner in map(np.array, itertools.product(*corners))
            ]
            jump = np.zeros((len(lines), node.size))
            for row, line in zip(jump, lines, strict=True):
                row[line] = np.array([1.0, -2.0, 1.0]) / h[axis]
            result += jump.T @ mass @ jump
    return result


def some_points(dim, name, shape):
    """Random points in two clumps; the same on any number of ranks.

    They are away from nodes and knots, beyond which functions are not seen if hardly more than
    zero.
    """
    rng = np.random.default_rng(11)
    t = rng.integers(0, 2, (60, dim)) + rng.choice([0.0, 0.5], (60, dim))
    t += rng.uniform(0.15, 0.35, (60, dim)) + np.repeat([[0.0], [2.0]], 30, axis=0)
    x = LOWER[:dim] + t / shape * (UPPER - LOWER)[:dim]
    here = slice(None) if COMM.rank == 0 else slice(0)
    return use(MaterialPoints(lattice(dim, shape=shape), x[here], 1e-3), name)


@pytest.mark.ranks
@pytest.mark.mpi
@pytest.mark.parametrize("parts", [("p",), ("u", "p")])
@pytest.mark.parametrize("name", ["linear", "quadratic", "cubic", "gimp"])
@pytest.mark.parametrize("dim", [2, 3])
def test_interior_penalty_is_one_on_second_differences(dim, name, parts):
    """For points of any functions, the formula with linear ones over the cells that are active."""
    shape = np.array((6, 5, 4)[:dim])
    body = some_points(dim, name, shape)
    active = expected_cells(body, shape, name)
    assert 2**dim < active.sum() < active.size
    cells = ActiveCells(body)
    assert COMM.allreduce(len(cells.cells())) == active.sum()
    z = Unknown(body.mesh, *parts)
    if len(parts) > 1:
        z.interpolate("p", noise(z.part_space("p")))
    else:
        z.U.x.array[:] = noise(z.space).x.array
    law = NeoHookean(3 * MU, 0.5)
    R = fm.interior_penalty(z, cells, law, gamma=GAMMA)
    h = (UPPER - LOWER)[:dim] / shape
    factor = -GAMMA * np.prod(h) ** (3 / dim) / (2 * MU)
    expected = factor * jumps_squared(active, h)

    V, dofs = z.part_space("p"), z.dofs("p")
    owned = dofs[: V.dofmap.index_map.size_local]
    X = V.tabulate_dof_coordinates()
    grid = (LOWER[k] + h[k] * np.arange(n + 1) for k, n in enumerate(shape))
    grid = np.stack(np.meshgrid(*grid, indexing="ij"), axis=-1).reshape(-1, dim)
    nodes = np.zeros((3, len(grid)))
    nodes[:dim] = grid.T
    phase = np.random.default_rng(0).uniform(5.0, 15.0, (1, 3))  # that of noise
    wanted = expected @ np.sin(phase @ nodes)[0]
    where = np.rint(numbers(body.mesh, shape, X[: len(owned)])).astype(int)
    wanted = wanted[np.ravel_multi_index(tuple(where.T), shape + 1)]
    size = COMM.allreduce(np.abs(wanted).max(initial=0.0), MPI.MAX)
    by_matrix = product(tangent(R, z), z.U)
    assert by_matrix[owned] == pytest.approx(wanted, abs=1e-12 * size)
    others = np.setdiff1d(np.arange(len(by_matrix)), owned)
    assert not np.any(by_matrix[others])
    b = forms.assemble_vector(forms.form(R))
    b.scatter_reverse(la.InsertMode.add)
    assert b.array[owned] == pytest.approx(wanted, abs=1e-12 * size)
    # linear pressures have no jumps
    z.interpolate("p", lambda x: 1.0 + x[0] - 2.0 * x[1] + 3.0 * x[2])
    assert np.abs(product(tangent(R, z), z.U)).max(initial=0.0) < 1e-12 * size


@pytest.mark.ranks
@pytest.mark.mpi
@pytest.mark.parametrize("kind", ["triangle", "tetrahedron", "quadrilateral"])
def test_interior_penalty_is_that_of_dolfinx_on_a_full_mesh(kind):
    dim = 3 if kind == "tetrahedron" else 2
    make = mesh.create_unit_cube if dim == 3 else mesh.create_unit_square
    domain = make(COMM, *[4] * dim, getattr(mesh.CellType, kind))
    x = domain.geometry.x
    if kind != "quadrilateral":
        x[:, :dim] += 0.03 * np.sin(7 * x[:, :dim][:, ::-1])
    z = Unknown(domain, "p")
    z.U.x.array[:] = noise(z.space).x.array
    R = fm.interior_penalty(z, ActiveCells(points.fill(domain, 1)), NeoHookean(3 * MU, 0.5))
    n = ufl.FacetNormal(domain)
    volume = ufl.CellVolume(domain) if kind != "quadrilateral" else fem.Constant(domain, 1 / 16)
    h = ufl.avg(volume) ** (1 / dim)
    p, q = (ufl.jump(ufl.grad(f), n) for f in (z.p, z.test.p))
    exact = fem.form(-0.05 * h**3 / (2 * MU) * p * q * ufl.dS(degree=4))
    expected = fem.assemble_vector(exact).array
    size = np.abs(expected).max()
    assert residual(R) == pytest.approx(expected, abs=1e-13 * size)
    expected = fem.assemble_vector(exact)
    expected.scatter_reverse(la.InsertMode.add)
    owned = z.space.dofmap.index_map.size_local
    found = product(tangent(R, z), z.U)
    assert found == pytest.approx(expected.array[:owned], abs=1e-12 * size)


@pytest.mark.mpi
def test_interior_penalty_with_inertia():
    """gamma h / (2 mu / h^2 + rho r_a) instead of gamma h / (2 mu / h^2), for each dt anew."""
    domain = lattice(2)
    bodies = [use(points.fill(domain, k), "quadratic") for k in (2, 3)]
    for body, density in zip(bodies, (2.0, 5.0), strict=True):
        fm.set_initial_state(body, density)
    cells, law = ActiveCells(*bodies), NeoHookean(3 * MU, 0.5)
    z = Unknown(domain, "u", "p")
    scheme = Bossak(z, dt=0.02)
    h_squared = np.prod((UPPER - LOWER)[:2] / (6, 5))
    alpha = (0.8 - 1) / (0.8 + 1)
    beta = (1 - alpha) ** 2 / 4
    plain = forms.assemble_matrix(tangent(fm.interior_penalty(z, cells, law), z))
    a = tangent(fm.interior_penalty(z, cells, law, scheme=scheme), z)
    A = forms.create_matrix(a)
    seen = np.abs(plain.data) > 1e-3 * np.abs(plain.data).max()
    seen &= plain.data != 1.0  # rows of the identity
    for dt in (0.02, 0.005, 0.005, 0.1):
        scheme.dt.value = dt
        forms.assemble_matrix(a, A=A)
        inertia = 3.5 * (1 - alpha) / (beta * dt**2)
        ratio = (2 * MU / h_squared) / (2 * MU / h_squared + inertia)
        assert ratio < 0.995
        assert A.data[seen] == pytest.approx(ratio * plain.data[seen], rel=1e-12)


@pytest.mark.mpi
def test_split_osgs_with_inertia():
    """Likewise h^2 / (2 mu + rho r_a h^2) instead of h^2 / (2 mu)."""
    body, law = use(points.fill(lattice(2), 3), "quadratic"), NeoHookean(3 * MU, 0.5)
    fm.set_initial_state(body, 3.5)
    z = Unknown(body.mesh, "u", "p")
    z.interpolate("p", noise(z.part_space("p")))
    scheme = Bossak(z, dt=0.02)
    h_squared = np.prod((UPPER - LOWER)[:2] / (6, 5))
    alpha = (0.8 - 1) / (0.8 + 1)
    beta = (1 - alpha) ** 2 / 4
    plain = residual(fm.split_osgs(z, body, law))
    for dt in (0.02, 0.1):
        scheme.dt.value = dt
        inertia = 3.5 * (1 - alpha) / (beta * dt**2)
        ratio = (2 * MU / h_squared) / (2 * MU / h_squared + inertia)
        assert ratio < 0.995
        found = residual(fm.split_osgs(z, body, law, scheme=scheme))
        assert found == pytest.approx(ratio * plain, rel=1e-9, abs=1e-12 * np.abs(plain).max())


@pytest.mark.ranks
@pytest.mark.mpi
def test_interior_penalty_follows_points_and_counts_loads():
    """Facets of a moved body, and those between a body and a load that is apart from it."""
    domain = rectangle((6, 4), (6, 4))
    x = [[0.5, 0.5], [1.5, 0.5]] if COMM.rank == 0 else np.empty((0, 2))
    body = MaterialPoints(domain, x, 0.1)
    edge = points.at(domain, (3.5, 0.5))
    z, law = Unknown(domain, "p"), NeoHookean(3 * MU, 0.5)
    z.interpolate("p", lambda x: np.maximum(x[0] - 1.0, 0.0) + np.maximum(x[0] - 3.0, 0.0))
    unit = GAMMA / (2 * MU)

    def penalty(cells):
        R = fm.interior_penalty(z, cells, law, gamma=GAMMA)
        return -forms.assemble_scalar(forms.form(ufl.action(R, z.U)))

    alone, loaded = ActiveCells(body), ActiveCells(body, loads=[edge])
    assert penalty(alone) == pytest.approx(unit)
    # the load and all around it: facets x = 3 of the two lowest rows
    assert penalty(loaded) == pytest.approx(unit + 2 * unit)
    body.move(body.x + np.array([0.0, 1.0]))
    assert penalty(alone) == pytest.approx(unit)
    body.move(body.x + np.array([2.0, 0.0]))
    assert penalty(alone) == pytest.approx(unit)
    body.move(body.x + np.array([1.0, 0.0]))
    assert penalty(alone) == pytest.approx(0.0, abs=1e-14)


@pytest.mark.ranks
@pytest.mark.mpi
def test_conditions_on_one_rank_only():
    """Matrices over facets are kept or made anew by all ranks together."""
    body = use(points.fill(lattice(2), 2), "quadratic")
    z, law = Unknown(body.mesh, "u", "p"), NeoHookean(3 * MU, 0.3)
    z.fix("u", lambda x: np.isclose(x[0], LOWER[0]) & np.isclose(x[1], LOWER[1]))
    a = tangent(fm.mixed(z, body, law) + fm.interior_penalty(z, ActiveCells(body), law), z)
    A = forms.assemble_matrix(a, z.bcs)
    before = A.data.copy()
    for _ in range(2):
        assert len(forms.inactive_dofs(a, A)) == 0  # overwrites it, without conditions
        assert COMM.allreduce(not np.array_equal(A.data, before), MPI.LOR)
        assert np.array_equal(forms.assemble_matrix(a, z.bcs, A=A).data, before)


# --- second derivatives ---------------------------------------------------------------------------


def dense(body, z):
    """Values, gradients and second derivatives of all functions of "p" at the points."""
    V = z.part_space("p")
    f = fem.Function(V)
    at = [forms.PointExpression(e, body) for e in (f, ufl.grad(f), ufl.grad(ufl.grad(f)))]
    result = [[], [], []]
    for i in range(len(f.x.array)):
        f.x.array[:] = 0.0
        f.x.array[i] = 1.0
        for values, expression in zip(result, at, strict=True):
            values.append(expression.evaluate())
    return [np.array(values) for values in result]


@pytest.mark.mpi
@pytest.mark.parametrize("name", ["quadratic", "cubic"])
@pytest.mark.parametrize("dim", [2, 3])
def test_hessian_penalty_of_a_quadratic_pressure(dim, name):
    """-gamma h^4 / (2 mu) H : H times the volume, for pressures that splines reproduce."""
    shape = np.array((9, 8, 7)[:dim])
    h = (UPPER - LOWER)[:dim] / shape
    rng = np.random.default_rng(2)
    x = LOWER[:dim] + h * rng.uniform(2, shape - 2, (50, dim))
    weight = rng.uniform(0.5, 1.5, 50)
    here = slice(None) if COMM.rank == 0 else slice(0)
    body = use(MaterialPoints(lattice(dim, shape=shape), x[here], weight[here]), name)
    z, law = Unknown(body.mesh, "p"), NeoHookean(3 * MU, 0.5)
    H = np.array([[2.0, 0.7, -0.4], [0.7, -1.2, 0.9], [-0.4, 0.9, 0.6]])[:dim, :dim]

    # nodal values of x_k^2 are x_k^2 less the variance of the spline
    variance = {"quadratic": 1 / 4, "cubic": 1 / 3}[name] * h**2

    def pressure(x):
        squares = np.einsum("in,ij,jn->n", x[:dim], H, x[:dim])
        return (squares - np.diag(H) @ variance) / 2 + 3 * x[0] - x[1]

    z.interpolate("p", pressure)
    at = np.zeros((3, len(body)))
    at[:dim] = body.x.T
    exact = pressure(at) + np.diag(H) @ variance / 2
    assert forms.evaluate(z.p, body) == pytest.approx(exact, abs=1e-11)
    R = fm.hessian_penalty(z, body, law, gamma=GAMMA)
    found = forms.assemble_scalar(forms.form(ufl.action(R, z.U)))
    factor = GAMMA * np.prod(h) ** (4 / dim) / (2 * MU)
    assert found == pytest.approx(-factor * np.sum(H**2) * weight.sum(), rel=1e-10)
    size = np.abs(product(tangent(R, z), z.U)).max(initial=0.0)
    z.interpolate("p", lambda x: 1.0 + x[0] - 2.0 * x[1] + 3.0 * x[2])
    assert np.abs(product(tangent(R, z), z.U)).max(initial=0.0) < 1e-10 * size + 1e-14
    # with inertia
    fm.set_initial_state(body, 3.0)
    w = Unknown(body.mesh, "u", "p")
    w.interpolate("p", pressure)
    scheme = fm.Newmark(w, dt=0.01)
    R = fm.hessian_penalty(w, body, law, gamma=GAMMA, scheme=scheme)
    less = forms.assemble_scalar(forms.form(ufl.replace(R, {w.V: w.U})))
    h_squared = np.prod(h) ** (2 / dim)
    ratio = (2 * MU / h_squared) / (2 * MU / h_squared + 3.0 * 4 / 0.01**2)
    assert less / found == pytest.approx(ratio, rel=1e-10)


@pytest.mark.mpi
def test_hessian_and_interior_penalty_are_the_same_along_an_axis():
    """For pressures of x alone, row by row at nodes away from the walls.

    Second derivatives are constant in the box around a node, so that as many equal weights on
    both sides of each cell's middle leave round-off only.
    """
    domain = rectangle((2.0, 1.75), (8, 7))
    body = points.fill(domain, 4)
    basis.use(body, "quadratic")
    z, law = Unknown(domain, "p"), NeoHookean(3 * MU, 0.5)
    z.interpolate("p", lambda x: np.sin(5.0 * x[0]) + np.cos(11.0 * x[0]))
    X = z.space.tabulate_dof_coordinates()[: z.space.dofmap.index_map.size_local]
    inside = np.all((X[:, :2] > 0.45) & (X[:, :2] < (1.55, 1.3)), axis=1)
    cip = product(tangent(fm.interior_penalty(z, ActiveCells(body), law), z), z.U)
    hessian = product(tangent(fm.hessian_penalty(z, body, law), z), z.U)
    size = COMM.allreduce(np.abs(cip).max(initial=0.0), MPI.MAX)
    assert COMM.allreduce(int(inside.sum())) == 20
    assert size > 1e-4
    assert hessian[inside] == pytest.approx(cip[inside], abs=1e-12 * size)


# --- split OSGS -----------------------------------------------------------------------------------


@pytest.mark.mpi
@pytest.mark.parametrize("name", ["linear", "quadratic", "cubic", "gimp"])
def test_split_osgs_leaves_linear_pressures(name):
    """Also in a body that is deformed homogeneously, whatever cells it cuts.

    Up to what is added to the volumes at nodes, 1e-11 of a weight, so that none of them is zero but
    for round-off.
    """
    body = some_points(2, name, np.array((6, 5)))
    z, law = Unknown(body.mesh, "u", "p"), NeoHookean(3 * MU, 0.5)
    form = forms.form(fm.split_osgs(z, body, law))
    z.interpolate("u", lambda x: np.array([[0.1, 0.2], [-0.1, 0.3]]) @ x[:2])
    z.interpolate("p", lambda x: np.sin(5 * x[0]) * x[1])
    size = np.abs(forms.assemble_vector(form).array).max()
    z.interpolate("p", lambda x: 1.0 + x[0] - 2.0 * x[1])
    rest = np.abs(forms.assemble_vector(form).array).max()
    assert COMM.allreduce(size, MPI.MAX) > 1e-6
    assert COMM.allreduce(rest, MPI.MAX) < 1e-9 * COMM.allreduce(size, MPI.MAX)


@pytest.mark.mpi
@pytest.mark.parametrize("name", ["quadratic", "cubic"])
def test_split_osgs_leaves_linear_pressures_inside(name):
    """At nodes whose functions see full cells only, to round-off."""
    shape = np.array((12, 11))
    body = use(points.fill(lattice(2, shape=shape), 2), name)
    z, law = Unknown(body.mesh, "u", "p"), NeoHookean(3 * MU, 0.5)
    form = forms.form(fm.split_osgs(z, body, law))
    z.interpolate("p", lambda x: 1.0 + x[0] - 2.0 * x[1])
    b = forms.assemble_vector(form)
    b.scatter_reverse(la.InsertMode.add)
    V = z.part_space("p")
    owned = V.dofmap.index_map.size_local
    t = numbers(body.mesh, shape, V.tabulate_dof_coordinates()[:owned])
    inside = np.all((t > 3.9) & (t < shape - 3.9), axis=1)  # no point there sees nodes at walls
    assert COMM.allreduce(int(inside.sum())) == 20
    # of terms tau |grad p| |grad q| V of about 1e-3
    assert np.abs(b.array[z.dofs("p")[:owned][inside]]).max(initial=0.0) < 1e-15


@pytest.mark.parametrize("name", ["quadratic", "gimp"])
def test_split_osgs_is_its_formula(name):
    """-tau_1 (g - sum_I N_I s_I / m_I) . grad q with the sums s_I of N_I V g, by numpy."""
    body = some_points(2, name, np.array((6, 5)))
    body["weight"] = np.random.default_rng(1).uniform(0.5, 1.5, len(body))
    z, law = Unknown(body.mesh, "u", "p"), NeoHookean(3 * MU, 0.5)
    z.interpolate("p", noise(z.part_space("p")))
    p = z.U.x.array[z.dofs("p")]
    space = Unknown(body.mesh, "p")
    f = fem.Function(space.space)
    value, gradient = (forms.PointExpression(e, body) for e in (f, ufl.grad(f)))
    N, G = [], []
    for i in range(len(p)):
        f.x.array[:] = np.eye(len(p))[i]
        N.append(value.evaluate())
        G.append(gradient.evaluate())
    N, G, V = np.array(N), np.array(G), body.weight
    g = np.einsum("ipk,i->pk", G, p)
    mass = N @ V
    seen = mass > 1e-14
    mean = np.zeros((len(p), 2))
    mean[seen] = ((N * V) @ g)[seen] / mass[seen, None]
    tau = np.prod((UPPER - LOWER)[:2] / (6, 5)) / (2 * MU)
    expected = -tau * np.einsum("p,pk,ipk->i", V, g - N.T @ mean, G)
    found = residual(fm.split_osgs(z, body, law))
    size = np.abs(expected).max()
    assert found[z.dofs("p")] == pytest.approx(expected, abs=1e-9 * size)  # see above
    assert np.abs(found[z.dofs("u")]).max() < 1e-13 * size


def cantilever(name, nu=0.5, comm=COMM, functions="quadratic"):
    """A block that is clamped on the left and bends under its weight; its solver."""
    domain = rectangle((2.5, 2.0), (10, 8), comm)
    body = points.fill(domain, 3, inside=lambda x: (x[0] < 2) & (abs(x[1] - 1) < 0.5))
    basis.use(body, functions)
    z, law = Unknown(domain, "u", "p"), NeoHookean(30.0, nu)
    z.fix("u", lambda x: np.isclose(x[0], 0))
    cells = ActiveCells(body)
    R = fm.stabilized(name, z, body, law, cells=cells)
    R -= 0.3 * z.test.u[1] * body.dx
    newton = {"tying": Tying(z.space, body, cells), "petsc_options": {"pc_type": "lu"}}
    return z, NewtonSolver(R, z.U, z.bcs, rtol=1e-10, **newton)


@pytest.mark.mpi
@pytest.mark.parametrize("name", SMOOTH)
def test_newton_converges_quadratically(name):
    """The tangent has all of the projection of split OSGS, tied nodes included."""
    z, solver = cantilever(name)
    result = solver.solve()
    norms = np.array(result.residuals)
    assert result.iterations <= 5
    assert norms[-1] < 1e-10 * norms[0]
    # the digits double, up to round-off
    for before, after in itertools.pairwise(norms[1:] / norms[1]):
        assert after < max(10 * before**2, 1e-10)
    assert COMM.allreduce(np.abs(z.U.x.array[z.dofs("u")]).max(), MPI.MAX) > 0.1


# --- tangents -------------------------------------------------------------------------------------


@pytest.mark.parametrize("nu", [0.3, 0.5])
@pytest.mark.parametrize("name", SMOOTH)
def test_tangents(name, nu):
    """Central differences of the residual of a deformed state, in a random direction."""
    body = some_points(2, "quadratic", np.array((6, 5)))
    rng = np.random.default_rng(3)
    body.add_field("F", (3, 3), np.eye(3))
    body["F"][:, :2, :2] += 0.1 * rng.standard_normal((len(body), 2, 2))
    body.add_field("J", (), np.linalg.det(body["F"]))
    z, law = Unknown(body.mesh, "u", "p"), NeoHookean(3 * MU, nu)
    z.U.x.array[:] = 0.01 * rng.standard_normal(len(z.U.x.array))
    R = fm.stabilized(name, z, body, law, cells=ActiveCells(body))
    form, a = forms.form(R), tangent(R, z)
    forms.assemble_vector(form)
    projected = ProjectedTangent(R, z.U, None)
    assert bool(projected) == (name == "split_osgs")
    A = forms.assemble_matrix(a).to_scipy().tocsr()
    s = rng.standard_normal(len(z.U.x.array))
    s[forms.inactive_dofs(a)] = 0.0
    present, eps = z.U.x.array.copy(), 1e-6

    def difference():
        ends = []
        for sign in (1, -1):
            z.U.x.array[:] = present + sign * eps * s
            ends.append(forms.assemble_vector(form).array)
        z.U.x.array[:] = present
        return (ends[0] - ends[1]) / (2 * eps)

    with projected.held():
        expected = difference()
        found = A @ s
        size = np.abs(expected).max()
        assert found == pytest.approx(expected, abs=2e-8 * size)
    if projected:
        forms.assemble_vector(form)
        with projected.held():
            projected.assemble([])
        x, y = (forms.petsc.create_vector(form) for _ in range(2))
        x.array_w[:] = s
        projected.mult_all(x, y)
        assert np.abs(y.array_r).max() > 1e-3 * size
        assert found + y.array_r == pytest.approx(difference(), abs=2e-8 * size)


# --- time schemes ---------------------------------------------------------------------------------


def spinning(dim=2, density=2.0, comm=COMM, functions="quadratic"):
    """A block that flies and turns, on smooth functions."""
    domain = rectangle((3, 2), (18, 12), comm)
    body = points.lattice(domain, 0.5 / 12, inside=lambda x: np.abs(x[:2] - 0.8).max(axis=0) < 0.4)
    basis.use(body, functions, *([0.5 / 24] if functions == "gimp" else []))

    def v0(x):
        return np.array([1.0 + 2.0 * (0.8 - x[1]), 0.5 + 2.0 * (x[0] - 0.8)])

    fm.set_initial_state(body, density, v0)
    return body


@pytest.mark.mpi
@pytest.mark.parametrize("way", ["ghost penalty", "tying"])
@pytest.mark.parametrize("name", ["Newmark", "Bossak", "GeneralizedAlpha", "BDF2", "Midpoint"])
def test_flight_by_all_schemes(name, way):
    body = spinning()
    z, law = Unknown(body.mesh, "u", "p"), NeoHookean(1000.0, 0.5)
    scheme = getattr(fm, name)(z, dt=0.01)
    cells = ActiveCells(body)
    newton = {"rtol": 1e-12}
    if name == "Midpoint":
        R = fm.MixedEnergyMomentum(law, body, z).power() + scheme.inertia(body)
    else:
        R = fm.stabilized("cip", z, body, law, force=scheme.force(body), cells=cells)
    if way == "tying":
        newton["tying"] = Tying(z.space, body, cells)
    else:
        R += fm.ghost_penalty(z, cells, law)
    # continued velocities, else mapping slows down the turn; with the consistent mass it does not
    sim = ImplicitMPM(R, z, scheme, body, newton=newton, taylor=name != "Midpoint")
    before, start = diagnostics.momentum(body), by_id(body, body.x)
    for step in sim.run(until=0.05):
        assert step.newton.iterations <= 5
        assert diagnostics.momentum(body) == pytest.approx(before, rel=1e-9)
        assert np.abs(body["J"] - 1).max(initial=0.0) < 0.005
    # the centre moves on, and all turn about it
    now = by_id(body, body.x)
    velocity = before / COMM.allreduce(body["mass"].sum())
    assert now.mean(axis=0) - start.mean(axis=0) == pytest.approx(0.05 * velocity, rel=1e-6)
    turn = np.array([[np.cos(0.1), -np.sin(0.1)], [np.sin(0.1), np.cos(0.1)]])
    expected = (start - start.mean(axis=0)) @ turn.T
    assert now - now.mean(axis=0) == pytest.approx(expected, abs=2.5e-3)  # BDF2; others 1e-4


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("functions", "name"), [("gimp", "cip"), ("quadratic", "hessian"), ("quadratic", "split_osgs")]
)
def test_flight_by_others(functions, name):
    """The same with uGIMP, and with the other stabilizations of splines."""
    body = spinning(functions=functions)
    z, law = Unknown(body.mesh, "u", "p"), NeoHookean(1000.0, 0.5)
    scheme, cells = Bossak(z, dt=0.01), ActiveCells(body)
    options = {"cells": cells} if name == "cip" else {}
    R = fm.stabilized(name, z, body, law, force=scheme.force(body), **options)
    newton = {"rtol": 1e-12, "tying": Tying(z.space, body, cells)}
    sim = ImplicitMPM(R, z, scheme, body, newton=newton, taylor=True)
    before, start = diagnostics.momentum(body), by_id(body, body.x)
    for step in sim.run(until=0.05):
        assert step.newton.iterations <= 5
        assert diagnostics.momentum(body) == pytest.approx(before, rel=1e-9)
        assert np.abs(body["J"] - 1).max(initial=0.0) < 0.005
    now = by_id(body, body.x)
    turn = np.array([[np.cos(0.1), -np.sin(0.1)], [np.sin(0.1), np.cos(0.1)]])
    expected = (start - start.mean(axis=0)) @ turn.T
    assert now - now.mean(axis=0) == pytest.approx(expected, abs=2.5e-3)


@pytest.mark.mpi
@pytest.mark.parametrize("name", ["BDF2", "Newmark"])
def test_water_falls_and_turns(name):
    """A block of water: its momentum is that of its weight, and pressures have no checkerboard."""
    rough = {}
    for stabilization in ("none", "cip"):
        body = spinning(density=1e3)
        z = Unknown(body.mesh, "u", "p")
        scheme = getattr(fm, name)(z, dt=0.01)
        law = fm.NewtonianFlow(1e-3, 1e3, scheme)
        b = fem.Constant(body.mesh, (0.0, -9.81))
        R = fm.mixed(z, body, law, force=fm.density(body) * b) + scheme.lumped(body)
        cells = ActiveCells(body)
        if stabilization == "cip":
            R += fm.interior_penalty(z, cells, law)
        newton = {"rtol": 1e-12, "tying": Tying(z.space, body, cells)}
        sim = ImplicitMPM(R, z, scheme, body, newton=newton)
        before = diagnostics.momentum(body)
        mass = COMM.allreduce(body["mass"].sum())
        for _ in sim.run(until=0.05):
            expected = before + np.array([0.0, -9.81 * mass * sim.time])
            assert diagnostics.momentum(body) == pytest.approx(expected, rel=1e-9)
        rough[stabilization] = diagnostics.roughness(body, forms.evaluate(z.p, body), 0.5 / 12)
    # pressures are of rho omega^2 r^2 = 640 Pa
    assert rough["cip"] < 0.02 * 640
    assert rough["none"] > 12 * rough["cip"]


# --- checkerboards --------------------------------------------------------------------------------


PRESS = 0.1  # Pa


def pressed(name, functions="quadratic"):
    """A confined block, the left half of whose top is pressed; roughness of its pressure [Pa]."""
    n, k = 8, 4
    domain = rectangle((1, 1), (n, n))
    body = points.fill(domain, k)
    body.add_field("u", (2,))
    load = points.on_curve(domain, (0, 1), (0.5, 1), spacing=1 / (4 * n))
    for p in (body, load):
        basis.use(p, functions, 1 / (2 * n * k) if functions == "gimp" else None)
    z, law = Unknown(domain, "u", "p"), NeoHookean(3.0, 0.5)
    z.fix("u", lambda x: np.isclose(x[0], 0) | np.isclose(x[0], 1), component=0)
    z.fix("u", lambda x: np.isclose(x[1], 0), component=1)
    R = fm.stabilized(name, z, body, law, cells=ActiveCells(body, loads=[load]))
    R += fm.dead_load(z.test.u, load, (0.0, -PRESS))
    NewtonSolver(R, z.U, z.bcs, petsc_options={"pc_type": "lu"}).solve()
    return diagnostics.roughness(body, forms.evaluate(z.p, body), 1 / (n * k))


@pytest.mark.mpi
def test_checkerboards_of_splines():
    """Quadratic splines of equal order have them, and each of the remedies leaves none.

    Without stabilization, pressures oscillate by more than the load; with it, their curvature
    from point to point is a thousandth of it.
    """
    rough = {name: pressed(name) for name in ("none", *SMOOTH)}
    for name in SMOOTH:
        assert rough[name] < 2e-3 * PRESS
        assert rough["none"] > 300 * rough[name]


@pytest.mark.mpi
@pytest.mark.parametrize("functions", ["cubic", "gimp"])
def test_checkerboards_of_others(functions):
    rough = {name: pressed(name, functions) for name in ("none", "cip", "split_osgs")}
    for name in ("cip", "split_osgs"):
        assert rough[name] < 3e-3 * PRESS
        assert rough["none"] > {"cubic": 150, "gimp": 40}[functions] * rough[name]


# --- loads at the edge ----------------------------------------------------------------------------


def pulled(functions, end, way, scheme=Bossak, is_free=False, dt=0.05):
    """A block that its right edge, at ``end`` cells of 0.125 m, pulls; edge and simulation."""
    h, k = 0.125, 4
    domain = rectangle((2.5, 1.5), (20, 12))
    end, start = h * end, h * (2.2 if is_free else 0.0)
    n = round((end - start) / (h / k))
    spacing = np.array([(end - start) / n, h / k])
    # a lattice that ends half a spacing before the edge
    x, y = start + spacing[0] * (np.arange(n) + 0.5), 0.5 + spacing[1] * (np.arange(16) + 0.5)
    x = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    here = slice(None) if COMM.rank == 0 else slice(0)
    body = MaterialPoints(domain, x[here], np.prod(spacing))
    edge = points.on_curve(domain, (end, 0.5), (end, 1.0), spacing=h / 5)
    if functions != "linear":
        for p in (body, edge):
            basis.use(p, functions, spacing / 2 if functions == "gimp" else None)
    fm.set_initial_state(body, 1.0)
    z, law = Unknown(domain, "u", "p"), NeoHookean(100.0, 0.5)
    if not is_free:
        z.fix("u", lambda x: np.isclose(x[0], 0))
    scheme = scheme(z, dt=dt)
    cells = ActiveCells(body, loads=[edge])
    R = fm.stabilized("cip", z, body, law, force=scheme.force(body), cells=cells)
    R += fm.dead_load(z.test.u, edge, (4.0, 1.0))
    newton = {"rtol": 1e-12}
    if way == "tying":
        newton["tying"] = Tying(z.space, body, cells)
    elif way == "ghost penalty":
        R += fm.ghost_penalty(z, cells, law)
    # linear functions are too soft without them
    corrected = [lambda sim, step: correct_weights(body, cells)] if functions == "linear" else []
    sim = ImplicitMPM(R, z, scheme, body, carried=[edge], newton=newton, observers=corrected)
    return body, edge, sim


def sees_more(edge, body):
    """Whether the edge sees nodes that the body does not."""
    space = fem.functionspace(body.mesh, ("Lagrange", 1))
    loads, volumes = (p2g(p, p.weight, space).array for p in (edge, body))
    return COMM.allreduce(bool(np.any((loads > 1e-9) & (volumes < 1e-15))), MPI.LOR)


@pytest.mark.mpi
@pytest.mark.parametrize(("functions", "end"), [("quadratic", 9.55), ("gimp", 9.95)])
def test_loads_at_the_edge(functions, end):
    """Nodes that the load sees, but no material: tied, by the ghost penalty, and linear ones."""
    moved = {}
    for way in ("tying", "ghost penalty"):
        for f in (functions, "linear"):
            body, edge, sim = pulled(f, end, way)
            assert sees_more(edge, body) == (f != "linear")
            for _ in sim.run(0.3):
                pass
            u = COMM.allreduce(edge.weight @ edge["u"]) / COMM.allreduce(edge.weight.sum())
            moved[way, f] = u
    exact = moved["tying", functions]
    assert np.all(exact > 0)
    for u in moved.values():
        assert u == pytest.approx(exact, rel=0.04)


@pytest.mark.mpi
@pytest.mark.parametrize("way", ["tying", "ghost penalty"])
@pytest.mark.parametrize(("functions", "end"), [("quadratic", 9.55), ("gimp", 9.95)])
def test_a_load_gives_its_impulse(functions, end, way):
    body, edge, sim = pulled(functions, end, way, scheme=fm.BDF2, is_free=True, dt=0.01)
    assert sees_more(edge, body)
    for _ in sim.run(0.05):
        impulse = 0.5 * sim.time * np.array([4.0, 1.0])
        assert diagnostics.momentum(body) == pytest.approx(impulse, rel=1e-8)


@pytest.mark.parametrize(("functions", "end"), [("quadratic", 9.55), ("gimp", 9.95)])
def test_a_load_at_the_edge_needs_one_of_the_remedies(functions, end):
    _, _, sim = pulled(functions, end, "none")
    with pytest.raises(NewtonError, match=r"load without material.* most at \(1.375, 0.75\)"):
        sim.step()


# --- stretch --------------------------------------------------------------------------------------


def stretched(steps, per_side, corrected):
    return moved_points.stretched("quadratic", corrected, steps, 8, per_side, QuasiStatic)


@pytest.mark.mpi
@pytest.mark.parametrize("steps", [20, 40])
def test_a_stretched_block(steps):
    """Splines need no corrected weights."""
    force, stretch, change = stretched(steps, per_side=6, corrected=False)
    assert force == pytest.approx(1, abs=0.005)
    assert stretch == pytest.approx(1.2, rel=1e-3)
    assert change < 0.005


@pytest.mark.mpi
@pytest.mark.parametrize("steps", [20, 40])
def test_a_stretched_block_with_corrected_weights(steps):
    """With them, it takes more points: weights jump where points go from cell to cell."""
    force, stretch, _ = stretched(steps, per_side=8, corrected=True)
    assert force == pytest.approx(1, abs=0.01)
    assert stretch == pytest.approx(1.2, rel=2e-3)


# --- loops ----------------------------------------------------------------------------------------

POINTER = types.CPointer(types.float64)


@cfunc(types.void(*[POINTER] * 7))
def copy_inputs(tensor, coefficients, inputs, coordinates, first, second, third):
    """A kernel that adds what it is given: the number of entries, then these."""
    for i in range(int(inputs[0])):
        tensor[i] += inputs[1 + i]


def slots(rng, lengths, per_component, averaged):
    """Table of slots of components on dofs one after the other, then averaged ones on the same."""
    start = np.cumsum([0, *lengths[:-1]])
    length, first = [], []
    for _ in range(1 + averaged):
        for n, s, k in zip(lengths, start, per_component, strict=True):
            length += [n] * k
            first += [s] * k
    column = rng.permutation(len(length))
    ends = np.cumsum([0, *np.array(length)[column]])
    begin = np.empty(len(length), dtype=np.int64)
    begin[column] = ends[:-1] + 3
    return ends[-1] + 5, begin, np.array(length), np.array(first)


@pytest.mark.parametrize(
    ("lengths", "per_component", "averaged"),
    [
        (((1,), (1,)), ((1,), (1,)), False),
        (((4,), (8,)), ((3,), (2,)), False),
        (((9, 9, 9), (9, 9, 9)), ((3, 3, 1), (3, 3, 4)), False),
        (((3, 3, 10), (5, 17)), ((2, 1, 3), (4, 1)), False),
        (((27, 27), (27, 27)), ((4, 1), (1, 2)), True),
        (((64, 7), (13,)), ((1, 4), (3,)), True),
    ],
)
def test_element_matrices_in_registers(lengths, per_component, averaged):
    """sum_p V_p B0^T D B1 by dense products, for tables of any size and blocks of zeros."""
    rng = np.random.default_rng(sum(map(sum, lengths)))
    offsets, n = groups_with_points()
    tables = []
    for sizes, many in zip(lengths, per_component, strict=True):
        width, *where = slots(rng, sizes, many, averaged)
        tables.append((rng.standard_normal((n, width)), *where))
    n0, n1 = (len(t[1]) for t in tables)
    D = rng.standard_normal((n, n0, n1))
    D[:, rng.random((n0, n1)) < 0.3] = 0.0  # couplings that there are not
    D[rng.random(n) < 0.1] = 0.0  # points without any
    D[:, n0 // 2, :] = 0.0
    compare_with_dense_products(rng, offsets, tables, D, False)


@pytest.mark.parametrize("averaged", [False, True])
@pytest.mark.parametrize("symmetric", [0, 1, 2, 3])
def test_symmetric_element_matrices(symmetric, averaged):
    """Pairs of components are mirrored only where D is symmetric there."""
    rng = np.random.default_rng(symmetric)
    offsets, n = groups_with_points()
    many = np.array([3, 3, 1])
    width, *where = slots(rng, (9, 12, 4), many, averaged)
    table = rng.standard_normal((n, width)), *where
    D = rng.standard_normal((n, len(where[0]), len(where[0])))
    D += D.transpose(0, 2, 1)
    ends = np.cumsum([0, *many])
    for first, second in [(0, 1), (0, 2), (1, 2)][symmetric:]:
        # one entry of one point is enough, even if only its sign is another one
        rows, columns = slice(ends[first], ends[first + 1]), slice(ends[second], ends[second + 1])
        D[rng.integers(n), rows, columns] *= -1.0
    compare_with_dense_products(rng, offsets, [table, table], D, True)


def groups_with_points():
    """Where the points of groups begin, after some of another batch; number of all points."""
    offsets = 5 + np.cumsum([0, 3, 0, 8, 1, 9, 17, 30])
    return offsets, offsets[-1]


def compare_with_dense_products(rng, offsets, tables, D, is_same):
    """Element matrices of two tables ``(basis, column, length, start)`` and D at each point."""
    n, n0, n1 = D.shape
    rows, weights = rng.permutation(n), rng.uniform(0.5, 1.5, n)
    inputs = [np.full(n, n0 * n1), D.transpose(0, 2, 1).reshape(n, n0 * n1)]
    inputs = np.ascontiguousarray(np.column_stack(inputs)[offsets[0] :])
    n_local = [np.max(start + length) for _, _, length, start in tables]
    result = np.full((len(offsets) - 1, *n_local), np.nan)
    matrix_loops.element_matrices(
        copy_inputs.address, offsets, weights, rows, inputs, is_same, *tables[0], *tables[1], result
    )
    factors = []
    for (table, column, length, start), size in zip(tables, n_local, strict=True):
        B = np.zeros((n, len(column), size))
        for s in range(len(column)):
            here = slice(start[s], start[s] + length[s])
            B[:, s, here] = table[rows][:, column[s] : column[s] + length[s]]
        factors.append(B)
    for i, group in enumerate(map(slice, offsets[:-1], offsets[1:])):
        B0, B1 = (B[group] for B in factors)
        terms = [weights[group], B0, D[group], B1]
        expected = np.einsum("p,psi,pst,ptj->ij", *terms, optimize=True)
        size = np.einsum("p,psi,pst,ptj->ij", *map(np.abs, terms), optimize=True).max(initial=1.0)
        assert result[i] == pytest.approx(expected, abs=1e-13 * size)


class Recorder:
    """What is inserted into a pattern."""

    def __init__(self):
        self.pairs, self.count = set(), 0

    def insert(self, rows, columns):
        self.pairs |= set(itertools.product(rows.tolist(), columns.tolist()))
        self.count += len(rows) * len(columns)


@pytest.mark.parametrize("n", [0, 1, 40])
def test_cliques(n):
    """Every pair once, also of lines in which blocks are repeated, as at walls."""
    rng = np.random.default_rng(n)
    rows = rng.integers(0, 20, (n, 5)).astype(np.int32)
    columns = rng.integers(0, 30, (n, 7)).astype(np.int32)
    rows[:, 4] = rows[:, 0]
    columns[:, 6] = 31 + columns[:, 0]  # always together
    pattern = Recorder()
    assembly._insert_cliques(pattern, rows, columns)
    expected = set()
    for one, other in zip(rows.tolist(), columns.tolist(), strict=True):
        expected |= set(itertools.product(one, other))
    assert pattern.pairs == expected
    assert pattern.count == len(expected)


@pytest.mark.parametrize("compact", [True, False])
@pytest.mark.parametrize("name", ["quadratic", "cubic", "gimp"])
def test_patterns_of_mixed_spaces(name, compact):
    """All dofs of all nodes that points of a group see meet, and those of two cells at facets."""
    shape = np.array((6, 5))
    body = some_points(2, name, shape)
    z, law = Unknown(body.mesh, "u", "p"), NeoHookean(3 * MU, 0.5)
    cells = ActiveCells(body)
    R = fm.mixed(z, body, law) + fm.interior_penalty(z, cells, law)
    A = forms.create_matrix(tangent(R, z), compact=compact)
    lines = zip(A.indptr[:-1], A.indptr[1:], strict=True)
    found = {(i, j) for i, (a, b) in enumerate(lines) for j in A.indices[a:b].tolist()}

    # nodes by their numbers on the lattice; of groups around nodes or of cells
    t = numbers(body.mesh, shape, body.x)
    first, width = {
        "quadratic": (np.rint(t) - 1, 3),
        "gimp": (np.rint(t) - 1, 3),
        "cubic": (np.floor(t) - 1, 4),
    }[name]
    if not compact:
        ends = shape + (0 if name == "cubic" else 1)
        first = np.array(list(itertools.product(*map(range, ends)))) - 1
    cliques = [
        [np.clip(f + s, 0, shape) for s in itertools.product(range(width), repeat=2)]
        for f in np.unique(first.astype(int), axis=0)
    ]
    active = np.argwhere(expected_cells(body, shape, name))
    for cell, axis in itertools.product(active, (0, 1)):
        other = cell + np.eye(2, dtype=int)[axis]
        if np.any(np.all(active == other, axis=1)):
            pair = itertools.product((cell, other), itertools.product((0, 1), repeat=2))
            cliques.append([c + corner for c, corner in pair])
    V = z.part_space("p")
    where = np.rint(numbers(body.mesh, shape, V.tabulate_dof_coordinates())).astype(int)
    at_node = {tuple(node): [] for node in where.tolist()}
    for part in (z.space.sub(0).sub(0), z.space.sub(0).sub(1), z.space.sub(1)):
        scalar, dofs = _compat.collapsed(part)
        x = np.rint(numbers(body.mesh, shape, scalar.tabulate_dof_coordinates())).astype(int)
        for node, dof in zip(x.tolist(), dofs, strict=True):
            at_node[tuple(node)].append(int(dof))
    expected = {(i, i) for i in range(len(z.U.x.array))}
    for clique in cliques:
        members = [d for node in {tuple(map(int, c)) for c in clique} for d in at_node[node]]
        expected |= set(itertools.product(members, members))
    assert found == expected


# --- whole runs -----------------------------------------------------------------------------------


def leaving(comm=COMM, functions="quadratic"):
    """Two blocks that touch and fly out of the mesh, pulled at the rim of one of them."""
    domain = rectangle((2, 2), (8, 8), comm)
    bodies = []
    for side in (1, -1):
        body = points.lattice(
            domain, 0.0625,
            inside=lambda x, s=side: (abs(x[1] - 1) < 0.45)
            & (x[0] > 1.3) & (s * (x[1] - 1.03) > 0),
        )  # fmt: skip
        fm.set_initial_state(body, 1.0, velocity=(2.0, 0.3))
        bodies.append(body)
    edge = points.on_curve(domain, (1.28, 1.1), (1.28, 1.4), spacing=0.05)
    for p in (*bodies, edge):
        basis.use(p, functions, *([0.03125] if functions == "gimp" else []))
    z, law = Unknown(domain, "u", "p"), NeoHookean(100.0, 0.5)
    scheme = Bossak(z, dt=0.02)
    cells = ActiveCells(*bodies, loads=[edge])
    R = fm.interior_penalty(z, cells, law) + fm.dead_load(z.test.u, edge, (-1.0, 0.0))
    R += sum(fm.mixed(z, body, law, force=scheme.force(body)) for body in bodies)
    newton = {"rtol": 1e-12, "tying": Tying(z.space, bodies, cells)}
    newton["petsc_options"] = {"pc_type": "lu", "pc_factor_mat_solver_type": "mumps"}
    return ImplicitMPM(R, z, scheme, bodies, carried=[edge], newton=newton, on_exit="delete")


@pytest.mark.ranks
@pytest.mark.mpi
@pytest.mark.parametrize("functions", ["quadratic", "gimp"])
def test_goes_on_bit_by_bit_while_points_leave(tmp_path, functions):
    path = COMM.bcast(tmp_path) / "splines.h5"
    sim, again = leaving(functions=functions), leaving(functions=functions)
    removed = [sim.step((0.02, 0.01)[k % 2]).removed for k in range(3)]
    checkpoint.save(path, sim)
    checkpoint.restore(path, again)
    gone = []
    for k in range(5):
        lost = [s.step((0.01, 0.02)[k % 2]).removed for s in (sim, again)]
        assert lost[0] == lost[1]
        gone.append(lost[0])
    assert sum(removed) + sum(gone) > 20 and max(gone) > 0
    for one, other in zip(
        (*sim.bodies, *sim.carried), (*again.bodies, *again.carried), strict=True
    ):
        for name, array in one.snapshot().items():
            assert np.array_equal(other[name], array), name


@pytest.mark.mpi
@pytest.mark.parametrize("functions", ["quadratic", "gimp"])
def test_bodies_that_touch_fly_as_one(functions):
    """Two bodies that share cells, with one set of active cells, and the same as one body."""

    def flight(sides):
        domain = rectangle((3, 2), (18, 12))
        bodies = []
        for side in sides:
            body = points.lattice(
                domain, 0.5 / 12,
                inside=lambda x, s=side: (np.abs(x[:2] - 0.8).max(axis=0) < 0.4)
                & (s * (x[0] + x[1] / 3 - 1.1) >= 0),
            )  # fmt: skip
            basis.use(body, functions, *([0.5 / 24] if functions == "gimp" else []))
            fm.set_initial_state(body, 2.0, lambda x: np.array([1 - 2 * x[1], 2 * x[0] - 1]))
            bodies.append(body)
        z, law = Unknown(domain, "u", "p"), NeoHookean(300.0, 0.5)
        scheme = Bossak(z, dt=0.02)
        cells = ActiveCells(*bodies)
        R = sum(fm.mixed(z, body, law, force=scheme.force(body)) for body in bodies)
        R += fm.interior_penalty(z, cells, law)
        newton = {"rtol": 1e-12, "tying": Tying(z.space, bodies, cells)}
        sim = ImplicitMPM(R, z, scheme, bodies, newton=newton)
        for _ in range(4):
            sim.step()
        order = np.concatenate([by_id(b, b.x - b["u"]) for b in bodies])
        result = np.concatenate([by_id(b, np.column_stack([b.x, b["v"]])) for b in bodies])
        return result[np.lexsort(np.round(order, 9).T)]

    apart, whole = flight((1, -1)), flight((0,))
    assert apart == pytest.approx(whole, abs=1e-8)


# --- bad input ------------------------------------------------------------------------------------


def small(functions="quadratic"):
    domain = rectangle((1, 1), (4, 4), MPI.COMM_SELF)
    body = points.fill(domain, 2)
    if functions != "linear":
        basis.use(body, functions, 1 / 16 if functions == "gimp" else None)
    fm.set_initial_state(body, 1.0)
    return body, Unknown(domain, "u", "p"), NeoHookean(3.0, 0.5)


def test_splines_are_for_lattices():
    body = points.fill(mesh.create_unit_square(MPI.COMM_SELF, 2, 2), 1)
    with pytest.raises(ValueError, match=r"axis-parallel boxes .* not one of triangles"):
        basis.use(body, "quadratic")
    with pytest.raises(ValueError, match="need half_size"):
        basis.use(points.fill(rectangle((1, 1), (2, 2), MPI.COMM_SELF), 1), "gimp")


@pytest.mark.parametrize("functions", ["quadratic", "cubic", "gimp"])
@pytest.mark.parametrize("name", ["asgs", "osgs"])
def test_residuals_of_smooth_functions(name, functions):
    body, z, law = small(functions)
    with pytest.raises(ValueError, match=rf'linear functions only, not for {functions} .* "cip"'):
        fm.stabilized(name, z, body, law)


def test_interior_penalty_needs_cells_and_a_factor():
    body, z, law = small()
    with pytest.raises(ValueError, match=r"give ActiveCells\(body, loads=\[..\]\), not None"):
        fm.stabilized("cip", z, body, law)
    cells = ActiveCells(body)
    for gamma in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(ValueError, match=f"must be positive and finite: gamma = {gamma}"):
            fm.interior_penalty(z, cells, law, gamma=gamma)
        with pytest.raises(ValueError, match=f"must be positive and finite: gamma = {gamma}"):
            fm.hessian_penalty(z, body, law, gamma=gamma)
    quadratic = Unknown(body.mesh, "u", "p", degree=2)
    with pytest.raises(ValueError, match="the interior penalty needs continuous linear"):
        fm.interior_penalty(quadratic, cells, law)
    with pytest.raises(ValueError, match=r"'cipp': use one of none, .*cip"):
        fm.stabilized("cipp", z, body, law)


def test_unknowns_without_pressure():
    body, _, law = small()
    z = Unknown(body.mesh, "u")
    cells = ActiveCells(body)
    with pytest.raises(ValueError, match=r"the interior penalty needs the part p .* which has u"):
        fm.interior_penalty(z, cells, law)
    with pytest.raises(ValueError, match=r"second derivatives needs the part p .* which has u"):
        fm.hessian_penalty(z, body, law)
    with pytest.raises(ValueError, match=r"split OSGS needs the parts u, p .* which has u"):
        fm.split_osgs(z, body, law)
    for name in SMOOTH:
        with pytest.raises(ValueError, match=r"needs the parts u, p .* which has u"):
            fm.stabilized(name, z, body, law, cells=cells)


@pytest.mark.parametrize("functions", ["linear", "gimp"])
def test_second_derivatives_that_there_are_not(functions):
    body, z, law = small(functions)
    message = rf"needs splines, .* not {functions} functions"
    with pytest.raises(ValueError, match=message):
        fm.stabilized("hessian", z, body, law)
    if functions == "gimp":
        fields = body.field_names
        with pytest.raises(ValueError, match=r"stabilization \(alpha > 0\) " + message):
            fm.MixedEnergyMomentum(law, body, z)
        assert body.field_names == fields
        fm.MixedEnergyMomentum(law, body, z, alpha=0)
        assert "r" not in body


def test_inertia_twice():
    body, z, _ = small()
    scheme = fm.BDF2(z, dt=0.1)
    water = fm.NewtonianFlow(1e-3, 1.0, scheme)
    cells = ActiveCells(body)
    for name in SMOOTH:
        with pytest.raises(ValueError, match="inertia"):
            fm.stabilized(name, z, body, water, scheme=scheme, cells=cells)


@pytest.mark.parametrize("is_told", [False, True])
def test_a_load_far_from_the_body(is_told):
    """Splines of a body do not reach it, nor does the ghost penalty of cells that are far apart."""
    domain = rectangle((3, 1), (12, 4), MPI.COMM_SELF)
    body = points.fill(domain, 2, inside=lambda x: x[0] < 1)
    edge = points.on_curve(domain, (2.55, 0.4), (2.55, 0.5), spacing=0.1)
    for p in (body, edge):
        basis.use(p, "quadratic")
    fm.set_initial_state(body, 1.0)
    cells = ActiveCells(body, loads=[edge] if is_told else [])
    z, law = Unknown(domain, "u", "p"), NeoHookean(1e3, 0.3)
    z.fix("u", lambda x: np.isclose(x[0], 0))
    scheme = Bossak(z, dt=0.01)
    R = fm.stabilized("cip", z, body, law, force=scheme.force(body), cells=cells)
    R += fm.dead_load(z.test.u, edge, (1.0, 0.0)) + fm.ghost_penalty(z, cells, law)
    sim = ImplicitMPM(R, z, scheme, body, carried=[edge])
    before = body.snapshot()
    error, message = NewtonError, r"load without material.* most at \(2.5, 0.5\)"
    if is_told:
        error, message = ValueError, r"a load at \(2.55, 0.4\d*\) m is too far from the bodies"
    with pytest.raises(error, match=message):
        sim.step()
    for name, array in before.items():
        assert np.array_equal(body[name], array), name
