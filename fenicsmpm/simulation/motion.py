# SPDX-License-Identifier: MIT
"""What moves by the same displacement in implicit steps: bodies and carried points."""

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
        unknown: with a part that moves the points.
        scheme: of this unknown.
        bodies: which get the fields that unknown and scheme need, where they have none.
        carried: points that move along.
        taylor: see ``ImplicitMPM``.
        tying: tied nodes of the whole space, or None.

    Attributes:
        unknown: as above.
        scheme: as above.
        bodies: as above.
        carried: as above.
        histories: parts of the unknown that bodies carry.
        dofs: places of the moving part in the solution.

    Raises:
        ValueError: for no body, a scheme of another unknown, bodies without their fields, and
            functions by which velocities cannot be mapped.
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
        """Add fields, and compile the mass by which velocities are mapped (collective)."""
        if not bodies or scheme.unknown is not unknown:
            raise ValueError("ImplicitMPM needs a body, and a time scheme of the same unknown")
        self.unknown, self.scheme, self._taylor = unknown, scheme, taylor
        self.bodies, self.carried = list(bodies), list(carried)
        self.histories = [part for part in unknown.parts if part.role == "history"]
        assert unknown.moving is not None  # else there were no scheme
        self.dofs = unknown.dofs(unknown.moving)
        self._projection: EffectiveProjection | None = None
        mapped = [part.name for part in self.histories]
        if scheme.lumping > 0:
            mapped.append(unknown.moving)
        if mapped:
            unknown.require_linear("mapping by the lumped mass", *mapped)
        if scheme.lumping < 1:
            if taylor:
                raise ValueError("velocities are continued with the lumped mass only: lumping = 1")
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
        """Map histories of the scheme by its mass, those of the unknown by lumped mass.

        Args:
            fixed: dofs of the solution with Dirichlet conditions.
        """
        functions = {part.name: getattr(self.unknown.old, part.name) for part in self.histories}
        if self._projection is None:
            functions |= self.scheme.histories
        else:
            held = np.flatnonzero(np.isin(self.dofs, fixed))
            self._projection.project(self.scheme.histories, held)
        project(self.bodies, functions, gradients={"v": "grad_v"} if self._taylor else {})

    def start_from_histories(self) -> None:
        """Set the parts of the solution to what was mapped, and those without history to zero."""
        z = self.unknown
        for part in z.parts:
            value = getattr(z.old, part.name).x.array if part in self.histories else 0.0
            z.U.x.array[z.dofs(part.name)] = value

    def new_fields(self, points: MaterialPoints) -> dict[str, Any]:
        """What a body or carried points get at the end of a step, whatever the residual."""
        increment = self.scheme.increment
        fields = {"x": increment}  # of which positions and displacements are sums
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
    """Motions of a simulation, see ``ImplicitMPM`` (collective).

    Raises:
        ValueError: for sequences of different lengths, unknowns that are not coupled, points that
            move twice, schemes of other kinds, and as ``Motion``.
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
            f"{lengths[0]} unknowns, {lengths[1]} time schemes, bodies of {lengths[2]} unknowns "
            f"and carried points of {lengths[3]}: give as many of each, in the same order"
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
    """What time schemes remember, as numbers with names."""
    return {
        f"{name} of scheme {k}" if k > 0 else name: value
        for k, motion in enumerate(motions)
        for name, value in motion.scheme.memory.items()
    }


def remember_schemes(motions: Sequence[Motion], values: Mapping[str, float]) -> None:
    """Give time schemes what ``memory_of_schemes`` has found."""
    for k, motion in enumerate(motions):
        end = f" of scheme {k}" if k > 0 else ""
        own = {
            name.removesuffix(end): value
            for name, value in values.items()
            if name.endswith(end) and (k > 0 or " of scheme " not in name)
        }
        motion.scheme.memory = own


def _add_history(body: MaterialPoints, part: Part, dim: int) -> None:
    """Give a body the field of a part of the unknown, if it may be added."""
    if part.name in body:
        return
    if part.initial is None:
        raise ValueError(
            f"a body without the field {part.name!r}, of which the unknown's part has its history: "
            f"body.add_field({part.name!r}, shape, values), or give the Part an initial value"
        )
    body.add_field(part.name, (dim,) if part.is_vector else (), part.initial)
