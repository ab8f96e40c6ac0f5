# SPDX-License-Identifier: MIT
"""Formulations: functions that return UFL forms to be printed, changed and recombined."""

from fenicsmpm.formulations.kinematics import Kinematics, embed
from fenicsmpm.formulations.mixed import mixed, mixed_space, parts, volumetric_residual
from fenicsmpm.formulations.stabilization import (
    STABILIZATIONS,
    asgs,
    element_size,
    osgs,
    ppp,
    residuals,
    stabilized,
    tau,
)

__all__ = [
    "STABILIZATIONS",
    "Kinematics",
    "asgs",
    "element_size",
    "embed",
    "mixed",
    "mixed_space",
    "osgs",
    "parts",
    "ppp",
    "residuals",
    "stabilized",
    "tau",
    "volumetric_residual",
]
