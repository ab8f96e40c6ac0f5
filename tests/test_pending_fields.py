# SPDX-License-Identifier: MIT
"""Fields of points that a loop keeps elsewhere, and that come when somebody looks at them."""

import gc
import weakref

from mpi4py import MPI

import numpy as np
import pytest
import pyvista
import ufl
from dolfinx import mesh as dmesh

from fenicsmpm import MaterialPoints, forms, io, points
from fenicsmpm.points.location import locator
from fenicsmpm.points.migration import exchange, find_cells
from fenicsmpm.points.pending_fields import FieldTable

pytestmark = pytest.mark.ranks

COMM = MPI.COMM_WORLD
NAMES = ("x", "weight", "v", "F")
BUILT_IN = {"x", "xi", "cell", "weight", "id", "tag"}


def seeded(kind=dmesh.CellType.quadrilateral):
    mesh = dmesh.create_unit_square(COMM, 6, 6, kind)
    body = points.fill(mesh, 2, inside=lambda x: x.max(axis=0) < 0.7)
    body.add_field("v", (2,))
    body.add_field("F", (2, 2))
    body.add_field("mass", value=2.0)  # stays with the points
    body["v"][:, 0] = body.id
    body["F"][:] = body.id[:, None, None] + np.eye(2)
    return body


class Loop:
    """Keeps points in arrays of its own, as explicit steps do, and defers them after each step."""

    def __init__(self, body):
        self.body, self.calls, self.packed = body, [], []
        self.error = None
        self.version = -1
        self.own = {}

    def step(self):
        """Take what may have changed, then add 0.01 to positions, 1 to v and 0.5 to F."""
        body = self.body
        self.packed = list(NAMES) if body.version != self.version else sorted(body.changed)
        for name in self.packed:
            self.own[name] = body[name].copy()
        for name, change in (("x", 0.01), ("v", 1.0), ("F", 0.5), ("weight", 0.1)):
            self.own[name] = self.own[name] + change
        body.defer(NAMES, self.provide, self.send_home())
        self.version = body.version
        self.calls.clear()
        return self

    def send_home(self):
        """Points whose cell another rank owns go there, with all arrays (collective)."""
        body, place = self.body, locator(self.body.mesh)
        cell, _, _ = find_cells(COMM, place, self.own["x"], None)
        starts = np.array(COMM.allgather(place.geometry.first_global))
        owner = (np.searchsorted(starts, cell, side="right") - 1).astype(np.int32)
        if not COMM.allreduce(int(np.sum(owner != COMM.rank))):
            return None
        rest = {name: a for name, a in body.present().items() if name not in ("cell", "xi")}
        rest = {name: a for name, a in rest.items() if name not in NAMES}
        arrays = exchange(COMM, owner, {**rest, **self.own})
        self.own = {name: arrays.pop(name) for name in NAMES}
        return arrays

    def provide(self, name):
        self.calls.append(name)
        if self.error is not None:
            raise self.error
        return {name: self.own[name].copy()}


def expected(body, steps=1):
    """Values after some steps, by id."""
    v = np.stack([body.id + steps, np.full(len(body), steps)], axis=1)
    F = body.id[:, None, None] + np.eye(2) + 0.5 * steps
    return {"v": v, "F": F}


def check(body, steps=1):
    for name, value in expected(body, steps).items():
        np.testing.assert_array_equal(body[name], value)


def test_fields_come_once_when_they_are_read():
    loop = Loop(seeded())
    body = loop.step().body
    assert loop.calls == [] and body.changed == frozenset()
    check(body)
    assert loop.calls == ["v", "F"]
    check(body)
    assert body["v"] is body["v"]
    assert loop.calls == ["v", "F"]
    assert body.changed == {"v", "F"}


@pytest.mark.mpi
def test_numbers_names_and_shapes_leave_all_pending():
    body = seeded()
    before = body.size_global, body.field_names
    loop = Loop(body)
    loop.step()
    assert COMM.allreduce(len(body)) == body.size_global
    assert (body.size_global, body.field_names) == before
    assert body.field_shape("F") == (2, 2) and "v" in body and "w" not in body
    assert len(body.id) == len(body.tag) == len(body["mass"]) == len(body)
    assert set(body.present()) == {"id", "tag", "mass"}
    assert loop.calls == [] and body.changed == frozenset()
    with pytest.raises(KeyError, match="no field 'w' at the points; there are x, "):
        body.field_shape("w")
    with pytest.raises(KeyError, match="no field 'w' at the points; there are x, "):
        body["w"]


