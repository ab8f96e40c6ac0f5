# SPDX-License-Identifier: MIT
"""Time spent in the stages of a computation."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager


class Stopwatch(dict[str, float]):
    """Seconds by stage; ``with watch("map"): ...`` adds the time of a block."""

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        """Measure the time of a block.

        Args:
            stage: Name of the stage to which the time is added.
        """
        start = time.perf_counter()
        try:
            yield
        finally:
            self.add(stage, time.perf_counter() - start)

    def add(self, stage: str, seconds: float) -> None:
        """Add time to a stage.

        Args:
            stage: Name of the stage.
            seconds: Time [s].
        """
        self[stage] = self.get(stage, 0.0) + seconds

    def __str__(self) -> str:
        """Return the seconds of each stage, the longest first."""
        stages = sorted(self.items(), key=lambda item: -item[1])
        return ", ".join(f"{stage} {seconds:.2g} s" for stage, seconds in stages) or "none"
