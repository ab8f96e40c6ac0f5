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
    """What an object needs to be the ``subdomain_data`` of a measure over changing entities."""

    mesh: Any

    @property
    def version(self) -> Any:
        """Changes whenever the entities may have changed."""

    def entities(self, integral_type: str) -> npt.NDArray[np.int32]:
        """Integration entities of "cell" or "interior_facet" integrals."""

    def blocks(self, integral_type: str) -> npt.NDArray[np.int32]:
        """``(n, 1 or 2)`` local cells whose functions meet in each entity."""


def is_region(data: Any) -> bool:
    """Whether the data of a measure is a region."""
    return hasattr(data, "entities") and hasattr(data, "version")


class RegionForm:
    """A form over a region: compiled once, created anew when the region has changed.

    Args:
        integrals: UFL integrals with the same region as data.
        options: of ``dolfinx.fem.form``.

    Attributes:
        region: where its integrals are taken.
        types: of its integrals.
        is_constant: whether it has no coefficients, so that ``state`` tells all that it depends on.
    """

    def __init__(self, integrals: list[ufl.Integral], options: dict[str, Any]) -> None:
        """Compile (collective)."""
        self.region: Region = integrals[0].subdomain_data()
        if any(i.subdomain_id() != "everywhere" for i in integrals):
            raise ValueError("integrals over active cells or facets cannot be restricted further")
        # over "everywhere" dolfinx would take all entities of the mesh
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
        """Changes whenever the region or the constants have changed."""
        return self.region.version, self._compiled.constants().tobytes()

    def _of_facets(self) -> npt.NDArray[np.int64] | None:
        """Addresses of kernels for ``loops.add_facet_matrices``; None where it does not do."""
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
        """Add the matrix over facets without dolfinx' assembly, which takes ten times as long.

        Args:
            spaces: of test and trial functions.
            fixed: marks of constrained rows and columns.
            A: matrix of block size one, with room for it.

        Returns:
            Whether it could be done.
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
            raise ValueError("matrix made for another form: use create_matrix of this one")
        return True

    def current(self) -> fem.Form:
        """The dolfinx form over the region as it is now (collective)."""
        if self._form is None or self._version != self.region.version:
            self._version = self.region.version
            self._form = self._compiled.over({t: self.region.entities(t) for t in self.types})
        return self._form


def _unrolled(V: fem.FunctionSpace) -> npt.NDArray[np.int32]:
    """``(n_cells, n_local)`` dofs of each cell, components of a node one after the other."""
    blocks, bs = V.dofmap.list, V.dofmap.index_map_bs
    return (blocks[:, :, None] * bs + np.arange(bs, dtype=np.int32)).reshape(len(blocks), -1)