def test_reading_marks_what_can_be_written_only():
    loop = Loop(seeded())
    body = loop.step().body
    assert not body.x.flags.writeable and not body.cell.flags.writeable
    assert len(body.xi) == len(body.order) == body.cell_offsets[-1] == len(body)
    assert body.changed == frozenset()
    assert body.weight.flags.writeable
    assert body.changed == {"weight"}
    loop.step()
    assert loop.packed == ["weight"]


@pytest.mark.parametrize(
    "read",
    [
        lambda body: body["F"],
        lambda body: body.field("F").values,
        lambda body: body.snapshot()["F"],
        lambda body: body.snapshot(copy=False)["F"],
        lambda body: body.select(np.full(len(body), True))["F"],
        lambda body: body.copy()["F"],
        lambda body: points.from_mesh(body.mesh, body)["F"],
    ],
)
def test_each_way_to_read(read):
    loop = Loop(seeded())
    body = loop.step().step().body
    assert "F" not in loop.calls
    np.testing.assert_array_equal(read(body), expected(body, 2)["F"])
    assert loop.calls.count("F") == 1


def test_forms_read_fields_and_positions():
    loop = Loop(seeded())
    body = loop.step().body
    integral = forms.form(body.field("F")[0, 0] * ufl.SpatialCoordinate(body.mesh)[0] * body.dx)
    value = forms.assemble_scalar(integral)
    exact = np.sum(loop.own["F"][:, 0, 0] * loop.own["x"][:, 0] * loop.own["weight"])
    np.testing.assert_allclose(value, exact, rtol=1e-12)
    loop.step()  # the same form sees the next state
    exact = np.sum(loop.own["F"][:, 0, 0] * loop.own["x"][:, 0] * loop.own["weight"])
    np.testing.assert_allclose(forms.assemble_scalar(integral), exact, rtol=1e-12)


def test_files_and_printing_read_what_they_need(tmp_path):
    loop = Loop(seeded())
    body = loop.step().body
    assert f"{len(body)} of 64 points" in repr(body)
    assert "F" not in loop.calls
    io.write(tmp_path / "points.vtp", io.gather_points(body))
    cloud = pyvista.read(tmp_path / "points.vtp")
    order = np.argsort(cloud.point_data["id"])
    F = cloud.point_data["F"].reshape(-1, 3, 3)[order]
    np.testing.assert_array_equal(F[:, :2, :2], body["F"][np.argsort(body.id)])
    check(body)


@pytest.mark.mpi
def test_bounds_and_volume_mark_nothing():
    body = seeded()
    volume, (lower, upper) = body.volume(), body.bounds()
    loop = Loop(body)
    loop.step()
    n = body.size_global
    assert body.volume() == pytest.approx(volume + 0.1 * n, rel=1e-12)
    np.testing.assert_allclose(body.bounds(), (lower + 0.01, upper + 0.01), rtol=1e-12)
    assert body.changed == frozenset()


@pytest.mark.parametrize("kind", [dmesh.CellType.triangle, dmesh.CellType.quadrilateral])
@pytest.mark.mpi
def test_cells_are_those_that_all_ranks_find(kind):
    """Also of points on facets, between ranks too."""
    body = seeded(kind)
    loop = Loop(body)
    loop.step()
    nodes = np.unique(np.concatenate(COMM.allgather(np.round(6 * body.x) / 6)), axis=0)
    mine = nodes if COMM.rank == 0 else nodes[:0]
    exact = MaterialPoints(body.mesh, mine, 1.0)
    at = exact.copy()
    where = {"x": exact.x.copy()}
    at.defer(["x"], lambda name: where)
    np.testing.assert_array_equal(at.cell, exact.cell)
    np.testing.assert_allclose(at.xi, exact.xi, atol=1e-13)
    assert len(nodes) > 10


@pytest.mark.mpi
def test_points_that_changed_ranks():
    body = seeded()
    ids = np.sort(np.concatenate(COMM.allgather(body.id)))
    loop = Loop(body)
    for _ in range(25):
        loop.step()
    assert np.all(body.cell < body.geometry.num_owned)
    np.testing.assert_array_equal(np.sort(np.concatenate(COMM.allgather(body.id))), ids)
    check(body, 25)
    np.testing.assert_array_equal(body["mass"], 2.0)
    moved = body.geometry.push_forward(body.cell, body.xi)
    np.testing.assert_allclose(moved, body.x, atol=1e-14)


