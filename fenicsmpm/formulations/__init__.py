# SPDX-License-Identifier: MIT
"""Formulations: functions that return UFL forms, which users can print, change and combine."""

from fenicsmpm.formulations.bdf2 import BDF2
from fenicsmpm.formulations.boundary import (
    dead_load,
    follower_pressure,
    nitsche_dirichlet,
    penalty_dirichlet,
    set_normals,
)
from fenicsmpm.formulations.condition import Condition
from fenicsmpm.formulations.contact import contact, contact_traction
from fenicsmpm.formulations.energy_momentum import EnergyMomentum, stress_power
from fenicsmpm.formulations.fbar import ALGORITHM_1, TRUE_J, FBar, default_fbar
from fenicsmpm.formulations.ghost_penalty import ghost_mass, ghost_penalty
from fenicsmpm.formulations.initial_state import set_initial_state
from fenicsmpm.formulations.initial_stress import initial_stress
from fenicsmpm.formulations.interior_penalty import hessian_penalty, interior_penalty
from fenicsmpm.formulations.internal_force import body_force, internal_force
from fenicsmpm.formulations.k0_state import k0_state
from fenicsmpm.formulations.kinematics import Kinematics, embed
from fenicsmpm.formulations.lumped_projection import LumpedProjection
from fenicsmpm.formulations.midpoint import Midpoint
from fenicsmpm.formulations.mixed import MixedLaw, mixed
from fenicsmpm.formulations.mixed_energy_momentum import MixedEnergyMomentum
from fenicsmpm.formulations.newmark import Bossak, GeneralizedAlpha, Newmark
from fenicsmpm.formulations.newtonian_flow import NewtonianFlow
from fenicsmpm.formulations.quasi_static import QuasiStatic
from fenicsmpm.formulations.response import Response
from fenicsmpm.formulations.stabilization import (
    STABILIZATIONS,
    asgs,
    osgs,
    ppp,
    residuals,
    split_osgs,
    stabilized,
)
from fenicsmpm.formulations.stabilization_parameters import element_size, tau
from fenicsmpm.formulations.surface_gap import SurfaceGap
from fenicsmpm.formulations.time_scheme import TimeScheme, density
from fenicsmpm.formulations.unknown import Part, Unknown, coupled_unknowns
from fenicsmpm.formulations.walls import wall

__all__ = [
    "ALGORITHM_1",
    "BDF2",
    "STABILIZATIONS",
    "TRUE_J",
    "Bossak",
    "Condition",
    "EnergyMomentum",
    "FBar",
    "GeneralizedAlpha",
    "Kinematics",
    "LumpedProjection",
    "Midpoint",
    "MixedEnergyMomentum",
    "MixedLaw",
    "Newmark",
    "NewtonianFlow",
    "Part",
    "QuasiStatic",
    "Response",
    "SurfaceGap",
    "TimeScheme",
    "Unknown",
    "asgs",
    "body_force",
    "contact",
    "contact_traction",
    "coupled_unknowns",
    "dead_load",
    "default_fbar",
    "density",
    "element_size",
    "embed",
    "follower_pressure",
    "ghost_mass",
    "ghost_penalty",
    "hessian_penalty",
    "initial_stress",
    "interior_penalty",
    "internal_force",
    "k0_state",
    "mixed",
    "nitsche_dirichlet",
    "osgs",
    "penalty_dirichlet",
    "ppp",
    "residuals",
    "set_initial_state",
    "set_normals",
    "split_osgs",
    "stabilized",
    "stress_power",
    "tau",
    "wall",
]
