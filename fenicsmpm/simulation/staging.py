# SPDX-License-Identifier: MIT
"""Construction in stages: adding and removing points between steps, in any time loop.

Forms are compiled for bodies, not for their points. A stage is therefore a change of points: a body
that comes later has no points until then, and a body that is removed loses all of its points.
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
    """Record of points added to a body or removed from it, over all ranks.

    Attributes:
        points: A copy of the points with all fields, for example to be added again.
        time: Time of the simulation in s.
        count: Number of points.
        mass: Mass in kg.
        volume: Current volume in m^d.
        momentum: Momentum in kg m/s, ``(d,)``.
        kinetic_energy: Kinetic energy in J.
        strain_energy: Strain energy in J; None without a law that has one.
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
    """Add points to a body between steps, such as a lift of an embankment. Collective.

    Points that ``remove_points`` took from a body have all fields. New ones need the fields of
    ``set_initial_state``, and of ``initial_stress`` if the body has one. Fields that the loop has
    added to the body, such as accelerations and the state of a law, get the values of an undeformed
    body.

    Args:
        sim: The time loop.
        body: One of its bodies, which may be empty, or of its carried points.
        new: Points on the same mesh; they are copied.
        law: Material whose strain energy is recorded; by default that of the loop, if it has one.

    Returns:
        Record of the added points.

    Raises:
        ValueError: For points of another simulation or mesh, and missing fields. The body does not
            change then.
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
    """Remove points of a body between steps, such as those of an excavation. Collective.

    Where the rest of the body touched these points, it is no longer in equilibrium. It moves in the
    next step.

    Args:
        sim: The time loop.
        body: One of its bodies, or of its carried points.
        which: Selection as for ``MaterialPoints.remove``: marker of positions ``(3, n)``, mask or
            indices; None for all points.
        law: Material whose strain energy is recorded; by default that of the loop, if it has one.

    Returns:
        Record of the removed points.

    Raises:
        ValueError: On all ranks, for points of another simulation or an invalid selection.
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
            "bodies at the start, also those that come later, and remove their points before the "
            "first step"
        )


def _recorded(
    sim: ImplicitMPM | ExplicitMPM,
    body: MaterialPoints,
    points: MaterialPoints,
    law: Law | NeoHookean | None,
) -> Exchange:
    """Return the record of some points of a body. Collective."""
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
