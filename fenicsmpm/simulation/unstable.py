# SPDX-License-Identifier: MIT
"""The error of explicit steps."""

import numpy as np


class UnstableError(RuntimeError):
    """A point is inverted, not finite, or outside; the points are as they were at ``time``."""


def force_without_material(x: np.ndarray) -> str:
    """What to say of a force at a node at ``(d,)`` [m] that no point reaches."""
    return (
        f"a force without material at the node {np.array2string(x, precision=6)}: a load is away "
        "from all bodies"
    )
