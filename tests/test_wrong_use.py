# SPDX-License-Identifier: MIT
"""What would go wrong in silence, or leave other ranks waiting, is an error that says why."""

import pickle

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from energy_bodies import MATERIALS, block
from explicit_runs import simulate

from fenicsmpm import ImplicitMPM, diagnostics, forms, formulations, io, points
from fenicsmpm.cells import ActiveCells, Tying
from fenicsmpm.formulations import Unknown
from fenicsmpm.materials import Hencky, NeoHookean
from fenicsmpm.points import PointsOutsideError
from fenicsmpm.points.agreement import do_there
from fenicsmpm.simulation import Audit
from fenicsmpm.solvers import CourantStep, NewtonError, NewtonSolver

pytestmark = pytest.mark.ranks

COMM = MPI.COMM_WORLD


def square(n=4, comm=COMM):
    domain = mesh.create_unit_square(comm, n, n)
    body = points.fill(domain, 3)
    formulations.set_initial_state(body, 2.0)
    return domain, body


def on_the_wall(x):
    return np.any(np.isclose(x[:2], 0) | np.isclose(x[:2], 1), axis=0)


# --- spaces --------------------------------------------------------------------------------------


def test_functions_that_are_not_linear():
    """Lumped sums of quadratic functions are zero or negative at vertices."""
    domain, body = square(comm=MPI.COMM_SELF)
    z = Unknown(domain, "u", "p", degree=2)
    scheme = formulations.Bossak(z, dt=0.1)
    R = formulations.mixed(z, body, NeoHookean(1.0, 0.3), force=scheme.force(body))
    with pytest.raises(ValueError, match="mapping by the lumped mass needs continuous linear"):
        ImplicitMPM(R, z, scheme, body)


def test_tensors_and_vectors_on_the_grid():
    domain = mesh.create_unit_square(MPI.COMM_SELF, 1, 1)
    G = fem.Function(fem.functionspace(domain, ("Lagrange", 1, (2, 2))), name="G")
    G.interpolate(lambda x: np.vstack([x[0], x[1], 2 * x[0], 3 * x[1]]))
    grid = io.gather_functions([G])
    x, y = grid.points[:, 0], grid.points[:, 1]
    zero = 0 * x
    expected = np.column_stack([x, y, zero, 2 * x, 3 * y, zero, zero, zero, zero])
    assert grid["G"] == pytest.approx(expected)


# --- time ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("material", ["Hencky", "plastic"])
def test_stresses_of_another_time_than_their_state(material):
    body = block()
    z = Unknown(body.mesh, "u")
    scheme = formulations.GeneralizedAlpha(z, dt=0.1)
    stress = formulations.EnergyMomentum(MATERIALS[material], body, z)
    R = stress.power() + scheme.inertia(body)
    with pytest.raises(ValueError, match="GeneralizedAlpha cannot be used with a stress"):
        ImplicitMPM(R, z, scheme, body)


@pytest.mark.parametrize("scheme", ["Midpoint", "Newmark", "BDF2"])
def test_supports_that_move_along(scheme):
    """A penalty takes the displacement at the end of the motion, with any scheme."""
    domain = mesh.create_rectangle(MPI.COMM_SELF, [(0, 0), (3, 1)], [12, 4])
    body = points.fill(domain, 3, inside=lambda x: x[0] < 1)
    edge = points.on_facets(domain, lambda x: np.isclose(x[0], 0))
    formulations.set_initial_state(body, 2.0, (1.0, 0.0))
    z = Unknown(domain, "u")
    time = getattr(formulations, scheme)(z, dt=0.05)
    law = Hencky(100.0, 0.3)
    stress = formulations.Response(law, body, formulations.Kinematics(z.u, body).F)
    g = fem.Constant(domain, np.zeros(2))

    def data(start, end):
        g.value[0] = end

    R = formulations.stress_power(stress.P, z.test.u, body) + time.inertia(body)
    R += formulations.penalty_dirichlet(z, edge, law, g)
    sim = ImplicitMPM(R, z, time, body, carried=[edge], data=data)
    for _ in range(4):
        sim.step()
        assert body["v"] == pytest.approx(np.tile((1.0, 0.0), (len(body), 1)), abs=1e-9)
        assert edge["u"][:, 0] == pytest.approx(sim.time, abs=1e-10)


# --- tied nodes ----------------------------------------------------------------------------------


def test_conditions_replaced_between_steps():
    """What is no longer held is tied in the mapping, too."""
    body = block()
    z = Unknown(body.mesh, "u")
    body["v"] = (1.0, 0.0)
    scheme = formulations.Midpoint(z, dt=0.05)
    stress = formulations.EnergyMomentum(Hencky(100.0, 0.3), body, z)
    left = body.x[:, 0].min() + 0.3
    z.fix("u", lambda x: x[0] < left)
    audit = Audit()
    sim = ImplicitMPM(
        stress.power() + scheme.inertia(body), z, scheme, body, observers=[audit],
        newton={"tying": Tying(z.space, body, ActiveCells(body))},
    )  # fmt: skip
    sim.newton.bcs = []
    momentum = diagnostics.momentum(body)
    sim.step()
    mapped = audit.last.changes["map to the grid"]
    assert np.abs(mapped.momentum).max() < 1e-12 * np.abs(momentum).max()
    assert body["v"] == pytest.approx(np.tile((1.0, 0.0), (len(body), 1)), abs=1e-9)


