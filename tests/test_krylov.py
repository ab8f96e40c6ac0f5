# SPDX-License-Identifier: MIT
"""Linear solvers are chosen by the problem, and none gives a wrong answer."""

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import pytest
import ufl
from dolfinx import mesh

from fenicsmpm import ImplicitMPM, io, points
from fenicsmpm import formulations as fm
from fenicsmpm.cells import ActiveCells, Tying
from fenicsmpm.materials import NeoHookean
from fenicsmpm.solvers import LinearSolver, LinearSolverError, NewtonError, linear

pytestmark = pytest.mark.ranks

COMM = MPI.COMM_WORLD


@pytest.fixture
def many(monkeypatch):
    """Systems of these tests count as large."""
    monkeypatch.setattr(linear, "_MANY", 100)


def block(stabilization="asgs", nu=0.5, scheme=fm.Bossak, dt=0.05, tied=False, held=True, **newton):
    """A block on its base in a larger mesh, with cells that are hardly filled."""
    domain = mesh.create_box(COMM, [(0, 0, 0), (1.25, 1.25, 1.25)], [5, 5, 5])
    body = points.lattice(domain, 1 / 9.5, inside=lambda x: x.max(axis=0) < 1)
    fm.set_initial_state(body, 1000.0)
    z = fm.Unknown(domain, "u", "p")
    law, time, cells = NeoHookean(1e5, nu), scheme(z, dt=dt), ActiveCells(body)
    weight = ufl.as_vector((0.0, 1.0, -3.0))
    R = fm.stabilized(stabilization, z, body, law, force=time.force(body, weight))
    if tied:
        newton["tying"] = Tying(z.space, body, cells)
    else:
        R += fm.ghost_penalty(z, cells, law)
    if held:
        z.fix("u", lambda x: np.isclose(x[2], 0))
    return ImplicitMPM(R, z, time, body, newton=newton)


def by_id(body, name):
    parts = COMM.allgather((body.id, np.asarray(body[name])))
    ids, values = (np.concatenate(a) for a in zip(*parts, strict=True))
    return values[np.argsort(ids)]


@pytest.mark.mpi
@pytest.mark.parametrize(
    "case",
    [
        {},
        {"nu": 0.3},
        {"dt": 0.5},
        {"tied": True},
        {"stabilization": "osgs"},
        {"stabilization": "ppp", "scheme": fm.GeneralizedAlpha},
        {"scheme": fm.QuasiStatic, "dt": 1.0},
    ],
)
def test_iterations_find_what_factors_find(case, many):
    iterative, direct = block(**case), block(**case, petsc_options={"pc_type": "lu"})
    for sim in (iterative, direct):
        for _ in range(2):
            result = sim.step().newton
        assert result.iterations <= 6
    assert iterative.linear.method == "GMRES + ILU(0)" and iterative.linear.direct_after_all == 0
    assert result.linear_iterations == 0 and iterative.linear.total_iterations > 10
    assert "GMRES + ILU(0), " in repr(iterative.linear)
    for name, scale in (("u", 1e-3), ("p", 1e3), ("J", 1.0)):
        one, other = (by_id(sim.bodies[0], name) for sim in (iterative, direct))
        assert one == pytest.approx(other, abs=1e-6 * scale), name


@pytest.mark.mpi
def test_what_iterations_do_not_solve_is_solved_directly(many, monkeypatch):
    monkeypatch.setitem(linear.KRYLOV, "ksp_max_it", 0)
    sim, direct = block(), block(petsc_options={"pc_type": "lu"})
    sim.step()
    direct.step()
    assert sim.linear.method == "mumps"
    assert sim.linear.direct_after_all == sim.linear.systems > 0
    assert by_id(sim.bodies[0], "u") == pytest.approx(by_id(direct.bodies[0], "u"), abs=1e-12)


@pytest.mark.mpi
@pytest.mark.parametrize(("newton", "difference"), [({}, 1e-8), ({"rtol": 1e-12}, 1e-11)])
def test_a_restart_agrees_to_newtons_tolerance(many, tmp_path, newton, difference):
    # not bit for bit: on three ranks, dolfinx does not always cut the mesh in the same way
    path = COMM.bcast(tmp_path) / "block.h5"
    sim, again = block(**newton), block(**newton)
    sim.step()
    io.checkpoint.save(path, sim)
    sim.step()
    io.checkpoint.restore(path, again)
    again.step()
    assert again.linear.method == "GMRES + ILU(0)"
    for name in ("x", "v", "F", "p"):
        one, other = (by_id(s.bodies[0], name) for s in (sim, again))
        assert one == pytest.approx(other, abs=difference * np.abs(one).max()), name


