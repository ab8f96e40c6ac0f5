# SPDX-License-Identifier: MIT
"""Newton's method, load steps and linear solvers: right answers, and errors that say why."""

import gc
import logging
import math
import weakref

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh

from fenicsmpm import ImplicitMPM, forms, formulations, points
from fenicsmpm.cells import ActiveCells
from fenicsmpm.formulations import Unknown
from fenicsmpm.materials import Hencky, NeoHookean
from fenicsmpm.solvers import (
    LinearSolver,
    LinearSolverError,
    NewtonError,
    NewtonSolver,
    solve_in_load_steps,
)

pytestmark = pytest.mark.ranks


class Cubic:
    """u^3 - c = 0 at every dof by a lumped form: Newton's steps are known by hand."""

    def __init__(self, c=8.0, start=1.0, **options):
        self.domain = mesh.create_unit_square(MPI.COMM_WORLD, 3, 3)
        self.body = points.quadrature(self.domain, 2)
        V = fem.functionspace(self.domain, ("DG", 0))
        self.u = fem.Function(V)
        self.u.x.array[:] = start
        self.c = fem.Constant(self.domain, float(c))
        v = ufl.TestFunction(V)
        R = (self.u**3 - self.c) * v * self.body.dx
        self.solver = NewtonSolver(R, self.u, **options)


class Cantilever:
    """A clamped block, stretched or sheared by its right edge."""

    def __init__(self, n=4, stabilization="asgs", nu=0.5, E=1.0, **options):
        self.domain = mesh.create_unit_square(MPI.COMM_WORLD, n, n)
        self.body = points.quadrature(self.domain, 2)
        self.z = z = Unknown(self.domain, "u", "p")
        self.right = fem.Function(z.part_space("u"))
        z.fix("u", lambda x: np.isclose(x[0], 0))
        z.fix("u", lambda x: np.isclose(x[0], 1), self.right)
        law = NeoHookean(E=E, nu=nu)
        self.R = formulations.stabilized(stabilization, z, self.body, law)
        self.solver = NewtonSolver(self.R, z.U, z.bcs, **options)

    def pull(self, factor):
        self.right.interpolate(lambda x: factor * np.array([np.full_like(x[0], 0.5), 0 * x[0]]))


@pytest.mark.mpi
def test_newton_by_hand():
    problem = Cubic(rtol=1e-13)
    result = problem.solver.solve()
    u, residuals = 1.0, []
    area = np.sqrt(18) / 18  # norm of 18 equal entries, one a cell
    for _ in range(result.iterations + 1):
        residuals.append(abs(u**3 - 8) * area)
        u -= (u**3 - 8) / (3 * u**2)
    assert result.residuals == pytest.approx(residuals, rel=1e-6, abs=1e-11)
    assert problem.u.x.array == pytest.approx(2.0, rel=1e-12)
    assert result.step_lengths == [1.0] * result.iterations


def test_line_search_cuts_steps():
    # from 0.1 the first full step leads to 266.7 and a residual 2e6 times as large
    problem = Cubic(start=0.1, line_search=True, max_iterations=60)
    result = problem.solver.solve()
    assert problem.u.x.array == pytest.approx(2.0, rel=1e-8)
    assert min(result.step_lengths) < 0.1
    assert np.all(np.diff(result.residuals) < 0)


@pytest.mark.mpi
def test_a_tangent_that_is_kept():
    kept, new = (Cubic(start=1.9, keep_tangent=share) for share in (0.5, 0.0))
    few, all_of_them = (problem.solver.solve() for problem in (kept, new))
    assert few.tangents < few.iterations
    assert all_of_them.tangents == all_of_them.iterations < few.iterations
    for problem in (kept, new):
        assert problem.u.x.array == pytest.approx(2.0, rel=1e-8)
    for share in (1.0, -0.1):
        with pytest.raises(ValueError, match="keep_tangent"):
            Cubic(keep_tangent=share)


@pytest.mark.mpi
def test_divergence_leaves_the_state():
    problem = Cubic(start=0.1, max_iterations=3)
    with pytest.raises(NewtonError, match=r"diverged: .* after 3 iterations") as caught:
        problem.solver.solve()
    assert caught.value.reason == "diverged"
    assert len(caught.value.residuals) == 4
    assert np.all(problem.u.x.array == 0.1)


