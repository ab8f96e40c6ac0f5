# SPDX-License-Identifier: MIT
"""The text that is printed for time loops."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from fenicsmpm._display import Facts
from fenicsmpm.materials import Law
from fenicsmpm.points import MaterialPoints
from fenicsmpm.rigid import RigidBody


def facts_of_bodies(
    bodies: Sequence[MaterialPoints],
    laws: Mapping[MaterialPoints, Law],
    carried: Sequence[MaterialPoints],
    rigid: Sequence[RigidBody],
) -> Facts:
    """Return a line for each set of points and each rigid body. Not collective.

    Args:
        bodies: Bodies of the simulation.
        laws: Laws at the points, for bodies that have one.
        carried: Further points.
        rigid: Rigid bodies.
    """
    facts = [
        ("body", f"{body.size_global} points" + (f" of {laws[body]!r}" if body in laws else ""))
        for body in bodies
    ]
    facts += [("carried", f"{points.size_global} points") for points in carried]
    return [*facts, *(("rigid body", repr(body)) for body in rigid)]
