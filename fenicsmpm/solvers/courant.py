# SPDX-License-Identifier: MIT
"""Time steps from the Courant-Friedrichs-Lewy (CFL) condition on the grid."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import SupportsFloat

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
from dolfinx import fem

from fenicsmpm._numbers import positive
from fenicsmpm.materials import Law
from fenicsmpm.points import MaterialPoints
from fenicsmpm.points.geometry import cell_geometry
from fenicsmpm.solvers.checks import require_points
from fenicsmpm.transfer import p2g


class CourantStep:
    """Length of the next step as a multiple of the time that waves need to cross a cell.

    This time is h sqrt(m_I / (V_I M_I)), the minimum over all nodes I with points (conservation
    paper, section 6). Here h is the shortest edge of the mesh, and the mass m_I, volume V_I and
    P-wave modulus M_I are mapped from the points. M_I is the volume average of the moduli of the
    points. Equation 60 of the paper prints the sum instead, which would shorten the steps as the
    number of points grows.

    Args:
        laws: Law of each body, or its P-wave modulus [Pa].
        factor: Multiple of the critical step of explicit dynamics [-].
        smallest: Lower bound of the step [s].
        largest: Upper bound of the step [s].

    Attributes:
        history: Step lengths returned so far [s].

    Raises:
        ValueError: If there are no bodies, the factor or a modulus is not positive, or the bounds
            contradict each other. A call raises it if there are no points, or no points with mass.
    """

    def __init__(
        self,
        laws: Mapping[MaterialPoints, Law | float],
        factor: float,
        *,
        smallest: float = 0.0,
        largest: float = math.inf,
    ) -> None:
        """Find the cell size. Collective."""
        if not (0 < factor < math.inf and 0 <= smallest <= largest and largest > 0):
            raise ValueError(
                "the factor of the Courant step must be positive and its bounds in order: "
                f"{factor}, from {smallest} to {largest} s"
            )
        if not laws:
            raise ValueError("the Courant step needs a body and its law")
        self._moduli = {}
        for body, law in laws.items():
            modulus = law.wave_speed_modulus if isinstance(law, Law) else law
            if not isinstance(modulus, SupportsFloat):
                raise ValueError(
                    "the Courant step needs a law at points, such as NeoHookean(..).pointwise(), "
                    f"or a P-wave modulus [Pa], not {law!r}"
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
        """Return the length of the step that starts from the current points [s]. Collective."""
        require_points(list(self._moduli))
        sums = np.zeros(0)
        for body, modulus in self._moduli.items():
            # V_I cancels, because V_I M_I is the sum of V_p M_p of the points
            columns = np.column_stack([body["mass"], modulus * body.weight])
            nodes = p2g(body, columns, self._space, rounded=True).array.reshape(-1, 2)
            sums = nodes if len(sums) == 0 else sums + nodes
        mass, stiffness = sums[sums[:, 1] > 0].T
        slowness = float(np.sqrt(np.min(mass / stiffness, initial=np.inf)))
        slowness = self._space.mesh.comm.allreduce(slowness, MPI.MIN)
        if not 0 < slowness < math.inf:
            raise ValueError(
                f"the Courant step needs points with mass: the slowness is {slowness:g} s/m"
            )
        dt = self.factor * self._h * slowness
        dt = min(max(dt, self.smallest), self.largest)
        self.history.append(dt)
        return dt


def _shortest(corners: npt.NDArray[np.float64]) -> float:
    """Return the shortest distance [m] of two vertices in cells ``(n_cells, n_vertices, d)``."""
    n = corners.shape[1]
    pairs = [corners[:, i] - corners[:, j] for i in range(n) for j in range(i)]
    return min(float(np.linalg.norm(edge, axis=1).min(initial=math.inf)) for edge in pairs)
