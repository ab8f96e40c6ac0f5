# SPDX-License-Identifier: MIT
"""What a person reads while a program runs: log lines and progress bars, on rank 0 only."""

from __future__ import annotations

import logging
import sys
from collections.abc import Iterable, Iterator
from typing import Any

from mpi4py import MPI

from tqdm import tqdm


def show_log(level: int | str = logging.INFO) -> None:
    """Print the package's log on standard output, on rank 0 only.

    Args:
        level: logging.INFO for a line an iteration, logging.WARNING for problems only.
    """
    logger = logging.getLogger("fenicsmpm")
    logger.setLevel(level)
    if MPI.COMM_WORLD.rank == 0 and not logger.handlers:
        handler = logging.StreamHandler(sys.stdout)
        handler.setFormatter(logging.Formatter("%(message)s"))
        logger.addHandler(handler)
    logger.propagate = False


def progress(
    items: Iterable[Any], label: str, total: int | None = None, show: bool = True
) -> Iterator[Any]:
    """Go through items behind a progress bar, if there is a terminal that can show it.

    Args:
        items: what to go through.
        label: text before the bar.
        total: number of items, if they have no length.
        show: False for no bar at all.
    """
    visible = show and MPI.COMM_WORLD.rank == 0 and sys.stderr.isatty()
    with tqdm(items, desc=label, total=total, disable=not visible, leave=False) as bar:
        yield from bar
