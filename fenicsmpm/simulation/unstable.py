# SPDX-License-Identifier: MIT
"""Error of explicit steps."""

import numpy as np


class UnstableError(RuntimeError):
    """Error for points that are inverted, not finite, or outside; they stay as at ``time``."""


def force_without_material(x: np.ndarray) -> str:
    """Return the message for a force at a node at ``(d,)`` in m that no point reaches."""
    return (
        f"a force without material at the node {np.array2string(x, precision=6)}: a load acts away "
        "from all bodies"
    )
