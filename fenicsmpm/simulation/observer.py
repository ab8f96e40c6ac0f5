# SPDX-License-Identifier: MIT
"""What observes a run, whatever its time loop is."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

from fenicsmpm.simulation.step import Step


class Observer:
    """Something that a time loop calls around its steps; a subclass overrides what it needs.

    A function ``f(sim, step)`` is an observer, too: it is called as ``done``.
    """

    def start(self, sim: Any) -> None:
        """When the loop has been made."""

    def begin(self, sim: Any) -> None:
        """Before the first stage of a step, or of a block of explicit ones."""

    def mapped(self, sim: Any) -> None:
        """When fields of the points have been mapped to the grid (implicit steps)."""

    def solved(self, sim: Any) -> None:
        """When the grid has its solution and points have not moved yet (implicit steps)."""

    def done(self, sim: Any, step: Step) -> None:
        """When a step is done, and before the loop yields it."""


Watcher: TypeAlias = Observer | Callable[[Any, Step], None]


class Observers:
    """Those of a loop, in their order.

    Args:
        watchers: observers, or functions of the loop and the step.

    Raises:
        TypeError: for something else.
    """

    def __init__(self, watchers: Sequence[Watcher]) -> None:
        """Take functions for observers of steps that are done."""
        for watcher in watchers:
            if not (isinstance(watcher, Observer) or callable(watcher)):
                raise TypeError(
                    f"an observer is an Observer or a function of the simulation and the step, not "
                    f"{watcher!r}"
                )
        self._all = list(watchers)
        self._with_stages = [w for w in self._all if isinstance(w, Observer)]

    def call(self, stage: str, sim: Any) -> None:
        """Tell a stage by its name."""
        for observer in self._with_stages:
            getattr(observer, stage)(sim)

    def done(self, sim: Any, step: Step) -> None:
        """Tell that a step is done."""
        for watcher in self._all:
            if isinstance(watcher, Observer):
                watcher.done(sim, step)
            else:
                watcher(sim, step)
