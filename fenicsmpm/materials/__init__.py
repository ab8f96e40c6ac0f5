# SPDX-License-Identifier: MIT
"""Constitutive laws, in UFL and as functions at points compiled by numba."""

from fenicsmpm.materials import tensors
from fenicsmpm.materials.cam_clay import ModifiedCamClay
from fenicsmpm.materials.differences import check_tangent
from fenicsmpm.materials.drucker_prager import DruckerPrager
from fenicsmpm.materials.evaluate import bulk_to_shear, energy, state_of, stress, tangent
from fenicsmpm.materials.fluid import NewtonianFluid
from fenicsmpm.materials.from_energy import from_energy
from fenicsmpm.materials.hencky import Hencky
from fenicsmpm.materials.hyperelastic import VOLUMETRIC_LAWS, NeoHookean
from fenicsmpm.materials.law import Law, compiled
from fenicsmpm.materials.mohr_coulomb import MohrCoulomb
from fenicsmpm.materials.plasticity import VonMises
from fenicsmpm.materials.stretch import stretch_of

__all__ = [
    "VOLUMETRIC_LAWS",
    "DruckerPrager",
    "Hencky",
    "Law",
    "ModifiedCamClay",
    "MohrCoulomb",
    "NeoHookean",
    "NewtonianFluid",
    "VonMises",
    "bulk_to_shear",
    "check_tangent",
    "compiled",
    "energy",
    "from_energy",
    "state_of",
    "stress",
    "stretch_of",
    "tangent",
    "tensors",
]
