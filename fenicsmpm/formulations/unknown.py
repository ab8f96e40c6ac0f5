# SPDX-License-Identifier: MIT
"""The unknown of a problem: its named parts, their test functions and Dirichlet conditions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import basix.ufl
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem

from fenicsmpm import _compat
from fenicsmpm._display import Described, Facts
from fenicsmpm._memory import release_zeros
from fenicsmpm.basis import is_linear
from fenicsmpm.formulations.condition import Condition, Place

_ROLES = ("moves", "history", "grid")
# Attributes of an unknown besides its methods, which parts cannot have as names
_ATTRIBUTES = frozenset({"U", "V", "space", "mesh", "parts", "test", "old", "conditions"})


@dataclass(frozen=True)
class Part:
    """One part of an unknown, and its relation to the fields of the points.

    The role of a part is one of these:

    - "moves" for the displacement increment of a step.
    - "history" for a quantity that the points carry in a field of the same name. It is mapped to
      the grid at the start of a step and returned to the points at its end.
    - "grid" for a quantity that exists on the grid only.

    Args:
        name: Name of the part, and of the field of the points.
        is_vector: Whether the part is a vector ``(d,)`` or a scalar.
        role: "moves", "history" or "grid".
        degree: Degree of the Lagrange functions.
        flip: For a history, 0 if the points take its new value (PIC), 1 if they take its change
            (FLIP), or a blend of both.
        initial: Value of a history at points that have no field of its name. None if the field must
            exist.

    Raises:
        ValueError: If the name is not a valid identifier, the role is unknown or does not fit the
            shape, or flip lies outside [0, 1].
    """

    name: str
    is_vector: bool = False
    role: str = "history"
    degree: int = 1
    flip: float = 0.0
    initial: float | None = None

    def __post_init__(self) -> None:
        """Check the values."""
        if not self.name.isidentifier():
            raise ValueError(f"the name of a part must be a Python identifier: {self.name!r}")
        if self.role not in _ROLES:
            raise ValueError(f"unknown role {self.role!r} of a part: use {', '.join(_ROLES)}")
        if self.role == "moves" and not self.is_vector:
            raise ValueError(
                f"a part that moves the points must be a vector, but {self.name!r} is a scalar: "
                "set is_vector=True"
            )
        if not 0 <= self.flip <= 1:
            raise ValueError(f"the share of FLIP must lie in [0, 1]: flip = {self.flip}")


class Unknown(Described):
    """Unknown of a problem: named parts on one mesh, combined in one function for UFL.

    ``Unknown(mesh, "u", "p")`` has linear functions for displacement and pressure. The name "u"
    stands for a vector that moves the points, and "v" for a vector that exists on the grid only,
    such as the velocity of explicit steps. Any other name stands for a scalar that the points
    carry. Parts are attributes of the unknown, such as ``z.u``, and of its test functions, such as
    ``z.test.u``.

    Args:
        over: Mesh for a new function, or an existing function. The latter must be defined on a
            mixed space if there are several parts.
        parts: Names or ``Part`` objects, in the order of the space.
        degree: Degree of the Lagrange functions of parts given by name.

    Attributes:
        U: Function of all parts, with respect to which forms are differentiated.
        V: Test function of all parts.
        space: Function space of both.
        mesh: Background mesh.
        parts: The parts in their order.
        test: Test functions of the parts, as attributes.
        old: Values of the histories mapped from the points, as attributes (``fem.Function``).
        conditions: Dirichlet conditions, created by ``fix``.

    Raises:
        ValueError: If there are no parts, a name is taken, several parts move the points, or the
            given function has other parts.
    """

    def __init__(self, over: Any, *parts: str | Part, degree: int = 1) -> None:
        """Create spaces and functions. Collective."""
        own = _with_roles(parts, degree)
        U = over if isinstance(over, fem.Function) else _function_of(over, own)
        _check_shapes(U, own)
        self._take(U, ufl.TestFunction(U.function_space), own)

    def _take(
        self, U: fem.Function, V: ufl.Argument, parts: Sequence[Part], first: int = 0
    ) -> None:
        """Set the parts to those of a function, from part ``first`` on. Collective."""
        self.parts = tuple(parts)
        self.U, self.V, self.space, self.mesh = U, V, U.function_space, U.function_space.mesh
        names = [part.name for part in self.parts]
        is_mixed, own = _is_mixed(self.space), slice(first, first + len(names))
        split = [ufl.split(f)[own] if is_mixed else (f,) for f in (U, V)]
        subs = [self.space]
        if is_mixed:
            subs = [self.space.sub(first + i) for i in range(len(names))]
        self._values = dict(zip(names, split[0], strict=True))
        self.test = SimpleNamespace(**dict(zip(names, split[1], strict=True)))
        self._subspaces: dict[str, fem.FunctionSpace] = dict(zip(names, subs, strict=True))
        self._collapsed = {name: _collapsed(sub, is_mixed) for name, sub in self._subspaces.items()}
        histories = [part.name for part in self.parts if part.role == "history"]
        self.old = SimpleNamespace(**{name: self.function(name, "old") for name in histories})
        self.conditions: list[Condition] = []

    def __getattr__(self, name: str) -> Any:
        """Return a part by its name, UFL."""
        values = self.__dict__.get("_values", {})
        if name not in values:
            raise AttributeError(
                f"no part {name!r} of the unknown: it has {', '.join(values) or 'none yet'}"
            )
        return values[name]

    def __contains__(self, name: object) -> bool:
        """Return whether there is a part of this name."""
        return name in self._values

    @property
    def moving(self) -> str | None:
        """Name of the part that moves the points, or None."""
        return next((part.name for part in self.parts if part.role == "moves"), None)

    def part_space(self, name: str) -> fem.FunctionSpace:
        """Return the function space of a single part.

        Args:
            name: Name of the part.
        """
        return self._collapsed[name][0]

    def subspace(self, name: str) -> fem.FunctionSpace:
        """Return the part of the unknown's space that belongs to a part, as dolfinx views it.

        Args:
            name: Name of the part.
        """
        return self._subspaces[name]

    def dofs(self, name: str) -> npt.NDArray[np.int32]:
        """Return the indices ``(n,)`` of a part in ``U.x.array``, in the order of ``part_space``.

        Args:
            name: Name of the part.
        """
        space, dofs = self._collapsed[name]
        # A single part has all dofs. The array is not stored, since lattices can be large and
        # mostly empty.
        if dofs is None:
            index_map, bs = space.dofmap.index_map, space.dofmap.index_map_bs
            size = (index_map.size_local + index_map.num_ghosts) * bs
            dofs = np.arange(size, dtype=np.int32)
        return dofs

    def function(self, name: str, prefix: str = "") -> fem.Function:
        """Return a new function with the current values of a part, for evaluation or output.

        Args:
            name: Name of the part.
            prefix: Prefix of the name of the function.
        """
        result = fem.Function(self.part_space(name), name=f"{prefix}_{name}" if prefix else name)
        result.x.array[:] = self.U.x.array[self.dofs(name)]
        return result

    def interpolate(self, name: str, value: Any) -> None:
        """Interpolate a function into a part, as ``fem.Function.interpolate`` does.

        Args:
            name: Name of the part.
            value: Function of positions ``(3, n)`` [m], ``fem.Function`` or ``fem.Expression``.
        """
        function = fem.Function(self.part_space(name))
        function.interpolate(value)
        self.U.x.array[self.dofs(name)] = function.x.array

    def require(self, *names: str, of: str) -> None:
        """Raise ValueError if parts are missing.

        Args:
            names: Names of the parts.
            of: Name of the feature that needs them, for the message.

        Raises:
            ValueError: If a part is missing.
        """
        missing = [name for name in names if name not in self]
        if missing:
            raise ValueError(
                f"{of} needs the part{'s' * (len(names) > 1)} {', '.join(names)} of the unknown, "
                f"which has {', '.join(self._values)}"
            )

    def require_linear(self, what: str, *names: str) -> None:
        """Raise ValueError if parts have nodes other than the vertices.

        Args:
            what: Name of the feature that needs linear functions, for the message.
            names: Names of the parts. Without names, all parts are checked.

        Raises:
            ValueError: If the functions of a part are not continuous and linear.
        """
        for name in names or self._values:
            element = self.part_space(name).ufl_element()
            if not is_linear(element):
                raise ValueError(
                    f"{what} needs continuous linear functions, whose nodes are the vertices, not "
                    f"{element}"
                )

    def fix(
        self, part: str, where: Place, value: Any = 0.0, *, component: int | None = None
    ) -> Condition:
        """Add a Dirichlet condition on a part, or on one of its components. Collective.

        If the part moves the points, the value is the displacement since the start, at the end of a
        step. Time loops take the increments of this function of time at each node. If the
        increments depend on how far the body has rotated or stretched, give the displacement
        increment of a step instead, as a function of its ``start`` and ``end``. A value that does
        not depend on time is the increment of a single step.

        Args:
            part: Name of the part.
            where: Marker as in dolfinx, from positions ``(3, n)`` [m] to a mask ``(n,)``, or local
                facets ``(n,)``, such as those of ``dolfinx.mesh.exterior_facet_indices``.
            value: Number, sequence with one number for each component, function of the part's
                space, or callable. The parameters of a callable are ``x``, the positions ``(3, n)``
                [m], and ``t``, the time [s], or ``start`` and ``end`` of a step [s]. They are
                passed by these names.
            component: Index of the fixed component. None for all components.

        Returns:
            The condition, which is also appended to ``conditions``.

        Raises:
            ValueError: If the part or component is unknown, the marker has a wrong shape or finds
                no node on any rank, or the value has a wrong shape.
        """
        condition = Condition(self, part, where, value, component)
        self.conditions.append(condition)
        return condition

    @property
    def bcs(self) -> list[fem.DirichletBC]:
        """Dolfinx conditions of all ``conditions``, for dolfinx and ``NewtonSolver``."""
        return [condition.bc for condition in self.conditions]

    def require_conditions(self, known: Sequence[fem.DirichletBC]) -> None:
        """Raise ValueError if conditions were added after a simulation was created.

        Args:
            known: Value of ``bcs`` when the simulation was created.

        Raises:
            ValueError: If the conditions have changed since.
        """
        if self.bcs != list(known):
            raise ValueError(
                "conditions were added to the unknown after the simulation was made, which would "
                "ignore them: call fix(..) before"
            )

    def set_conditions(self, start: float, end: float) -> None:
        """Set all conditions to their values for a step. Collective.

        Args:
            start: Time at the start of the step [s].
            end: Time at which the equations hold [s].
        """
        for condition in self.conditions:
            condition.set(start, end)

    def _facts(self) -> Facts:
        facts = []
        for part in self.parts:
            dofmap = self.part_space(part.name).dofmap
            n = dofmap.index_map.size_global * dofmap.index_map_bs
            kind = "vector" if part.is_vector else "scalar"
            facts.append((part.name, f"{kind}, {part.role}, {n} degrees of freedom"))
        fixed = ", ".join(condition.part for condition in self.conditions)
        return [*facts, ("conditions on", fixed or "none")]

    def __repr__(self) -> str:
        """Names, shapes and roles of the parts."""
        return f"Unknown({_described(self.parts)})"


def coupled_unknowns(
    mesh: Any, *parts: Sequence[str | Part], degree: int = 1
) -> tuple[Unknown, ...]:
    """Return one unknown for each of several bodies on one mesh, solved for together. Collective.

    Bodies that share nodes then move independently, except for interactions such as ``contact``.
    Each unknown has its own parts, test functions and conditions. U, V and the space are those of
    all unknowns together.

    Args:
        mesh: Background mesh.
        parts: Parts of each unknown, as names or ``Part`` objects, such as ``("u", "p"), ("u",)``.
        degree: Degree of the Lagrange functions of parts given by name.

    Returns:
        The unknowns, in the same order.

    Raises:
        ValueError: If there are fewer than two unknowns, a name is given instead of a sequence of
            parts, or for the reasons of ``Unknown``.
    """
    if len(parts) < 2 or any(isinstance(own, str) for own in parts):
        raise ValueError(
            'give the parts of two unknowns or more: coupled_unknowns(mesh, ("u", "p"), ("u",))'
        )
    of_each = [_with_roles(own, degree) for own in parts]
    together = [part for own in of_each for part in own]
    U = _function_of(mesh, together)
    V, unknowns, first = ufl.TestFunction(U.function_space), [], 0
    for own in of_each:
        unknown = object.__new__(Unknown)
        unknown._take(U, V, own, first)
        unknowns.append(unknown)
        first += len(own)
    return tuple(unknowns)


def _by_name(name: str, degree: int) -> Part:
    """Return the part that a name stands for."""
    role = {"u": "moves", "v": "grid"}.get(name, "history")
    # The pressure of a step is the initial guess for the next one, so its start value may be zero.
    return Part(name, name in ("u", "v"), role, degree, initial=0.0 if name == "p" else None)


def _with_roles(parts: Sequence[str | Part], degree: int) -> tuple[Part, ...]:
    """Return the parts of one unknown, after a check of their names."""
    result = tuple(_by_name(part, degree) if isinstance(part, str) else part for part in parts)
    names = [part.name for part in result]
    if not names:
        raise ValueError('an unknown needs parts, such as Unknown(mesh, "u", "p")')
    taken = [name for name in names if hasattr(Unknown, name) or names.count(name) > 1]
    taken += sorted(_ATTRIBUTES.intersection(names))
    if taken:
        raise ValueError(f"the name {taken[0]!r} of a part is taken: choose another one")
    moving = [part.name for part in result if part.role == "moves"]
    if len(moving) > 1:
        raise ValueError(
            f"the parts {' and '.join(moving)} would both move the points, but only one can: give "
            'the others role="history" or "grid", or use coupled_unknowns for bodies that move '
            "independently"
        )
    return result


def _is_mixed(space: fem.FunctionSpace) -> bool:
    return space.num_sub_spaces > 0 and space.dofmap.index_map_bs == 1


def _check_shapes(U: fem.Function, parts: Sequence[Part]) -> None:
    """Raise ValueError if a function has other parts."""
    dim = U.function_space.mesh.geometry.dim
    split = ufl.split(U) if _is_mixed(U.function_space) else (U,)
    shapes = [part.ufl_shape for part in split]
    wanted = [(dim,) if part.is_vector else () for part in parts]
    if shapes != wanted:
        raise ValueError(
            f"the function has parts of shapes {shapes}, but Unknown({_described(parts)}) needs "
            f"{wanted}"
        )


def _described(parts: Sequence[Part]) -> str:
    return ", ".join(f"{p.name} ({'vector' if p.is_vector else 'scalar'}, {p.role})" for p in parts)


def _function_of(mesh: Any, parts: Sequence[Part]) -> fem.Function:
    """Return a new function with given parts on a mesh. Collective."""
    name = "_".join(part.name for part in parts)
    function = fem.Function(fem.functionspace(mesh, _element(mesh, parts)), name=name)
    release_zeros(function.x.array)
    return function


def _element(mesh: Any, parts: Sequence[Part]) -> Any:
    cell, dim = mesh.basix_cell(), mesh.geometry.dim
    elements = [
        basix.ufl.element("Lagrange", cell, part.degree, shape=(dim,) if part.is_vector else None)
        for part in parts
    ]
    return elements[0] if len(elements) == 1 else basix.ufl.mixed_element(elements)


def _collapsed(
    space: fem.FunctionSpace, is_part: bool
) -> tuple[fem.FunctionSpace, npt.NDArray[np.int32] | None]:
    """Return the space of a part, and its dofs in the whole space; None for all in their order."""
    if not is_part:
        return space, None
    return _compat.collapsed(space)
