# SPDX-License-Identifier: MIT
"""The time loops, and what observes them."""

from fenicsmpm.simulation.audit import AuditedMPM, Balance, StepAudit
from fenicsmpm.simulation.implicit import ImplicitMPM, Step

__all__ = ["AuditedMPM", "Balance", "ImplicitMPM", "Step", "StepAudit"]
