# SPDX-License-Identifier: MIT
"""Observers of time loops."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

from fenicsmpm.simulation.step import Step

_TOTAL = "total "  # begins the names of totals in the memory of a loop


class Observer:
    """Base of objects that a time loop calls around its steps; subclasses override what they need.

    A function ``f(sim, step)`` is an observer, too: it is called as ``done``.

    Attributes:
        totals: Names of attributes with numbers that are summed up over the steps. They go on in a
            restart from a checkpoint, and in a simulation that ``Rebalanced`` builds anew.
    """

    totals: tuple[str, ...] = ()

    def start(self, sim: Any) -> None:
        """Prepare, before the first step of a loop.

        Args:
            sim: The simulation.
        """

    def begin(self, sim: Any) -> None:
        """Act before the first stage of a step, or of a block of explicit steps.

        Args:
            sim: The simulation.
        """

    def mapped(self, sim: Any) -> None:
        """Act when fields of the points have been mapped to the grid (implicit steps).

        Args:
            sim: The simulation.
        """

    def solved(self, sim: Any) -> None:
        """Act when the grid has its solution and points have not moved yet (implicit steps).

        Args:
            sim: The simulation.
        """

    def done(self, sim: Any, step: Step) -> None:
        """Act when a step is done, before the loop yields it.

        Args:
            sim: The simulation.
            step: The finished step.
        """


Watcher: TypeAlias = Observer | Callable[[Any, Step], None]


class Observers:
    """Observers of a loop, in their order.

    Args:
        watchers: Observers, or functions of the loop and the step.

    Raises:
        TypeError: For anything else.
    """

    def __init__(self, watchers: Sequence[Watcher]) -> None:
        """Wrap functions as observers of finished steps."""
        for watcher in watchers:
            if not (isinstance(watcher, Observer) or callable(watcher)):
                raise TypeError(
                    "an observer must be an Observer or a function of the simulation and the "
                    f"step, not {watcher!r}"
                )
        self._all = list(watchers)
        self._with_stages = [w for w in self._all if isinstance(w, Observer)]
        self._have_started = False

    def start(self, sim: Any) -> None:
        """Call ``start`` once, before the first step: until then a loop may still be refused."""
        if not self._have_started:
            self.call("start", sim)
            self._have_started = True

    def call(self, stage: str, sim: Any) -> None:
        """Call the method of a stage by its name."""
        for observer in self._with_stages:
            getattr(observer, stage)(sim)

    @property
    def memory(self) -> dict[str, float]:
        """Totals of all observers by names."""
        return {name: float(getattr(*place)) for name, place in self._totals().items()}

    def remember(self, values: dict[str, float]) -> None:
        """Set totals to values of ``memory``, and remove these from the values.

        What is missing, because there was no such observer, stays the same.
        """
        for name, (observer, attribute) in self._totals().items():
            if name in values:
                kind = type(getattr(observer, attribute))
                setattr(observer, attribute, kind(values[name]))
        for name in [name for name in values if name.startswith(_TOTAL)]:
            del values[name]

    def _totals(self) -> dict[str, tuple[Observer, str]]:
        return {
            f"{_TOTAL}{name} of {type(observer).__name__} {k}": (observer, name)
            for k, observer in enumerate(self._with_stages)
            for name in observer.totals
        }

    def done(self, sim: Any, step: Step) -> None:
        """Report a finished step."""
        for watcher in self._all:
            if isinstance(watcher, Observer):
                watcher.done(sim, step)
            else:
                watcher(sim, step)
