# SPDX-License-Identifier: MIT
"""Constitutive laws."""

from fenicsmpm.materials.hyperelastic import VOLUMETRIC_LAWS, NeoHookean

__all__ = ["VOLUMETRIC_LAWS", "NeoHookean"]