@pytest.mark.mpi
def test_not_finite_names_the_point():
    problem = Cantilever()
    problem.z.U.sub(0).interpolate(lambda x: np.array([-2 * x[0], 0 * x[1]]))  # inverted
    before = problem.z.U.x.array.copy()
    with pytest.raises(
        NewtonError, match=r"not finite: .* point \d+ in cell \d+ on rank"
    ) as caught:
        problem.solver.solve()
    assert caught.value.reason == "not finite"
    assert "determinant <= 0" in str(caught.value)
    assert np.array_equal(problem.z.U.x.array, before)


@pytest.mark.mpi
def test_singular_matrix_is_reported():
    problem = Cantilever(stabilization="asgs")
    problem.solver.bcs = []  # free in space
    problem.solver.linear = LinearSolver(
        problem.domain.comm, {"pc_factor_mat_solver_type": "mumps", "mat_mumps_icntl_24": 0}
    )
    z = problem.z
    flat = forms.form(
        fem.Constant(problem.domain, 0.0)
        * ufl.inner(z.V, ufl.TrialFunction(z.space))
        * problem.body.dx
    )
    A = forms.petsc.assemble_matrix(flat)
    x, b = A.createVecs()
    b.set(1.0)
    with pytest.raises(LinearSolverError, match="may be singular"):
        problem.solver.linear.solve(A, b, x)


ITERATIONS = {"ksp_type": "gmres", "pc_type": "bjacobi", "sub_pc_type": "ilu"}
EDGE = lambda x: np.isclose(x[0], 0) & np.isclose(x[1], 0)  # noqa: E731
HOLDS = {  # dimension, what is held and its component, and the motions that are left
    "nothing": (2, None, None, "move along x, move along y, turn about z"),
    "rollers": (2, lambda x: np.isclose(x[1], 0), 1, "move along x"),
    "a node": (2, EDGE, None, r"turn about \(0, 0\)"),
    "nothing in space": (
        3, None, None,
        "move along x, move along y, move along z, turn about x, turn about y, turn about z",
    ),
    "a plate": (3, lambda x: np.isclose(x[2], 0), 2, "move along x, move along y, turn about z"),
    "a hinge": (3, EDGE, None, r"turn about an axis along \(0, 0, 1\) through \(0, 0, "),
}  # fmt: skip


@pytest.mark.mpi
@pytest.mark.parametrize("options", [None, ITERATIONS], ids=["direct", "Krylov"])
@pytest.mark.parametrize("held", HOLDS)
def test_a_body_without_supports(held, options):
    """Round-off would move it by 1e14 m; a load step is not halved in vain."""
    dim, where, component, motions = HOLDS[held]
    make = mesh.create_unit_square if dim == 2 else mesh.create_unit_cube
    domain = make(MPI.COMM_WORLD, *[3] * dim)
    body = points.fill(domain, 2, inside=lambda x: x[1] < 0.7)
    formulations.set_initial_state(body, 1.0)
    z = Unknown(domain, "u")
    if where is not None:
        z.fix("u", where, component=component)
    P = formulations.Response(Hencky(E=1e3, nu=0.3), body, formulations.Kinematics(z.u, body).F).P
    R = formulations.stress_power(P, z.test.u, body)
    R += formulations.body_force(z.test.u, body, (1.0, -2.0, 3.0)[:dim])
    scheme, newton = formulations.QuasiStatic(z, dt=1.0), {"petsc_options": options}
    sim = ImplicitMPM(R, z, scheme, body, newton=newton)
    with pytest.raises(NewtonError, match=f"nothing holds the body, which can {motions}") as caught:
        next(sim.run(1.0))
    assert caught.value.reason == "no support"
    assert np.all(z.U.x.array == 0.0) and sim.next_dt == 1.0