def test_points_that_are_not_at_home():
    body = seeded()
    if COMM.size == 1:
        body.defer(["x"], lambda name: {"x": np.full((len(body), 2), 7.0)})
        with pytest.raises(RuntimeError, match="are in no cell that it owns, first at"):
            _ = body.cell
        np.testing.assert_array_equal(body.x, 7.0)


# --- writing ---------------------------------------------------------------------------------


def test_values_written_are_those_of_the_next_step():
    loop = Loop(seeded())
    body = loop.step().body
    body["v"] = (3.0, 4.0)
    loop.step()
    assert loop.packed == ["v"]
    np.testing.assert_array_equal(body["v"], np.full((len(body), 2), (4.0, 5.0)))
    np.testing.assert_array_equal(body["F"], expected(body, 2)["F"])


def test_values_written_into_an_array_that_was_handed_out():
    loop = Loop(seeded())
    body = loop.step().body
    v = body["v"]
    v[:, 1] = 9.0
    loop.step()
    assert loop.packed == ["v"]
    np.testing.assert_array_equal(body["v"], np.stack([body.id + 2.0, 0 * body.id + 10.0], axis=1))
    # that array belongs to a step that is over
    v[:] = -1.0
    np.testing.assert_array_equal(body["v"][:, 1], 10.0)


def test_assigned_arrays_need_not_come_first():
    loop = Loop(seeded())
    body = loop.step().body
    new = np.full((len(body), 2), 5.0)
    body.assign({"v": new})
    assert loop.calls == [] and body["v"] is new and body.changed == {"v"}
    with pytest.raises(ValueError, match="cannot become field 'F'"):
        body.assign({"F": new})
    loop.step()
    assert loop.packed == ["v"]


def test_wrong_values_leave_what_is_pending():
    loop = Loop(seeded())
    body = loop.step().body
    with pytest.raises(ValueError, match="needs a value of shape"):
        body["v"] = np.zeros(3)
    with pytest.raises(ValueError, match="weights must be positive"):
        body["weight"] = -1.0
    with pytest.raises(ValueError, match="there is already a field 'F'"):
        body.add_field("F")
    check(body)
    body.add_field("extra", value=3.0)
    loop.step()
    np.testing.assert_array_equal(body["extra"], 3.0)


def test_without_a_look_nothing_is_taken_back():
    loop = Loop(seeded())
    body = loop.step().body
    loop.step()
    assert loop.packed == []
    loop.step()
    assert loop.packed == [] and loop.calls == []
    check(body, 3)


# --- changes of the set ----------------------------------------------------------------------


@pytest.mark.mpi
@pytest.mark.parametrize("change", ["move", "sort", "remove", "add", "restore"])
def test_changes_bring_everything_up_to_date_first(change):
    body = seeded()
    loop = Loop(body)
    loop.step()
    other = body.copy()
    version, n = body.version, body.size_global
    if change == "move":
        body.move(body.x + 0.02)
    elif change == "sort":
        body.sort(np.argsort(-body.id))
    elif change == "remove":
        assert body.remove(lambda x: x[0] < 0.3) > 0
    elif change == "add":
        body.add(other)
        assert body.size_global == 2 * n
    else:
        body.restore(other.snapshot())
    assert body.version > version and body.changed == frozenset()
    assert set(body.present()) == BUILT_IN | {"v", "F", "mass"}
    if change != "add":  # copies have new ids
        check(body)
    loop.step()
    assert loop.packed == list(NAMES)
    if change != "add":
        check(body, 2)


def test_a_snapshot_restores_what_was_pending():
    loop = Loop(seeded())
    body = loop.step().body
    before = body.snapshot()
    loop.step()
    assert loop.packed == []
    body.restore(before)
    assert loop.calls == []  # what was pending is not needed any more
    check(body)
    loop.step()
    assert loop.packed == list(NAMES)
    check(body, 2)


def test_copies_do_not_follow_the_loop():
    loop = Loop(seeded())
    body = loop.step().body
    copy, some = body.copy(), body.select(body.id < 5)
    assert body.changed == frozenset()
    loop.step()
    check(copy)
    check(some)
    check(body, 2)


def test_versions_grow_with_positions():
    body = seeded()
    version, order = body.version, body.order
    body.defer(["v"], lambda name: {"v": np.zeros((len(body), 2))})
    assert body.version == version and body.order is order
    x = body.x + 0.1
    body.defer(["x"], lambda name: {"x": x})
    assert body.version > version
    np.testing.assert_array_equal(body.cell, MaterialPoints(body.mesh, x, 1.0).cell)


