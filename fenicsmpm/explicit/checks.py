# SPDX-License-Identifier: MIT
"""Checks of what a simulation is made of."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from dolfinx import fem

from fenicsmpm.points import MaterialPoints


def check_points(V: fem.FunctionSpace, sets: list[MaterialPoints], n_bodies: int) -> None:
    """Raise ValueError for point sets that do not fit together (collective).

    Args:
        V: space of velocities.
        sets: bodies and then loads.
        n_bodies: how many of them are bodies.
    """
    if n_bodies == 0:
        raise ValueError("ExplicitMPM needs a body")
    if len({id(points) for points in sets}) < len(sets):
        raise ValueError(
            "a point set is given twice as a body or load: select() its loaded points, which "
            "gives a set of its own"
        )
    if any(points.mesh is not V.mesh for points in sets):
        raise ValueError(
            "bodies and loads must be on the mesh of V: bring them there with points.from_mesh"
        )
    if sum(points.size_global for points in sets[:n_bodies]) == 0:
        raise ValueError("the bodies have no points")


def check_space(V: fem.FunctionSpace, cells: npt.NDArray[np.int64], width: int) -> None:
    """Raise ValueError for a space that is not one of velocities on a lattice.

    Args:
        V: the space.
        cells: ``(d,)`` number of cells of the lattice.
        width: nodes of a grid function in one direction.
    """
    element, dim = V.ufl_element(), V.mesh.geometry.dim
    if element.degree != 1 or V.num_sub_spaces != dim or V.dofmap.index_map_bs != dim:
        raise ValueError(
            f"velocities need a linear Lagrange space with {dim} components, not {element}: "
            'fem.functionspace(mesh, ("Lagrange", 1, (mesh.geometry.dim,)))'
        )
    if np.any(cells < width - 1):
        raise ValueError(f"{cells} cells are too few for functions of {width} nodes a direction")
