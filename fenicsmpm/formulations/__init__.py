# SPDX-License-Identifier: MIT
"""Formulations: functions that return UFL forms to be printed, changed and recombined."""

from fenicsmpm.formulations.kinematics import Kinematics, embed
from fenicsmpm.formulations.mixed import mixed, mixed_space, volumetric_residual
from fenicsmpm.formulations.stabilization import asgs, element_size, osgs, ppp, residuals, tau

__all__ = [
    "Kinematics",
    "asgs",
    "element_size",
    "embed",
    "mixed",
    "mixed_space",
    "osgs",
    "ppp",
    "residuals",
    "tau",
    "volumetric_residual",
]
