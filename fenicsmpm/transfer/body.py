# SPDX-License-Identifier: MIT
"""Working arrays of a body, for the kernels of explicit steps."""

from __future__ import annotations

from typing import Any, NamedTuple


class Body(NamedTuple):
    """Working arrays over the points of a body, in blocks (see `fenicsmpm.basis.blocks`).

    Points that fill up the last block have neither mass nor volume.

    Attributes:
        x: positions (d,) at the beginning of a step [m].
        x_next: at its end.
        v: velocities (d,).
        F: deformation gradients (d, d).
        F33: stretches out of the plane, of no points if they are 1, and in space.
        J_bar: averaged J.
        J_0: J when the averages began, of no points if it is 1.
        mass: [kg].
        V_0: initial volumes.
        state: what the material remembers (n_state,).
        L: velocity gradients (d, d), of no points if the material does not need them.
        parameters: of the material.
    """

    x: Any
    x_next: Any
    v: Any
    F: Any
    F33: Any
    J_bar: Any
    J_0: Any
    mass: Any
    V_0: Any
    state: Any
    L: Any
    parameters: Any
