# SPDX-License-Identifier: MIT
"""Preconditioners of GMRES for the tangent of 3D steps with displacement and pressure.

The block of benchmarks/implicit_in_space.py does two steps. Each preconditioner then solves the
last linear system again, to a relative residual of 1e-8. All are right preconditioners; except for
fieldsplit, rows and columns are scaled by the diagonal. Nodal blocks have the unknowns of a node
next to each other. Times include set-up and iterations.

    ./run python benchmarks/preconditioners.py --n 16
"""

import time

from mpi4py import MPI
from petsc4py import PETSc

import machine
import numpy as np
import typer
from implicit_in_space import block

from fenicsmpm import io
from fenicsmpm.solvers import LinearSolver, linear
from fenicsmpm.solvers.places import dof_positions

GMRES = {
    "ksp_type": "gmres",
    "ksp_pc_side": "right",
    "ksp_gmres_restart": 200,
    "ksp_rtol": 1e-8,
    "ksp_max_it": 400,
}
LOCAL = {"pc_type": "bjacobi", "sub_pc_type": "ilu"}
SCHUR = {
    "pc_type": "fieldsplit",
    "pc_fieldsplit_type": "schur",
    "pc_fieldsplit_schur_fact_type": "upper",
    "pc_fieldsplit_schur_precondition": "selfp",
    "fieldsplit_u_ksp_type": "preonly",
    "fieldsplit_p_ksp_type": "preonly",
    "fieldsplit_p_pc_type": "bjacobi",
    "fieldsplit_p_sub_pc_type": "ilu",
}
# name: options, and the matrix type if the matrix is ordered by nodes
WAYS = {
    "ILU(0)": (LOCAL, None),
    "ILU(0), RCM": ({**LOCAL, "sub_pc_factor_mat_ordering_type": "rcm"}, None),
    "ILU(0), by nodes": (LOCAL, "aij"),
    "ILU(0), blocks 4 x 4": (LOCAL, "baij"),
    "ILU(1)": ({**LOCAL, "sub_pc_factor_levels": 1}, None),
    "SOR": ({"pc_type": "sor"}, None),
    "SOR, blocks 4 x 4": ({"pc_type": "sor"}, "baij"),
    "additive Schwarz, ILU(0)": ({"pc_type": "asm", "sub_pc_type": "ilu"}, None),
    "Schur, GAMG": ({**SCHUR, "fieldsplit_u_pc_type": "gamg"}, "split"),
    "Schur, BoomerAMG": ({**SCHUR, "fieldsplit_u_pc_type": "hypre"}, "split"),
}


def captured(sim):
    """Return matrix and right-hand side of the last system of two steps."""
    systems = []
    solve = LinearSolver.solve

    def keep(self, A, b, x, rtol=linear.TIGHT, products=None):
        systems[:] = [A.copy(), b.copy()]
        return solve(self, A, b, x, rtol, products)

    LinearSolver.solve = keep
    try:
        for _ in range(2):
            sim.step()
    finally:
        LinearSolver.solve = solve
    return systems


class Nodes:
    """Owned global degrees of freedom by nodes, (n, 4), in the order of the unknown."""

    def __init__(self, z):
        index_map = z.space.dofmap.index_map
        x = dof_positions(z.space)
        columns, owned = [], index_map.size_local
        for name, size in (("u", 3), ("p", 1)):
            dofs = np.sort(z.dofs(name).reshape(-1, size)[:, 0])
            dofs = dofs[dofs < owned]
            order = np.lexsort(np.round(x[dofs], 9).T)
            columns += [dofs[order] + k for k in range(size)]
        self.local = np.column_stack(columns)
        self.local = self.local[np.argsort(self.local.min(axis=1))]
        self.all = index_map.local_to_global(self.local.ravel().astype(np.int32)).reshape(-1, 4)
        self.x, self.comm = x[self.local[:, 0]], z.mesh.comm

    def indices(self, columns):
        """Return the index set of some columns."""
        rows = self.all[:, columns].ravel().astype(PETSc.IntType)
        return PETSc.IS().createGeneral(rows, self.comm)

    def rigid_motions(self):
        """Return the near-null space of elasticity."""
        block = PETSc.Vec().createMPI((self.x.size, None), bsize=3, comm=self.comm)
        block.array_w[:] = self.x.ravel()
        return PETSc.NullSpace().createRigidBody(block)


def solved(A, b, nodes, options, kind):
    """Return iterations and seconds of one preconditioner; None if it does not converge."""
    own = nodes.indices([0, 1, 2, 3])
    by_nodes = A.createSubMatrix(own, own) if kind in ("aij", "baij") else A.copy()
    rhs, x = by_nodes.createVecs()
    rhs.array_w[:] = (b.getSubVector(own) if kind in ("aij", "baij") else b).array_r
    settings = PETSc.Options("bench_")
    every = GMRES | options
    if kind != "split":
        every = every | {"ksp_diagonal_scale": None}
    for key, value in every.items():
        settings[key] = value
    ksp = PETSc.KSP().create(nodes.comm)
    ksp.setOptionsPrefix("bench_")
    if kind == "split":
        pc = ksp.getPC()
        pc.setType("fieldsplit")
        fields = nodes.indices([0, 1, 2]), nodes.indices([3])
        fields[0].setBlockSize(3)
        pc.setFieldSplitIS(("u", fields[0]), ("p", fields[1]))
        fields[0].compose("nearnullspace", nodes.rigid_motions())
    if kind == "baij":
        scale = by_nodes.getDiagonal()
        scale.array_w[:] = 1 / np.sqrt(np.abs(scale.array_r))
        by_nodes.diagonalScale(scale, scale)
        rhs.pointwiseMult(rhs, scale)
        by_nodes.setBlockSize(4)
        by_nodes = by_nodes.convert("baij")
        settings.delValue("ksp_diagonal_scale")
    ksp.setFromOptions()
    ksp.setOperators(by_nodes)
    nodes.comm.Barrier()
    begin = time.perf_counter()
    ksp.solve(rhs, x)
    spent = nodes.comm.allreduce(time.perf_counter() - begin, MPI.MAX)
    found = ksp.getIterationNumber() if ksp.getConvergedReason() > 0 else None
    ksp.destroy()
    by_nodes.destroy()
    for key in every:
        settings.delValue(key)
    return found, spent


def main(n: int = 16, waves: list[float] = [1.0, 10.0, 100.0], nu: list[float] = [0.3, 0.5]):
    """Print iterations and seconds by preconditioner."""
    io.say(machine.describe())
    columns = {"waves a step": "g", "nu": "g", "light nodes": "s", "preconditioner": "s"}
    table = io.Table({**columns, "iterations": "s", "seconds": ".3f"})
    for length in waves:
        for ratio in nu:
            for tied in (False, True):
                sim = block(n, length, nu=ratio, tied=tied)
                A, b = captured(sim)
                nodes = Nodes(sim.unknown)
                for name, (options, kind) in WAYS.items():
                    found, spent = solved(A, b, nodes, options, kind)
                    light = "tied" if tied else "ghost"
                    table.row(length, ratio, light, name, str(found or "> 400"), spent)


if __name__ == "__main__":
    typer.run(main)
