# SPDX-License-Identifier: MIT
"""Bodies and carried points with one displacement in implicit steps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from fenicsmpm.cells import Tying
from fenicsmpm.formulations import Kinematics
from fenicsmpm.formulations.time_scheme import TimeScheme
from fenicsmpm.formulations.unknown import Part, Unknown
from fenicsmpm.points import MaterialPoints
from fenicsmpm.solvers import EffectiveProjection
from fenicsmpm.solvers.checks import require_fields
from fenicsmpm.transfer import project


class Motion:
    """Bodies, and points that they carry, which move by one unknown and time scheme.

    Args:
        unknown: Unknown with a part that moves the points.
        scheme: Time scheme of this unknown.
        bodies: Bodies; they get the fields that unknown and scheme need, if they have none.
        carried: Points that move along.
        taylor: See ``ImplicitMPM``.
        tying: Tied nodes of the whole space, or None.

    Attributes:
        unknown: As above.
        scheme: As above.
        bodies: As above.
        carried: As above.
        histories: Parts of the unknown that bodies carry.
        dofs: Places of the moving part in the solution.

    Raises:
        ValueError: For no body, a scheme of another unknown, bodies without their fields, and
            functions with which velocities cannot be mapped.
    """

    def __init__(
        self,
        unknown: Unknown,
        scheme: TimeScheme,
        bodies: Sequence[MaterialPoints],
        carried: Sequence[MaterialPoints],
        taylor: bool,
        tying: Tying | None,
    ) -> None:
        """Add fields, and compile the mass by which velocities are mapped. Collective."""
        if not bodies or scheme.unknown is not unknown:
            raise ValueError("ImplicitMPM needs a body, and a time scheme of the same unknown")
        self.unknown, self.scheme, self._taylor = unknown, scheme, taylor
        self.bodies, self.carried = list(bodies), list(carried)
        self.histories = [part for part in unknown.parts if part.role == "history"]
        assert unknown.moving is not None  # or there would be no scheme
        self.dofs = unknown.dofs(unknown.moving)
        self._projection: EffectiveProjection | None = None
        mapped = [part.name for part in self.histories]
        if scheme.lumping > 0:
            mapped.append(unknown.moving)
        if mapped:
            unknown.require_linear("mapping by the lumped mass", *mapped)
        if scheme.lumping < 1:
            if taylor:
                raise ValueError("taylor=True needs a scheme with the lumped mass: set lumping=1")
            space = unknown.part_space(unknown.moving)
            if tying is not None:
                tying = tying.of(self.bodies, space)
            self._projection = EffectiveProjection(self.bodies, space, scheme.lumping, tying)
        dim = unknown.mesh.geometry.dim
        for body in self.bodies:
            require_fields(body)
            for part in self.histories:
                _add_history(body, part, dim)
            for name, function in scheme.histories.items():
                if name not in body:
                    body.add_field(name, function.ufl_shape)
            for name, value in scheme.updates(body).items():
                if name not in body:
                    body.add_field(name, value.ufl_shape)
            if taylor and "grad_v" not in body:
                body.add_field("grad_v", (dim, dim))
        for points in self.carried:
            if "u" not in points:
                points.add_field("u", (dim,))

    def map_to_grid(self, fixed: npt.NDArray[np.integer]) -> None:
        """Map histories of the scheme by its mass, and those of the unknown by lumped mass.

        Args:
            fixed: Dofs of the solution with Dirichlet conditions.
        """
        functions = {part.name: getattr(self.unknown.old, part.name) for part in self.histories}
        if self._projection is None:
            functions |= self.scheme.histories
        else:
            held = np.flatnonzero(np.isin(self.dofs, fixed))
            self._projection.project(self.scheme.histories, held)
        project(self.bodies, functions, gradients={"v": "grad_v"} if self._taylor else {})

    def start_from_histories(self) -> None:
        """Set the parts of the solution to the mapped values, and parts without history to zero."""
        z = self.unknown
        for part in z.parts:
            value = getattr(z.old, part.name).x.array if part in self.histories else 0.0
            z.U.x.array[z.dofs(part.name)] = value

    def new_fields(self, points: MaterialPoints) -> dict[str, Any]:
        """Return the fields that bodies and carried points get in each step of any residual."""
        increment = self.scheme.increment
        fields = {"x": increment}  # to be added to positions and displacements
        if points in self.bodies:
            k = Kinematics(increment, points)
            fields |= {"F": k.F, "J": k.J}
            for part in self.histories:
                change = self.scheme.change(part.name)
                new = getattr(self.unknown.old, part.name) + change
                if part.flip > 0:
                    new = part.flip * (points.field(part.name) + change) + (1 - part.flip) * new
                fields[part.name] = new
            fields |= self.scheme.updates(points)
            if self._taylor:
                fields["grad_v"] = k.grad(self.scheme.grid_velocity())
        return fields


def motions_of(
    unknowns: Unknown | Sequence[Unknown],
    schemes: TimeScheme | Sequence[TimeScheme],
    bodies: MaterialPoints | Sequence[Any],
    carried: Sequence[Any],
    taylor: bool,
    tying: Tying | None,
) -> list[Motion]:
    """Return the motions of a simulation, see ``ImplicitMPM``. Collective.

    Raises:
        ValueError: For sequences of different lengths, unknowns that are not coupled, points that
            move twice, schemes of different kinds, and as for ``Motion``.
    """
    if isinstance(unknowns, Unknown) and isinstance(schemes, TimeScheme):
        return [Motion(unknowns, schemes, _sets(bodies), carried, taylor, tying)]
    if isinstance(unknowns, Unknown) or isinstance(schemes, TimeScheme):
        raise ValueError("several unknowns need several time schemes: one of each")
    if isinstance(bodies, MaterialPoints) or not carried:
        bodies, carried = _sets(bodies), carried or [()] * len(unknowns)
    lengths = [len(given) for given in (unknowns, schemes, bodies, carried)]
    if len({*lengths}) > 1:
        raise ValueError(
            f"there are {lengths[0]} unknowns, {lengths[1]} time schemes, bodies of {lengths[2]} "
            f"unknowns and carried points of {lengths[3]}: give as many of each, in the same order"
        )
    if any(z.U is not unknowns[0].U for z in unknowns):
        raise ValueError("unknowns that are solved for together are made by coupled_unknowns(..)")
    if len({type(scheme) for scheme in schemes}) > 1 or len({s.share for s in schemes}) > 1:
        raise ValueError("coupled unknowns need time schemes of one kind: a step has one end")
    sets = [[*_sets(b), *_sets(c)] for b, c in zip(bodies, carried, strict=True)]
    moving = [points for group in sets for points in group]
    if len({id(points) for points in moving}) < len(moving):
        raise ValueError("points that move by two unknowns: give each set to one")
    return [
        Motion(z, scheme, _sets(b), _sets(c), taylor, tying)
        for z, scheme, b, c in zip(unknowns, schemes, bodies, carried, strict=True)
    ]


def _sets(points: MaterialPoints | Sequence[MaterialPoints]) -> list[MaterialPoints]:
    return [points] if isinstance(points, MaterialPoints) else list(points)


def memory_of_schemes(motions: Sequence[Motion]) -> dict[str, float]:
    """Return the memory of time schemes as numbers with names."""
    return {
        f"{name} of scheme {k}" if k > 0 else name: value
        for k, motion in enumerate(motions)
        for name, value in motion.scheme.memory.items()
    }


def remember_schemes(motions: Sequence[Motion], values: Mapping[str, float]) -> None:
    """Restore what ``memory_of_schemes`` returned."""
    for k, motion in enumerate(motions):
        end = f" of scheme {k}" if k > 0 else ""
        own = {
            name.removesuffix(end): value
            for name, value in values.items()
            if name.endswith(end) and (k > 0 or " of scheme " not in name)
        }
        motion.scheme.memory = own


def _add_history(body: MaterialPoints, part: Part, dim: int) -> None:
    """Add the field of a part of the unknown to a body, if that is possible."""
    if part.name in body:
        return
    if part.initial is None:
        raise ValueError(
            f"a body lacks the field {part.name!r}, the history of a part of the unknown: call "
            f"body.add_field({part.name!r}, shape, values), or give the Part an initial value"
        )
    body.add_field(part.name, (dim,) if part.is_vector else (), part.initial)
