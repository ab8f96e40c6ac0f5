# SPDX-License-Identifier: MIT
"""ExplicitMPM: the explicit time loop (F-bar, section 2.2 and algorithm 1)."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem

from fenicsmpm import _compat
from fenicsmpm._display import Described, Facts
from fenicsmpm.basis import functions_of
from fenicsmpm.basis.lattice import lattice_of
from fenicsmpm.basis.lattice_stencil import KINDS
from fenicsmpm.basis.lines import WIDTH
from fenicsmpm.formulations.condition import Condition
from fenicsmpm.formulations.time_scheme import check_time_step
from fenicsmpm.formulations.unknown import Unknown
from fenicsmpm.materials import Law
from fenicsmpm.points import MaterialPoints
from fenicsmpm.points.agreement import raise_together
from fenicsmpm.points.exits import Exits
from fenicsmpm.points.geometry import cell_geometry
from fenicsmpm.rigid import RigidBody
from fenicsmpm.simulation.contact import Contact, require_apart
from fenicsmpm.simulation.description import facts_of_bodies
from fenicsmpm.simulation.explicit_by_forms import ByForms
from fenicsmpm.simulation.explicit_checks import (
    check_bodies,
    check_functions,
    check_increments,
    check_rigid,
    check_space,
    wrong_number,
)
from fenicsmpm.simulation.explicit_on_lattice import OnLattice
from fenicsmpm.simulation.observer import Observers, Watcher
from fenicsmpm.simulation.parameters import of_points
from fenicsmpm.simulation.renewals import check_updates, renewals
from fenicsmpm.simulation.residual import Residual
from fenicsmpm.simulation.rigid_state import memory_of, remember, slip_on
from fenicsmpm.simulation.step import Step
from fenicsmpm.simulation.torn_off import TornOff
from fenicsmpm.simulation.unstable import UnstableError
from fenicsmpm.solvers.checks import check_bcs, require_points, warn_of_points_that_stay
from fenicsmpm.solvers.stopwatch import Stopwatch

logger = logging.getLogger(__name__)

# Number of steps after which carried points are checked, which may bring all points up to date
_LOOK = 100


class ExplicitMPM(Described):
    """Explicit dynamics of material points on a fixed background mesh.

    In a step, points give mass, momentum and forces to the nodes (P2G). ``m a = -R`` gives the
    accelerations of the nodes with the lumped mass. The new velocities move the points (G2P), and
    stresses follow from the deformation.

    Args:
        R: Residual of rank 1 in N, internal minus external forces, tested on the space of the
            velocity: ``formulations.internal_force`` of each body, ``body_force``, ``dead_load``,
            and the user's own terms over points, cells and facets. The velocity in it is that at
            the beginning of the step. It contains no inertia.
        unknown: Velocity of the nodes in m/s, ``Unknown(mesh, "v")``, in linear functions. Its
            conditions fix all components of nodes, or the normal one for rollers and slip walls.
        bodies: Material points with the fields of ``formulations.set_initial_state``. Bodies
            without a contact between them share the velocities of the nodes: they meet without
            slip and never separate. Each body has its own averages of J. Points see the grid
            functions chosen by ``basis.use``, by default the finite elements of the mesh.
        contacts: Contacts between bodies that touch, slide and separate.
        carried: Further points that move with the grid, such as those that carry loads. Each set
            gets a field "u" if it has none.
        bcs: Further Dirichlet conditions of dolfinx.
        updates: For each point set, more fields to be updated at the end of a step, in addition to
            those of ``PointField.renew``: UFL over its points with the velocity at the end of the
            step, or functions that return new arrays.
        data: Function of the times at the beginning and end of each step that sets loads and
            boundary values at the beginning. Points are up to date when it is called.
        on_exit: Treatment of points that leave the mesh: "error", "delete" or "clamp".
        dt: Time step in s; None for the fraction ``cfl`` of the stable step, updated now and then.
        cfl: Time step times wave speed over cell size.
        flip: Fraction of FLIP in velocities; the rest is PIC (eq. 13).
        damping: Factor of local damping, for static problems.
        rigid: Rigid bodies, which points cannot enter. With friction, points get a field for their
            slip on each of them.
        observers: ``Observer`` objects called around the yielded steps in their order, or functions
            of the simulation and the ``Step``.

    Attributes:
        velocity: Velocity of the nodes in m/s at the end of the last step. Where bodies in contact
            meet, it is the mass-weighted mean. Loads on carried points, cells and facets are
            distributed likewise.
        time: Time in s.
        number: Number of steps done.
        dt: Length of the last step in s; before the first step, its length.
        longest_dt: Longest allowed step in s. Steps are shorter if they end at a given time.
        bodies: Material points. Call ``settle`` before you change their mass or V_0.
        carried: Points that move along.
        laws: Law at the points of each body that has one. It may be replaced by one of the same
            kind with other parameters.
        bcs: Dirichlet conditions; may be changed between steps, as may flip, damping and data.
        rigid: Rigid bodies.
        contacts: Contacts with their forces and gaps in the last step.
        reaction: Force of Dirichlet conditions on the grid in the last step in N, ``(d,)``.
        duration: Dt in s as a constant for UFL, for example in ``updates``.
        seconds: Computing time spent in each stage so far, in s.

    Raises:
        TypeError: If R is no form, or data no function.
        ValueError: For a residual of another rank, with unknowns, or on another space or mesh;
            a velocity in place of an increment of displacement in ``Kinematics``; points without
            their fields, or with masses or velocities that are not finite; a field that
            is renewed twice; options out of range; contacts of point sets that are no
            body, that bodies cannot have all at once, or of bodies that overlap by a cell or more;
            no dt for bodies without a law.
    """

    def __init__(
        self,
        R: ufl.Form,
        unknown: Unknown,
        bodies: MaterialPoints | Sequence[MaterialPoints],
        *,
        contacts: Sequence[Contact] = (),
        carried: Sequence[MaterialPoints] = (),
        bcs: Sequence[fem.DirichletBC] = (),
        updates: Mapping[MaterialPoints, Mapping[str, Any]] | None = None,
        data: Callable[[float, float], None] | None = None,
        on_exit: str = "error",
        dt: float | None = None,
        cfl: float = 0.4,
        flip: float = 1.0,
        damping: float = 0.0,
        rigid: Sequence[RigidBody] = (),
        observers: Sequence[Watcher] = (),
    ) -> None:
        """Check and compile everything. Collective."""
        if dt is not None:
            check_time_step(dt)
        if not (0 < cfl < math.inf and 0 <= flip <= 1 and 0 <= damping < 1):
            raise ValueError(
                f"cfl must be positive, flip in [0, 1] and damping in [0, 1), not {cfl}, {flip} "
                f"and {damping}"
            )
        if not (data is None or callable(data)):
            raise TypeError(
                "data must be a function of the times at the beginning and end of a step, not "
                f"{data!r}"
            )
        self.exits = Exits(on_exit)
        self.unknown, self.velocity = unknown, _velocity(unknown)
        V = unknown.space
        self.bodies = [bodies] if isinstance(bodies, MaterialPoints) else list(bodies)
        self.carried = list(carried)
        check_space(V)
        check_bodies(V, self.bodies, self.carried)
        check_functions([*self.bodies, *self.carried])
        check_bcs(bcs, V)
        self.residual = Residual(R, self.velocity, self.bodies, self.carried)
        warn_of_points_that_stay(
            [integral.subdomain_data() for integral in R.integrals()],
            [*self.bodies, *self.carried],
        )
        self.laws: dict[MaterialPoints, Law] = {
            body: sigma.law for body, sigma in self.residual.stresses.items()
        }
        for points in self.carried:
            if "u" not in points:
                points.add_field("u", (V.mesh.geometry.dim,))
        check_rigid(rigid, V.mesh.geometry.dim)
        for k, rigid_body in enumerate(rigid):
            for body in self.bodies if rigid_body.friction > 0 else ():
                if slip_on(k) not in body:
                    body.add_field(slip_on(k), (2, rigid_body.dim))
        self._fixed = unknown.bcs
        self.bcs, self.rigid = [*self._fixed, *bcs], list(rigid)
        self.contacts = list(contacts)
        self.data = data
        self.flip, self.damping = flip, damping
        self.time, self.number = 0.0, 0
        self.reaction = np.zeros(V.mesh.geometry.dim)
        self.seconds = Stopwatch()
        self._cfl, self._given_dt, self._warned = cfl, dt, False
        self.longest_dt = self._stable = math.inf
        self._h = _smallest_height(V.mesh)
        way = OnLattice if self._is_for_kernels() else ByForms
        self.dt = dt or 1.0
        self.duration = fem.Constant(V.mesh, self.dt)
        self._way: OnLattice | ByForms = way(self, self._all_updates(R, updates or {}))
        require_apart(self.contacts)
        self.dt = self._step_length()
        self._torn_off, self._next_look = TornOff(self.bodies, self.carried), _LOOK
        self._torn_off.look(self.time)
        self._observers = Observers(observers)

    def _all_updates(
        self, R: ufl.Form, updates: Mapping[MaterialPoints, Mapping[str, Any]]
    ) -> dict[MaterialPoints, dict[str, Any]]:
        """Return updates defined by fields of the residual, and the user's updates."""
        moving = [*self.bodies, *self.carried]
        found = renewals(R, dict.fromkeys(moving, self.duration * self.velocity))
        by_laws = {
            body: {name: sigma for name in ("sigma", *sigma.law.state)}
            for body, sigma in self.residual.stresses.items()
        }
        check_updates(updates, moving, {p: {**by_laws.get(p, {}), **found[p]} for p in moving})
        together = {
            points: {**found[points], **updates.get(points, {})}
            for points in moving
            if found[points] or points in updates
        }
        check_increments(R, together.values(), self.velocity)
        return together

    @property
    def has_data(self) -> bool:
        """Whether boundary values or loads are set in each step."""
        return self.data is not None or any(c.depends_on_time for c in self.unknown.conditions)

    def set_data(self) -> None:
        """Set boundary values and the user's data for the next step."""
        self.unknown.require_conditions(self._fixed)
        if self.has_data:
            self.unknown.set_conditions(self.time, self.time + self.dt)
        if self.data is not None:
            self.data(self.time, self.time + self.dt)

    def reaction_of(self, condition: Condition) -> npt.NDArray[np.float64]:
        """Return the force of a condition on the bodies in the last step in N. Collective.

        Args:
            condition: Condition made by ``Unknown.fix``.

        Returns:
            Force, shape ``(d,)``.
        """
        dofs, forces = self._way.support_forces()
        here = np.isin(dofs, _compat.bc_dofs(condition.bc))
        dim = self.velocity.function_space.mesh.geometry.dim
        value = np.bincount(dofs[here] % dim, forces[here], minlength=dim)
        return np.asarray(self.velocity.function_space.mesh.comm.allreduce(value))

    def mass(self) -> fem.Function:
        """Return the mass of the nodes in the last step in kg. Collective at first use."""
        return self._way.mass()

    def acceleration(self) -> fem.Function:
        """Return the nodal acceleration in the last step in m/s^2. Collective at first use."""
        return self._way.acceleration()

    def contact_forces(self, contact: Contact) -> fem.Function:
        """Return nodal forces of a contact on its second body in the last step in N. Collective.

        Args:
            contact: A contact of this simulation.

        Raises:
            ValueError: For any other contact.
        """
        if contact not in self.contacts or not isinstance(self._way, ByForms):
            raise ValueError(f"this simulation does not have the contact {contact!r}")
        function = fem.Function(self.velocity.function_space, name="contact force")
        function.x.array[:] = self._way.contact_forces(contact).ravel()
        return function

    def _is_for_kernels(self) -> bool:
        """Return whether fused kernels can compute the residual, apart from further terms."""
        mesh = self.velocity.function_space.mesh
        if self.contacts:  # kernels have one velocity per node
            return False
        if cell_geometry(mesh).boxes is None or self.residual.internal != set(self.bodies):
            return False
        if functions_of(self.bodies[0]) == "cpgimp":  # kernels have one size for all points
            return False
        if self.exits.on_exit != "error":  # kernels keep all points until the end of a block
            return False
        try:
            lattice = lattice_of(mesh)
        except ValueError:  # the mesh has holes
            return False
        # kernels use all nodes that a point can see; on narrower lattices it sees fewer
        width = WIDTH[KINDS[functions_of(self.bodies[0])]]
        return bool(np.all(lattice.shape + 1 >= width))

    # --- steps -------------------------------------------------------------------------------

    def step(self) -> Step:
        """Do one step. Collective.

        Raises:
            UnstableError: As for ``run``.
        """
        self._observers.start(self)
        self._observers.call("begin", self)
        removed = self._advance(1, self._step_length(), may_stay=True)
        return self._done(removed)

    def run(self, until: float, interval: float | None = None) -> Iterator[Step]:
        """Do steps until a time. Collective.

        Args:
            until: End in s.
            interval: Time between yielded steps in s; None for each step.

        Yields:
            Steps at whose end all points and fields are up to date, or are brought up to date as
            soon as somebody reads them.

        Raises:
            UnstableError: If a point is inverted, not finite or outside. All points are then as
                they were when somebody last read them, or up to 100 steps before; ``time`` is set
                accordingly. Nodal fields are not restored.
            ValueError: For an end that is not finite or an interval that is not positive.
        """
        if not math.isfinite(until) or not (interval is None or interval > 0):
            raise ValueError(
                f"the end of a run must be finite and its interval positive, not {until} s and "
                f"{interval} s"
            )
        while until - self.time > 1e-9 * self.dt:
            # counted from the current time, so that a restart there does the same
            stop = until if interval is None else min(until, self.time + interval)
            removed = 0
            self._observers.start(self)
            self._observers.call("begin", self)
            while stop - self.time > 1e-9 * self.dt:
                # equal steps that end at the stop, none longer than allowed
                left = stop - self.time
                steps = max(1, math.ceil(left / self._step_length() - 1e-9))
                count = min(steps, 1 if interval is None else self._way.longest)
                may_stay = interval is None or count < steps
                removed += self._advance(count, left / steps, may_stay)
                if interval is None:
                    break
            else:
                self.time = stop  # without the round-off of a sum of steps
            yield self._done(removed)

    def _done(self, removed: int) -> Step:
        """Return the last step, after observers have seen it."""
        if self.number >= self._next_look:
            self._torn_off.look(self.time)
            self._next_look = self.number + _LOOK
        step = Step(self.number, self.time, self.dt, removed=removed)
        self._observers.done(self, step)
        return step

    def _advance(self, steps: int, dt: float, may_stay: bool) -> int:
        """Do some steps, and return how many points left the mesh."""
        before = self.time, self.number
        self.dt = dt
        try:
            return self._way.advance(steps, may_stay)
        except BaseException:
            self.time, self.number = min(before, (self.time, self.number))
            raise

    def settle(self) -> None:
        """Bring all points up to date, so that a restart continues as this run. Collective."""
        self._way.settle()

    def end_of_step(self) -> None:
        """Count a step."""
        self.time += self.dt
        self.number += 1

    # --- checkpoints ---------------------------------------------------------------------------

    @property
    def method(self) -> str:
        """Name of the method with the number of rigid bodies, whose states are in ``memory``."""
        bodies = f" with {len(self.rigid)} rigid bodies" if self.rigid else ""
        return type(self).__name__ + bodies

    @property
    def slips(self) -> list[str]:
        """Names of the fields of slip on rigid bodies with friction."""
        return [slip_on(k) for k, rigid in enumerate(self.rigid) if rigid.friction > 0]

    @property
    def parameters(self) -> dict[str, str]:
        """Return choices of the script, for checkpoints."""
        said = {"flip": repr(self.flip), "damping": repr(self.damping)}
        for k, contact in enumerate(self.contacts):
            said[f"friction of contact {k}"] = repr(contact.friction)
        for k, body in enumerate(self.bodies):
            if body in self.laws:
                said[f"law of body {k}"] = repr(self.laws[body])
                said[f"averages of body {k}"] = repr(self.residual.averages.get(body))
        said |= {f"rigid body {k}": repr(body) for k, body in enumerate(self.rigid)}
        return {**said, **of_points([*self.bodies, *self.carried])}

    @property
    def memory(self) -> dict[str, float]:
        """Numbers that the next step depends on, in addition to the points, for checkpoints."""
        return {**self._way.memory, **memory_of(self.rigid), **self._observers.memory}

    @memory.setter
    def memory(self, values: Mapping[str, float]) -> None:
        rest = dict(values)
        self._observers.remember(rest)
        self._way.memory = dict(rest)
        remember(self.rigid, rest)

    # --- time step -----------------------------------------------------------------------------

    def stable_step(self) -> float:
        """Return the time of a wave through a cell in s, about the stable step. Collective.

        Raises:
            ValueError: If masses or velocities are not finite, or masses not positive.
        """
        fastest, error = 0.0, None
        for points in self.bodies:
            if len(points):
                modulus = self.laws[points].wave_speed_modulus if points in self.laws else 0.0
                error = error or wrong_number(points)
                if error is not None:
                    fastest = math.inf
                    continue
                density = float(np.min(points["mass"] / points["V_0"]))
                speed = float(np.sqrt(np.max(np.sum(points["v"] ** 2, axis=1))))
                fastest = max(fastest, speed + math.sqrt(modulus / density))
        require_points(self.bodies)
        comm = self.velocity.function_space.mesh.comm
        fastest = comm.allreduce(fastest, MPI.MAX)
        if fastest == math.inf:
            raise_together(comm, error)
        return self._h / fastest if fastest > 0 else math.inf

    @property
    def contact_rate(self) -> float:
        """Return the square of the rate in 1/s^2 at which waves cross cells, for contacts."""
        if len(self.laws) == len(self.bodies):
            return 1 / self._stable**2
        return math.inf  # limited by the step only

    def _step_length(self) -> float:
        if self._way.is_open:
            return self.longest_dt
        if self._given_dt is None and len(self.laws) < len(self.bodies):
            raise ValueError(
                "no law at points gives the wave speed of a body: set the time step dt"
            )
        stable = self.stable_step()
        self._stable = stable
        dt = self._cfl * stable if self._given_dt is None else self._given_dt
        if dt > stable and not self._warned:
            self._warned = True
            logger.warning(
                "the time step of %g s is above the limit of stability, about %g s", dt, stable
            )
        self.longest_dt = dt
        return dt

    def raise_if(self, messages: list[str]) -> None:
        """Raise an UnstableError on all ranks if there is a message on any rank. Collective."""
        comm = self.velocity.function_space.mesh.comm
        if comm.size > 1:
            messages = [m for some in comm.allgather(messages) for m in some]
        if messages:
            raise UnstableError(
                f"step {self.number + 1}, t = {self.time + self.dt:g} s, dt = {self.dt:g} s: "
                f"{messages[0]}; the stable step is about {self._stable:g} s{self._hint()}"
            )

    def _hint(self) -> str:
        """Return possible reasons of the instability."""
        hints = [
            f"the rigid body {body.name} pushed with {body.force} N: give it a larger reach or a "
            "lower stiffness, or start further away from it"
            for body in self.rigid
            if np.any(body.force)
        ]
        if self.dt > self._stable:
            hints.append("the step is longer than that: take smaller ones")
        elif not hints:
            hints.append(
                "where points fill few nodes, as in thin films along walls, steps must be "
                "shorter: lower cfl"
            )
        return "".join(f"; {hint}" for hint in hints)

    def _facts(self) -> Facts:
        return [
            ("time", f"{self.time:g} s"),
            ("steps done", str(self.number)),
            ("step length", f"{self.dt:g} s"),
            *facts_of_bodies(self.bodies, self.laws, self.carried, self.rigid),
            *(("contact", repr(contact)) for contact in self.contacts),
            *self._way.facts(),
            ("time spent", str(self.seconds)),
        ]

    def __repr__(self) -> str:
        """Return the same text as printing."""
        return str(self)


def _smallest_height(mesh: Any) -> float:
    """Return the smallest distance of a node from the opposite facet in m. Collective."""
    geometry = cell_geometry(mesh)
    if geometry.boxes is not None:
        return float(geometry.boxes.spacing.min())
    centre = 1 / (geometry.dim + 1) if geometry.is_simplex else 0.5
    steepest = 0.0
    for cells in geometry.blocks():
        gradients = geometry.inverse_jacobian(cells, np.full((len(cells), geometry.dim), centre))
        if geometry.is_simplex:
            last = gradients.sum(axis=1, keepdims=True)
            gradients = np.concatenate([gradients, last], axis=1)
        steepest = max(steepest, float(np.max(np.sum(gradients**2, axis=2))))
    return 1.0 / math.sqrt(mesh.comm.allreduce(steepest, MPI.MAX))


def _velocity(unknown: Unknown) -> fem.Function:
    """Return the function of an unknown that consists of a velocity only."""
    if len(unknown.parts) != 1 or not unknown.parts[0].is_vector or unknown.moving is not None:
        raise ValueError(
            'the unknown of explicit steps must be the velocity of the nodes, Unknown(mesh, "v"), '
            f"not {unknown!r}"
        )
    return unknown.U