@pytest.mark.mpi
@pytest.mark.parametrize("options", [None, ITERATIONS], ids=["direct", "Krylov"])
@pytest.mark.parametrize("dim", [2, 3])
def test_a_piece_without_supports(dim, options):
    """One half of the points is held, the other one floats above it."""
    make = mesh.create_unit_square if dim == 2 else mesh.create_unit_cube
    domain = make(MPI.COMM_WORLD, *[4] * dim)
    body = points.fill(domain, 2, inside=lambda x: (x[1] < 0.25) | (x[1] > 0.75))
    formulations.set_initial_state(body, 1.0)
    z = Unknown(domain, "u", "p")
    z.fix("u", lambda x: np.isclose(x[1], 0))
    scheme = formulations.QuasiStatic(z, dt=1.0)
    force = scheme.force(body, (0.0, -1.0, 0.0)[:dim])
    R = formulations.stabilized("asgs", z, body, NeoHookean(100.0, 0.5), force=force)
    sim = ImplicitMPM(R, z, scheme, body, newton={"petsc_options": options})
    around = r"the piece of material around \(0.5, 0.875(, 0.5)?\), which can move along x, move"
    with pytest.raises(NewtonError, match=around) as caught:
        next(sim.run(1.0))
    assert caught.value.reason == "no support"


@pytest.mark.mpi
@pytest.mark.parametrize(("E", "rho", "side"), [(210e9, 7850.0, 0.01), (1e6, 1000.0, 5e-6)])
def test_weak_inertia_holds_a_body(E, rho, side):
    """Free fall in thousands of wave times a step, and of a cube that weighs 1e-12 N."""
    domain = mesh.create_box(MPI.COMM_WORLD, [[0, 0, -4 * side], [2 * side] * 3], [2, 2, 6])
    body = points.fill(domain, 2, inside=lambda x: np.all(np.abs(x - 1.5 * side) < side / 2, 0))
    formulations.set_initial_state(body, rho)
    z = Unknown(domain, "u")
    scheme = formulations.Newmark(z, dt=0.01 * math.sqrt(side / 0.01))
    P = formulations.Response(Hencky(E, 0.3), body, formulations.Kinematics(z.u, body).F).P
    R = formulations.stress_power(P, z.test.u, body)
    R -= ufl.inner(scheme.force(body, (0, 0, -9.81)), z.test.u) * body.dx
    sim = ImplicitMPM(R, z, scheme, body)
    for _ in sim.run(3 * sim.next_dt):
        pass
    assert body["v"][:, 2] == pytest.approx(-9.81 * sim.time, rel=1e-7)


@pytest.mark.mpi
def test_linear_failure_becomes_a_newton_error():
    problem = Cubic(start=0.0)  # the tangent 3 u^2 is zero
    with pytest.raises(NewtonError, match="linear solver") as caught:
        problem.solver.solve()
    assert caught.value.reason == "linear solver"
    assert np.all(problem.u.x.array == 0.0)
    problem.u.x.array[:] = 1.0  # and the solver is still good
    problem.solver.solve()
    assert problem.u.x.array == pytest.approx(2.0)


@pytest.mark.mpi
@pytest.mark.parametrize("stabilization", ["asgs", "osgs"])
def test_prescribed_displacement(stabilization):
    problem = Cantilever(stabilization=stabilization)
    problem.pull(0.2)
    result = problem.solver.solve()
    assert result.iterations <= 5
    volume = forms.assemble_scalar(
        forms.form(formulations.Kinematics(problem.z.u, problem.body).j * problem.body.dx)
    )
    assert volume == pytest.approx(1.0, abs=2e-3)
    reached = np.zeros(len(problem.z.U.x.array))
    for bc in problem.z.bcs:
        bc.set(reached)
        dofs = bc.dof_indices()[0]
        assert problem.z.U.x.array[dofs] == pytest.approx(reached[dofs], abs=1e-14)
    # solved again from the solution: factors leave nothing to do, iterations more than round-off
    assert problem.solver.solve().iterations <= (stabilization == "osgs")


def test_load_steps_get_where_one_step_fails():
    problem = Cantilever(n=6, max_iterations=5)
    problem.pull(3.0)
    with pytest.raises(NewtonError):
        problem.solver.solve()
    results = solve_in_load_steps(problem.solver, lambda s: problem.pull(3 * s))
    assert len(results) > 1
    assert problem.z.U.x.array[problem.z.bcs[1].dof_indices()[0]].max() == pytest.approx(1.5)
    with pytest.raises(ValueError, match="first load step"):
        solve_in_load_steps(problem.solver, problem.pull, first=2.0)


