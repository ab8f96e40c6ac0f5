# SPDX-License-Identifier: MIT
"""Manufactured solutions and convergence studies."""

from fenicsmpm.verification.convergence import Convergence
from fenicsmpm.verification.manufactured import Exact, Manufactured
from fenicsmpm.verification.motions import axis_aligned_waves, generalized_vortex, ring

__all__ = [
    "Convergence",
    "Exact",
    "Manufactured",
    "axis_aligned_waves",
    "generalized_vortex",
    "ring",
]