@pytest.mark.mpi
def test_a_body_without_supports_is_an_error(many):
    sim = block(scheme=fm.QuasiStatic, held=False)
    with pytest.raises(
        NewtonError, match="move along x, move along y, move along z, turn"
    ) as caught:
        sim.step()
    assert caught.value.reason == "no support"


def matrix():
    A = PETSc.Mat().createAIJ((4, 4), nnz=2, comm=MPI.COMM_SELF)
    for i in range(4):
        A[i, i] = 2.0
        if i:
            A[i, i - 1] = -0.5
    A.assemble()
    return A


@pytest.mark.parametrize(
    ("options", "method"),
    [
        (None, "mumps"),
        ({"ksp_type": "gmres", "pc_type": "ilu"}, "gmres + ilu"),
        ({"pc_type": "lu", "pc_factor_mat_solver_type": "petsc"}, "petsc"),
        ({"mat_mumps_icntl_14": 50}, "mumps"),
    ],
)
def test_options_stand_alone_where_they_name_a_preconditioner(options, method):
    solver, A = LinearSolver(MPI.COMM_SELF, options), matrix()
    x, b = A.createVecs()
    b.set(1.0)
    solver.solve(A, b, x)
    assert solver.method == method
    A.mult(x, b)
    assert b.array_r == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"pc_type": "ilu", "pc_typ": "x"}, ValueError, "did not use the option pc_typ"),
        ({"ksp_rtool": 1, "ksp_tol": 1}, ValueError, "the options ksp_rtool, ksp_tol"),
        ({"pc_type": "nonsense"}, ValueError, "refuses the options .* type nonsense"),
        ({"ksp_type": "nonsense"}, ValueError, "refuses the options .* type nonsense"),
        (
            {"pc_type": "lu", "pc_factor_mat_solver_type": "spam"},
            ValueError,
            "refuses the options: .* solver type spam",
        ),
        (
            {"ksp_type": "gmres", "pc_type": "bjacobi", "sub_pc_type": "nonsense"},
            ValueError,
            "refuses the options: .* type nonsense",
        ),
        ({"pc_type": "none", "ksp_max_it": 0}, ValueError, "ksp_max_it must be at least 1: 0"),
        (
            {"ksp_type": "gmres", "pc_type": "none", "ksp_max_it": 2},
            LinearSolverError,
            "2 iterations did not suffice",
        ),
        ("pc_type lu", TypeError, "must be a dictionary of options, not 'pc_type lu'"),
    ],
)
def test_options_that_cannot_be_used(options, error, message):
    A = matrix()
    x, b = A.createVecs()
    b.set(1.0)
    with pytest.raises(error, match=message):
        LinearSolver(MPI.COMM_SELF, options).solve(A, b, x)


def test_a_method_for_positive_definite_matrices():
    A = matrix()
    A[0, 0] = -2.0
    A.assemble()
    x, b = A.createVecs()
    b.set(1.0)
    with pytest.raises(LinearSolverError, match="needs a positive definite matrix"):
        LinearSolver(MPI.COMM_SELF, {"ksp_type": "cg", "pc_type": "none"}).solve(A, b, x)


@pytest.mark.mpi
@pytest.mark.parametrize(
    "options", [{"sub_pc_type": "nonsense"}, {"sub_pc_factor_mat_solver_type": "spam"}]
)
def test_a_loop_does_not_retry_what_petsc_refuses(options, caplog):
    """PETSc itself would take its default in a second try."""
    given = {"ksp_type": "gmres", "pc_type": "bjacobi", "sub_pc_type": "lu", **options}
    sim = block(petsc_options=given)
    with pytest.raises(ValueError, match="PETSc refuses the options"):
        next(sim.run(1.0))
    assert sim.number == 0 and "halved" not in caplog.text


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"rtol": -1}, "rtol must lie in"),
        ({"rtol": float("nan")}, "rtol must lie in"),
        ({"atol": float("inf")}, "atol must be finite"),
        ({"max_iterations": 0}, "max_iterations must be at least 1: 0"),
    ],
)
def test_impossible_tolerances(options, message):
    with pytest.raises(ValueError, match=message):
        block(**options)