def test_load_steps_give_up():
    problem = Cantilever(max_iterations=10)
    with pytest.raises(NewtonError):
        # pushed through its own clamp
        solve_in_load_steps(problem.solver, lambda s: problem.pull(-2.2 * s), smallest=0.05)
    assert np.all(np.isfinite(problem.z.U.x.array))
    assert problem.right.x.array.min() > -1.0  # the last load that was reached


@pytest.mark.mpi
def test_a_new_solver_buries_dead_ones():
    """Otherwise MPI runs out of communicators after some hundred of them on several ranks."""
    problem = Cubic()
    problem.solver.solve()
    matrix = weakref.ref(problem.solver._A.getAttr("fenicsmpm_work"))
    assert matrix() is not None
    del problem
    gc.collect()
    LinearSolver(MPI.COMM_WORLD)
    gc.collect()
    assert matrix() is None


def test_options_reach_petsc():
    PETSc.Options()["mine_ksp_rtol"] = 1e-3
    solver = LinearSolver(
        MPI.COMM_WORLD, {"ksp_type": "gmres", "pc_type": "jacobi", "ksp_rtol": 1e-9}, prefix="mine_"
    )
    assert solver.ksp.getType() == "gmres"
    assert solver.ksp.getPC().getType() == "jacobi"
    assert solver.ksp.getTolerances()[0] == 1e-3  # the command line has the last word
    default = LinearSolver(MPI.COMM_WORLD)
    assert default.ksp.getType() == "preonly"
    assert default.ksp.getPC().getFactorSolverType() == "mumps"
    PETSc.Options().delValue("mine_ksp_rtol")


@pytest.mark.parametrize("failures, tries, workspace", [(0, 1, 100), (1, 2, 200), (9, 4, 800)])
def test_mumps_gets_more_workspace(failures, tries, workspace, monkeypatch):
    """Twice as much at each failure for want of it, up to tenfold."""
    solver = LinearSolver(MPI.COMM_SELF)
    A = PETSc.Mat().createAIJ((2, 2), nnz=1, comm=MPI.COMM_SELF)
    for i in range(2):
        A[i, i] = 2.0
    A.assemble()
    x, b = A.createVecs()
    b.set(1.0)
    once, seen = solver._try, []

    def fail(*arguments):
        seen.append(solver._options.getInt("mat_mumps_icntl_14"))
        reason = once(*arguments)
        return -11 if len(seen) <= failures else reason

    monkeypatch.setattr(solver, "_try", fail)
    monkeypatch.setattr(solver, "_mumps_wants_memory", lambda: True)
    if failures == 9:
        with pytest.raises(LinearSolverError, match="linear solver failed"):
            solver.solve(A, b, x)
    else:
        solver.solve(A, b, x)
        assert x.array == pytest.approx(0.5)
    assert len(seen) == tries and seen[-1] == workspace


def test_a_line_an_iteration(said):
    logger = logging.getLogger("fenicsmpm")
    before = logger.level
    logger.setLevel(logging.INFO)
    try:
        result = Cubic().solver.solve()
    finally:
        logger.setLevel(before)
    assert "|R|" in said[0]
    assert len(said) == result.iterations + 2
    assert said[-1].split()[0] == str(result.iterations)


@pytest.mark.mpi
def test_large_moduli_and_small_changes():
    """Residuals of 1e-5 N are round-off where forces are 1e10 N; small motions are motions."""
    problem = Cantilever(stabilization="ppp", E=2e11)
    problem.pull(0.1)
    problem.solver.solve()
    # solved already: a new start from the solution must not ask for less than round-off
    again = NewtonSolver(problem.R, problem.z.U, problem.z.bcs)
    assert again.solve().iterations <= 2
    for change in (1e-4, 1e-6):
        problem.pull(0.1 + change)
        result = problem.solver.solve()
        assert 1 <= result.iterations <= 4
        moved = problem.z.U.x.array[problem.z.bcs[1].dof_indices()[0]]
        reached = max(problem.domain.comm.allgather(np.max(moved, initial=0.0)))
        assert reached == pytest.approx(0.05 + change / 2, rel=1e-13)


