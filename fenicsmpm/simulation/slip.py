# SPDX-License-Identifier: MIT
"""Names of the fields in which points keep their elastic slip on rigid bodies."""


def slip_on(number: int) -> str:
    """Field ``(n, 2, d)`` [m]: spring of friction on a rigid body, and way in the last step.

    Both are in the frame in which the body's shape was given.

    Args:
        number: of the body in ``ExplicitMPM.rigid``.
    """
    return f"slip on rigid body {number}"
