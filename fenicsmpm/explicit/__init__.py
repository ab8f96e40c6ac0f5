# SPDX-License-Identifier: MIT
"""Explicit dynamics on lattices, with averaged volumes against locking (F-bar)."""

from fenicsmpm.explicit.contact import RigidBox
from fenicsmpm.explicit.explicit_mpm import ExplicitMPM, Step, UnstableError
from fenicsmpm.explicit.initial_state import set_initial_state
from fenicsmpm.explicit.walls import roller
from fenicsmpm.formulations.fbar import ALGORITHM_1, TRUE_J, FBar, default_fbar

__all__ = [
    "ALGORITHM_1",
    "TRUE_J",
    "ExplicitMPM",
    "FBar",
    "RigidBox",
    "Step",
    "UnstableError",
    "default_fbar",
    "roller",
    "set_initial_state",
]
