# SPDX-License-Identifier: MIT
"""The error of explicit steps."""


class UnstableError(RuntimeError):
    """A point is inverted, not finite, or outside; the points are as they were at ``time``."""
