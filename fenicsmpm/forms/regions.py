# SPDX-License-Identifier: MIT
"""Integrals over cells and facets that follow the points."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem, la
from ufl.algorithms import expand_derivatives

from fenicsmpm import _compat
from fenicsmpm.forms import loops


class Region(Protocol):
    """Interface of ``subdomain_data`` for measures over changing entities.

    Attributes:
        mesh: Dolfinx mesh.
    """

    mesh: Any

    @property
    def version(self) -> Any:
        """Value that changes whenever the entities may have changed."""

    def entities(self, integral_type: str) -> npt.NDArray[np.int32]:
        """Return the integration entities of "cell" or "interior_facet" integrals.

        Args:
            integral_type: "cell" or "interior_facet".
        """

    def blocks(self, integral_type: str) -> npt.NDArray[np.int32]:
        """Return ``(n, 1 or 2)`` local cells whose functions interact in each entity.

        Args:
            integral_type: "cell" or "interior_facet".
        """


def is_region(data: Any) -> bool:
    """Return whether the data of a measure is a region.

    Args:
        data: ``subdomain_data`` of the measure.
    """
    return hasattr(data, "entities") and hasattr(data, "version")


class RegionForm:
    """Form over a region, compiled once and created again when the region has changed.

    Args:
        integrals: UFL integrals with the same region as data.
        options: Options of ``dolfinx.fem.form``.

    Attributes:
        region: Domain of integration.
        types: Types of the integrals.
        is_constant: Whether the form has no coefficients, so that it depends on ``state`` only.
    """

    def __init__(self, integrals: list[ufl.Integral], options: dict[str, Any]) -> None:
        """Compile. Collective."""
        self.region: Region = integrals[0].subdomain_data()
        if any(i.subdomain_id() != "everywhere" for i in integrals):
            raise ValueError(
                "integrals over active cells or facets cannot be restricted further: leave out "
                "the tag of the measure"
            )
        # With "everywhere", dolfinx would integrate over all entities of the mesh.
        form = expand_derivatives(
            ufl.Form([i.reconstruct(subdomain_data=None, subdomain_id=1) for i in integrals])
        )
        self.types = {i.integral_type() for i in integrals}
        self._arguments = form.arguments()
        self.is_constant = not form.coefficients()
        self._compiled = _compat.CompiledForm(self.region.mesh, form, options)
        self._version: Any = None
        self._form: fem.Form | None = None
        self._facet_kernels = self._of_facets()

    @property
    def state(self) -> tuple[Any, bytes]:
        """Value that changes whenever the region or the constants have changed."""
        return self.region.version, self._compiled.constants().tobytes()

    def _of_facets(self) -> npt.NDArray[np.int64] | None:
        """Return kernel addresses for ``loops.add_facet_matrices``, or None if it is unsuitable."""
        spaces = [a.ufl_function_space() for a in self._arguments]
        if not self.is_constant or len(spaces) != 2 or self.types != {"interior_facet"}:
            return None
        if any(V.element.needs_dof_transformations for V in spaces):
            return None
        return self._compiled.facet_kernels()

    def add_facets(
        self,
        spaces: Sequence[fem.FunctionSpace],
        fixed: Sequence[npt.NDArray[np.uint8]],
        A: la.MatrixCSR,
    ) -> bool:
        """Add the matrix over facets without dolfinx's assembly, which takes ten times as long.

        Args:
            spaces: Spaces of test and trial functions.
            fixed: Marks of constrained rows and columns.
            A: Matrix of block size one with a suitable pattern.

        Returns:
            Whether the form is suitable, so that the matrix was added.

        Raises:
            ValueError: If the pattern of the matrix is that of another form.
        """
        if self._facet_kernels is None:
            return False
        mesh = self.region.mesh
        topology, entities = mesh.topology, self.region.entities("interior_facet")
        topology.create_entity_permutations()
        permutations = np.asarray(topology.get_facet_permutations())
        nodes = _compat.geometry_dofmap(mesh)
        per_cell = len(permutations) // len(nodes)
        done = loops.add_facet_matrices(
            self._facet_kernels,
            self._compiled.constants(),
            entities.reshape(-1, 4),
            mesh.geometry.x,
            nodes,
            *(_unrolled(V) for V in spaces),
            permutations.reshape(len(nodes), per_cell),
            *fixed,
            A.indptr,
            A.indices,
            A.data,
        )
        if not done:
            raise ValueError(
                "matrix made for another form: create it with forms.create_matrix for this one"
            )
        return True

    def current(self) -> fem.Form:
        """Return the dolfinx form over the current region. Collective."""
        if self._form is None or self._version != self.region.version:
            self._version = self.region.version
            self._form = self._compiled.over({t: self.region.entities(t) for t in self.types})
        return self._form


def _unrolled(V: fem.FunctionSpace) -> npt.NDArray[np.int32]:
    """Return the ``(n_cells, n_local)`` dofs of each cell, node by node with all components."""
    blocks, bs = V.dofmap.list, V.dofmap.index_map_bs
    return (blocks[:, :, None] * bs + np.arange(bs, dtype=np.int32)).reshape(len(blocks), -1)