# --- the provider ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    "use",
    [
        lambda body: body["F"],
        lambda body: body.copy(),
        lambda body: body.snapshot(),
        lambda body: body.move(np.zeros((len(body), 2))),
        lambda body: body.sort(),
        lambda body: body.remove([0]),
        lambda body: body.add(body),
        lambda body: body.__setitem__("F", 0.0),
        lambda body: body.cell,
    ],
)
def test_errors_of_the_provider_leave_the_points_as_they_were(use):
    loop = Loop(seeded())
    body = loop.step().body
    loop.error = MemoryError("no room")
    before = body.version, len(body), body.size_global, body.next_id
    with pytest.raises(MemoryError, match="no room"):
        use(body)
    assert (body.version, len(body), body.size_global, body.next_id) == before
    assert "F" not in body.present()
    loop.error = None
    check(body)
    loop.step()
    check(body, 2)


def test_arrays_that_come_together():
    body = seeded()
    n, calls = len(body), []

    def provide(name):
        calls.append(name)
        # more than was asked for: F is pending with it, v is not, nor is anything called w
        return {
            "weight": np.full(n, 2.0),
            "F": np.ones((n, 2, 2)),
            "v": np.full((n, 2), 9.0),
            "w": np.zeros(n),
        }

    body.defer(["weight", "F"], provide)
    v = body["v"].copy()
    np.testing.assert_array_equal(body["F"], 1.0)
    np.testing.assert_array_equal(body.weight, 2.0)
    np.testing.assert_array_equal(body["v"], v)
    assert calls == ["F"] and "w" not in body
    assert body.changed == {"weight", "F"}


@pytest.mark.parametrize(
    "given",
    [{}, {"v": np.zeros((1, 2))}, {"v": np.zeros(3)}, {"v": np.zeros((0, 2))}, {"F": 0}],
)
def test_wrong_arrays_of_the_provider(given):
    body = seeded()
    given = {
        k: np.zeros((len(body), 2), dtype=np.float32) if k == "F" else a for k, a in given.items()
    }
    body.defer(["v", "F"], lambda name: given)
    with pytest.raises(ValueError, match=r"pending field '[vF]' (returned|must return shape)"):
        body["v"]
    assert "v" not in body.present()


def test_wrong_names_and_others():
    body = seeded()
    for name in ("id", "tag", "cell", "xi"):
        with pytest.raises(ValueError, match=f"{name} cannot be deferred"):
            body.defer([name], dict)
    with pytest.raises(KeyError, match="no field 'w' to be deferred"):
        body.defer(["v", "w"], dict)
    with pytest.raises(ValueError, match="others must have arrays of one number of points for"):
        body.defer(["v"], dict, others={"mass": np.zeros(3)})
    present = body.present()
    present.pop("v")
    with pytest.raises(ValueError, match="others must have arrays of one number of points for"):
        body.defer(["v"], dict, others={**present, "mass": np.zeros(3)})
    assert set(body.present()) == BUILT_IN | {"v", "F", "mass"}


def test_one_loop_after_another():
    body = seeded()
    n = len(body)
    body.defer(["v"], lambda name: {"v": np.full((n, 2), 1.0)})
    body.defer(["F"], lambda name: {"F": np.full((n, 2, 2), 2.0)})
    np.testing.assert_array_equal(body["F"], 2.0)
    body.defer(["v"], lambda name: {"v": np.full((n, 2), 3.0)})
    assert body.changed == {"F"}
    np.testing.assert_array_equal(body["v"], 3.0)
    assert body.changed == {"v", "F"}


def test_what_is_pending_takes_no_memory():
    body = seeded()
    arrays = [weakref.ref(body._data[name]) for name in ("x", "xi", "cell", "weight", "v", "F")]
    loop = Loop(body)
    loop.step()
    gc.collect()
    assert [a() for a in arrays] == [None] * 6
    kept = weakref.ref(body["v"])
    loop.step()
    gc.collect()
    assert kept() is None


def test_a_table_is_a_mapping():
    table = FieldTable({"a": np.zeros(2), "b": np.ones(2)})
    calls = []

    def provide(name):
        calls.append(name)
        return {name: np.full(2, 5.0)}

    table.defer({"b": provide})
    assert list(table) == ["a", "b"] and len(table) == 2 and table.shape("b") == (2,)
    assert "b" in table and "c" not in table and calls == []
    np.testing.assert_array_equal(dict(table)["b"], 5.0)
    assert calls == ["b"] and table.changed == set()
