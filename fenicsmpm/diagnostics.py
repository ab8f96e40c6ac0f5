# SPDX-License-Identifier: MIT
"""What is recorded of a body in motion: momentum, energy, and values at single points."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import la
from scipy.spatial import cKDTree

from fenicsmpm import forms, materials
from fenicsmpm.formulations.unknown import Unknown
from fenicsmpm.materials import Law, NeoHookean
from fenicsmpm.points import MaterialPoints

__all__ = [
    "angular_momentum",
    "kinetic_energy",
    "mean_stress",
    "moment",
    "momentum",
    "probe",
    "resultant",
    "roughness",
    "strain_energy",
    "torque",
    "turning_points",
]


def momentum(body: MaterialPoints) -> npt.NDArray[np.float64]:
    """Linear momentum, the sum of m v over all points of all ranks (collective).

    Args:
        body: material points with the fields "mass" and "v".

    Returns:
        [kg m/s], shape (d,); per thickness in the plane.
    """
    return body.mesh.comm.allreduce(body["mass"] @ body["v"])


def angular_momentum(body: MaterialPoints) -> float | npt.NDArray[np.float64]:
    """Angular momentum about the origin, the sum of x cross m v (collective).

    Args:
        body: material points with the fields "mass" and "v".

    Returns:
        [kg m^2/s], a number in the plane (per thickness), shape (3,) in space.
    """
    return body.mesh.comm.allreduce(moment(body.x, body["mass"][:, None] * body["v"]))


def moment(
    x: npt.NDArray[np.float64], p: npt.NDArray[np.float64]
) -> float | npt.NDArray[np.float64]:
    """Sum of x cross p on this rank.

    Args:
        x: positions [m], shape (n, d).
        p: vectors, such as momenta [kg m/s], shape (n, d).

    Returns:
        A number in the plane, shape (3,) in space.
    """
    if x.shape[1] == 2:
        return float(np.sum(x[:, 0] * p[:, 1] - x[:, 1] * p[:, 0]))
    return np.cross(x, p).sum(axis=0)


def kinetic_energy(body: MaterialPoints) -> float:
    """Kinetic energy, the sum of m v . v / 2 over all points of all ranks (collective).

    Args:
        body: material points with the fields "mass" and "v".

    Returns:
        [J], per thickness in the plane.
    """
    return float(body.mesh.comm.allreduce(body["mass"] @ np.sum(body["v"] ** 2, axis=1) / 2))


def strain_energy(body: MaterialPoints, law: NeoHookean | Law) -> float:
    """Strain energy, the sum of V_0 psi over all points (collective).

    Of a ``NeoHookean`` of the mixed formulation it is the deviatoric part, all there is of an
    incompressible material. The volumetric energy of a compressible one is left out: the pressure
    is an unknown of its own there, and no law gives that energy from F alone.

    Args:
        body: material points with the fields "V_0", "F" and "J", and those of a law's state.
        law: constitutive law; one at points must have an energy.

    Returns:
        [J], per thickness in the plane.

    Raises:
        ValueError: for a law at points without an energy.
    """
    if isinstance(law, Law):
        psi = materials.energy(law, body["F"], materials.state_of(law, body))
        return float(body.mesh.comm.allreduce(body["V_0"] @ psi))
    F, J = body.field("F"), body.field("J")
    energy = law.energy(F, J) * body.field("V_0") / body.field("weight")
    return float(forms.assemble_scalar(forms.form(energy * body.dx)))


def resultant(z: Unknown, form: ufl.Form) -> npt.NDArray[np.float64]:
    """Force that terms of a residual exert on the body, the sum over all nodes (collective).

    They are taken for the unknown and the points as they are: after ``NewtonSolver.solve``. In time
    loops ``simulation.Resultant`` asks when a step is solved and points have not moved.

    Args:
        z: unknown with a displacement or velocity.
        form: terms of its residual, UFL of rank 1.

    Returns:
        [N], shape (d,); per thickness in the plane.
    """
    return z.mesh.comm.allreduce(_nodal_forces(z, form).sum(axis=0))


def torque(z: Unknown, form: ufl.Form) -> float | npt.NDArray[np.float64]:
    """Moment about the origin of what terms of a residual exert on the body (collective).

    Forces act where the points are after a motion u; otherwise as ``resultant``.

    Args:
        z: unknown with a displacement or velocity in linear functions or B-splines.
        form: terms of its residual, UFL of rank 1.

    Returns:
        [N m], a number in the plane (per thickness), shape (3,) in space.
    """
    f = _nodal_forces(z, form)
    name = "v" if "v" in z else "u"
    x = z.part_space(name).tabulate_dof_coordinates()[: len(f), : z.mesh.geometry.dim].copy()
    if name == "u":
        x += z.U.x.array[z.dofs(name)[: f.size]].reshape(f.shape)
    return z.mesh.comm.allreduce(moment(x, f))


def _nodal_forces(z: Unknown, form: ufl.Form) -> npt.NDArray[np.float64]:
    """Minus a form at the nodes of this rank, ``(n, d)`` [N]."""
    name = "v" if "v" in z else "u"
    b = forms.assemble_vector(forms.form(form))
    b.scatter_reverse(la.InsertMode.add)
    space = z.part_space(name)
    owned = space.dofmap.index_map.size_local * space.dofmap.index_map_bs
    return -b.array[z.dofs(name)[:owned]].reshape(-1, z.mesh.geometry.dim)


def mean_stress(sigma: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """A third of the trace of stresses.

    Args:
        sigma: ``(n, 3, 3)``, or ``(n, 9)`` as ``io.gather_points`` has them [Pa].

    Returns:
        ``(n,)`` [Pa], positive in tension.
    """
    return np.asarray(sigma).reshape(-1, 9)[:, [0, 4, 8]].mean(axis=1)


def roughness(body: MaterialPoints, values: npt.NDArray[np.float64], spacing: float) -> float:
    """How much a field oscillates from point to point (collective).

    The root mean square of the differences between the value of a point and the mean of those that
    were its neighbours on a lattice at the start, zero for linear fields; only points whose
    neighbours are all on the same rank count.

    Args:
        body: material points that were seeded on a lattice, with the field "u".
        values: ``(n,)`` one number a point.
        spacing: of the lattice [m].

    Returns:
        In the unit of the values; zero if there are no such points.
    """
    X = (body.x - body["u"]) / spacing
    dim = X.shape[1]
    near = cKDTree(X).query(X, 2 * dim + 1, distance_upper_bound=1.01) if len(X) else None
    total, count = 0.0, 0
    if near is not None:
        inner = np.isfinite(near[0]).all(axis=1)
        means = values[near[1][inner, 1:]].mean(axis=1)
        total, count = float(np.sum((values[inner] - means) ** 2)), int(inner.sum())
    total, count = body.mesh.comm.allreduce(np.array([total, count]))
    return float(np.sqrt(total / count)) if count else 0.0


def probe(points: MaterialPoints, name: str) -> Any:
    """Value of a field at the only point of a point set, on all ranks (collective).

    Args:
        points: a set of one point, such as one that a simulation carries along.
        name: name of a field, or "x" for the position [m].

    Returns:
        A number or an array of the field's shape.

    Raises:
        ValueError: on all ranks, if there are no or several points.
    """
    if points.size_global != 1:
        raise ValueError(
            f"a probe needs a set of one point, not of {points.size_global}: make one with "
            "MaterialPoints, or select() it"
        )
    values = points.mesh.comm.allgather(np.array(points[name]))
    return np.concatenate(values)[0]


def turning_points(
    t: npt.NDArray[np.float64], values: npt.NDArray[np.float64], apart: float = 0.2
) -> list[tuple[float, float]]:
    """Peaks and minima of a curve, in their order in time.

    Args:
        t: times, ascending, ``(n,)`` [s].
        values: of the curve, ``(n,)``, linear between these times.
        apart: turns that another one exceeds within this time are noise [s].

    Returns:
        Times [s] and values.
    """
    from scipy.signal import argrelextrema  # whose import takes long

    step = apart / 80
    grid = np.arange(t[0], t[-1], step)
    curve = np.interp(grid, t, values)
    found = [argrelextrema(curve, kind, order=80)[0] for kind in (np.greater, np.less)]
    return [(float(grid[k]), float(curve[k])) for k in np.sort(np.concatenate(found))]
