# SPDX-License-Identifier: MIT
"""FFCx compilations that wait for running processes, but not for killed ones.

FFCx marks a compilation in progress by a new .c file in its cache. If the process is killed, this
file remains, and all later processes wait for its result until their timeout. Here a lock, which
ends with the process that holds it, tells which files still have a writer.
"""

from __future__ import annotations

import fcntl
import hashlib
import logging
import re
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import ufl
from dolfinx import fem, jit

logger = logging.getLogger(__name__)

T = TypeVar("T")

_PATIENCE = 2  # s until a wait is logged
# s after which a file without a locking writer counts as left by a killed process. Before that,
# plain dolfinx, which does not lock, may be compiling the same form.
_STALE = 30


def kernel_form(comm: Any, form: ufl.Form, jit_options: Mapping[str, Any]) -> tuple[Any, Any]:
    """Compile a UFL form once on all ranks. Collective.

    Args:
        comm: MPI communicator; its rank 0 compiles.
        form: UFL form; its meshes may be pure UFL ones.
        jit_options: Options of ``dolfinx.jit.ffcx_jit``.

    Returns:
        The ``ufcx_form`` C object and the CFFI module that keeps it alive.
    """

    def compiled(options: dict[str, Any]) -> tuple[Any, Any]:
        return jit.ffcx_jit(comm, form, {"scalar_type": np.float64}, options)[:2]

    return _once(comm, form.signature(), compiled, jit_options)


def mesh_form(
    form: ufl.Form,
    form_compiler_options: Mapping[str, Any] | None = None,
    jit_options: Mapping[str, Any] | None = None,
) -> fem.Form:
    """Call ``dolfinx.fem.form`` for a form over cells and facets. Collective."""

    def compiled(options: dict[str, Any]) -> fem.Form:
        return fem.form(form, form_compiler_options=form_compiler_options, jit_options=options)

    comm = form.ufl_domain().ufl_cargo().comm
    return _once(comm, form.signature(), compiled, jit_options)


def open_form(
    comm: Any, form: ufl.Form, form_compiler_options: Any, jit_options: Mapping[str, Any] | None
) -> Any:
    """Call ``dolfinx.fem.compile_form``, which leaves integration entities open. Collective."""

    def compiled(options: dict[str, Any]) -> Any:
        return fem.compile_form(
            comm, form, form_compiler_options=form_compiler_options, jit_options=options
        )

    return _once(comm, form.signature(), compiled, jit_options)


def expression(value: Any, points: Any, comm: Any) -> fem.Expression:
    """Call ``dolfinx.fem.Expression`` for given reference points. Collective.

    Args:
        value: UFL expression.
        points: Reference points in the cell.
        comm: MPI communicator.
    """

    def compiled(options: dict[str, Any]) -> fem.Expression:
        return fem.Expression(value, points, jit_options=options)

    return _once(comm, str(value), compiled, None)


def _once(
    comm: Any,
    key: str,
    compiled: Callable[[dict[str, Any]], T],
    jit_options: Mapping[str, Any] | None,
) -> T:
    """Return the result of ``compiled``, called again while FFCx waits for a file.

    Args:
        comm: MPI communicator.
        key: Text that identifies what is compiled.
        compiled: Function of JIT options that compiles, or reads from the cache.
        jit_options: JIT options of the user.
    """
    options = {**(jit_options or {}), "timeout": _PATIENCE}
    cache = Path(jit.get_options(options)["cache_dir"])
    with _lock(cache, key) if comm.rank == 0 else nullcontext(False) as is_locked:
        while True:
            try:
                return compiled(options)
            except (TimeoutError, RuntimeError) as error:  # the latter on several ranks
                if not comm.bcast(comm.rank == 0 and _is_worth_trying(error, is_locked)):
                    raise


def _is_worth_trying(error: Exception, is_locked: bool) -> bool:
    """Return whether FFCx only waited for a file; remove the file if it has no writer any more."""
    found = re.search(r"timed out.* remove (.+\.c)\)", str(error))
    if found is None:
        return False
    path = Path(found[1])
    try:
        age = time.time() - path.stat().st_mtime
    except FileNotFoundError:  # its writer failed
        return True
    if not is_locked or age < _STALE:
        logger.warning("waiting for %s, which another process may be compiling", path)
    else:
        logger.warning("compiling %s again: no process has finished it for %.0f s", path.name, age)
        path.unlink(missing_ok=True)
    return True


@contextmanager
def _lock(cache: Path, key: str) -> Iterator[bool]:
    """Wait until no other process compiles the same; yield False if files cannot be locked."""
    cache.mkdir(parents=True, exist_ok=True)
    # one byte of one file for each key, so that nothing needs to be cleaned up
    byte = int(hashlib.sha256(key.encode()).hexdigest()[:15], 16)
    with open(cache / "fenicsmpm.lock", "a") as file:
        begin, told, is_locked = time.monotonic(), False, False
        while not is_locked:
            try:
                fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB, 1, byte)
                is_locked = True
            except (BlockingIOError, PermissionError):  # another process has it
                time.sleep(0.1)
            except OSError:  # a file system without locks
                break
            if not is_locked and not told and time.monotonic() - begin > _PATIENCE:
                told = True
                logger.warning("waiting for another process that compiles the same, see %s", cache)
        yield is_locked
