# SPDX-License-Identifier: MIT
"""What printing a time loop says."""

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
    """A line for each set of points and each rigid body; not collective.

    Args:
        bodies: of the simulation.
        laws: at the points of those that have one.
        carried: further points.
        rigid: rigid bodies.
    """
    facts = [
        ("body", f"{body.size_global} points" + (f" of {laws[body]!r}" if body in laws else ""))
        for body in bodies
    ]
    facts += [("carried", f"{points.size_global} points") for points in carried]
    return [*facts, *(("rigid body", repr(body)) for body in rigid)]