@pytest.mark.mpi
def test_driven_wall_without_material():
    domain = mesh.create_unit_square(MPI.COMM_WORLD, 6, 6)
    body = points.quadrature(domain, 2, inside=lambda x: x[0] > 0.5)
    V = fem.functionspace(domain, ("Lagrange", 1))
    u, v = fem.Function(V), ufl.TestFunction(V)
    dofs = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[0], 0.0))
    bc = fem.dirichletbc(fem.Constant(domain, 2.0), dofs, V)
    R = (ufl.inner(ufl.grad(u), ufl.grad(v)) + u * v) * body.dx
    NewtonSolver(R, u, [bc]).solve()
    assert u.x.array[dofs] == pytest.approx(2.0)
    assert np.sum(u.x.array != 0.0) == len(dofs)


@pytest.mark.mpi
def test_load_without_material():
    """What carries no load has no tangent: no number of iterations would reduce its residual."""
    domain = mesh.create_rectangle(MPI.COMM_WORLD, [(0, 0), (3, 1)], [12, 4])
    body = points.quadrature(domain, 2, inside=lambda x: x[0] < 1)
    z = Unknown(domain, "u", "p")
    z.fix("u", lambda x: np.isclose(x[0], 0))
    law = NeoHookean(E=1e3, nu=0.3)
    R = formulations.stabilized("asgs", z, body, law)

    def load(x, size=1.0):
        edge = points.on_curve(domain, (x, 0.4), (x, 0.5), spacing=0.1)
        return formulations.dead_load(z.test.u, edge, (size, 0.0))

    # one on the facet of the last cells with material is no problem, nor is one of round-off size
    supported = R + load(1.0)
    NewtonSolver(supported + load(2.6, size=1e-13), z.U, z.bcs).solve()
    solution = z.U.x.array.copy()
    message = r"load without material: \|R\| = .* most at \(2\.5, 0\.5\); give ActiveCells"
    with pytest.raises(NewtonError, match=message) as caught:
        NewtonSolver(supported + load(2.55), z.U, z.bcs).solve()
    assert caught.value.reason == "load without material"
    assert np.array_equal(z.U.x.array, solution)
    # with a way to the body
    edge = points.on_curve(domain, (1.3, 0.4), (1.3, 0.5), spacing=0.1)
    R += formulations.dead_load(z.test.u, edge, (1.0, 0.0))
    with pytest.raises(NewtonError, match="load without material"):
        NewtonSolver(R, z.U, z.bcs).solve()
    R += formulations.ghost_penalty(z, ActiveCells(body, loads=[edge]), law)
    NewtonSolver(R, z.U, z.bcs).solve()


def test_condition_on_another_space():
    problem = Cubic()
    twin = fem.functionspace(problem.domain, ("DG", 0))
    problem.solver.bcs = [fem.dirichletbc(1.0, np.array([0], dtype=np.int32), twin)]
    with pytest.raises(ValueError, match="another function space"):
        problem.solver.solve()


@pytest.mark.mpi
def test_load_steps_of_a_linear_problem():
    """The continuation of a linear path is exact up to round-off, whatever the modulus."""
    domain = mesh.create_unit_square(MPI.COMM_WORLD, 4, 4)
    body = points.quadrature(domain, 2)
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    u, v = fem.Function(V), ufl.TestFunction(V)
    E, load = 2e11, fem.Constant(domain, 0.0)
    R = E * ufl.inner(ufl.sym(ufl.grad(u)), ufl.grad(v)) * body.dx
    R -= 1e9 * load * v[1] * body.dx
    dofs = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[0], 0.0))
    solver = NewtonSolver(R, u, [fem.dirichletbc(np.zeros(2), dofs, V)])

    def set_load(factor):
        load.value = factor

    steps = solve_in_load_steps(solver, set_load, first=0.25)
    # 0.25, 0.75, 1: the continuation leaves nothing but round-off
    assert [step.iterations for step in steps] == [1, 0, 0]
    assert steps[-1].residuals[0] < 1e-13 * 1e9


