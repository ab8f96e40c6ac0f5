# SPDX-License-Identifier: MIT
"""Output: pictures, plots, files for ParaView, histories, checkpoints, log and progress."""

from fenicsmpm._display import Picture
from fenicsmpm.io import checkpoint
from fenicsmpm.io.console import Table, progress, say, show_log, watch
from fenicsmpm.io.history import History, read_history
from fenicsmpm.io.movie import animate
from fenicsmpm.io.pictures import picture
from fenicsmpm.io.plots import plot
from fenicsmpm.io.results import gather_functions, gather_points, write
from fenicsmpm.io.series import Series

__all__ = [
    "History",
    "Picture",
    "Series",
    "Table",
    "animate",
    "checkpoint",
    "gather_functions",
    "gather_points",
    "picture",
    "plot",
    "progress",
    "read_history",
    "say",
    "show_log",
    "watch",
    "write",
]
