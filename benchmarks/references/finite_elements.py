# SPDX-License-Identifier: MIT
"""Finite element references for three dynamic examples of an incompressible neo-Hookean solid.

They use total Lagrangian Taylor-Hood P2-P1 elements by plain dolfinx, with the energy
``mu/2 (J^(-2/3) I1 - 3) + p (J - 1)`` and Bossak's scheme: inertia at ``n + 1 - alpha``, everything
else at ``n + 1``. With the constraint J = 1 imposed at ``n + 1``, Newmark's scheme without
dissipation is only weakly stable: pressure and energy grow.

- ``cook``: Cook's membrane, plane strain, under a suddenly applied dead load;
- ``beam``: a column clamped at its base starts with a sideways velocity that is linear in height;
- ``twist``: the same column starts twisting.

Each run writes the displacement of one corner to a ``.csv`` table in the directory of this script.
It uses one core. A step in which Newton's method fails is divided into two halves.
"""

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from mpi4py import MPI
from petsc4py import PETSc

import dolfinx
import numpy as np
import ufl
from basix.ufl import element, mixed_element
from dolfinx import fem, mesh
from dolfinx.fem import petsc

import fenicsmpm

RHO_INF = 0.8
ALPHA = (RHO_INF - 1) / (RHO_INF + 1)  # Bossak, inertia (1 - ALPHA) a_new + ALPHA a_old
GAMMA = 1 / 2 - ALPHA
BETA = (1 - ALPHA) ** 2 / 4

MAX_ITERATIONS = 20
TOLERANCE = 1e-6  # residual of Newton's method relative to that of its first guess
REUSE = 0.1  # residual reduction below which the factors of the tangent are used again
SMALLEST = 2**-8  # smallest fraction of the time step, by halving


def membrane(n):
    domain = mesh.create_unit_square(MPI.COMM_WORLD, n, n, diagonal=mesh.DiagonalType.right)
    x, y = domain.geometry.x[:, 0].copy(), domain.geometry.x[:, 1].copy()
    domain.geometry.x[:, 0] = 4.8 * x
    domain.geometry.x[:, 1] = 4.4 * x + (4.4 - 2.8 * x) * y
    return domain


def column(n):
    corners = [[-0.5, -0.5, 0.0], [0.5, 0.5, 6.0]]
    return mesh.create_box(MPI.COMM_WORLD, corners, [n, n, 6 * n])


def bending(x):
    return np.stack([5 / 3 * x[2], 0 * x[0], 0 * x[0]])


def twisting(x):
    return 100 * np.sin(np.pi * x[2] / 12) * np.stack([x[1], -x[0], 0 * x[0]])


@dataclass
class Example:
    title: str
    mesh: Callable
    n: int  # boxes or squares along a short side
    cells: str
    clamped: Callable
    corner: tuple  # m, where the displacement is recorded
    young: float  # Pa
    density: float  # kg/m^3
    dt: float  # s
    until: float  # s
    file: str
    traction: tuple | None = None  # Pa, per reference area
    loaded: Callable | None = None
    velocity: Callable | None = None  # m/s, initial


EXAMPLES = {
    "cook": Example(
        title="dynamic Cook's membrane, plane strain",
        mesh=membrane,
        n=32,
        cells="{0} x {0} x 2 triangles, right diagonals",
        clamped=lambda x: np.isclose(x[0], 0),
        corner=(4.8, 6.0),
        young=250.0,
        density=1.0,
        dt=0.0125,
        until=7.0,
        file="cook_dynamic.csv",
        traction=(0.0, 6.25),
        loaded=lambda x: np.isclose(x[0], 4.8),
    ),
    "beam": Example(
        title="bending beam",
        mesh=column,
        n=4,
        cells="{0} x {0} x {1} x 6 tetrahedra",
        clamped=lambda x: np.isclose(x[2], 0),
        corner=(0.5, 0.5, 6.0),
        young=1.7e7,
        density=1100.0,
        dt=0.005,
        until=3.0,
        file="bending_beam.csv",
        velocity=bending,
    ),
    "twist": Example(
        title="twisting column",
        mesh=column,
        n=4,
        cells="{0} x {0} x {1} x 6 tetrahedra",
        clamped=lambda x: np.isclose(x[2], 0),
        corner=(0.5, 0.5, 6.0),
        young=1.7e7,
        density=1100.0,
        dt=0.001,
        until=0.5,
        file="twisting_column.csv",
        velocity=twisting,
    ),
}


class NotConverged(RuntimeError):
    """Error for a step in which Newton's method or the linear solver failed."""


