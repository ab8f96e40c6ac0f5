# SPDX-License-Identifier: MIT
"""Nonlinear and linear solvers."""

from fenicsmpm.solvers.courant import CourantStep
from fenicsmpm.solvers.linear import LinearSolver, LinearSolverError
from fenicsmpm.solvers.load_steps import solve_in_load_steps
from fenicsmpm.solvers.newton import NewtonError, NewtonResult, NewtonSolver
from fenicsmpm.solvers.projection import EffectiveProjection

__all__ = [
    "CourantStep",
    "EffectiveProjection",
    "LinearSolver",
    "LinearSolverError",
    "NewtonError",
    "NewtonResult",
    "NewtonSolver",
    "solve_in_load_steps",
]
