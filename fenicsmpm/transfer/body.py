# SPDX-License-Identifier: MIT
"""Working arrays of a body, for the kernels of explicit steps."""

from __future__ import annotations

from typing import Any, NamedTuple


class Body(NamedTuple):
    """Working arrays over the points of a body, in blocks (see `fenicsmpm.basis.blocks`).

    Points that fill up the last block have neither mass nor volume.

    Attributes:
        x: Positions at the beginning of a step in m, (d,).
        x_next: Positions at the end of a step in m, (d,).
        v: Velocities in m/s, (d,).
        F: Deformation gradients, (d, d).
        F33: Out-of-plane stretches; without points if they are 1, and in 3D.
        J_bar: Averaged J.
        J_0: J at the beginning of the averages; without points if it is 1.
        mass: Masses in kg.
        V_0: Initial volumes in m^d.
        state: State variables of the material, (n_state,).
        L: Velocity gradients in 1/s, (d, d); without points if the material does not need them.
        parameters: Parameters of the material.
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