class Dynamics:
    """An example on a mesh: its state, and the step to the next one.

    Displacement, velocity and acceleration are functions of one mixed space. Their second part is
    the pressure over the shear modulus for the displacement, and zero for the others.
    """

    def __init__(self, example, n):
        self.domain = domain = example.mesh(n)
        dim = domain.geometry.dim
        cell = domain.basix_cell()
        P2, P1 = element("Lagrange", cell, 2, shape=(dim,)), element("Lagrange", cell, 1)
        self.W = W = fem.functionspace(domain, mixed_element([P2, P1]))
        self.U, self.old, self.velocity, self.acceleration = (fem.Function(W) for _ in range(4))
        self.dt = fem.Constant(domain, example.dt)
        self.iterations = 0

        base = mesh.locate_entities_boundary(domain, dim - 1, example.clamped)
        W_u, u_dofs = W.sub(0).collapse()
        self.u_dofs = np.array(u_dofs)
        self.is_u = np.zeros(len(self.U.x.array))
        self.is_u[self.u_dofs] = 1
        dofs = fem.locate_dofs_topological((W.sub(0), W_u), dim - 1, base)
        self.bcs = [fem.dirichletbc(fem.Function(W_u), dofs, W.sub(0))]
        self.clamped = dofs[0]
        x = W_u.tabulate_dof_coordinates()[:, :dim]
        corner = int(np.flatnonzero(np.all(np.isclose(x, example.corner), axis=1))[0])
        self.corner = self.u_dofs[dim * corner + np.arange(dim)]

        self._forms(example)
        self.ksp = PETSc.KSP().create(domain.comm)
        self.ksp.setType("preonly")
        self.ksp.getPC().setType("cholesky")
        self.ksp.getPC().setFactorSolverType("mumps")
        PETSc.Options()["mat_mumps_icntl_14"] = 200  # more room for pivots, percent
        self.ksp.setFromOptions()
        self._initial_state(example, W_u)

    def _forms(self, example):
        domain, dt = self.domain, self.dt
        dim = domain.geometry.dim
        dx = ufl.dx(domain=domain, metadata={"quadrature_degree": 4})
        mu, rho = example.young / 3, example.density
        (u, p), (w, q) = ufl.split(self.U), ufl.TestFunctions(self.W)
        u0, v0, a0 = (ufl.split(f)[0] for f in (self.old, self.velocity, self.acceleration))

        F = ufl.Identity(dim) + ufl.grad(u)
        J = ufl.det(F)
        I1 = ufl.inner(F, F) + (3 - dim)  # F33 = 1 in plane strain
        elastic = mu / 2 * (J ** (-2 / 3) * I1 - 3)
        a = (u - u0 - dt * v0) / (BETA * dt**2) - (1 / (2 * BETA) - 1) * a0
        load = 0
        if example.traction is not None:
            edge = mesh.locate_entities_boundary(domain, dim - 1, example.loaded)
            tags = mesh.meshtags(domain, dim - 1, np.sort(edge), np.full(len(edge), 1, np.int32))
            ds = ufl.Measure("ds", domain=domain, subdomain_data=tags)
            load = ufl.inner(ufl.as_vector(example.traction), w) * ds(1)

        # Pressure and constraint are scaled by mu, so the parts of the residual have similar sizes.
        residual = rho * ufl.inner((1 - ALPHA) * a + ALPHA * a0, w) * dx - load
        residual += ufl.derivative((elastic + mu * p * (J - 1)) * dx, self.U)
        self.residual = fem.form(residual)
        self.tangent = fem.form(ufl.derivative(residual, self.U))
        self.matrix = petsc.create_matrix(self.tangent)
        energy = rho / 2 * ufl.inner(v0, v0) * dx + elastic * dx
        self._energy = fem.form(energy)
        self._volume = fem.form(J * dx)

        # At rest: d^2 J / dt^2 = div a + (div v)^2 - tr(L^2) with L = grad v
        b, s = ufl.TrialFunctions(self.W)
        L = ufl.grad(v0)
        saddle = ufl.inner(b, w) * dx + s * ufl.div(w) * dx + q * ufl.div(b) * dx
        self.saddle = fem.form(saddle)  # with a pressure over rho
        self.start = fem.form(1 / rho * load + (ufl.tr(L * L) - ufl.tr(L) ** 2) * q * dx)
        self.momentum = fem.form(ufl.inner(v0, w) * dx)

    def _initial_state(self, example, W_u):
        """Set a velocity without divergence, then the matching acceleration and pressure."""
        self._factor(self.saddle)
        if example.velocity is not None:
            v0 = fem.Function(W_u)
            v0.interpolate(example.velocity)
            self.velocity.x.array[self.u_dofs] = v0.x.array
            v = self._solve(fem.assemble_vector(self.momentum).array)
            self.velocity.x.array[:] = self.is_u * v
        start = self._solve(fem.assemble_vector(self.start).array)
        self.acceleration.x.array[:] = self.is_u * start
        self.old.x.array[:] = (1 - self.is_u) * start * example.density / (example.young / 3)
        self.U.x.array[:] = self.old.x.array

    def _factor(self, form):
        self.matrix.zeroEntries()
        petsc.assemble_matrix(self.matrix, form, bcs=self.bcs)
        self.matrix.assemble()
        self.ksp.setOperators(self.matrix)
        self.ksp.setUp()

    def _solve(self, right):
        right[self.clamped] = 0
        b = PETSc.Vec().createWithArray(right, comm=self.domain.comm)
        x = b.duplicate()
        self.ksp.solve(b, x)
        if self.ksp.getConvergedReason() < 0:
            info = self.ksp.getPC().getFactorMatrix().getMumpsInfog(1)
            raise NotConverged(f"MUMPS error {info}")
        return x.array.copy()

    def _right(self):
        right = -fem.assemble_vector(self.residual).array
        right[self.clamped] = 0
        return right, np.linalg.norm(right)

    def step(self, dt):
        """Compute the next state; after a failure, raise NotConverged and keep the old one."""
        self.dt.value = dt
        u, old, v, a = (f.x.array for f in (self.U, self.old, self.velocity, self.acceleration))
        u[:] = old + dt * v
        right, first = self._right()
        norm, before = first, 0
        for _ in range(MAX_ITERATIONS):
            if not np.isfinite(norm) or norm < TOLERANCE * first:
                break
            if norm > REUSE * before:
                self._factor(self.tangent)
            u += self._solve(right)
            self.iterations += 1
            before = norm
            right, norm = self._right()
        if not norm < TOLERANCE * first:
            u[:] = old
            raise NotConverged(f"residual {first:.1e} to {norm:.1e}")

        new = self.is_u * (u - old - dt * v) / (BETA * dt**2) - (1 / (2 * BETA) - 1) * a
        v += dt * ((1 - GAMMA) * a + GAMMA * new)
        a[:] = new
        old[:] = u

    def advance(self, dt, whole):
        """Do one step, or its halves; return the number of steps taken."""
        try:
            self.step(dt)
            return 1
        except NotConverged as error:
            if dt / 2 < SMALLEST * whole:
                raise
            print(f"  step of {dt:.2e} s failed ({error}), divided into halves", flush=True)
            return self.advance(dt / 2, whole) + self.advance(dt / 2, whole)

    @property
    def displacement(self):
        return self.U.x.array[self.corner]

    @property
    def energy(self):
        return fem.assemble_scalar(self._energy)

    @property
    def volume(self):
        return fem.assemble_scalar(self._volume)


