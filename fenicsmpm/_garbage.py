# SPDX-License-Identifier: MIT
"""Life and death of PETSc objects on several ranks."""

from __future__ import annotations

from mpi4py import MPI
from petsc4py import PETSc


def lasting(comm: MPI.Intracomm) -> MPI.Intracomm:
    """COMM_WORLD or COMM_SELF if they have the same ranks, for PETSc objects.

    What Python drops on several ranks waits for ``collect_garbage`` on its communicator; that of a
    mesh would be gone by then.

    Args:
        comm: communicator of a mesh.
    """
    for lasts in (MPI.COMM_WORLD, MPI.COMM_SELF):
        if MPI.Comm.Compare(comm, lasts) in (MPI.IDENT, MPI.CONGRUENT):
            return lasts
    return comm


def collect_garbage(comm: MPI.Intracomm) -> None:
    """Destroy the PETSc objects that Python has dropped on all ranks (collective).

    Args:
        comm: communicator of a mesh.
    """
    PETSc.garbage_cleanup(lasting(comm))
