# SPDX-License-Identifier: MIT
"""Stresses of eight points at once, or of one point after the other (numba)."""

# mypy: disallow_untyped_defs=False, disallow_untyped_calls=False

from __future__ import annotations

import functools
from typing import Any

from fenicsmpm.basis.blocks import inline
from fenicsmpm.lanes import LANES, tensors, works_on_rows

# Components of a symmetric stress (3, 3), numbered by rows, that are stored between blocks of
# steps, by dimension
STORED = {2: (0, 1, 4, 8), 3: (0, 1, 2, 4, 5, 8)}


@functools.cache
def stresses(update: Any, update_eight: Any, n_state: int, rates: bool) -> Any:
    """Compile the numba function that computes the stresses of a block of points by a law.

    Its arguments are the block, its deformation gradients and velocity gradients ``(9, 8)``, the
    law's parameters, the states of all blocks ``(n_blocks * n_state, 8)``, work arrays
    ``(3, 3, 3)`` and ``(n_state,)``, and the stresses, written to nine rows of an array from a
    given row on.

    Args:
        update: Function of the law.
        update_eight: The same for eight points at once, or None. It returns False where it
            cannot, such as at points that need iterations.
        n_state: Number of state variables of the law.
        rates: Whether the law needs velocity gradients.
    """

    @inline
    def one_by_one(block, F, L, parameters, states, work, state, stress, first):
        F_i, L_i, sigma = work[0], work[1], work[2]
        for i in range(LANES):
            for j in range(3):
                for k in range(3):
                    F_i[j, k] = F[3 * j + k, i]
                    if rates:
                        L_i[j, k] = L[3 * j + k, i]
            for k in range(n_state):
                state[k] = states[block * n_state + k, i]
            update(F_i, L_i, parameters, state, sigma)
            for k in range(n_state):
                states[block * n_state + k, i] = state[k]
            for j in range(3):
                for k in range(3):
                    stress[first + 3 * j + k, i] = sigma[j, k]

    @inline
    def all_at_once(block, F, L, parameters, states, work, state, stress, first):
        nothing = tensors(states, 0)
        update(tensors(F, 0), tensors(L, 0), parameters, nothing, tensors(stress, first))

    @inline
    def if_easy(block, F, L, parameters, states, work, state, stress, first):
        before = tensors(states, block * n_state)
        if not update_eight(
            tensors(F, 0), tensors(L, 0), parameters, before, tensors(stress, first)
        ):
            one_by_one(block, F, L, parameters, states, work, state, stress, first)

    if n_state == 0 and works_on_rows(update):
        return all_at_once
    return one_by_one if update_eight is None else if_easy
