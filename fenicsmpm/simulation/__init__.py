# SPDX-License-Identifier: MIT
"""Time loops and their observers."""

from fenicsmpm.simulation.audit import Audit, Balance, StepAudit
from fenicsmpm.simulation.contact import Contact
from fenicsmpm.simulation.explicit import ExplicitMPM
from fenicsmpm.simulation.implicit import ImplicitMPM
from fenicsmpm.simulation.observer import Observer
from fenicsmpm.simulation.reaction import Reaction
from fenicsmpm.simulation.rebalanced import Rebalanced, imbalance
from fenicsmpm.simulation.resultant import Resultant
from fenicsmpm.simulation.staging import Exchange, add_points, remove_points
from fenicsmpm.simulation.step import Step
from fenicsmpm.simulation.throughflow import Sink, Source
from fenicsmpm.simulation.unstable import UnstableError

__all__ = [
    "Audit",
    "Balance",
    "Contact",
    "Exchange",
    "ExplicitMPM",
    "ImplicitMPM",
    "Observer",
    "Reaction",
    "Rebalanced",
    "Resultant",
    "Sink",
    "Source",
    "Step",
    "StepAudit",
    "UnstableError",
    "add_points",
    "imbalance",
    "remove_points",
]
