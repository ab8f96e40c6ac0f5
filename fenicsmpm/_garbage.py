# SPDX-License-Identifier: MIT
"""Destruction of PETSc objects on several ranks."""

from __future__ import annotations

from mpi4py import MPI
from petsc4py import PETSc


def lasting(comm: MPI.Intracomm) -> MPI.Intracomm:
    """Return COMM_WORLD or COMM_SELF if they have the same ranks, for PETSc objects.

    On several ranks, objects that Python has dropped wait for ``collect_garbage`` on their
    communicator. The communicator of a mesh would no longer exist by then.

    Args:
        comm: Communicator of a mesh.
    """
    for lasts in (MPI.COMM_WORLD, MPI.COMM_SELF):
        if MPI.Comm.Compare(comm, lasts) in (MPI.IDENT, MPI.CONGRUENT):
            return lasts
    return comm


def collect_garbage(comm: MPI.Intracomm) -> None:
    """Destroy the PETSc objects that Python has dropped on all ranks. Collective.

    Args:
        comm: Communicator of a mesh.
    """
    PETSc.garbage_cleanup(lasting(comm))
