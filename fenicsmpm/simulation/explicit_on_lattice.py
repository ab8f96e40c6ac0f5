# SPDX-License-Identifier: MIT
"""Explicit steps by the fused kernels of lattices, with further forces by forms beside."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
from dolfinx import fem, la

from fenicsmpm import forms
from fenicsmpm.basis.lattice_stencil import KINDS
from fenicsmpm.points import MaterialPoints
from fenicsmpm.simulation.explicit_checks import functions_of
from fenicsmpm.simulation.lattice_engine import LatticeEngine

if TYPE_CHECKING:
    from fenicsmpm.simulation.explicit import ExplicitMPM

Array = npt.NDArray[np.float64]

# Steps after which cells are found and points sorted: more would cost time, as would fewer
STEPS_OF_A_BLOCK = 100


class OnLattice:
    """The stages of explicit steps by fused kernels, see ``LatticeEngine``.

    Args:
        sim: the simulation, whose residual, points and options are taken.
        updates: further fields to be renewed.

    Attributes:
        mass: of the nodes in the last step [kg].
        acceleration: of the nodes in the last step [m/s^2].
        longest: how many steps may be done before points are up to date.
    """

    def __init__(
        self, sim: ExplicitMPM, updates: Mapping[MaterialPoints, Mapping[str, Any]]
    ) -> None:
        """Prepare; kernels are compiled in the first step (collective)."""
        self._sim, residual = sim, sim.residual
        V = sim.velocity.function_space
        self._dim = V.mesh.geometry.dim
        self.mass = fem.Function(fem.functionspace(V.mesh, ("Lagrange", 1)), name="mass")
        self.acceleration = fem.Function(V, name="acceleration")
        self._engine = LatticeEngine(
            V,
            sim.laws,
            [residual.averages[body] for body in sim.bodies],
            sim.carried,
            KINDS[functions_of(sim.bodies[0])],
        )
        self._tractions = {
            points: forms.PointExpression(t, points) for points, t in residual.loads.items()
        }
        self._updates = {
            points: forms.FieldUpdates(points, fields) for points, fields in updates.items()
        }
        self._at_bodies, self._elsewhere = (
            None if rest is None else forms.form(rest)
            for rest in (residual.rest_at_bodies, residual.rest_elsewhere)
        )
        self._nodal = la.vector(V.dofmap.index_map, self._dim)
        # forms and updates take points where they are
        is_fused = self._at_bodies is None and self._elsewhere is None and not self._updates
        self.longest = STEPS_OF_A_BLOCK if is_fused else 1
        self._unsorted = 0

    def advance(self, steps: int) -> int:
        """Do steps; if one fails, all points are as before (collective).

        Returns:
            How many points left the mesh.
        """
        sim, engine, clock = self._sim, self._engine, self._sim.seconds
        ways = [box.moved for box in sim.rigid]
        try:
            with clock("begin"):
                engine.begin(sim.laws, sim.bcs)
            for k in range(steps):
                self._step(again=k < steps - 1)
                sim.end_of_step()
            faults = [(part, part.bad_stress()) for part in engine.parts]
            sim.raise_if([part.describe(block) for part, block in faults if block >= 0])
            new = {points: update.evaluate() for points, update in self._updates.items()}
        except BaseException:
            for box, way in zip(sim.rigid, ways, strict=True):
                box.moved = way
            raise
        with clock("convect"):
            for points, fields in new.items():
                points.assign(fields)
            self._unsorted += steps
            sort = self._unsorted >= STEPS_OF_A_BLOCK
            engine.settle(sort)
            if sort:
                self._unsorted = 0
        return 0

    def _step(self, again: bool) -> None:
        sim, engine, dt, clock = self._sim, self._engine, self._sim.dt, self._sim.seconds
        if sim.data is not None:
            sim.data(sim.time, sim.time + dt)
            engine.read_supports()
        velocities = [box.velocity_at(sim.time) for box in sim.rigid]
        messages = []
        with clock("P2G"):
            for box, velocity in zip(sim.rigid, velocities, strict=True):
                box.force = np.zeros_like(box.force)
                messages += engine.push(box, velocity, dt)
            engine.sum_nodes(sim.residual.gravity)
        with clock("forces"):
            messages += self._forces()
        with clock("grid"):
            reaction = engine.move_nodes(dt, sim.damping)
            messages += engine.move_loads(dt)
        with clock("G2P"):
            messages += engine.gather(dt, sim.flip)
            for box, velocity in zip(sim.rigid, velocities, strict=True):
                box.moved = box.moved + dt * velocity
                messages += engine.hold_back(box, velocity, dt)
        with clock("grid"):
            anew = self._agree(messages, reaction)
            if not again:
                self._write_nodes()
            engine.average()
        with clock("stress and P2G"):
            engine.finish(again, anew)

    def _forces(self) -> list[str]:
        """Add what is neither internal force nor gravity; what is wrong, on this rank."""
        engine, velocity = self._engine, self._sim.velocity
        loads = {
            points: points.weight[:, None] * traction.evaluate()
            for points, traction in self._tractions.items()
        }
        if self._at_bodies is not None or self._elsewhere is not None:
            engine.write("mass", self.mass)
            engine.write("momentum", velocity)
            momentum, mass = velocity.x.array.reshape(-1, self._dim), self.mass.x.array[:, None]
            np.divide(momentum, mass, out=momentum, where=mass > 0)
        if self._at_bodies is not None:
            engine.add_forces(self._assemble(self._at_bodies))
        at_nodes = None if self._elsewhere is None else self._assemble(self._elsewhere)
        return engine.add_loads(loads, at_nodes) if loads or at_nodes is not None else []

    def _assemble(self, form: forms.Form) -> Array:
        """Minus a part of the residual, at the nodes of this rank, ``(n, d)`` [N]."""
        force = self._nodal
        force.array[:] = 0.0
        forms.assemble_vector(form, force)
        force.scatter_reverse(la.InsertMode.add)
        owned = force.index_map.size_local
        return -force.array.reshape(-1, self._dim)[:owned]

    def _write_nodes(self) -> None:
        """Nodal fields at the end of a step as functions."""
        engine = self._engine
        engine.write("mass", self.mass)
        engine.write("velocity", self._sim.velocity)
        engine.write("increment", self.acceleration)
        self.acceleration.x.array[:] /= self._sim.dt

    def _agree(self, messages: list[str], reaction: Array) -> bool:
        """Sum up over ranks what each has found in a step (collective).

        Returns:
            Whether points have left their tiles on any rank.
        """
        sim, strays = self._sim, self._engine.strays
        comm, failed = sim.velocity.function_space.mesh.comm, len(messages) > 0
        if comm.size > 1:
            forces = [box.force for box in sim.rigid]
            mine = np.concatenate([[float(failed), float(strays)], reaction, *forces])
            comm.Allreduce(MPI.IN_PLACE, mine, MPI.SUM)
            failed, strays = mine[0] > 0, mine[1] > 0
            reaction, *forces = np.split(mine[2:], np.cumsum([3, *map(len, forces)])[:-1])
            for box, force in zip(sim.rigid, forces, strict=True):
                box.force = force.copy()
        if failed:
            sim.raise_if(messages)
        sim.reaction = reaction[: self._dim].copy()
        return bool(strays)

    @property
    def memory(self) -> dict[str, float]:
        """Steps since points were sorted."""
        return {"unsorted": float(self._unsorted)}

    @memory.setter
    def memory(self, values: Mapping[str, float]) -> None:
        self._unsorted = int(values["unsorted"])

    def __repr__(self) -> str:
        """Which part of the residual goes which way."""
        kernels = ["internal forces"]
        if self._sim.residual.gravity:
            kernels.append("gravity")
        if self._tractions:
            kernels.append("loads")
        text = f"by fused kernels: {', '.join(kernels)}"
        rest = [form for form in (self._at_bodies, self._elsewhere) if form is not None]
        return text + "".join(f"; by forms: {form}" for form in rest)
