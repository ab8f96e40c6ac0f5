# SPDX-License-Identifier: MIT
"""Material Point Method on FEniCSx background meshes, with every weak form in UFL."""

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
from fenicsmpm._memory import return_freed_memory
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

return_freed_memory()
