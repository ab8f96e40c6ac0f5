# SPDX-License-Identifier: MIT
"""Material Point Method on FEniCSx background meshes, with every weak form in UFL."""

import ctypes
import os

from mpi4py import MPI

import numba

from fenicsmpm import (
    basis,
    cells,
    diagnostics,
    forms,
    formulations,
    io,
    materials,
    points,
    rigid,
    shapes,
    simulation,
    solvers,
    transfer,
    verification,
)
from fenicsmpm.points import MaterialPoints
from fenicsmpm.rigid import RigidBody
from fenicsmpm.simulation import ExplicitMPM, ImplicitMPM, UnstableError

__version__ = "1.0.0"

__all__ = [
    "ExplicitMPM",
    "ImplicitMPM",
    "MaterialPoints",
    "RigidBody",
    "UnstableError",
    "basis",
    "cells",
    "diagnostics",
    "forms",
    "formulations",
    "io",
    "materials",
    "points",
    "rigid",
    "shapes",
    "simulation",
    "solvers",
    "transfer",
    "verification",
]

# Ranks share the cores: by default, each rank assembles with one thread.
if MPI.COMM_WORLD.size > 1 and "NUMBA_NUM_THREADS" not in os.environ:
    numba.set_num_threads(1)

# SuperLU_DIST, which Debian's PETSc loads, lets glibc keep all memory that is freed. Arrays over
# many points come and go, and would leave holes. Large ones get pages of their own again. Both are
# glibc's defaults; other C libraries have no such options.
_set = getattr(ctypes.CDLL(None), "mallopt", None)
if _set is not None:
    _M_MMAP_THRESHOLD, _M_MMAP_MAX = -3, -4
    _set(_M_MMAP_THRESHOLD, 2**25)
    _set(_M_MMAP_MAX, 65536)
