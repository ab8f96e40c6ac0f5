# SPDX-License-Identifier: MIT
"""Integrals over cells and facets that follow the points, by dolfinx' own assembly."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from ufl.algorithms import expand_derivatives

from fenicsmpm import _compat


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
        is_constant: whether it has neither coefficients nor constants.
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
        self.is_constant = not (form.coefficients() or form.constants())
        self._compiled = _compat.CompiledForm(self.region.mesh, form, options)
        self._version: Any = None
        self._form: fem.Form | None = None

    def current(self) -> fem.Form:
        """The dolfinx form over the region as it is now (collective)."""
        if self._form is None or self._version != self.region.version:
            self._version = self.region.version
            self._form = self._compiled.over({t: self.region.entities(t) for t in self.types})
        return self._form