def run(example, n, dt, until, output):
    begin = time.perf_counter()
    body = Dynamics(example, n)
    energy, volume = body.energy, body.volume
    names = "xyz"[: body.domain.geometry.dim]
    head = [
        f"{example.title}: displacement of the corner {example.corner} m",
        f"E = {example.young:g} Pa, nu = 0.5, density = {example.density:g} kg/m^3, neo-Hookean",
        f"mesh: {example.cells.format(n, 6 * n)}, Taylor-Hood P2-P1, total Lagrangian",
        f"scheme: Bossak, rho_inf = {RHO_INF}, dt = {dt:g} s",
        f"benchmarks/references/finite_elements.py, fenicsmpm {fenicsmpm.__version__}, "
        f"dolfinx {dolfinx.__version__}",
        ", ".join(["t [s]"] + [f"u_{name} [m]" for name in names]),
    ]
    dofs = body.W.dofmap.index_map.size_global * body.W.dofmap.index_map_bs
    print(f"{example.title}: {head[2]}, {dofs} unknowns", flush=True)
    steps, whole = 0, round(until / dt)
    with open(output, "w") as file:
        file.writelines(f"# {line}\n" for line in head)
        for i in range(whole + 1):
            if i > 0:
                steps += body.advance(dt, dt)
            row = [f"{i * dt:.6g}"] + [f"{value + 0.0:.6f}" for value in body.displacement]
            print(",".join(row), file=file, flush=True)
            if i % max(1, whole // 20) == 0:
                print(
                    f"t = {i * dt:7.4f} s, u = {body.displacement} m, {steps} steps, "
                    f"{body.iterations} iterations, energy {body.energy:.6g} J "
                    f"(start {energy:.6g}), volume {body.volume / volume - 1:+.1e}, "
                    f"{time.perf_counter() - begin:.0f} s",
                    flush=True,
                )
    print(f"{output} after {time.perf_counter() - begin:.0f} s")


def main():
    parser = argparse.ArgumentParser(description="Finite element references, incompressible")
    parser.add_argument("example", choices=EXAMPLES)
    parser.add_argument("--n", type=int, help="squares a side, or boxes on a short side")
    parser.add_argument("--dt", type=float, help="time step in s")
    parser.add_argument("--until", type=float, help="end in s")
    parser.add_argument("--output", type=Path, help="file .csv")
    options = parser.parse_args()
    example = EXAMPLES[options.example]
    run(
        example,
        options.n or example.n,
        options.dt or example.dt,
        options.until or example.until,
        options.output or Path(__file__).parent / example.file,
    )


if __name__ == "__main__":
    main()
