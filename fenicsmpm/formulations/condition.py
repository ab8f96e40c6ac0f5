# SPDX-License-Identifier: MIT
"""Dirichlet conditions on parts of an unknown."""

from __future__ import annotations

import inspect
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import numpy.typing as npt
from dolfinx import fem

from fenicsmpm.points.agreement import do_there, raise_together
from fenicsmpm.points.of_position import CaughtMarker, OfPosition

if TYPE_CHECKING:
    from fenicsmpm.formulations.unknown import Unknown

Place: TypeAlias = OfPosition | npt.NDArray[np.integer]


class Condition:
    """Dirichlet condition on a part of an unknown; see ``Unknown.fix``.

    Attributes:
        bc: Dirichlet condition of dolfinx.
        part: Name of the part.
        unknown: The unknown that has the part.
        size: Number of components of the part.
        depends_on_time: Whether the value is a function of time.
    """

    def __init__(
        self, unknown: Unknown, part: str, where: Place, value: Any, component: int | None
    ) -> None:
        """Find the nodes, and set the value at time zero. Collective."""
        unknown.require(part, of="a Dirichlet condition")
        self.part, self._is_motion = part, part == unknown.moving
        self._is_set = False
        self.unknown = unknown
        is_vector = len(getattr(unknown, part).ufl_shape) > 0
        self.size = unknown.mesh.geometry.dim if is_vector else 1
        sub = unknown.subspace(part)
        if component is not None:
            n = self.size if is_vector else 0
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
        """Set the value for a step; see ``Unknown.set_conditions``. Collective.

        Args:
            start: Time at the start of the step [s].
            end: Time at which the equations hold [s].
        """
        if self._value is None or (self._is_set and not self.depends_on_time):
            return  # a function that the user sets, or a constant value
        value, self._is_set = self._value, True

        def at(x: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
            if self._is_motion and "t" in value.names:
                return value.at(x, end, end) - value.at(x, start, start)
            return value.at(x, start, end)

        # The user's function may fail on one rank only.
        comm = self._function.function_space.mesh.comm
        do_there(comm, True, lambda: self._function.interpolate(at))

    def moves_again(self) -> bool:
        """Return whether every step would repeat the same nonzero displacement. Collective."""
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
                    f"the value of part {part!r} has the parameters "
                    f"{', '.join(self.names) or '(none)'}: use x for positions and t for time, or "
                    "start and end of a step, by these names"
                )
        self.at(np.zeros((3, 4)), 0.0, 0.0)
        here, there = (self._called(np.full((3, 4), at), 0.0, 0.0) for at in (0.0, 1.0))
        if "x" in self.names and here.ndim == 1 and self._rows > 1 and np.any(here != there):
            raise ValueError(
                f"the value of part {part!r} depends on position, but is a single value for all "
                "positions: x has the shape (3, n) as in dolfinx, so use x[0] for the first "
                "coordinates"
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
        """Return ``(n_components, n)`` values at positions ``(3, n)``."""
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
    """Return the dofs of a condition; raise ValueError on all ranks if there are none."""
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
        "give fix(..) a marker of positions or local facets (n,), not an array of "
        f"{facets.dtype} of the shape {facets.shape}"
    )
