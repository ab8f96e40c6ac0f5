# SPDX-License-Identifier: MIT
"""Material points: named arrays with one row per point, distributed like the cells of the mesh."""

from collections.abc import Iterable, Mapping
from typing import Any, TypeAlias

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx.mesh import Mesh

from fenicsmpm._display import Described, Facts, Picture
from fenicsmpm.points import drawing
from fenicsmpm.points.agreement import raise_together
from fenicsmpm.points.checks import (
    check_fields,
    check_input,
    check_positions,
    check_same_fields,
    check_selection,
)
from fenicsmpm.points.description import facts_of
from fenicsmpm.points.location import locator
from fenicsmpm.points.migration import find_cells, send_home
from fenicsmpm.points.numbering import ids_in_order
from fenicsmpm.points.of_position import OfPosition
from fenicsmpm.points.pending_fields import FieldTable, Provider
from fenicsmpm.points.point_arrays import BUILT_IN, PointArrays
from fenicsmpm.points.point_field import PointField
from fenicsmpm.points.sorting import order_by_number, sort_by_number

Selection: TypeAlias = npt.ArrayLike | OfPosition


class MaterialPoints(PointArrays, Described):
    """Material points (or boundary points with loads) in a background mesh.

    Each point is stored on the rank that owns its cell. The first index of each array is the
    point.

    Attributes:
        mesh: The background mesh, which does not move.
        geometry: Shapes of the cells of the mesh.
        version: Counter that grows whenever positions, cells, order or number of the points change.
        size_global: Number of points on all ranks.
        next_id: Id of the next point that is added.
        grid_functions: Grid functions chosen for these points by `fenicsmpm.basis.use`; None for
            the finite element functions of the mesh.
    """

    def __init__(
        self,
        mesh: Mesh,
        x: npt.ArrayLike,
        weight: npt.ArrayLike,
        *,
        cells: npt.ArrayLike | None = None,
        xi: npt.ArrayLike | None = None,
        tag: npt.ArrayLike = 0,
        number: npt.ArrayLike | None = None,
        fields: Mapping[str, npt.ArrayLike] | None = None,
    ):
        """Create points at given positions. Collective.

        Each rank may pass any points, or none. They are sent to the ranks that own their cells.
        Their ids are 0, 1, ... over all ranks.

        Args:
            mesh: Background mesh of straight triangles, quadrilaterals, tetrahedra or hexahedra.
            x: Positions in m, shape (n, d).
            weight: Volume of body points in m^d (in 2D per unit thickness), area or length of
                boundary points in m^(d-1); shape (n,) or one number.
            cells: Local cell in or near which the search for each point starts, -1 if unknown;
                shape (n,).
            xi: Reference coordinates of the points, shape (n, d), if they are known. Then `cells`
                must be the cells of the points, and no search takes place.
            tag: Integers that tell groups of points apart, shape (n,) or one number.
            number: Distinct integers from 0, shape (n,). Ids follow their order, on whatever rank
                the points are passed. None for the order in which points are passed, rank by rank.
            fields: Initial fields, arrays of shape (n, *value_shape). Names and value shapes must
                be the same on all ranks.

        Raises:
            ValueError: On all ranks, for meshes of unsupported cells, wrong shapes, weights that
                are not positive and finite, positions that are not finite, and numbers that are
                negative or not distinct.
            PointsOutsideError: On all ranks, if some point is in no cell of the mesh.
        """
        self.mesh = mesh
        self._locator = locator(mesh)
        self.geometry = self._locator.geometry
        error, data = check_input(
            self._locator, x, weight, cells, xi, tag, number, fields, BUILT_IN
        )
        raise_together(self._comm, error)
        raise_together(self._comm, check_fields(self._comm, data))

        n = len(data["x"])
        self.version = 0
        self.grid_functions: tuple[str, npt.ArrayLike | None] | None = None
        self._coefficients: dict[str, PointField] = {}
        self._initial = {}
        self._order: tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]] | None = None
        self.size_global: int = self._comm.allreduce(n)
        self.next_id = self.size_global
        if "id" in data:
            data["id"] = ids_in_order(self._comm, data["id"])
        else:
            data["id"] = (self._comm.exscan(n) or 0) + np.arange(n, dtype=np.int64)
        if "xi" in data:
            global_cell = self.geometry.global_index(data["cell"])
        else:
            global_cell, data["cell"], data["xi"] = find_cells(
                self._comm, self._locator, data["x"], data.get("cell")
            )
        names = [*BUILT_IN, *(name for name in data if name not in BUILT_IN)]
        self._data = FieldTable({name: data[name] for name in names})
        self._send_home(global_cell)

    @property
    def _comm(self) -> MPI.Intracomm:
        return self.mesh.comm

    def field(self, name: str) -> PointField:
        """Return a field as a coefficient for UFL forms over these points.

        Args:
            name: Name of a field of float64 values; also "x" or "weight".

        Returns:
            The coefficient, the same object at each call. It reads the array of the field whenever
            a form is assembled.

        Raises:
            KeyError: If there is no such field.
        """
        if name not in self._coefficients:
            self._coefficients[name] = PointField(self, name)
        return self._coefficients[name]

    # --- integration ----------------------------------------------------------------------------

    @property
    def dx(self) -> ufl.Measure:
        """Measure for integrals over the points; `dx(i)` is restricted to points with tag i."""
        return ufl.Measure("dx", domain=self.mesh.ufl_domain(), subdomain_data=self)

    def volume(self) -> float:
        """Return the sum of the weights over all ranks, in m^d or m^(d-1). Collective."""
        return self._comm.allreduce(float(self._data["weight"].sum()))

    def bounds(self) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """Return the lowest and highest coordinates over all ranks. Collective.

        Returns:
            Two arrays of shape (d,) in m; plus and minus infinity if there are no points.
        """
        x = self._data["x"]
        lower, upper = np.empty((2, x.shape[1]))
        self._comm.Allreduce(x.min(axis=0, initial=np.inf), lower, MPI.MIN)
        self._comm.Allreduce(x.max(axis=0, initial=-np.inf), upper, MPI.MAX)
        return lower, upper

    # --- pictures -------------------------------------------------------------------------------

    def plot(self, field: str | None = None, label: str | None = None, **options: Any) -> Picture:
        """Draw the points in a notebook, without writing a file. Collective.

        Args:
            field: Name of the field that gives the colours. None draws all points in one colour,
                and in 2D the cells of the mesh as well.
            label: Text beside the colour bar, with the unit; None for the name of the field.
            **options: Keyword arguments of `fenicsmpm.io.picture`, such as `cut` and `limits`.

        Returns:
            The picture, which a notebook displays.

        Raises:
            RuntimeError: On all ranks, if rendering is impossible; says what to install.
            ValueError: On all ranks, for fields or components that do not exist.
        """
        return drawing.picture(None, self, field, label, comm=self._comm, **options)

    # --- order ----------------------------------------------------------------------------------

    @property
    def order(self) -> npt.NDArray[np.int64]:
        """Permutation that sorts the points by cell (stable), shape (n,), int64."""
        return self._sorted()[0]

    @property
    def cell_offsets(self) -> npt.NDArray[np.int64]:
        """Offsets of the cells in `order`, shape (owned + ghost cells + 1,), int64.

        The points of local cell c are ``order[cell_offsets[c]:cell_offsets[c + 1]]``.
        """
        return self._sorted()[1]

    def _sorted(self) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
        if self._order is None:
            self._order = sort_by_number(self._data["cell"], self.geometry.num_cells)
        return self._order

    def sort(self, by: npt.NDArray[np.integer] | None = None) -> None:
        """Reorder the points in memory, by cell unless told otherwise.

        Loops over points are faster when neighbours in the mesh are neighbours in memory.

        Args:
            by: Non-negative integers by which the points are sorted, shape (n,); the cells of the
                points if not given.
        """
        self._data.settle()
        order = order_by_number(self._data["cell"] if by is None else by)
        # One array at a time, the largest first: it needs the most free memory.
        for name in sorted(self._data, key=lambda name: -self._data[name].nbytes):
            self._data[name] = self._data[name][order]
        self._replace(self._data)

    # --- loops that keep points in arrays of their own ------------------------------------------

    def defer(
        self,
        names: Iterable[str],
        provide: Provider,
        others: Mapping[str, npt.NDArray] | None = None,
    ) -> None:
        """Drop arrays that a loop keeps itself, until somebody reads them. Not collective.

        `fenicsmpm.points.pending_fields` describes what such a loop has to do.

        Args:
            names: Fields, "weight" or "x". "cell" and "xi" are dropped with "x".
            provide: Function that returns the array of a name, and possibly of others in `names`.
            others: New arrays for everything that is not pending, if points have changed ranks
                or places in the arrays; `size_global` must not change.

        Raises:
            KeyError: For names without arrays.
            ValueError: For ids, tags, cells and reference coordinates, and if `others` does not
                fit.
        """
        providers = dict.fromkeys(names, provide)
        forbidden = {"id", "tag", "cell", "xi"}.intersection(providers)
        if forbidden:
            raise ValueError(
                f"{', '.join(sorted(forbidden))} cannot be deferred, only fields, "
                "'weight' and 'x' can"
            )
        if "x" in providers:
            providers |= dict.fromkeys(("cell", "xi"), self._find_own_cells)
        self._data.defer(providers, others)
        if "x" in providers or others is not None:
            self._order = None
            self.version += 1

    def _find_own_cells(self, name: str) -> dict[str, npt.NDArray]:
        """Return cells and reference coordinates of points that lie in cells of this rank."""
        x = self._data["x"]
        cell, xi = self._locator.locate(x, owned=True)
        lost = np.flatnonzero(cell < 0)
        if len(lost):
            raise RuntimeError(
                f"{len(lost)} of {len(x)} points on rank {self._comm.rank} are in no cell that it "
                f"owns, first at {x[lost[0]]}: they must be sent home before they are deferred"
            )
        return {"cell": cell, "xi": xi}

    # --- changes --------------------------------------------------------------------------------

    def move(self, x: npt.ArrayLike) -> None:
        """Set new positions and find the new cells, starting from the old ones. Collective.

        Points that enter a cell of another rank are sent there with their fields. If an error is
        raised, the points stay as they were.

        Args:
            x: New positions in m, shape (n, d).

        Raises:
            ValueError: On all ranks, for wrong shapes or positions that are not finite, or if the
                nodes of the background mesh have moved.
            PointsOutsideError: On all ranks, if some position is in no cell of the mesh.
        """
        error, positions = check_positions(x, self.geometry.dim, len(self))
        if self.geometry.has_moved(self.mesh):
            error = ValueError(
                "the nodes of the background mesh have moved since the points were located in it: "
                "make new MaterialPoints from their positions"
            )
        raise_together(self._comm, error)
        self._data.settle(but=("x", "cell", "xi"))
        near = self._data.present().get("cell")
        global_cell, cell, xi = find_cells(self._comm, self._locator, positions, near)
        self._data.update({"x": positions, "cell": cell, "xi": xi})
        self._send_home(global_cell)

    def add(self, other: "MaterialPoints") -> None:
        """Add copies of other points. Collective.

        The copies get new ids, in the order of the old ones.

        Args:
            other: Points on the same mesh with the same fields. A field may be missing in `other`
                if `add_field` gave it one initial value for all points: the copies get this value.

        Raises:
            ValueError: If meshes or fields differ.
        """
        if other.mesh is not self.mesh:
            raise ValueError(
                "points on another mesh cannot be added: put them on this one with from_mesh first"
            )
        theirs = dict(other._data)
        for name in self._initial.keys() - theirs.keys():
            value, shape = self._initial[name], self.field_shape(name)
            theirs[name] = np.broadcast_to(value, (len(other), *shape))
        check_same_fields(self._data, theirs)
        new = {**theirs, "id": self.next_id + ids_in_order(self._comm, other.id)}
        self.next_id += other.size_global
        self.size_global += other.size_global
        self._replace({name: np.concatenate([a, new[name]]) for name, a in self._data.items()})

    def remove(self, which: Selection) -> int:
        """Remove points. Collective.

        Args:
            which: Mask of shape (n,) or indices on this rank; or a marker as in dolfinx, a function
                from positions in m of shape (3, n) to a mask of shape (n,).

        Returns:
            Number of points removed on all ranks.

        Raises:
            ValueError: On all ranks, if `which` is neither a mask nor indices of these points, or
                if the marker returns another shape. Errors of the marker are raised as they are.
        """
        keep = ~self._mask(which)
        self._data.settle()
        before = self.size_global
        self.size_global = self._comm.allreduce(int(keep.sum()))
        self._replace(self._rows(keep))
        return before - self.size_global

    def select(self, which: Selection) -> "MaterialPoints":
        """Return a copy of some of the points, with their ids, tags and fields. Collective.

        Args:
            which: As for `remove`.

        Raises:
            ValueError: As for `remove`.
        """
        mask = self._mask(which)
        result = object.__new__(MaterialPoints)
        result.__dict__.update(self.__dict__)
        result._coefficients, result._initial = {}, dict(self._initial)
        result.size_global = self._comm.allreduce(int(mask.sum()))
        result._replace(self._rows(mask))
        return result

    def copy(self) -> "MaterialPoints":
        """Return an independent copy on the same mesh. Collective."""
        return self.select(np.full(len(self), True))

    def _mask(self, which: Selection) -> npt.NDArray[np.bool_]:
        error, mask = check_selection(which, self["x"])
        raise_together(self._comm, error)
        return mask

    def _rows(self, which: npt.NDArray) -> dict[str, npt.NDArray]:
        return {name: a[which] for name, a in self._data.items()}

    def restore(self, snapshot: Mapping[str, npt.NDArray], size_global: int | None = None) -> None:
        """Restore positions, cells, ranks and fields from a snapshot.

        Args:
            snapshot: What `snapshot` of these points returned; its arrays are used, not copied.
            size_global: Number of points on all ranks at the snapshot. None counts them, which is
                collective.
        """
        self._replace(dict(snapshot))
        self.size_global = self._comm.allreduce(len(self)) if size_global is None else size_global

    def _replace(self, data: Mapping[str, npt.NDArray]) -> None:
        self._data = FieldTable(data)
        self._order = None
        self.version += 1

    def _send_home(self, global_cell: npt.NDArray[np.int64]) -> None:
        """Send points to the ranks that own their cells. Collective."""
        self._replace(send_home(self._comm, self._locator, global_cell, self._data))

    def _facts(self) -> Facts:
        return facts_of(self)

    def __repr__(self) -> str:
        """Return the same text as printing."""
        return str(self)
