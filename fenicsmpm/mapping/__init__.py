# SPDX-License-Identifier: MIT
"""Between points and grid."""

from fenicsmpm.mapping.filled_fraction import FilledFraction
from fenicsmpm.mapping.transfer import p2g

__all__ = ["FilledFraction", "p2g"]
