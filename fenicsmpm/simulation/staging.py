# SPDX-License-Identifier: MIT
"""Construction in stages: points that come and go between steps, in any time loop.

Forms are compiled for bodies, not for their points. So a stage is a change of points: a body that
comes later is one without points until then, and a body that goes loses all of its points.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fenicsmpm import diagnostics
from fenicsmpm.formulations.internal_force import CauchyStress
from fenicsmpm.materials import Law, NeoHookean
from fenicsmpm.points import MaterialPoints
from fenicsmpm.points.material_points import Selection
from fenicsmpm.simulation.explicit import ExplicitMPM
from fenicsmpm.simulation.implicit import ImplicitMPM


@dataclass
class Exchange:
    """What came to a body, or went from it, over all ranks.

    Attributes:
        points: a copy of the points, with all fields, to be added again for example.
        time: of the simulation [s].
        count: how many points.
        mass: [kg].
        volume: present one [m^d].
        momentum: ``(d,)`` [kg m/s].
        kinetic_energy: [J].
        strain_energy: [J]; None where no law is known that has one.
    """

    points: MaterialPoints
    time: float
    count: int
    mass: float
    volume: float
    momentum: npt.NDArray[np.float64]
    kinetic_energy: float
    strain_energy: float | None


def add_points(
    sim: ImplicitMPM | ExplicitMPM,
    body: MaterialPoints,
    new: MaterialPoints,
    law: Law | NeoHookean | None = None,
) -> Exchange:
    """Add points to a body between steps: a lift of an embankment, a body of its own (collective).

    Those that were taken from a body by ``remove_points`` have all the fields. New ones need those
    of ``set_initial_state``, and of ``initial_stress`` if they have one; what the loop has added to
    the body, such as accelerations and the state of a law, they get as an undeformed body would.

    Args:
        sim: the time loop.
        body: one of its bodies, which may be empty, or of its carried points.
        new: on the same mesh; they are copied.
        law: material whose strain energy is recorded; by default that of the loop, if it has one.

    Returns:
        What came.

    Raises:
        ValueError: for points of another simulation or mesh, and fields that are missing. The body
            is as before.
    """
    _require(sim, body)
    sim.settle()
    if isinstance(sim, ExplicitMPM) and body in sim.laws:
        new = new.copy()
        CauchyStress(new, sim.laws[body], sim.residual.averages.get(body))
    before = body.next_id
    body.add(new)
    return _recorded(sim, body, body.select(body.id >= before), law)


def remove_points(
    sim: ImplicitMPM | ExplicitMPM,
    body: MaterialPoints,
    which: Selection | None = None,
    law: Law | NeoHookean | None = None,
) -> Exchange:
    """Remove points of a body between steps: an excavation, a body that is taken away (collective).

    What is left is no longer in equilibrium where it touched them, and moves in the next step.

    Args:
        sim: the time loop.
        body: one of its bodies, or of its carried points.
        which: as for ``MaterialPoints.remove``: marker of positions ``(3, n)``, mask or indices;
            None for all points.
        law: material whose strain energy is recorded; by default that of the loop, if it has one.

    Returns:
        What went.

    Raises:
        ValueError: for points of another simulation, and a selection that is none; on all ranks.
    """
    _require(sim, body)
    sim.settle()
    mask = np.full(len(body), True) if which is None else which
    taken = body.select(mask)
    body.remove(np.isin(body.id, taken.id))
    return _recorded(sim, body, taken, law)


def _require(sim: ImplicitMPM | ExplicitMPM, body: MaterialPoints) -> None:
    if body not in [*sim.bodies, *sim.carried]:
        raise ValueError(
            "the points are neither a body nor carried points of this simulation: give it all "
            "bodies at the start, those that come later too, and take out their points before the "
            "first step"
        )


def _recorded(
    sim: ImplicitMPM | ExplicitMPM,
    body: MaterialPoints,
    points: MaterialPoints,
    law: Law | NeoHookean | None,
) -> Exchange:
    """What some points are, which are or were those of a body (collective)."""
    dim = points.mesh.geometry.dim
    is_body = body in sim.bodies
    if law is None:
        law = sim.laws.get(body)
    energy = None
    if law is not None and law.energy is not None:
        energy = diagnostics.strain_energy(points, law)
    comm = points.mesh.comm
    return Exchange(
        points=points,
        time=sim.time,
        count=points.size_global,
        mass=float(comm.allreduce(float(points["mass"].sum()))) if is_body else 0.0,
        volume=points.volume(),
        momentum=diagnostics.momentum(points) if is_body else np.zeros(dim),
        kinetic_energy=diagnostics.kinetic_energy(points) if is_body else 0.0,
        strain_energy=energy,
    )
