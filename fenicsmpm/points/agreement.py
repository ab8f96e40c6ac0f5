# SPDX-License-Identifier: MIT
"""Errors that all ranks raise together.

An exception on one rank only would leave the others waiting in the next collective operation.
So a check that may fail on some ranks is done first, and its outcome is agreed on before anything
else is sent.
"""

import pickle
from collections.abc import Callable
from typing import TypeVar

from mpi4py import MPI

T = TypeVar("T")


def raise_together(comm: MPI.Comm, error: Exception | None) -> None:
    """Raise on every rank when any rank has an error. Collective.

    A rank that has an error of its own raises that one, the others raise the one of the lowest
    rank that has one (a RuntimeError with its message, if it cannot be sent).

    Args:
        comm: The communicator of the ranks that have to agree.
        error: What is wrong on this rank, or None.

    Raises:
        Exception: The error, on all ranks.
    """
    if comm.allreduce(error is not None, MPI.LOR):
        errors = comm.allgather(_sendable(error))
        raise error or next(e for e in errors if e is not None)


def _sendable(error: Exception | None) -> Exception | None:
    """The error, or one that says the same if it cannot be made anew on another rank."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:  # of a user's class, which may do anything
        return RuntimeError(f"{type(error).__name__}: {error}")
    return error


def do_there(comm: MPI.Comm, here: bool, action: Callable[[], T]) -> T | None:
    """Do something on some ranks, such as writing a file on rank 0; all hear of errors. Collective.

    Args:
        comm: The communicator of the ranks that have to agree.
        here: Whether this rank does it.
        action: What is to be done.

    Returns:
        What the action returned, None where it was not done.

    Raises:
        Exception: Whatever the action raised somewhere, on all ranks.
    """
    result, error = None, None
    if here:
        try:
            result = action()
        except Exception as failure:  # of any kind: the other ranks wait
            error = failure
    raise_together(comm, error)
    return result
