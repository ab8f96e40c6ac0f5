# SPDX-License-Identifier: MIT
"""The time loops, and what observes them."""

from fenicsmpm.simulation.audit import AuditedMPM, Balance, StepAudit
from fenicsmpm.simulation.explicit import ExplicitMPM
from fenicsmpm.simulation.implicit import ImplicitMPM
from fenicsmpm.simulation.rigid_box import RigidBox
from fenicsmpm.simulation.step import Step
from fenicsmpm.simulation.unstable import UnstableError

__all__ = [
    "AuditedMPM",
    "Balance",
    "ExplicitMPM",
    "ImplicitMPM",
    "RigidBox",
    "Step",
    "StepAudit",
    "UnstableError",
]
