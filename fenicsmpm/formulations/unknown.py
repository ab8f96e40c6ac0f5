# SPDX-License-Identifier: MIT
"""Unknown: the parts of a problem's unknown by name, their test functions and conditions."""

from __future__ import annotations

import inspect
from collections.abc import Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, TypeAlias

import basix.ufl
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem

from fenicsmpm import _compat
from fenicsmpm._display import Described, Facts
from fenicsmpm.basis import is_linear
from fenicsmpm.points.agreement import do_there, raise_together
from fenicsmpm.points.of_position import CaughtMarker, OfPosition

Place: TypeAlias = OfPosition | npt.NDArray[np.integer]

_ROLES = ("moves", "history", "grid")
# Of an unknown, beside its methods: parts cannot have these names
_ATTRIBUTES = frozenset({"U", "V", "space", "mesh", "parts", "test", "old", "conditions"})


@dataclass(frozen=True)
class Part:
    """A part of an unknown and how it lives at the points.

    Args:
        name: by which forms and fields of points know it.
        is_vector: whether it has a component for each direction, or is a scalar.
        role: "moves" for the increment of displacement in a step; "history" for what points carry
            in a field of the same name, which is mapped to the grid at the beginning of a step and
            given back at its end; "grid" for what is the grid's alone.
        degree: of its Lagrange functions.
        flip: of a history: 0 if points take the grid's new value (PIC), 1 if they take its change
            (FLIP), or between.
        initial: value of a history at points without a field of its name; None if they must have
            one.
    """

    name: str
    is_vector: bool = False
    role: str = "history"
    degree: int = 1
    flip: float = 0.0
    initial: float | None = None

    def __post_init__(self) -> None:
        """Check the role, and the rest by it."""
        if not self.name.isidentifier():
            raise ValueError(f"the name of a part must be one of Python's: {self.name!r}")
        if self.role not in _ROLES:
            raise ValueError(f"unknown role {self.role!r} of a part: use {', '.join(_ROLES)}")
        if self.role == "moves" and not self.is_vector:
            raise ValueError(f"what moves the points is a vector, but {self.name!r} is a scalar")
        if not 0 <= self.flip <= 1:
            raise ValueError(f"the share of FLIP must lie in [0, 1]: flip = {self.flip}")


