# SPDX-License-Identifier: MIT
"""Explicit steps by forms: any mesh, any grid functions, any residual.

This module states once in UFL what the fused kernels on lattices do in fewer passes over the
points.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem, la

from fenicsmpm import _compat, forms
from fenicsmpm._display import Facts
from fenicsmpm.basis import functions_of
from fenicsmpm.formulations.fbar import FBar
from fenicsmpm.formulations.internal_force import (
    CauchyStress,
    averaged_J,
    moved_F,
)
from fenicsmpm.formulations.kinematics import embed
from fenicsmpm.materials import Law, state_of, stress
from fenicsmpm.points import MaterialPoints
from fenicsmpm.points.migration import PointsOutsideError
from fenicsmpm.rigid.body import TOTALS
from fenicsmpm.simulation.contact import Contact, share_velocities
from fenicsmpm.simulation.nodal_field import ContactsOfFields, NodalField, mean, share_out
from fenicsmpm.simulation.rigid_state import slip_on
from fenicsmpm.simulation.unstable import force_without_material
from fenicsmpm.transfer import p2g
from fenicsmpm.transfer.contact import keep_points_out, push_points
from fenicsmpm.transfer.light_nodes import LIGHT, LIGHT_FOR_LOADS, LightNodes
from fenicsmpm.transfer.wall_averages import WallsOfBody, continue_to_walls

if TYPE_CHECKING:
    from fenicsmpm.simulation.explicit import ExplicitMPM

Array = npt.NDArray[np.float64]


class BodyByForms:
    """Updates at the points of a body in a step, in UFL.

    Args:
        points: The body.
        sigma: Its stress by a law at points; None if all of its forces are UFL.
        averages: Averages of J for stresses; None for J itself.
        velocity: Velocity of the grid at the end of the step in m/s.
        increment: Change of this velocity in the step in m/s.
        straining: Velocity of the grid in m/s whose gradient deforms the points.
        dt: Length of the step in s.
        flip: Fraction of FLIP in the points' velocities.
        scalars: Space of a scalar on the nodes.
        updates: Further fields to be updated, see ``ExplicitMPM``.
    """

    def __init__(
        self,
        points: MaterialPoints,
        sigma: CauchyStress | None,
        averages: FBar | None,
        velocity: fem.Function,
        increment: fem.Function,
        straining: fem.Function,
        dt: fem.Constant,
        flip: fem.Constant,
        scalars: fem.FunctionSpace,
        updates: Mapping[str, Any],
    ) -> None:
        """Write the updates in UFL and compile them. Collective."""
        self.points, self._averages = points, averages
        law = sigma.law if sigma is not None else None
        f = ufl.Identity(points.mesh.geometry.dim) + dt * ufl.grad(straining)
        F = moved_F(points, f, averages, law is not None and law.is_fluid)
        motion = {
            "v": flip * (points.field("v") + increment) + (1 - flip) * velocity,
            "x": dt * velocity,
        }
        fields = {"F": F, "J": ufl.det(F), **updates}
        if averages is not None:
            fields["J_bar"] = averaged_J(points, f, averages)
            self._mean = fem.Function(scalars)
            self._mean_at_points = forms.PointExpression(self._mean, points)
            self._walls = WallsOfBody(points).at(scalars.tabulate_dof_coordinates())
        if law is not None and law.needs_rate:
            fields["L"] = embed(ufl.grad(straining))
        self._motion = forms.FieldUpdates(points, motion)
        self._strain = forms.FieldUpdates(points, fields)
        self._scalars = scalars

    def momentum(self, space: fem.FunctionSpace, v: Array) -> Array:
        """Return nodal mass in kg and momentum in kg m/s, ``(n_nodes, 1 + d)``. Collective."""
        columns = np.column_stack([np.ones(len(v)), v]) * self.points["mass"][:, None]
        return p2g(self.points, columns, space, positive=True).array.reshape(-1, columns.shape[1])

    def moved(self) -> dict[str, Array]:
        """Return velocities "v", displacements "u" and positions "x" after the step."""
        return _summed(self.points, self._motion.evaluate())

    def strained(self, law: Law | None) -> dict[str, Array]:
        """Return other fields after the step, by the current law; points do not change."""
        new = self._strain.evaluate()
        if self._averages is not None:
            new["J_bar"] = self._average(new["J_bar"]) * self.points["J_0"]
        if law is not None:
            F = new["F"]
            if self._averages is not None:
                F = F.copy()
                dim = self.points.mesh.geometry.dim
                F[:, :dim] *= ((new["J_bar"] / new["J"]) ** (1 / dim))[:, None, None]
            state = state_of(law, self.points)
            new["sigma"] = stress(law, F, new.pop("L", None), state)
            new |= {name: law.state_field(state, name).copy() for name in law.state}
        return new

    def _average(self, J: Array) -> Array:
        """Return the volume average over the grid at the points (F-bar, eq. 19). Collective."""
        volume = self.points.weight
        columns = np.column_stack([volume, volume * J])
        sums = p2g(self.points, columns, self._scalars, positive=True).array.reshape(-1, 2)
        where = sums[:, 0] > 0
        self._mean.x.array[:] = 0.0
        np.divide(sums[:, 1], sums[:, 0], out=self._mean.x.array, where=where)
        continue_to_walls(self._mean.x.array, sums[:, 0], self._walls)
        self._mean.x.scatter_forward()  # neighbours of ghost nodes may be on other ranks
        return self._mean_at_points.evaluate()


class ByForms:
    """Stages of explicit steps, each of them a form or a sum on the grid.

    Args:
        sim: The simulation, which defines residual, points and options.
        updates: Further fields to be updated.

    Attributes:
        longest: Number of steps that may be done before points are brought up to date.
    """

    longest = 1
    is_open = False

    def __init__(
        self, sim: ExplicitMPM, updates: Mapping[MaterialPoints, Mapping[str, Any]]
    ) -> None:
        """Compile the stages. Collective."""
        self._sim, residual = sim, sim.residual
        V = sim.velocity.function_space
        mesh = V.mesh
        self._V, self._dim = V, mesh.geometry.dim
        self._scalars = fem.functionspace(mesh, ("Lagrange", 1))
        self._mass = fem.Function(self._scalars, name="mass")
        self._acceleration = fem.Function(V, name="acceleration")
        self._increment = fem.Function(V, name="increment")
        self._flip = fem.Constant(mesh, float(sim.flip))
        self._force = la.vector(V.dofmap.index_map, self._dim)
        self._elsewhere = residual.elsewhere and forms.form(residual.elsewhere)
        self._maps_back = functions_of(sim.bodies[0]) == "linear" or bool(sim.contacts)
        self._straining = fem.Function(V) if self._maps_back else sim.velocity
        self._bodies = {
            body: BodyByForms(
                body,
                residual.stresses.get(body),
                residual.averages.get(body),
                sim.velocity,
                self._increment,
                self._straining,
                sim.duration,
                self._flip,
                self._scalars,
                updates.get(body, {}),
            )
            for body in sim.bodies
        }
        self._light_nodes = LightNodes(V)
        shape = self._increment.x.array.reshape(-1, self._dim).shape
        self._fields = [
            NodalField([self._bodies[body] for body in group], self._form_of(group), shape)
            for group in share_velocities(sim.bodies, sim.contacts)
        ]
        self._contacts = ContactsOfFields(
            sim.contacts, self._fields, V, self._scalars, self._light_nodes
        )
        self._carried = {
            points: forms.FieldUpdates(
                points,
                {"x": sim.duration * sim.velocity, **updates.get(points, {})},
            )
            for points in sim.carried
        }
        self._supported: Array = np.empty(0)

    def _form_of(self, bodies: Sequence[MaterialPoints]) -> Any:
        """Return the compiled integrals over the points of some bodies; None for none."""
        part = self._sim.residual.at(bodies)
        return part and forms.form(part)

    def mass(self) -> fem.Function:
        """Return the mass of the nodes in the last step in kg."""
        return self._mass

    def acceleration(self) -> fem.Function:
        """Return the acceleration of the nodes in the last step in m/s^2."""
        return self._acceleration

    def support_forces(self) -> tuple[npt.NDArray[np.int32], Array]:
        """Return owned dofs and the force in N at each, see ``ExplicitMPM.reaction_of``."""
        return np.arange(len(self._supported), dtype=np.int32), self._supported

    def contact_forces(self, contact: Contact) -> Array:
        """Return nodal forces in N, ``(n_nodes, d)``, see ``ExplicitMPM.contact_forces``."""
        return self._contacts.nodal_forces(contact)

    def settle(self) -> None:
        """Do nothing: all points are up to date."""

    def advance(self, steps: int, may_stay: bool) -> int:
        """Do steps. If one fails, all points are as they were before. Collective.

        Args:
            steps: Number of steps.
            may_stay: Ignored, since points are always up to date.

        Returns:
            Number of points that left the mesh.
        """
        sim = self._sim
        moving = [*sim.bodies, *sim.carried]
        states = [body.state for body in sim.rigid]
        held = dict(sim.exits.held)
        before = [(points, points.snapshot(copy=False), points.size_global) for points in moving]
        try:
            return sum(self._step() for _ in range(steps))
        except BaseException:
            for points, arrays, size_global in before:
                points.restore(arrays, size_global)
            sim.exits.held = held
            for rigid, state in zip(sim.rigid, states, strict=True):
                rigid.state = state
            raise

    def _step(self) -> int:
        sim, clock = self._sim, self._sim.seconds
        sim.duration.value, self._flip.value = sim.dt, sim.flip
        sim.set_data()
        with clock("P2G"):
            self._points_to_grid()
        with clock("forces"):
            self._forces()
            slips = self._push()
            self._contacts.push(sim.contact_rate, sim.dt)
        with clock("grid"):
            self._move_nodes()
        with clock("G2P"):
            new: dict[MaterialPoints, dict[str, Array]] = {}
            for field in self._fields:
                self._show(field)
                new |= {body.points: body.moved() | slips[body.points] for body in field.bodies}
            self._hold_back(new)
        if self._maps_back:
            with clock("P2G"):
                self._map_back(new)
        with clock("G2P"):
            for field in self._fields:
                self._show(field)
                for body in field.bodies:
                    new[body.points] |= body.strained(sim.laws.get(body.points))
            self._show_mean()
            for points, update in self._carried.items():
                new[points] = _summed(points, update.evaluate())
        sim.raise_if([m for points in sim.bodies if (m := _fault(points, new[points]))])
        with clock("convect"):
            removed = self._convect(new)
        sim.end_of_step()
        return removed

    def _show(self, field: NodalField) -> None:
        """Copy the velocities of a field to the functions that forms and expressions use."""
        self._sim.velocity.x.array[:] = field.velocity.ravel()
        self._increment.x.array[:] = field.increment.ravel()
        if self._maps_back:
            self._straining.x.array[:] = field.straining.ravel()

    def _show_mean(self) -> None:
        """Copy the mass-weighted mean of all fields likewise."""
        self._sim.velocity.x.array[:] = mean("velocity", self._fields).ravel()
        self._increment.x.array[:] = mean("increment", self._fields).ravel()
        self._acceleration.x.array[:] = self._increment.x.array / self._sim.dt

    def _points_to_grid(self) -> None:
        """Compute mass and velocity of the nodes."""
        for field in self._fields:
            v = {body.points: body.points["v"] for body in field.bodies}
            field.mass, field.velocity = self._nodal_velocity(field, v)
        self._mass.x.array[:] = np.sum([field.mass for field in self._fields], axis=0)

    def _nodal_velocity(
        self, field: NodalField, v: Mapping[MaterialPoints, Array]
    ) -> tuple[Array, Array]:
        """Return nodal masses in kg, and nodal velocities from those of the points."""
        sums = np.sum([body.momentum(self._V, v[body.points]) for body in field.bodies], axis=0)
        mass = sums[:, :1]
        # where functions end, round-off may have either sign
        mass[mass <= self._least_mass()] = 0.0
        momentum = sums[:, 1:]
        velocity = np.divide(momentum, mass, out=np.zeros_like(momentum), where=mass > 0)
        return mass[:, 0], velocity

    def _map_back(self, new: Mapping[MaterialPoints, dict[str, Array]]) -> None:
        """Compute the velocity whose gradient deforms points of linear functions: `light_nodes`."""
        for field in self._fields:
            v = {body.points: new[body.points]["v"] for body in field.bodies}
            _, field.straining = self._nodal_velocity(field, v)
            self._constrain(field.straining)

    def _constrain(self, velocity: Array) -> None:
        """Apply Dirichlet conditions to velocities ``(n_nodes, d)``, in place. Collective."""
        v = self._sim.velocity
        v.x.array[:] = velocity.ravel()
        for bc in self._sim.bcs:
            _compat.bc_set(bc, v.x.array, None, 1.0)
        v.x.scatter_forward()
        velocity[:] = v.x.array.reshape(-1, self._dim)

    def _forces(self) -> None:
        """Compute forces: minus the residual, moved from light nodes to their neighbours."""
        for field in self._fields:
            field.force = np.zeros_like(field.velocity)
            if field.form is not None:
                self._show(field)
                field.force -= self._assembled(field.form, field.mass, LIGHT, False)
        if self._elsewhere is not None:
            self._show_mean()
            # loads act at surfaces, where more nodes are light
            force = self._assembled(self._elsewhere, self._mass.x.array, LIGHT_FOR_LOADS, True)
            share_out(-force, self._fields)

    def _assembled(self, form: Any, mass: Array, light: float, of_loads: bool) -> Array:
        """Return a form ``(n_nodes, d)`` without forces on light nodes. Collective."""
        force = self._force
        force.array[:] = 0.0
        forms.assemble_vector(form, force)
        force.scatter_reverse(la.InsertMode.add)
        force.scatter_forward()
        nodes = force.array.reshape(-1, self._dim)
        self._light_nodes.relieve(mass, nodes, light, of_loads)
        return nodes

    def _push(self) -> dict[MaterialPoints, dict[str, Array]]:
        """Add contact forces of rigid bodies to the nodes, and return slips of points on them."""
        sim, messages = self._sim, []
        slips = {body: {name: body[name].copy() for name in sim.slips} for body in sim.bodies}
        self._pushed = np.zeros((len(sim.rigid), TOTALS))
        for k, rigid in enumerate(sim.rigid):
            rigid.begin(sim.time)
            for field, body in self._all_points():
                slip = self._slip(slips[body], k)
                forces, bad = push_points(
                    body.x, body["v"], slip, body["mass"], rigid.contact(sim.longest_dt),
                    sim.dt, self._pushed[k],
                )  # fmt: skip
                if bad >= 0:
                    messages.append(f"a point is inside of the rigid body {rigid.name}")
                field.force += p2g(body, forces, self._V).array.reshape(-1, self._dim)
        if sim.rigid:
            sim.raise_if(messages)
            self._V.mesh.comm.Allreduce(MPI.IN_PLACE, self._pushed, MPI.SUM)
        return slips

    def _hold_back(self, new: Mapping[MaterialPoints, dict[str, Array]]) -> None:
        """Move rigid bodies, and keep points out of them."""
        sim, held = self._sim, np.zeros((len(self._sim.rigid), TOTALS))
        for k, rigid in enumerate(sim.rigid):
            rigid.move(sim.time, sim.dt, self._pushed[k])
            contact = rigid.contact(sim.longest_dt)
            for body, fields in new.items():
                x_next = fields["x"]
                free = x_next.copy()
                keep_points_out(
                    body.x, x_next, fields["v"], self._slip(fields, k),
                    body["mass"], contact, sim.dt, held[k],
                )  # fmt: skip
                fields["u"] += x_next - free
        if sim.rigid:
            self._V.mesh.comm.Allreduce(MPI.IN_PLACE, held, MPI.SUM)
        for rigid, total in zip(sim.rigid, held, strict=True):
            rigid.end(sim.dt, total)

    def _slip(self, fields: Mapping[str, Array], number: int) -> Array:
        """Return slip on a rigid body ``(n, 2 d)``, without rows if there is no friction."""
        slip = fields.get(slip_on(number), np.empty((0, 2, self._dim)))
        return slip.reshape(len(slip), 2 * self._dim)

    def _all_points(self) -> Iterator[tuple[NodalField, MaterialPoints]]:
        """Yield bodies with their nodal fields."""
        for field in self._fields:
            yield from ((field, body.points) for body in field.bodies)

    def _move_nodes(self) -> None:
        """Solve the momentum balance of the nodes (F-bar, eq. 9): damping, conditions, contact."""
        sim, dt, owned = self._sim, self._sim.dt, self._V.dofmap.index_map.size_local
        fixed: npt.NDArray[np.bool_] = np.zeros(self._force.array.size, dtype=np.bool_)
        fixed[_compat.fixed_dofs(sim.bcs)] = True
        fixed = fixed.reshape(-1, self._dim)
        push, before = np.zeros(fixed.shape), [field.velocity.copy() for field in self._fields]
        for field in self._fields:
            mass, v, f = field.mass[:, None], field.velocity, field.force
            nowhere = (field.mass == 0) & (f != 0).any(axis=1)
            sim.raise_if(self._describe_load(np.flatnonzero(nowhere[:owned])))
            start = v.copy()
            damped = f - sim.damping * np.abs(f) * np.sign(v)
            v += np.divide(dt * damped, mass, out=np.zeros_like(f), where=mass > 0)
            self._constrain(v)
            # supported nodes are not damped: the reaction to a body at rest is its weight
            push += np.where(fixed, mass * (v - start) / dt - f, 0.0)
        sim.reaction = self._V.mesh.comm.allreduce(push[:owned].sum(axis=0))
        self._supported = push[:owned].ravel()
        self._contacts.rub(fixed, dt)
        for field, v in zip(self._fields, before, strict=True):
            field.increment = field.velocity - v

    def _describe_load(self, nodes: npt.NDArray[np.intp]) -> list[str]:
        if not len(nodes):
            return []
        where = self._V.tabulate_dof_coordinates()[nodes[0], : self._dim]
        return [force_without_material(where)]

    def _convect(self, new: Mapping[MaterialPoints, dict[str, Array]]) -> int:
        """Assign new fields to the points, and move them."""
        sim, removed = self._sim, 0
        for points, fields in new.items():
            points.assign({name: array for name, array in fields.items() if name != "x"})
            if points in sim.bodies:
                points.assign({"weight": points["V_0"] * points["J"]})
            try:
                removed += sim.exits.move(points, fields["x"])
            except PointsOutsideError as error:
                sim.raise_if([f"a point leaves the mesh: {error}"])
        return removed

    def _least_mass(self) -> float:
        """Return a mass in kg far below that of any point at a node in its support."""
        least = min(float(np.min(body["mass"], initial=np.inf)) for body in self._sim.bodies)
        return 1e-16 * self._V.mesh.comm.allreduce(least, MPI.MIN)

    @property
    def memory(self) -> dict[str, float]:
        """Nothing to remember."""
        return {}

    @memory.setter
    def memory(self, values: Mapping[str, float]) -> None:
        pass

    def facts(self) -> Facts:
        """Return that everything is done by forms."""
        parts = [field.form for field in self._fields] + [self._elsewhere]
        return [("by forms", repr(form)) for form in parts if form is not None]


def _summed(points: MaterialPoints, new: dict[str, Array]) -> dict[str, Array]:
    """Return new fields with displacements "u" and positions "x", from increments in "x"."""
    increment = new["x"]
    return {**new, "u": points["u"] + increment, "x": points.x + increment}


def _fault(points: MaterialPoints, new: Mapping[str, Array]) -> str | None:
    """Return what is wrong with a point after a step, and where it is; None if all is well."""
    J = new["J"] + 0 * new["v"].sum(axis=1)  # NaN if either is
    stressed = np.isfinite(new["sigma"]).all(axis=(1, 2)) if "sigma" in new else True
    good = (J > 0) & np.isfinite(J) & stressed
    if good.all():
        return None
    i = int(np.argmin(good))
    what = (
        "is inverted"
        if J[i] <= 0
        else "has a stress that is not finite"
        if np.isfinite(J[i])
        else "is not finite"
    )
    where = np.array2string(points.x[i], precision=6)
    return f"point {points.id[i]} {what} at {where} with J = {J[i]:g}"
