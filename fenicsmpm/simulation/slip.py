# SPDX-License-Identifier: MIT
"""Names of the fields in which points keep their elastic slip on rigid bodies."""


def slip_on(number: int) -> str:
    """Field ``(n, d)`` [m] of the slip on a rigid body, in the frame of its shape.

    Args:
        number: of the body in ``ExplicitMPM.rigid``.
    """
    return f"slip on rigid body {number}"