class Unknown(Described):
    """The unknown of a problem: named parts on one mesh, in one function for UFL.

    ``Unknown(mesh, "u", "p")`` has the linear functions of displacement and pressure: the name "u"
    stands for a vector that moves the points, "v" for one that is the grid's alone (the velocity of
    explicit steps), any other name for a scalar that points carry. Parts are attributes of the
    unknown and of its test functions: ``z.u``, ``z.test.u``.

    Args:
        over: mesh for a new function; or a function of one's own, on a mixed space if there are
            several parts.
        parts: names, or ``Part`` objects, in the order of the space.
        degree: of the Lagrange functions of parts given by their names.

    Attributes:
        U: the function of all parts, in which forms are differentiated.
        V: its test function.
        space: of both.
        mesh: background mesh.
        parts: in their order.
        test: the parts of V, as attributes.
        old: of each history, what was mapped from the points, as attributes (``fem.Function``).
        conditions: made by ``fix``.

    Raises:
        ValueError: for no parts or names that are taken, several parts that move the points, or a
            function with other parts.
    """

    def __init__(self, over: Any, *parts: str | Part, degree: int = 1) -> None:
        """Create spaces and functions (collective)."""
        self.parts = tuple(
            _by_name(part, degree) if isinstance(part, str) else part for part in parts
        )
        names = [part.name for part in self.parts]
        self._check_names(names)
        if isinstance(over, fem.Function):
            self.U, self.space = over, over.function_space
        else:
            self.space = fem.functionspace(over, _element(over, self.parts))
            self.U = fem.Function(self.space, name="_".join(names))
        self.mesh = self.space.mesh
        self.V = ufl.TestFunction(self.space)
        is_mixed = self.space.num_sub_spaces > 0 and self.space.dofmap.index_map_bs == 1
        split = [f if is_mixed else (f,) for f in (self.U, self.V)]
        if is_mixed:
            split = [ufl.split(f) for f in (self.U, self.V)]
        self._check_shapes([part.ufl_shape for part in split[0]])
        self._values = dict(zip(names, split[0], strict=True))
        self.test = SimpleNamespace(**dict(zip(names, split[1], strict=True)))
        subs = [self.space.sub(i) for i in range(len(names))] if is_mixed else [self.space]
        self._subspaces = dict(zip(names, subs, strict=True))
        self._collapsed = {name: _collapsed(sub, is_mixed) for name, sub in self._subspaces.items()}
        histories = [part.name for part in self.parts if part.role == "history"]
        self.old = SimpleNamespace(**{name: self.function(name, "old") for name in histories})
        self.conditions: list[Condition] = []

    def __getattr__(self, name: str) -> Any:
        """A part by its name, UFL."""
        values = self.__dict__.get("_values", {})
        if name not in values:
            raise AttributeError(
                f"no part {name!r} of the unknown: it has {', '.join(values) or 'none yet'}"
            )
        return values[name]

    def __contains__(self, name: object) -> bool:
        """Whether there is a part of this name."""
        return name in self._values

    @property
    def moving(self) -> str | None:
        """Name of the part that moves the points; None without one."""
        return next((part.name for part in self.parts if part.role == "moves"), None)

    def part_space(self, name: str) -> fem.FunctionSpace:
        """Space of a part alone.

        Args:
            name: of the part.
        """
        return self._collapsed[name][0]

    def dofs(self, name: str) -> npt.NDArray[np.int32]:
        """``(n,)`` places of a part in ``U.x.array``, in the order of ``part_space``.

        Args:
            name: of the part.
        """
        space, dofs = self._collapsed[name]
        if dofs is None:  # the only part: not kept, as lattices may be large and mostly empty
            index_map, bs = space.dofmap.index_map, space.dofmap.index_map_bs
            size = (index_map.size_local + index_map.num_ghosts) * bs
            dofs = np.arange(size, dtype=np.int32)
        return dofs

    def function(self, name: str, prefix: str = "") -> fem.Function:
        """New function with the present values of a part, to be evaluated or written.

        Args:
            name: of the part.
            prefix: of the function's name.
        """
        result = fem.Function(self.part_space(name), name=f"{prefix}_{name}" if prefix else name)
        result.x.array[:] = self.U.x.array[self.dofs(name)]
        return result

    def interpolate(self, name: str, value: Any) -> None:
        """Give a part the values of a function, as ``fem.Function.interpolate`` takes it.

        Args:
            name: of the part.
            value: function of positions ``(3, n)``, ``fem.Function`` or ``fem.Expression``.
        """
        function = fem.Function(self.part_space(name))
        function.interpolate(value)
        self.U.x.array[self.dofs(name)] = function.x.array

    def require(self, *names: str, of: str) -> None:
        """Raise ValueError if parts are missing.

        Args:
            names: of the parts.
            of: what needs them.
        """
        missing = [name for name in names if name not in self]
        if missing:
            raise ValueError(
                f"{of} needs the part{'s' * (len(names) > 1)} {', '.join(names)} of the unknown, "
                f"which has {', '.join(self._values)}"
            )

    def require_linear(self, what: str, *names: str) -> None:
        """Raise ValueError for parts with nodes beside the vertices.

        Args:
            what: needs linear functions.
            names: of the parts; none for all.
        """
        for name in names or self._values:
            element = self.part_space(name).ufl_element()
            if not is_linear(element):
                raise ValueError(
                    f"{what} is for continuous linear functions, whose nodes are the vertices, not "
                    f"for {element}"
                )

    def fix(
        self, part: str, where: Place, value: Any = 0.0, *, component: int | None = None
    ) -> Condition:
        """Dirichlet condition on a part, or one of its components (collective).

        Of what moves the points, the value is the displacement since the start at the end of a
        step, a function of time of which loops take the increments at each node. Where these depend
        on how the body has turned or stretched so far, give the increment of a step instead, as a
        function of its ``start`` and ``end``. A value without any time is that of a single step.

        Args:
            part: its name.
            where: marker as in dolfinx, from positions ``(3, n)`` [m] to a mask ``(n,)``; or local
                facets ``(n,)``, such as ``dolfinx.mesh.exterior_facet_indices`` finds.
            value: number, one for each component, function of the part's space, or callable with
                the parameters ``x``, positions ``(3, n)``, and ``t``, the time [s], or ``start``
                and ``end`` of a step [s], all by these names.
            component: that is fixed; None for all.

        Returns:
            The condition, which is also among ``conditions``.

        Raises:
            ValueError: for unknown parts or components; a marker of another shape or that finds no
                node on any rank; a value of another shape.
        """
        condition = Condition(self, part, where, value, component)
        self.conditions.append(condition)
        return condition

    @property
    def bcs(self) -> list[fem.DirichletBC]:
        """All conditions, for dolfinx and ``NewtonSolver``."""
        return [condition.bc for condition in self.conditions]

    def require_conditions(self, known: Sequence[fem.DirichletBC]) -> None:
        """Raise ValueError for conditions that a simulation was not made with.

        Args:
            known: what ``bcs`` was then.
        """
        if self.bcs != list(known):
            raise ValueError(
                "conditions were added to the unknown after the simulation was made, which would "
                "not know them: call fix(..) before"
            )

    def set_conditions(self, start: float, end: float) -> None:
        """Give all conditions the values of a step (collective).

        Args:
            start: time at its beginning [s].
            end: time when the equations hold [s].
        """
        for condition in self.conditions:
            condition.set(start, end)

    def _check_names(self, names: Sequence[str]) -> None:
        if not names:
            raise ValueError('an unknown needs parts, such as Unknown(mesh, "u", "p")')
        taken = [name for name in names if hasattr(type(self), name) or names.count(name) > 1]
        taken += sorted(_ATTRIBUTES.intersection(names))
        if taken:
            raise ValueError(f"the name {taken[0]!r} of a part is taken: choose another one")
        moving = [part.name for part in self.parts if part.role == "moves"]
        if len(moving) > 1:
            raise ValueError(
                f"the parts {' and '.join(moving)} would both move the points: only one can; give "
                'the others role="history" or "grid"'
            )

    def _check_shapes(self, shapes: Sequence[tuple[int, ...]]) -> None:
        dim = self.mesh.geometry.dim
        wanted = [(dim,) if part.is_vector else () for part in self.parts]
        if list(shapes) != wanted:
            raise ValueError(
                f"the function has parts of shapes {list(shapes)}, but {self!r} needs {wanted}"
            )

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
        described = [
            f"{part.name} ({'vector' if part.is_vector else 'scalar'}, {part.role})"
            for part in self.parts
        ]
        return f"Unknown({', '.join(described)})"


