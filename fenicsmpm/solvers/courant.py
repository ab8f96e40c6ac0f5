# SPDX-License-Identifier: MIT
"""Time steps from the condition of Courant, Friedrichs and Lewy on the grid."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import SupportsFloat

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
from dolfinx import fem

from fenicsmpm.materials import Law
from fenicsmpm.materials.law import positive
from fenicsmpm.points import MaterialPoints
from fenicsmpm.points.geometry import cell_geometry
from fenicsmpm.solvers.checks import require_points
from fenicsmpm.transfer import p2g


class CourantStep:
    """Length of the next step: a multiple of the one that waves take through a cell.

    Conservation paper, section 6: h sqrt(m_I / (V_I M_I)), the least of all nodes I with points,
    with h the shortest edge of the mesh, and mass m_I, volume V_I and P-wave modulus M_I mapped
    from the points. M_I is the mean by volume of the points' moduli; their sum, printed as equation
    60, would shorten steps with the number of points.

    Args:
        laws: of each body, or P-wave moduli [Pa].
        factor: multiple of the step of explicit dynamics [-].
        smallest: no step is shorter [s].
        largest: no step is longer [s].

    Attributes:
        history: lengths returned so far [s].

    Raises:
        ValueError: for no bodies, a factor or moduli that are not positive, or bounds that exclude
            each other; when called, if there are no points, or none with a mass.
    """

    def __init__(
        self,
        laws: Mapping[MaterialPoints, Law | float],
        factor: float,
        *,
        smallest: float = 0.0,
        largest: float = math.inf,
    ) -> None:
        """Find the size of the cells (collective)."""
        if not (0 < factor < math.inf and 0 <= smallest <= largest and largest > 0):
            raise ValueError(
                "the factor of Courant's step must be positive and its bounds in order: "
                f"{factor}, from {smallest} to {largest} s"
            )
        if not laws:
            raise ValueError("Courant's step needs a body and its law")
        self._moduli = {}
        for body, law in laws.items():
            modulus = law.wave_speed_modulus if isinstance(law, Law) else law
            if not isinstance(modulus, SupportsFloat):
                raise ValueError(
                    "Courant's step needs a law at points, such as NeoHookean(..).pointwise(), or "
                    f"a P-wave modulus [Pa], not {law!r}"
                )
            self._moduli[body] = positive(float(modulus), "M", "P-wave modulus", "Pa")
        self.factor, self.smallest, self.largest = factor, smallest, largest
        self.history: list[float] = []
        mesh = next(iter(laws)).mesh
        geometry = cell_geometry(mesh)
        shortest = min(
            (_shortest(geometry.corners(c)) for c in geometry.blocks()), default=math.inf
        )
        self._h = mesh.comm.allreduce(shortest, MPI.MIN)
        self._space = fem.functionspace(mesh, ("Lagrange", 1))

    def __call__(self) -> float:
        """Length of the step that begins with the points as they are [s] (collective)."""
        require_points(list(self._moduli))
        sums = np.zeros(0)
        for body, modulus in self._moduli.items():
            # V_I cancels: V_I M_I is the sum of the points' V_p M_p
            columns = np.column_stack([body["mass"], modulus * body.weight])
            nodes = p2g(body, columns, self._space, rounded=True).array.reshape(-1, 2)
            sums = nodes if len(sums) == 0 else sums + nodes
        mass, stiffness = sums[sums[:, 1] > 0].T
        slowness = float(np.sqrt(np.min(mass / stiffness, initial=np.inf)))
        slowness = self._space.mesh.comm.allreduce(slowness, MPI.MIN)
        if not 0 < slowness < math.inf:
            raise ValueError(f"Courant's step of points without mass: {slowness:g} s/m")
        dt = self.factor * self._h * slowness
        dt = min(max(dt, self.smallest), self.largest)
        self.history.append(dt)
        return dt


def _shortest(corners: npt.NDArray[np.float64]) -> float:
    """Shortest distance of two vertices of a cell, of ``(n_cells, n_vertices, d)`` [m]."""
    n = corners.shape[1]
    pairs = [corners[:, i] - corners[:, j] for i in range(n) for j in range(i)]
    return min(float(np.linalg.norm(edge, axis=1).min(initial=math.inf)) for edge in pairs)
