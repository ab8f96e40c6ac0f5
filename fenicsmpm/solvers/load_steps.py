# SPDX-License-Identifier: MIT
"""Static problems solved in load steps."""

from __future__ import annotations

import logging
from collections.abc import Callable

import numpy as np

from fenicsmpm.solvers.newton import NewtonError, NewtonResult, NewtonSolver

logger = logging.getLogger(__name__)


def solve_in_load_steps(
    solver: NewtonSolver,
    set_load: Callable[[float], None],
    *,
    first: float = 1.0,
    smallest: float = 1e-3,
) -> list[NewtonResult]:
    """Increase the load factor from 0 to 1 in adaptive steps.

    A step that fails is halved. After a step that succeeds, the next one is twice as long.

    Args:
        solver: Newton's method for the problem.
        set_load: Function that sets loads and Dirichlet data for a load factor between 0 and 1.
        first: First step of the load factor [-].
        smallest: Smallest step to try [-].

    Returns:
        Result of each successful step.

    Raises:
        NewtonError: The last failure, if a step below ``smallest`` would be needed. Unknown and
            load are then those of the last successful step.
        ValueError: If the first step lies outside (0, 1].
    """
    if not 0 < first <= 1:
        raise ValueError(f"the first load step must lie in (0, 1]: {first}")
    results: list[NewtonResult] = []
    factor, step = 0.0, first
    before_last = last = solver.U.x.array.copy()
    last_step = 0.0
    while factor < 1.0:
        target = min(1.0, factor + step)
        set_load(target)
        if last_step > 0.0:  # extrapolate linearly from the last two steps
            solver.U.x.array[:] = last + (target - factor) / last_step * (last - before_last)
        try:
            results.append(solver.solve())
        except NewtonError as error:
            logger.info("load factor %.4g not reached: %s", target, error)
            solver.U.x.array[:] = last
            set_load(factor)
            step = (target - factor) / 2
            last_step = 0.0  # do not extrapolate after a failure
            if step < smallest:
                raise
            continue
        logger.info("load factor %.4g after %d iterations", target, results[-1].iterations)
        before_last, last = last, solver.U.x.array.copy()
        last_step, factor = target - factor, target
        step = 2 * step
        assert np.all(np.isfinite(last))
    return results