class Condition:
    """A Dirichlet condition on a part of an unknown; see ``Unknown.fix``.

    Attributes:
        bc: of dolfinx.
        part: name of the part.
        size: number of the part's components.
        depends_on_time: whether its value is given as a function of time.
    """

    def __init__(
        self, unknown: Unknown, part: str, where: Place, value: Any, component: int | None
    ) -> None:
        """Find the nodes, and set the value of time zero (collective)."""
        unknown.require(part, of="a Dirichlet condition")
        self.part, self._is_motion = part, part == unknown.moving
        self._is_set = False
        self.size = len(unknown._values[part].ufl_shape) * unknown.mesh.geometry.dim or 1
        sub = unknown._subspaces[part]
        if component is not None:
            n = self.size if unknown._values[part].ufl_shape else 0
            if component not in range(n):
                raise ValueError(f"part {part!r} has no component {component}: it has {n}")
            sub = sub.sub(component)
        space = unknown.part_space(part) if component is None else sub.collapse()[0]
        if isinstance(value, fem.Function):
            if value.function_space != space:
                raise ValueError(
                    f"the value of part {part!r} is a function of another space: use "
                    f"fem.Function(unknown.part_space({part!r}))"
                )
            self._function, self._value = value, None
        else:
            self._function = fem.Function(space)
            self._value = do_there(space.mesh.comm, True, lambda: _Value(value, part, space))
        whole = sub is unknown.space
        dofs = _located(where, sub if whole else (sub, space), space, part)
        self.bc = fem.dirichletbc(self._function, dofs, *(() if whole else (sub,)))
        self.set(0.0, 0.0)

    @property
    def depends_on_time(self) -> bool:
        """Whether the value is a function of time."""
        return self._value is not None and self._value.depends_on_time

    def set(self, start: float, end: float) -> None:
        """Take the value of a step (collective); see ``Unknown.set_conditions``."""
        if self._value is None or (self._is_set and not self.depends_on_time):
            return  # the user's function, or what stays
        value, self._is_set = self._value, True

        def at(x: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
            if self._is_motion and "t" in value.names:
                return value.at(x, end, end) - value.at(x, start, start)
            return value.at(x, start, end)

        # the user's function may fail on one rank only
        comm = self._function.function_space.mesh.comm
        do_there(comm, True, lambda: self._function.interpolate(at))

    def moves_again(self) -> bool:
        """Whether each step of a loop would add the same displacement, not zero (collective)."""
        if not self._is_motion or self._value is None or self.depends_on_time:
            return False
        here = bool(np.any(self._function.x.array != 0))
        return any(self._function.function_space.mesh.comm.allgather(here))


class _Value:
    """A value that may depend on position and time."""

    def __init__(self, value: Any, part: str, space: fem.FunctionSpace) -> None:
        self._given, self._part = value, part
        self._rows = space.dofmap.index_map_bs
        self.names: list[str] = []
        if callable(value):
            parameters = inspect.signature(value).parameters.values()
            self.names = [p.name for p in parameters if p.default is p.empty]
            known = ({"x", "t"}, {"x", "start", "end"})
            if not self.names or not any(set(self.names) <= names for names in known):
                raise ValueError(
                    f"the value of part {part!r} is called with positions x, and time t, or start "
                    "and end of a step, by these names, but has the parameters "
                    f"{', '.join(self.names) or '(none)'}"
                )
        self.at(np.zeros((3, 4)), 0.0, 0.0)
        here, there = (self._called(np.full((3, 4), at), 0.0, 0.0) for at in (0.0, 1.0))
        if "x" in self.names and here.ndim == 1 and self._rows > 1 and np.any(here != there):
            raise ValueError(
                f"the value of part {part!r} is one for all positions, but depends on them: x has "
                "the shape (3, n) as in dolfinx, so that x[0] are the first coordinates"
            )

    def _called(
        self, x: npt.NDArray[np.float64], start: float, end: float
    ) -> npt.NDArray[np.float64]:
        given = self._given
        if self.names:
            arguments = {"x": x, "t": end, "start": start, "end": end}
            given = given(**{name: arguments[name] for name in self.names})
        return np.asarray(given, dtype=np.float64)

    @property
    def depends_on_time(self) -> bool:
        return not set(self.names) <= {"x"}

    def at(self, x: npt.NDArray[np.float64], start: float, end: float) -> npt.NDArray[np.float64]:
        """``(n_components, n)`` values at positions ``(3, n)``."""
        rows, n = self._rows, x.shape[1]
        array = self._called(x, start, end)
        if array.ndim <= 1 and (rows > 1 or array.size == 1):  # the same everywhere
            array = array.reshape(-1, 1)
        elif array.shape == (n,) and rows == 1:
            array = array[None]
        if array.shape not in ((1, 1), (rows, 1), (rows, n)):
            raise ValueError(
                f"the value of part {self._part!r} needs {rows} component(s) at each position, but "
                f"has the shape {array.shape} at {n} positions"
            )
        return np.array(np.broadcast_to(array, (rows, n)))


def _located(where: Place, spaces: Any, space: fem.FunctionSpace, part: str) -> Any:
    """Degrees of freedom of a condition; ValueError on all ranks for places that are none."""
    comm = space.mesh.comm
    if callable(where):
        marker = CaughtMarker(where)
        dofs = fem.locate_dofs_geometrical(spaces, marker)
        raise_together(comm, marker.error)
    else:
        do_there(comm, True, lambda: _check_facets(where))
        dim = space.mesh.topology.dim
        space.mesh.topology.create_connectivity(dim - 1, dim)
        dofs = fem.locate_dofs_topological(spaces, dim - 1, np.asarray(where, dtype=np.int32))
    if comm.allreduce(np.size(dofs)) == 0:
        raise ValueError(f"a condition on part {part!r} at no node: check the marker")
    return dofs


def _check_facets(where: Any) -> None:
    facets = np.asarray(where)
    if facets.ndim == 1 and (np.issubdtype(facets.dtype, np.integer) or len(facets) == 0):
        return
    raise ValueError(
        f"where a part is fixed is said by a marker or by local facets (n,), not by {facets.dtype} "
        f"of the shape {facets.shape}"
    )


def _by_name(name: str, degree: int) -> Part:
    """The part for which a name alone stands."""
    role = {"u": "moves", "v": "grid"}.get(name, "history")
    # the pressure of a step is a first guess for the next one
    return Part(name, name in ("u", "v"), role, degree, initial=0.0 if name == "p" else None)


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
    """Space of a part, and where its dofs are in the whole one; None for all in their order."""
    if not is_part:
        return space, None
    return _compat.collapsed(space)