@pytest.mark.mpi
def test_pressure_without_a_level_and_tied_nodes():
    domain, body = square(8)
    z = Unknown(domain, "u", "p")
    z.fix("u", on_the_wall)
    R = formulations.stabilized("asgs", z, body, NeoHookean(1.0, 0.5))
    b = ufl.as_vector((0.0, -1.0))
    R -= ufl.inner(b, z.test.u) * body.dx
    newton = NewtonSolver(R, z.U, z.bcs, tying=Tying(z.space, body, ActiveCells(body)))
    with pytest.raises(ValueError, match="nothing holds the level of the pressure"):
        newton.solve()


@pytest.mark.mpi
def test_load_without_material_and_tied_nodes():
    domain = mesh.create_rectangle(COMM, [(0, 0), (3, 1)], [12, 4])
    body = points.quadrature(domain, 2, inside=lambda x: x[0] < 1)
    edge = points.on_curve(domain, (2.55, 0.4), (2.55, 0.5), spacing=0.1)
    z = Unknown(domain, "u", "p")
    z.fix("u", lambda x: np.isclose(x[0], 0))
    R = formulations.stabilized("asgs", z, body, NeoHookean(1e3, 0.3))
    R += formulations.dead_load(z.test.u, edge, (1.0, 0.0))
    with pytest.raises(NewtonError, match="load without material") as caught:
        NewtonSolver(R, z.U, z.bcs, tying=Tying(z.space, body, ActiveCells(body))).solve()
    assert "to the ghost penalty or to cells.Tying" in str(caught.value)


# --- explicit supports ---------------------------------------------------------------------------


@pytest.mark.mpi
@pytest.mark.parametrize("kind", ["another space", "nowhere"])
def test_explicit_supports(kind):
    domain = mesh.create_unit_square(COMM, 4, 4, mesh.CellType.quadrilateral)
    body, law = points.fill(domain, 2), Hencky(1.0, 0.3)
    formulations.set_initial_state(body, 1.0)
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    if kind == "nowhere":
        dofs = fem.locate_dofs_geometrical(V, lambda x: x[0] > 7)
        bc = fem.dirichletbc(np.zeros(2), dofs, V)
        message = "on no degrees of freedom"
    else:
        other = fem.functionspace(domain, ("Lagrange", 1))
        dofs = fem.locate_dofs_geometrical(other, lambda x: np.isclose(x[1], 0))
        bc = fem.dirichletbc(0.0, dofs, other)
        message = "another function space"
    with pytest.raises(ValueError, match=message):
        simulate(V, {body: law}, bcs=[bc])


# --- several ranks -------------------------------------------------------------------------------


@pytest.mark.mpi
def test_a_state_is_restored_by_one_rank_alone():
    """An error on one rank only must get out of a step, instead of waiting for the others."""
    domain, body = square()
    z = Unknown(domain, "u", "p")
    scheme = formulations.Bossak(z, dt=0.1)
    R = formulations.mixed(z, body, NeoHookean(1.0, 0.3), force=scheme.force(body))
    sim = ImplicitMPM(R, z, scheme, body)
    before, size = sim._snapshot(), body.size_global
    if COMM.rank == 0:
        body.assign({"v": body["v"] + 3.0})
        sim._restore(before)
        assert not np.any(body["v"])
    COMM.barrier()
    assert body.size_global == size


@pytest.mark.mpi
@pytest.mark.parametrize("kind", [IndexError, ImportError, KeyError, OSError])
def test_errors_of_one_rank_are_those_of_all(kind):
    def fail():
        raise kind("what went wrong")

    with pytest.raises(kind, match="what went wrong"):
        do_there(COMM, COMM.rank == COMM.size - 1, fail)
    assert do_there(COMM, COMM.rank == 0, lambda: 3) == (3 if COMM.rank == 0 else None)


@pytest.mark.parametrize(
    "error",
    [
        NewtonError("diverged", "not at all", [1.0, 2.0]),
        PointsOutsideError(1, 2, np.zeros(2), np.array([1]), np.zeros((1, 2))),
    ],
)
def test_errors_travel_between_ranks(error):
    copy = pickle.loads(pickle.dumps(error))
    assert type(copy) is type(error)
    assert str(copy) == str(error)


# --- arguments -----------------------------------------------------------------------------------


def test_laws_of_the_wrong_kind():
    domain, body = square(comm=MPI.COMM_SELF)
    z = Unknown(domain, "u", "p")
    with pytest.raises(ValueError, match="a law with a shear modulus mu"):
        formulations.ghost_penalty(z, ActiveCells(body), NeoHookean(1.0, 0.3).pointwise())
    with pytest.raises(ValueError, match=r"such as NeoHookean\(..\).pointwise\(\), or a P-wave"):
        CourantStep({body: NeoHookean(1.0, 0.3)}, 1.0)


def test_new_fields_that_are_zero():
    _, body = square(comm=MPI.COMM_SELF)
    body["v"] = 7.0
    zero = 0.0 * body.field("v")
    assert not np.any(forms.FieldUpdates(body, {"v": zero}).evaluate()["v"])
