# SPDX-License-Identifier: MIT
"""Times of runs that continue after a restart."""


def is_until(time: float, end: float) -> bool:
    """Return whether a recorded time belongs to the run before ``end``, in s."""
    return time <= end + 1e-9 * abs(end)