def test_dirichlet_condition_on_nothing():
    problem = Cantilever()
    nowhere = [np.empty(0, dtype=np.int32)] * 2
    part = problem.z.space.sub(0)
    problem.solver.bcs = [fem.dirichletbc(problem.right, nowhere, part)]
    with pytest.raises(ValueError, match="on no degrees of freedom"):
        problem.solver.solve()


def column_in_equilibrium():
    """Residual, unknown and supports of 10 m of soil with exact stresses, on rollers."""
    domain = mesh.create_rectangle(
        MPI.COMM_SELF, [(0, 0), (4, 12)], (8, 24), mesh.CellType.quadrilateral
    )
    body = points.lattice(domain, 0.25, inside=lambda x: x[1] < 10.0)
    weight = 2000.0 * 9.81  # N/m^3
    stress = np.zeros((len(body), 2, 2))
    stress[:, 1, 1] = weight * (body.x[:, 1] - 10.0)
    stress[:, 0, 0] = 0.43 * stress[:, 1, 1]
    body.add_field("stress", (2, 2))
    body["stress"] = stress
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    u, v = fem.Function(V), ufl.TestFunction(V)
    strain = ufl.sym(ufl.grad(u))
    sigma = body.field("stress") + 5e7 * (ufl.tr(strain) * ufl.Identity(2) + strain)
    R = (ufl.inner(sigma, ufl.grad(v)) + weight * v[1]) * body.dx
    bcs = []
    for k, at_wall in enumerate(
        [lambda x: np.isclose(x[0] % 4.0, 0.0), lambda x: np.isclose(x[1], 0.0)]
    ):
        facets = mesh.locate_entities_boundary(domain, 1, at_wall)
        dofs = fem.locate_dofs_topological(V.sub(k), 1, facets)
        bcs.append(fem.dirichletbc(0.0, dofs, V.sub(k)))
    return R, u, bcs


def test_exact_equilibrium_has_converged():
    """The residual is round-off of 1e4 to 1e5 N, and no step could reduce it."""
    R, u, bcs = column_in_equilibrium()
    result = NewtonSolver(R, u, bcs).solve()
    assert result.iterations == 0
    assert 0.0 < result.residuals[0] < 1e-6
    assert not u.x.array.any()


@pytest.mark.parametrize("line_search", [False, True])
def test_a_residual_of_round_off_stops_the_method(line_search):
    """No tolerance below round-off keeps it from its end."""
    R, u, bcs = column_in_equilibrium()
    load = fem.Constant(u.function_space.mesh, 1.0)
    v = R.arguments()[0]
    R -= load * v[1] * R.integrals()[0].subdomain_data().dx
    solver = NewtonSolver(R, u, bcs, rtol=1e-30, line_search=line_search)
    result = solver.solve()
    assert result.iterations <= 4
    assert result.residuals[-1] < 1e-6


@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e9])
def test_forces_of_any_size_are_balanced(unit):
    """The solution of a linear problem does not depend on the unit of force."""
    domain = mesh.create_unit_square(MPI.COMM_WORLD, 4, 4)
    body = points.quadrature(domain, 2)
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    u, v = fem.Function(V), ufl.TestFunction(V)
    R = unit * (ufl.inner(ufl.sym(ufl.grad(u)), ufl.grad(v)) - 1e-6 * v[1]) * body.dx
    dofs = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[0], 0.0))
    bcs = [fem.dirichletbc(np.zeros(2), dofs, V)]
    assert NewtonSolver(R, u, bcs).solve().iterations == 1
    w = ufl.TrialFunction(V)
    a, L = ufl.inner(ufl.sym(ufl.grad(w)), ufl.grad(v)) * ufl.dx, 1e-6 * v[1] * ufl.dx
    A = fem.assemble_matrix(fem.form(a), bcs).to_dense()
    b = fem.assemble_vector(fem.form(L)).array
    b[dofs[:, None] * 2 + np.arange(2)] = 0.0
    assert u.x.array == pytest.approx(np.linalg.solve(A, b), abs=1e-17)
