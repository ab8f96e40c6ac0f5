# SPDX-License-Identifier: MIT
"""Errors that all ranks raise together.

An exception on one rank only would leave the other ranks waiting in the next collective operation.
A check that may fail on some ranks therefore comes first, and all ranks agree on its outcome
before any other communication.
"""

import pickle
from collections.abc import Callable
from typing import TypeVar

from mpi4py import MPI

T = TypeVar("T")


def raise_together(comm: MPI.Comm, error: Exception | None) -> None:
    """Raise an error on every rank if any rank has one. Collective.

    A rank that has an error raises its own. The others raise that of the lowest rank with an error,
    or a RuntimeError with the same message if the error cannot be sent.

    Args:
        comm: Communicator of the ranks that have to agree.
        error: Error of this rank, or None.

    Raises:
        Exception: The error, on all ranks.
    """
    if comm.allreduce(error is not None, MPI.LOR):
        errors = comm.allgather(_sendable(error))
        raise error or next(e for e in errors if e is not None)


def _sendable(error: Exception | None) -> Exception | None:
    """Return the error, or one with the same text if it cannot be recreated on another rank."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:  # classes of users may raise anything here
        return RuntimeError(f"{type(error).__name__}: {error}")
    return error


def do_there(comm: MPI.Comm, here: bool, action: Callable[[], T]) -> T | None:
    """Run an action on some ranks, such as writing a file on rank 0. Collective.

    Args:
        comm: Communicator of the ranks that have to agree.
        here: Whether this rank runs the action.
        action: The function to call.

    Returns:
        The result of the action, None on ranks that do not run it.

    Raises:
        Exception: Any error of the action, on all ranks.
    """
    result, error = None, None
    if here:
        try:
            result = action()
        except Exception as failure:  # of any kind, since the other ranks wait
            error = failure
    raise_together(comm, error)
    return result
