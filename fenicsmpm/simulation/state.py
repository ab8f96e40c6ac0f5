# SPDX-License-Identifier: MIT
"""The state of a simulation between two steps, as each rank has it.

The state is what a step leaves behind: all arrays of all points, the time, and the memory of the
time scheme. Mesh, forms and loads are no part of it. Whoever restores it must build the simulation
first.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from fenicsmpm.points import MaterialPoints
from fenicsmpm.points.point_arrays import BUILT_IN
from fenicsmpm.simulation.explicit import ExplicitMPM
from fenicsmpm.simulation.implicit import ImplicitMPM

Arrays = dict[str, npt.NDArray]
Fields = dict[str, tuple[int, ...]]  # shapes of the values at one point
Simulation: TypeAlias = ImplicitMPM | ExplicitMPM


@dataclass
class PointSet:
    """The points of one set on this rank.

    Attributes:
        next_id: Id of the next point that is added.
        arrays: Arrays with a row for each point, ``(n, *shape)``.
    """

    next_id: int
    arrays: Arrays


@dataclass
class State:
    """Data that the next step depends on.

    Attributes:
        time: Time in s.
        number: Number of steps done.
        memory: Other numbers.
        sets: Bodies, then carried points.
    """

    time: float
    number: int
    memory: dict[str, float]
    sets: list[PointSet]


def point_sets(sim: Simulation) -> list[MaterialPoints]:
    """Return bodies, then carried points."""
    return [*sim.bodies, *sim.carried]


def fields_of(points: MaterialPoints) -> Fields:
    """Return the shapes of the values at one point by the names of all arrays, in their order."""
    return {name: points.field_shape(name) for name in (*BUILT_IN, *points.field_names)}


def take(sim: Simulation) -> State:
    """Return the state of a simulation; arrays are not copied. Collective.

    Args:
        sim: The simulation.
    """
    sim.settle()
    sets = [PointSet(points.next_id, points.snapshot(copy=False)) for points in point_sets(sim)]
    return State(float(sim.time), int(sim.number), dict(sim.memory), sets)


def put(state: State, sim: Simulation) -> None:
    """Set the state of a simulation with the same point sets and fields. Collective.

    Args:
        state: State with points in cells that this rank owns; its arrays become those of the
            points.
        sim: The simulation.
    """
    for points, saved in zip(point_sets(sim), state.sets, strict=True):
        points.restore(saved.arrays)
        points.next_id = saved.next_id
    sim.time, sim.number = state.time, state.number
    sim.memory = state.memory


def located(points: MaterialPoints, arrays: Arrays) -> Arrays:
    """Send arrays of points to the ranks that own their cells, and set the cells. Collective.

    Args:
        points: Points on the mesh in which the cells are searched.
        arrays: Arrays of any points with the same fields; "cell" and "xi" are ignored.
    """
    n = len(arrays["x"])
    nowhere = {"cell": np.full(n, -1, np.int32), "xi": np.zeros_like(arrays["x"])}
    others = points.select([])
    others.restore({**arrays, **nowhere})
    others.move(arrays["x"])
    return others.snapshot(copy=False)


def differences(
    there: tuple[str, Sequence[Fields]], here: tuple[str, Sequence[Fields]]
) -> list[str]:
    """Return the reasons why a state does not fit a simulation; an empty list if it does.

    Args:
        there: Method, and fields of each point set of the state.
        here: Those of the simulation.
    """
    said = []
    (method, sets), (other_method, other_sets) = there, here
    if method != other_method:
        said.append(f"its scheme is {method}, here it is {other_method}")
    if len(sets) != len(other_sets):
        return [*said, f"it has {len(sets)} point sets, here are {len(other_sets)}"]
    return said + [
        f"point set {k} {_difference(one, other)}"
        for k, (one, other) in enumerate(zip(sets, other_sets, strict=True))
        if one != other
    ]


def _difference(there: Fields, here: Fields) -> str:
    said = []
    if missing := [name for name in there if name not in here]:
        said.append(f"has fields that are missing here: {', '.join(missing)}")
    if more := [name for name in here if name not in there]:
        said.append(f"lacks fields that are here: {', '.join(more)}")
    said += [
        f"has {name!r} of shape {there[name]}, here it is {here[name]}"
        for name in there
        if name in here and there[name] != here[name]
    ]
    return " and ".join(said)


def chosen_otherwise(there: dict[str, str], here: dict[str, str]) -> Iterator[tuple[str, str, str]]:
    """Yield parameters that differ: the name, and both values.

    Args:
        there: ``parameters`` of one simulation.
        here: Those of another one.
    """
    for name in {**there, **here}:
        one, other = (parameters.get(name, "nothing") for parameters in (there, here))
        if one != other:
            yield name, one, other
