# SPDX-License-Identifier: MIT
"""Momentum, energy and forces of bodies, and values at single points."""

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
    """Return the linear momentum, the sum of m v over all points of all ranks. Collective.

    Args:
        body: Material points with the fields "mass" and "v".

    Returns:
        Momentum in kg m/s, shape (d,); in 2D per unit thickness.
    """
    return body.mesh.comm.allreduce(body["mass"] @ body["v"])


def angular_momentum(body: MaterialPoints) -> float | npt.NDArray[np.float64]:
    """Return the angular momentum about the origin, the sum of x cross m v. Collective.

    Args:
        body: Material points with the fields "mass" and "v".

    Returns:
        A number in kg m^2/s in 2D (per unit thickness), shape (3,) in 3D.
    """
    return body.mesh.comm.allreduce(moment(body.x, body["mass"][:, None] * body["v"]))


def moment(
    x: npt.NDArray[np.float64], p: npt.NDArray[np.float64]
) -> float | npt.NDArray[np.float64]:
    """Return the sum of x cross p on this rank.

    Args:
        x: Positions in m, shape (n, d).
        p: Vectors, such as momenta in kg m/s, shape (n, d).

    Returns:
        A number in 2D, shape (3,) in 3D.
    """
    if x.shape[1] == 2:
        return float(np.sum(x[:, 0] * p[:, 1] - x[:, 1] * p[:, 0]))
    return np.cross(x, p).sum(axis=0)


def kinetic_energy(body: MaterialPoints) -> float:
    """Return the kinetic energy, the sum of m v . v / 2 over all points. Collective.

    Args:
        body: Material points with the fields "mass" and "v".

    Returns:
        Energy in J; in 2D per unit thickness.
    """
    return float(body.mesh.comm.allreduce(body["mass"] @ np.sum(body["v"] ** 2, axis=1) / 2))


def strain_energy(body: MaterialPoints, law: NeoHookean | Law) -> float:
    """Return the strain energy, the sum of V_0 psi over all points. Collective.

    For a ``NeoHookean`` law of the mixed formulation it is the deviatoric part. This is the whole
    energy of an incompressible material. The volumetric energy of a compressible one is missing:
    the pressure is an unknown of its own, and no law gives this energy from F alone.

    Args:
        body: Material points with the fields "V_0", "F" and "J", and those of the law's state.
        law: Constitutive law; a law at points must have an energy.

    Returns:
        Energy in J; in 2D per unit thickness.

    Raises:
        ValueError: For a law at points without an energy.
    """
    if isinstance(law, Law):
        psi = materials.energy(law, body["F"], materials.state_of(law, body))
        return float(body.mesh.comm.allreduce(body["V_0"] @ psi))
    F, J = body.field("F"), body.field("J")
    energy = law.energy(F, J) * body.field("V_0") / body.field("weight")
    return float(forms.assemble_scalar(forms.form(energy * body.dx)))


def resultant(z: Unknown, form: ufl.Form) -> npt.NDArray[np.float64]:
    """Return the force that terms of a residual exert on the body, summed over nodes. Collective.

    The terms are evaluated for the current unknown and points, for example after
    ``NewtonSolver.solve``. In time loops, ``simulation.Resultant`` evaluates them when a step is
    solved and the points have not moved yet.

    Args:
        z: Unknown with a displacement or velocity.
        form: Terms of its residual, UFL of rank 1.

    Returns:
        Force in N, shape (d,); in 2D per unit thickness.
    """
    return z.mesh.comm.allreduce(_nodal_forces(z, form).sum(axis=0))


def torque(z: Unknown, form: ufl.Form) -> float | npt.NDArray[np.float64]:
    """Return the moment about the origin of the force of terms of a residual. Collective.

    Forces act at the positions after the motion u; otherwise as for ``resultant``.

    Args:
        z: Unknown with a displacement or velocity in linear functions or B-splines.
        form: Terms of its residual, UFL of rank 1.

    Returns:
        A number in N m in 2D (per unit thickness), shape (3,) in 3D.
    """
    f = _nodal_forces(z, form)
    name = "v" if "v" in z else "u"
    x = z.part_space(name).tabulate_dof_coordinates()[: len(f), : z.mesh.geometry.dim].copy()
    if name == "u":
        x += z.U.x.array[z.dofs(name)[: f.size]].reshape(f.shape)
    return z.mesh.comm.allreduce(moment(x, f))


def _nodal_forces(z: Unknown, form: ufl.Form) -> npt.NDArray[np.float64]:
    """Return the negative form at the nodes of this rank in N, ``(n, d)``."""
    name = "v" if "v" in z else "u"
    b = forms.assemble_vector(forms.form(form))
    b.scatter_reverse(la.InsertMode.add)
    space = z.part_space(name)
    owned = space.dofmap.index_map.size_local * space.dofmap.index_map_bs
    return -b.array[z.dofs(name)[:owned]].reshape(-1, z.mesh.geometry.dim)


def mean_stress(sigma: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """Return a third of the trace of stresses.

    Args:
        sigma: Stresses in Pa, shape ``(n, 3, 3)``, or ``(n, 9)`` as from ``io.gather_points``.

    Returns:
        Mean stresses in Pa, shape ``(n,)``, positive in tension.
    """
    return np.asarray(sigma).reshape(-1, 9)[:, [0, 4, 8]].mean(axis=1)


def roughness(body: MaterialPoints, values: npt.NDArray[np.float64], spacing: float) -> float:
    """Measure how much a field oscillates from point to point. Collective.

    The measure is the root mean square of the difference between the value of a point and the mean
    of its initial neighbours on a lattice. It is zero for linear fields. Only points whose
    neighbours are all on the same rank count.

    Args:
        body: Material points that were seeded on a lattice, with the field "u".
        values: One number per point, shape ``(n,)``.
        spacing: Spacing of the lattice in m.

    Returns:
        Roughness in the unit of the values; zero if there are no such points.
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
    """Return the value of a field at the only point of a point set, on all ranks. Collective.

    Args:
        points: A set of one point, such as one that a simulation carries along.
        name: Name of a field, or "x" for the position in m.

    Returns:
        A number or an array of the field's shape.

    Raises:
        ValueError: On all ranks, if there is not exactly one point.
    """
    if points.size_global != 1:
        raise ValueError(
            f"a probe needs a set of one point, not of {points.size_global}: make one with "
            "points.at, or select() it"
        )
    values = points.mesh.comm.allgather(np.array(points[name]))
    return np.concatenate(values)[0]


def turning_points(
    t: npt.NDArray[np.float64], values: npt.NDArray[np.float64], apart: float = 0.2
) -> list[tuple[float, float]]:
    """Return the maxima and minima of a curve, in order of time.

    Args:
        t: Ascending times in s, shape ``(n,)``.
        values: Values of the curve, linear between these times, shape ``(n,)``.
        apart: Extrema that another one exceeds within this time in s count as noise.

    Returns:
        Pairs of time in s and value.
    """
    from scipy.signal import argrelextrema  # a slow import

    step = apart / 80
    grid = np.arange(t[0], t[-1], step)
    curve = np.interp(grid, t, values)
    found = [argrelextrema(curve, kind, order=80)[0] for kind in (np.greater, np.less)]
    return [(float(grid[k]), float(curve[k])) for k in np.sort(np.concatenate(found))]
