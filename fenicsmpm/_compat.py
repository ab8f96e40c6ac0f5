# SPDX-License-Identifier: MIT
"""All uses of APIs that differ between dolfinx 0.9, 0.10 and 0.11, one function each."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import cpp, fem
from dolfinx.mesh import GhostMode, create_cell_partitioner
from ufl.algorithms import extract_coefficients
from ufl.algorithms.analysis import extract_constants

from fenicsmpm import _jit


def kernel_address(compiled: Any, module: Any) -> int:
    """Return the address of the only ``tabulate_tensor`` function of a compiled form.

    The function takes 6 pointers in FFCx 0.9, and 7 (a trailing user pointer) from 0.10 on.
    """
    function = compiled.form_integrals[0].tabulate_tensor_float64
    return int(module.ffi.cast("intptr_t", function))


def collapsed(
    space: fem.FunctionSpace,
) -> tuple[fem.FunctionSpace, npt.NDArray[np.int32]]:
    """Return a part of a space as a space of its own, and its dofs in the whole one, ``(n,)``.

    From 0.10 on, dolfinx returns the array of dofs in a list.

    Args:
        space: Part of a mixed or blocked space.
    """
    result, dofs = space.collapse()
    return result, np.asarray(dofs, dtype=np.int32).ravel()


def bc_dofs(bc: fem.DirichletBC) -> npt.NDArray[np.int32]:
    """Return the constrained degrees of freedom of this rank, ghosts included, unrolled.

    Args:
        bc: Dirichlet condition.

    Returns:
        Local indices of shape ``(n,)``, int32, with unrolled block size.
    """
    cpp = getattr(bc, "_cpp_object", bc)
    return cpp.dof_indices()[0]


def fixed_dofs(bcs: Sequence[fem.DirichletBC]) -> npt.NDArray[np.int32]:
    """Return the local degrees of freedom constrained by any of the conditions, sorted."""
    return np.unique(np.concatenate([np.empty(0, np.int32), *map(bc_dofs, bcs)]))


def bc_set(
    bc: fem.DirichletBC,
    x: npt.NDArray[np.float64],
    x0: npt.NDArray[np.float64] | None,
    alpha: float,
) -> None:
    """Set the constrained entries of ``x`` to ``alpha * (g - x0)``.

    Args:
        bc: Dirichlet condition with the values ``g``.
        x: Array of the local vector, with or without ghosts, shape ``(n,)``.
        x0: Array like ``x``, or None for zero.
        alpha: Factor.
    """
    cpp = getattr(bc, "_cpp_object", bc)
    cpp.set(x, x0, alpha)


def geometry_dofmap(mesh: Any) -> npt.NDArray[np.int32]:
    """Return the geometry nodes of each cell, ``(n_cells, n_nodes)``, for one cell type."""
    geometry = mesh.geometry
    return geometry.dofmaps[0] if hasattr(geometry, "dofmaps") else geometry.dofmap


def cell_partitioner(ghosts: GhostMode) -> Any:
    """Return dolfinx' own function that distributes cells over ranks.

    From 0.10 on, it needs the largest number of cells at a facet.
    """
    try:
        return create_cell_partitioner(ghosts, 2)
    except TypeError:
        return create_cell_partitioner(ghosts)


def is_on(bc: fem.DirichletBC, V: fem.FunctionSpace) -> bool:
    """Return whether a Dirichlet condition constrains (a component of) a function space."""
    space = getattr(bc, "function_space", None) or bc._cpp_object.function_space
    space = getattr(space, "_cpp_object", space)
    return V._cpp_object.contains(space)


def interpolation_points(V: fem.FunctionSpace) -> npt.NDArray[np.float64]:
    """Return the reference points at which a function space evaluates expressions."""
    points = V.element.interpolation_points
    return points() if callable(points) else points


def facet_entities(mesh: Any, facets: npt.NDArray[np.int32]) -> npt.NDArray[np.int32]:
    """Return integration entities (cell, local facet, cell, local facet) of facets, flat.

    Args:
        mesh: Dolfinx mesh.
        facets: Owned interior facets, shape ``(n,)``.
    """
    kind = fem.IntegralType.interior_facet
    topology = mesh.topology
    topology = getattr(topology, "_cpp_object", topology)
    compute = cpp.fem.compute_integration_domains
    try:
        return compute(kind, topology, facets, mesh.topology.dim - 1).ravel()
    except TypeError:  # from 0.10 on, the dimension follows from the type
        return compute(kind, topology, facets).ravel()


class CompiledForm:
    """UFL form compiled for given coefficients, with integration entities to be given later.

    Args:
        mesh: Dolfinx mesh.
        form: UFL form with integrals over subdomain 1. Derivatives must have been expanded: they
            may make coefficients disappear, which confuses dolfinx 0.9.
        options: ``form_compiler_options`` and ``jit_options`` of ``dolfinx.fem.form``.
    """

    def __init__(self, mesh: Any, form: ufl.Form, options: dict[str, Any]) -> None:
        """Compile the form. Collective."""
        self._mesh = mesh
        options = {"form_compiler_options": {}, "jit_options": {}} | {
            name: value for name, value in options.items() if value is not None
        }
        compiler_options = {"scalar_type": np.float64} | options.pop("form_compiler_options")
        self._compiled = _jit.open_form(mesh.comm, form, compiler_options, options["jit_options"])
        self._spaces = [a.ufl_function_space() for a in form.arguments()]
        original = self._compiled.ufl_form
        self._coefficients = {c: c for c in extract_coefficients(original)}
        self._constants = {c: c for c in extract_constants(original)}

    def constants(self) -> npt.NDArray[np.float64]:
        """Return the current values of all constants for kernels; at least one number."""
        values = [np.ravel(c.value) for c in self._constants]
        return np.concatenate([*values, np.zeros(0 if values else 1)])

    def facet_kernels(self) -> npt.NDArray[np.int64] | None:
        """Return addresses of the interior facet kernels; None if there are other integrals."""
        form, module = self._compiled.ufcx_form, self._compiled.module
        first, last = form.form_integral_offsets[2], form.form_integral_offsets[3]
        if first > 0:
            return None
        functions = [form.form_integrals[i].tabulate_tensor_float64 for i in range(last)]
        return np.array([int(module.ffi.cast("intptr_t", f)) for f in functions], dtype=np.int64)

    def over(self, entities: dict[str, npt.NDArray[np.int32]]) -> fem.Form:
        """Return the form with integrals over given integration entities, by integral type."""
        subdomains = {
            getattr(fem.IntegralType, name): [(1, array)] for name, array in entities.items()
        }
        return fem.create_form(
            self._compiled,
            self._spaces,
            self._mesh,
            subdomains,
            self._coefficients,
            self._constants,
        )
