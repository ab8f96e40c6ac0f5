# SPDX-License-Identifier: MIT
"""Errors that all ranks raise together.

An exception on one rank only would leave the others waiting in the next collective operation.
So a check that may fail on some ranks is done first, and its outcome is agreed on before anything
else is sent.
"""

from mpi4py import MPI


def raise_together(comm: MPI.Comm, error: Exception | None) -> None:
    """Raise on every rank when any rank has an error. Collective.

    A rank that has an error of its own raises that one, the others raise the one of the lowest
    rank that has one.

    Args:
        comm: The communicator of the ranks that have to agree.
        error: What is wrong on this rank, or None.

    Raises:
        Exception: The error, on all ranks.
    """
    if comm.allreduce(error is not None, MPI.LOR):
        errors = comm.allgather(error)
        raise error or next(e for e in errors if e is not None)
