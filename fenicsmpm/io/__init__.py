# SPDX-License-Identifier: MIT
"""Output for people and for other programs."""

from fenicsmpm.io.console import Table, progress, say, show_log
from fenicsmpm.io.pictures import Panel, colour_range, picture
from fenicsmpm.io.results import gather_functions, gather_points, write

__all__ = [
    "Panel",
    "Table",
    "colour_range",
    "gather_functions",
    "gather_points",
    "picture",
    "progress",
    "say",
    "show_log",
    "write",
]
