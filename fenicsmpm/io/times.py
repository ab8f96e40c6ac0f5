# SPDX-License-Identifier: MIT
"""Times of runs that go on after a restart."""


def is_until(time: float, end: float) -> bool:
    """Whether a time that was written belongs to a run that went on from ``end`` [s]."""
    return time <= end + 1e-9 * abs(end)
