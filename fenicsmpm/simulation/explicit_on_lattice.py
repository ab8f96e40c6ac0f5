# SPDX-License-Identifier: MIT
"""Explicit steps by the fused kernels of lattices, with additional forces by forms."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
from dolfinx import fem, la

from fenicsmpm import forms
from fenicsmpm._display import Facts
from fenicsmpm.basis import functions_of
from fenicsmpm.basis.lattice_stencil import KINDS
from fenicsmpm.points import MaterialPoints
from fenicsmpm.points.agreement import raise_together
from fenicsmpm.points.location import locator
from fenicsmpm.rigid.body import TOTALS
from fenicsmpm.simulation.lattice_engine import LatticeEngine
from fenicsmpm.simulation.rigid_state import slip_on

if TYPE_CHECKING:
    from fenicsmpm.simulation.explicit import ExplicitMPM

Array = npt.NDArray[np.float64]

# Number of steps after which cells are found and points sorted: both more and fewer are slower.
STEPS_OF_A_BLOCK = 100


class OnLattice:
    """Stages of explicit steps by fused kernels, see ``LatticeEngine``.

    Args:
        sim: The simulation, which defines residual, points and options.
        updates: Further fields to be updated.

    Attributes:
        is_open: Whether points are in working arrays.
    """

    def __init__(
        self, sim: ExplicitMPM, updates: Mapping[MaterialPoints, Mapping[str, Any]]
    ) -> None:
        """Prepare the stages; kernels are compiled in the first step. Collective."""
        self._sim, residual = sim, sim.residual
        V = sim.velocity.function_space
        self._dim = V.mesh.geometry.dim
        # created when somebody needs them: arrays over the whole lattice
        self._functions: dict[str, fem.Function] = {}
        self._last: dict[str, tuple[Callable[[fem.Function], None], float]] = {}
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
        # forms and updates need up-to-date points
        self._may_stay = self._at_bodies is None and self._elsewhere is None and not self._updates
        self._unsorted, self._count, self.is_open = 0, 0, False
        self._before: list[Any] = []

    @property
    def longest(self) -> int:
        """Number of steps that may be done at once."""
        # the user's data may read the points
        if not self._may_stay or self._sim.has_data:
            return 1
        return STEPS_OF_A_BLOCK - (self._count if self.is_open else 0)

    def advance(self, steps: int, may_stay: bool) -> int:
        """Do steps. If one fails, all points are as they were at the beginning of the block.

        Collective.

        Args:
            steps: Number of steps.
            may_stay: Whether points may stay in working arrays until somebody reads them.

        Returns:
            Number of points that left the mesh.
        """
        sim, clock = self._sim, self._sim.seconds
        stays = may_stay and self._may_stay
        sim.set_data()
        if self.is_open and self._has_changed():
            self.settle()
        if not self.is_open:
            raise_together(sim.velocity.function_space.mesh.comm, self._not_plane())
        try:
            if not self.is_open:
                with clock("begin"):
                    self._begin()
            for k in range(steps):
                is_last = k == steps - 1
                self._step(again=stays or not is_last, keep=is_last)
                sim.end_of_step()
                self._unsorted += 1
                self._count += 1
            faults = [(part, part.bad_stress()) for part in self._engine.parts]
            sim.raise_if([part.describe(block) for part, block in faults if block >= 0])
            sim.duration.value = sim.dt
            new = {points: update.evaluate() for points, update in self._updates.items()}
        except BaseException:
            self._go_back()
            raise
        with clock("convect"):
            for points, fields in new.items():
                points.assign(fields)
            if stays and self._count < STEPS_OF_A_BLOCK and self._are_at_home():
                self._engine.defer()
                for carried in self._engine.carried:
                    carried.settle()
            else:
                self.settle()
        return 0

    def _begin(self) -> None:
        """Begin a block of steps, and store the state at its beginning."""
        sim = self._sim
        points = [*sim.bodies, *sim.carried]
        self._before = [(p, p.snapshot(copy=False), p.size_global) for p in points]
        self._mark = sim.time, sim.number, [body.state for body in sim.rigid], self._unsorted
        self._laws, self._bcs = dict(sim.laws), list(sim.bcs)
        self._engine.begin(sim.laws, sim.bcs, sim.slips)
        self.is_open, self._count = True, 0

    def _not_plane(self) -> ValueError | None:
        """Return an error if 2D kernels would lose a part of F."""
        if self._dim == 3:
            return None
        for body in self._sim.bodies:
            F = body["F"]
            if np.any(F[:, :2, 2] != 0) or np.any(F[:, 2, :2] != 0):
                return ValueError(
                    "fused kernels in 2D need deformation gradients without out-of-plane shear: "
                    "multiply internal_force by a fem.Constant, and forms are used instead, which "
                    "keep all of F"
                )
        return None

    def _has_changed(self) -> bool:
        """Return whether points were read, or laws or conditions replaced. Collective."""
        sim = self._sim
        changed = self._engine.is_looked_at or self._laws != sim.laws or self._bcs != sim.bcs
        return sim.velocity.function_space.mesh.comm.allreduce(changed, MPI.LOR)

    def _are_at_home(self) -> bool:
        """Return whether each point is in a cell that its rank owns. Collective."""
        mesh = self._sim.velocity.function_space.mesh
        if mesh.comm.size == 1:
            return True
        place = locator(mesh)
        home = True
        positions = [part.near_border for part in self._engine.parts]
        positions += [carried.positions for carried in self._engine.carried]
        for x in positions:
            cell, xi = place.locate(x, owned=True)
            home &= bool(np.all(place.is_sure(cell, xi)))
        return mesh.comm.allreduce(home, MPI.LAND)

    def _go_back(self) -> None:
        """Return to the beginning of the block, without communication."""
        sim = self._sim
        self._engine.drop()
        self.is_open = False
        for points, arrays, size_global in self._before:
            points.restore(arrays, size_global)
        sim.time, sim.number, states, self._unsorted = self._mark
        for body, state in zip(sim.rigid, states, strict=True):
            body.state = state

    def settle(self) -> None:
        """Bring all points up to date, and end the block of steps. Collective."""
        if not self.is_open:
            return
        sort = self._unsorted >= STEPS_OF_A_BLOCK
        self._before = []  # must not be in memory twice
        self._engine.settle(sort)
        self.is_open = False
        if sort:
            self._unsorted = 0

    def _step(self, again: bool, keep: bool) -> None:
        sim, engine, dt, clock = self._sim, self._engine, self._sim.dt, self._sim.seconds
        if sim.has_data or keep:
            engine.read_supports()
        for body in sim.rigid:
            body.begin(sim.time)
        pushed, held = (np.zeros((len(sim.rigid), TOTALS)) for _ in range(2))
        messages = []
        with clock("P2G"):
            for k, body in enumerate(sim.rigid):
                messages += engine.push(slip_on(k), body, dt, sim.longest_dt, pushed[k])
            engine.sum_nodes(sim.residual.gravity)
        with clock("forces"):
            engine.relieve_light_nodes()
            messages += self._forces()
        with clock("grid"):
            reaction = engine.move_nodes(dt, sim.damping)
            messages += engine.move_loads(dt)
        with clock("G2P"):
            messages += engine.gather(dt, sim.flip)
            if sim.rigid:
                sim.velocity.function_space.mesh.comm.Allreduce(MPI.IN_PLACE, pushed, MPI.SUM)
            for k, body in enumerate(sim.rigid):
                body.move(sim.time, dt, pushed[k])
                messages += engine.hold_back(slip_on(k), body, dt, sim.longest_dt, held[k])
            messages += engine.deform(dt)
        with clock("grid"):
            anew = self._agree(messages, reaction, held)
            if keep:
                self._write_nodes()
                self._support_forces = engine.support_forces()
            engine.average()
        with clock("stress and P2G"):
            engine.finish(again, keep, anew)

    def _forces(self) -> list[str]:
        """Add forces other than internal force and gravity; return this rank's messages."""
        engine, velocity = self._engine, self._sim.velocity
        loads = {
            points: points.weight[:, None] * traction.evaluate()
            for points, traction in self._tractions.items()
        }
        if self._at_bodies is not None or self._elsewhere is not None:
            engine.write("mass", self.mass())
            engine.write("momentum", velocity)
            momentum, mass = velocity.x.array.reshape(-1, self._dim), self.mass().x.array[:, None]
            np.divide(momentum, mass, out=momentum, where=mass > 0)
        if self._at_bodies is not None:
            engine.add_forces(self._assemble(self._at_bodies))
        at_nodes = None if self._elsewhere is None else self._assemble(self._elsewhere)
        return engine.add_loads(loads, at_nodes) if loads or at_nodes is not None else []

    def _assemble(self, form: forms.Form) -> Array:
        """Return minus a part of the residual at the nodes of this rank in N, ``(n, d)``."""
        force = la.vector(self._sim.velocity.function_space.dofmap.index_map, self._dim)
        forms.assemble_vector(form, force)
        force.scatter_reverse(la.InsertMode.add)
        owned = force.index_map.size_local
        return -force.array.reshape(-1, self._dim)[:owned]

    def mass(self) -> fem.Function:
        """Return the mass of the nodes in the last step in kg. Collective at first use."""
        if "mass" not in self._functions:
            mesh = self._sim.velocity.function_space.mesh
            self._make("mass", fem.functionspace(mesh, ("Lagrange", 1)))
        return self._functions["mass"]

    def support_forces(self) -> tuple[npt.NDArray[np.int32], Array]:
        """Return owned dofs and the force in N at each, see ``ExplicitMPM.reaction_of``."""
        return self._support_forces()

    def acceleration(self) -> fem.Function:
        """Return the nodal acceleration in the last step in m/s^2. Collective at first use."""
        if "acceleration" not in self._functions:
            self._make("acceleration", self._sim.velocity.function_space)
        return self._functions["acceleration"]

    def _make(self, name: str, space: fem.FunctionSpace) -> None:
        """Create the function of a nodal field of the last step."""
        self._functions[name] = function = fem.Function(space, name=name)
        if name in self._last:
            write, factor = self._last.pop(name)
            write(function)
            function.x.array[:] *= factor

    def _write_nodes(self) -> None:
        """Write nodal fields at the end of a step to functions that somebody has asked for."""
        engine = self._engine
        engine.write("velocity", self._sim.velocity)
        for name, column, factor in (
            ("mass", "mass", 1.0),
            ("acceleration", "increment", 1 / self._sim.dt),
        ):
            if name in self._functions:
                engine.write(column, self._functions[name])
                self._functions[name].x.array[:] *= factor
            else:
                self._last[name] = engine.keep(column), factor

    def _agree(self, messages: list[str], reaction: Array, held: Array) -> bool:
        """Sum up over ranks what each rank has found in a step. Collective.

        Returns:
            Whether points have left their tiles on any rank.
        """
        sim, strays = self._sim, self._engine.strays
        comm, failed = sim.velocity.function_space.mesh.comm, len(messages) > 0
        if comm.size > 1:
            mine = np.concatenate([[float(failed), float(strays)], reaction, held.ravel()])
            comm.Allreduce(MPI.IN_PLACE, mine, MPI.SUM)
            failed, strays = mine[0] > 0, mine[1] > 0
            reaction, held = mine[2:5], mine[5:].reshape(held.shape)
        if failed:
            sim.raise_if(messages)
        for k, body in enumerate(sim.rigid):
            body.end(sim.dt, held[k])
        sim.reaction = reaction[: self._dim].copy()
        return bool(strays)

    @property
    def memory(self) -> dict[str, float]:
        """Number of steps since points were sorted."""
        return {"unsorted": float(self._unsorted)}

    @memory.setter
    def memory(self, values: Mapping[str, float]) -> None:
        self._unsorted = int(values["unsorted"])

    def facts(self) -> Facts:
        """Return which part of the residual is computed which way."""
        kernels = ["internal forces"]
        if self._sim.residual.gravity:
            kernels.append("gravity")
        if self._tractions:
            kernels.append("loads")
        rest = [form for form in (self._at_bodies, self._elsewhere) if form is not None]
        by_forms = [("by forms", repr(form)) for form in rest]
        return [("by fused kernels", ", ".join(kernels)), *by_forms]
