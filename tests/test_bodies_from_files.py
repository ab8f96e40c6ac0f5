# SPDX-License-Identifier: MIT
"""Bodies from files that the tests write: volumes, areas, normals, ids; what is refused."""

import sys

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import mesh as dmesh

from fenicsmpm import io, points, shapes
from fenicsmpm.points.agreement import do_there

COMM = MPI.COMM_WORLD
pytestmark = [pytest.mark.mpi, pytest.mark.ranks]


def plane(n=12):
    return dmesh.create_rectangle(COMM, [(-1.5, -1.5), (1.5, 1.5)], [n, n])


def space(n=6):
    return dmesh.create_box(COMM, [(-1.5,) * 3, (1.5,) * 3], [n] * 3, dmesh.CellType.hexahedron)


def total(body, values):
    return COMM.allreduce(np.sum((body.weight * values.T).T, axis=0))


def by_id(body, *names):
    """Arrays of all points in the order of their ids, on all ranks."""
    names = ("id", "x", "weight", *names)
    arrays = [np.concatenate(COMM.allgather(np.asarray(body[name]))) for name in names]
    order = np.argsort(arrays[0])
    np.testing.assert_array_equal(arrays[0][order], np.arange(len(order)))
    return [array[order] for array in arrays[1:]]


@pytest.fixture
def directory(tmp_path):
    return COMM.bcast(tmp_path)


def on_rank_0(action):
    return do_there(COMM, COMM.rank == 0, action)


def sphere(radius=1.0, n=24):
    """A surface of pyvista."""
    import pyvista

    return pyvista.Sphere(radius=radius, theta_resolution=n, phi_resolution=n)


# --- surfaces ------------------------------------------------------------------------------------

BALL = 4 / 3 * np.pi


@pytest.mark.parametrize("kind", ["stl", "ply", "vtk", "vtp", "obj"])
def test_surface(directory, kind):
    path = directory / f"ball.{kind}"
    on_rank_0(lambda: sphere().save(path))
    ball = points.read_solid(path, COMM)
    exact = on_rank_0(lambda: (sphere().triangulate().volume, sphere().area))
    np.testing.assert_allclose((ball.volume, ball.area), COMM.bcast(exact), rtol=1e-6)
    assert ball.volume == pytest.approx(BALL, rel=0.03)

    domain = space()
    body = points.in_solid(domain, ball, 0.19, tag=3)  # no point on the surface
    assert np.all(body.tag == 3)
    assert body.volume() == pytest.approx(ball.volume, rel=1e-13)
    assert np.all(ball.distance(body.x.T) < 0)
    np.testing.assert_allclose(total(body, body.x) / ball.volume, 0, atol=2e-3)
    square = np.einsum("ni,nj->nij", body.x, body.x)
    # of boxes, not of points: a box has a moment of its own
    moment = total(body, square) + ball.volume * 0.19**2 / 12 * np.eye(3)
    np.testing.assert_allclose(moment, ball.second_moment, atol=0.004)
    clear = ball.distance(body.x.T) < -0.19 * np.sqrt(3)
    np.testing.assert_allclose(body.weight[clear], 0.19**3, rtol=1e-14)

    skin = points.on_surface(domain, ball, 0.2, tag=4)
    normal = skin["normal"]
    assert np.all(skin.tag == 4)
    assert skin.volume() == pytest.approx(ball.area, rel=1e-13)
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1, rtol=1e-14)
    np.testing.assert_allclose(total(skin, normal), 0, atol=1e-13)  # closed
    assert total(skin, np.sum(skin.x * normal, axis=1)) == pytest.approx(3 * ball.volume, rel=1e-13)
    assert np.all(np.sum(skin.x * normal, axis=1) > 0.95)
    np.testing.assert_allclose(ball.distance(skin.x.T), 0, atol=1e-14)


def test_cube_in_millimetres(directory):
    """A file of another unit, with one surface of quadrilaterals; moved and turned."""
    import pyvista

    path = directory / "cube.vtk"
    on_rank_0(lambda: pyvista.Cube(x_length=1000, y_length=500, z_length=250).save(path))
    turn = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]])
    block = points.read_solid(path).transformed(1e-3, (0.1, 0.2, 0.3), turn)
    assert block.volume == pytest.approx(0.125) and block.area == pytest.approx(1.75)
    np.testing.assert_allclose(block.bounds(), [(-0.15, -0.3, 0.175), (0.35, 0.7, 0.425)])
    domain = space()
    body = points.in_solid(domain, block, 0.097)
    assert body.volume() == pytest.approx(0.125, rel=1e-13)
    np.testing.assert_allclose(total(body, body.x) / 0.125, [0.1, 0.2, 0.3], atol=5e-3)
    skin = points.on_surface(domain, block, 0.1)
    x, _, normal = by_id(skin, "normal")
    area = by_id(skin)[1]
    for axis, side in ((0, 0.25), (1, 0.125), (2, 0.5)):
        for sign in (1, -1):
            on_side = normal[:, axis] * sign > 0.999
            assert area[on_side].sum() == pytest.approx(side)
            assert np.ptp(x[on_side, axis]) < 1e-12


def test_spacing_of_a_lattice_that_fits():
    """A solid along the lattice has the points of `lattice`, with the same volumes."""
    domain = space()
    corners = np.array([[-0.5, -0.5, -0.5]]), np.array([[0.5, 0.25, 1.0]])
    values = np.ones((1, 1, 1), dtype=bool)
    box = shapes.mask(values, (corners[1] - corners[0])[0], corners[0][0])
    body = points.in_solid(domain, box, (0.25, 0.125, 0.5))
    plain = points.lattice(domain, np.array([0.25, 0.125, 0.5]), inside=box)
    for mine, theirs in zip(by_id(body), by_id(plain), strict=True):
        np.testing.assert_allclose(mine, theirs, rtol=1e-13)
    assert body.size_global == 4 * 6 * 3
    # a solid is a predicate for the other ways of seeding, too
    assert points.fill(domain, 2, inside=box).volume() == pytest.approx(box.volume)


def test_same_points_on_any_number_of_ranks():
    """As rank 0 has them alone."""
    angle = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    radius = 1 + 0.3 * np.sin(5 * angle)
    star = shapes.polygon(np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1))
    ball = shapes.contour(1 - np.sum(np.indices((9, 9, 9)) ** 2 / 64, axis=0), 0.5, 0.1, 0.05)
    alone = MPI.COMM_SELF
    pairs = [
        (dmesh.create_rectangle, [(-1.5, -1.5), (1.5, 1.5)], [12, 12], star),
        (dmesh.create_box, [(-1.5,) * 3, (1.5,) * 3], [5] * 3, ball),
    ]
    for create, corners, n, solid in pairs:
        for seed in (points.in_solid, points.on_surface):
            names = ["normal"] if seed is points.on_surface else []
            shared = by_id(seed(create(COMM, corners, n), solid, 0.11), *names)
            single = seed(create(alone, corners, n), solid, 0.11)
            order = np.argsort(single.id)
            for mine, name in zip(shared, ["x", "weight", *names], strict=True):
                np.testing.assert_allclose(mine, single[name][order], rtol=1e-13, atol=1e-15)


@pytest.mark.parametrize("across, most", [(8, 0.01), (16, 0.003)])
def test_parts_at_the_boundary(across, most):
    """Volumes before the last factor, anywhere on the lattice, as in docs/howto/bodies.md."""
    angle = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    disc = shapes.polygon(np.stack([np.cos(angle), np.sin(angle)], axis=1))
    cube = shapes.mask(np.ones((1, 1, 1), dtype=bool), 2.0, -1.0)
    rng = np.random.default_rng(0)
    for domain, solid in ((plane(), disc), (space(), cube)):
        for _ in range(8):
            moved = solid.transformed(rng.uniform(0.8, 1), rng.uniform(-0.3, 0.3, solid.dim))
            size = np.full(solid.dim, 2 / across)
            inside = points.in_solid(domain, moved, 2 / across)
            whole = np.isclose(inside.weight, size.prod(), rtol=1e-14)
            n = int(np.ceil(1.5 * across)) + 1
            grid = np.indices((n,) * solid.dim).reshape(solid.dim, -1).T
            parts = shapes.fractions(moved, -1.5 + (grid + 0.5) * size, size)
            assert parts.sum() * size.prod() == pytest.approx(moved.volume, rel=most)
            assert total(inside, np.ones(len(inside))) == pytest.approx(moved.volume, rel=1e-13)
            # those that are changed are near the boundary
            far = moved.distance(inside.x.T) < -np.linalg.norm(size)
            assert np.all(whole[far])


def test_few_points_are_told(said):
    """A strip that passes between most points: those inside do not have its volume alone."""
    strip = shapes.polygon([(-1, -0.3), (1, 0.3), (1, 0.34), (-1, -0.26)])
    body = points.in_solid(plane(), strip, 0.2)
    assert body.volume() == pytest.approx(strip.volume)
    assert COMM.rank > 0 or any("coarse for Solid of 4 sides" in line for line in said)


@pytest.mark.parametrize("seed", [points.in_solid, points.on_surface])
def test_bad_seeding(seed):
    square = shapes.polygon([(0, 0), (1, 0), (1, 1), (0, 1)])
    domain = plane()
    for spacing in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(ValueError, match="must be positive, not"):
            seed(domain, square, spacing)
    with pytest.raises(ValueError, match="a solid of 2 dimensions does not fit a mesh of 3"):
        seed(space(2), square, 0.1)
    with pytest.raises(points.PointsOutsideError):
        seed(domain, square.transformed(1.0, 1.0), 0.1)


def test_solid_between_points():
    small = shapes.polygon([(0.01, 0.01), (0.02, 0.01), (0.01, 0.02)])
    with pytest.raises(
        ValueError, match=r"no point of a lattice with spacing 0\.5 lies in Solid of 3"
    ):
        points.in_solid(plane(), small, 0.5)


def test_surface_of_volumes(directory):
    """Cells of volumes in a .vtu: their outer sides."""
    import pyvista

    def write():
        grid = pyvista.ImageData(dimensions=(4, 3, 2), spacing=(0.1, 0.2, 0.3))
        grid.cast_to_unstructured_grid().save(directory / "box.vtu")

    on_rank_0(write)
    box = points.read_solid(directory / "box.vtu")
    assert (box.volume, box.area) == (pytest.approx(0.036), pytest.approx(0.66))


def test_without_pyvista(directory, monkeypatch):
    on_rank_0(lambda: (directory / "ball.stl").write_text(""))
    if COMM.rank == 0:
        monkeypatch.setitem(sys.modules, "pyvista", None)
    with pytest.raises(ImportError, match="pyvista"):
        points.read_solid(directory / "ball.stl")


# --- what surfaces are refused, on all ranks -----------------------------------------------------


def test_open_surface(directory):
    """A sphere without its upper quarter."""
    path = directory / "open.stl"
    on_rank_0(lambda: sphere(n=60).clip("z", origin=(0, 0, 0.5)).extract_surface().save(path))
    with pytest.raises(
        shapes.OpenSurfaceError, match="the surface is open: 120 free edges"
    ) as info:
        points.read_solid(path)
    assert info.value.length == pytest.approx(2 * np.pi * np.sqrt(0.75), rel=0.01)
    # the centroid of the rest is at z = -0.25, from where the hole is a cone
    seen = 0.5 * (1 - 0.75 / np.hypot(0.75, np.sqrt(0.75)))
    assert info.value.solid_angle == pytest.approx(seen, rel=0.01)


def test_files_that_are_no_surfaces(directory):
    import pyvista

    def write():
        (directory / "damaged.stl").write_text("solid nothing\nfacet normal\n")
        (directory / "surface.step").write_text("ISO-10303-21;")
        pyvista.PolyData(np.eye(3)).save(directory / "cloud.vtp")
        pyvista.ImageData(dimensions=(3, 3, 3)).save(directory / "image.vti")

    on_rank_0(write)
    for name, error, match in [
        ("nothing.stl", FileNotFoundError, "no file .*nothing.stl"),
        ("damaged.stl", ValueError, "contains no triangles"),
        ("cloud.vtp", ValueError, "contains no triangles"),
        ("surface.step", ValueError, r"a surface is read from .stl, .* not from '.step'"),
        ("image.vti", ValueError, "not from '.vti'"),
    ]:
        with pytest.raises(error, match=match):
            points.read_solid(directory / name)


# --- images --------------------------------------------------------------------------------------


def test_picture(directory):
    """A .png of an F: the first coordinate to the right, the second one upwards."""
    from matplotlib.image import imsave

    rows = np.array([[1, 1, 1], [1, 0, 0], [1, 1, 0], [1, 0, 0]])
    on_rank_0(lambda: imsave(directory / "f.png", np.repeat(rows[..., None], 3, axis=2) * 1.0))
    image = points.read_image(directory / "f.png")
    np.testing.assert_allclose(image.values, rows[::-1].T, atol=0.01)
    letter = shapes.mask(image.values > 0.5, 0.25, (-0.5, -0.5))
    assert letter.volume == pytest.approx(7 / 16) and letter.area == pytest.approx(4)
    domain = plane()
    body = points.in_solid(domain, letter, 0.0625)
    np.testing.assert_allclose(body.weight, 0.0625**2, rtol=1e-13)
    assert body.size_global == 7 * 16
    skin = points.on_surface(domain, letter, 0.125)
    assert skin.size_global == 32 and skin.volume() == pytest.approx(4)
    assert total(skin, np.sum(skin.x * skin["normal"], axis=1)) == pytest.approx(2 * letter.volume)


def voxels():
    """A ball of radius 0.8 around the origin, in unequal voxels, and their sizes."""
    size = np.array([0.1, 0.08, 0.05])
    x = np.meshgrid(*((np.arange(-1 + s / 2, 1, s)) for s in size), indexing="ij")
    return 0.8 - np.linalg.norm(x, axis=0), size


@pytest.mark.parametrize("of", ["cells", "points"])
def test_voxels_of_vtk(directory, of):
    import pyvista

    values, size = voxels()

    def write():
        if of == "cells":
            grid = pyvista.ImageData(
                dimensions=np.array(values.shape) + 1, spacing=size, origin=(-1, -1, -1)
            )
            grid.cell_data["gray"] = values.ravel(order="F")
        else:
            grid = pyvista.ImageData(dimensions=values.shape, spacing=size, origin=-1 + size / 2)
            grid.point_data["gray"] = values.ravel(order="F")
        grid.set_active_scalars("gray")
        grid.save(directory / "ball.vti")

    on_rank_0(write)
    image = points.read_image(directory / "ball.vti")
    np.testing.assert_allclose(image.values, values)
    np.testing.assert_allclose(image.spacing, size)
    np.testing.assert_allclose(image.origin, -1)
    blocks = shapes.mask(image.values > 0, image.spacing, image.origin)
    smooth = shapes.contour(image.values, 0.0, image.spacing, image.origin)
    assert blocks.volume == pytest.approx((values > 0).sum() * np.prod(size), rel=1e-12)
    assert smooth.volume == pytest.approx(BALL * 0.512, rel=0.01)
    assert smooth.area == pytest.approx(4 * np.pi * 0.64, rel=0.01)
    assert blocks.area == pytest.approx(1.5 * smooth.area, rel=0.1)  # stairs: 6 pi r^2
    for solid in (blocks, smooth):
        assert points.in_solid(space(), solid, 0.25).volume() == pytest.approx(solid.volume)


def test_array(directory):
    values = voxels()[0]
    on_rank_0(lambda: np.save(directory / "ball.npy", values > 0))
    image = points.read_image(directory / "ball.npy")
    np.testing.assert_array_equal(image.values, values > 0)
    assert np.all(image.spacing == 1) and np.all(image.origin == 0)


def test_files_that_are_no_images(directory):
    import pyvista

    def write():
        np.save(directory / "line.npy", np.ones(4))
        (directory / "image.gif").write_bytes(b"GIF89a")
        (directory / "empty.png").write_bytes(b"")
        pyvista.ImageData(dimensions=(3, 3, 3)).save(directory / "bare.vti")
        sphere().save(directory / "ball.vtk")

    on_rank_0(write)
    for name, error, match in [
        ("nothing.npy", FileNotFoundError, "no file"),
        ("line.npy", ValueError, r"not shape \(4,\)"),
        ("image.gif", ValueError, "an image is read from .npy, .png, .* not from '.gif'"),
        ("empty.png", Exception, ""),
        ("bare.vti", ValueError, r"needs one active array of scalars, but has \[\]"),
        ("ball.vtk", ValueError, "PolyData instead of an image"),
    ]:
        with pytest.raises(error, match=match):
            points.read_image(directory / name)


# --- clouds --------------------------------------------------------------------------------------


def cloud(dim, n=50):
    rng = np.random.default_rng(3)
    return rng.uniform(-1, 1, (n, dim)), rng.uniform(0.5, 1, n), rng.uniform(300, 400, n)


def write_cloud(path, dim):
    import pyvista

    x, volume, temperature = cloud(dim)
    if path.suffix == ".csv":
        names = ["x", "y", "z"][:dim]
        table = np.column_stack([x, temperature, volume])
        header = ",".join([*names, "temperature", "volume"])
        np.savetxt(path, table, "%.17g", delimiter=",", header=header, comments="")
    elif path.suffix == ".npz":
        np.savez(path, x=x, volume=volume, temperature=temperature)
    else:
        data = pyvista.PolyData(np.pad(x, ((0, 0), (0, 3 - dim))))
        data.point_data["volume"], data.point_data["temperature"] = volume, temperature
        data.save(path)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("kind", ["csv", "npz", "vtp"])
def test_cloud(directory, dim, kind):
    path = directory / f"cloud.{kind}"
    on_rank_0(lambda: write_cloud(path, dim))
    body = points.read_cloud(plane() if dim == 2 else space(), path, tag=2)
    assert np.all(body.tag == 2) and body.field_names == ("temperature",)
    for read, written in zip(by_id(body, "temperature"), cloud(dim), strict=True):
        np.testing.assert_allclose(read, written, rtol=1e-15)


def test_cloud_of_points_that_were_written(directory):
    domain = plane()
    body = points.random(domain, 3, seed=1, inside=lambda x: x[0] < 0)
    body.tag[:] = body.x[:, 1] > 0
    body.add_field("p", (), body.x[:, 1])
    io.write(directory / "body.vtp", io.gather_points(body))
    again = points.read_cloud(domain, directory / "body.vtp", volume="weight")
    for read, written in zip(by_id(again, "p", "tag"), by_id(body, "p", "tag"), strict=True):
        np.testing.assert_allclose(read, written, rtol=1e-15)


def test_bad_clouds(directory):
    def write():
        (directory / "short.csv").write_text("x,y\n0,0\n")
        (directory / "odd.csv").write_text("x,y,volume\n0,0\n")
        (directory / "nowhere.csv").write_text("volume,mass\n1,1\n")
        (directory / "word.csv").write_text("x,y,volume\n0,zero,1\n")
        (directory / "negative.csv").write_text("x,y,volume\n0,0,1\n0,0.1,-1\n")
        (directory / "far.csv").write_text("x,y,volume\n0,0,1\n0,9,1\n")
        (directory / "space.csv").write_text("x,y,z,volume\n0,0,1,1\n")
        (directory / "cloud.xyz").write_text("0 0 0\n")

    on_rank_0(write)
    domain = plane()
    for name, error, match in [
        ("nothing.csv", FileNotFoundError, "no file"),
        ("short.csv", ValueError, "needs 'x' and 'volume', but has x"),
        ("odd.csv", ValueError, "the first line has 3 names for 2 columns"),
        ("nowhere.csv", ValueError, "needs 'x' and 'volume', but has volume, mass"),
        ("word.csv", ValueError, "zero"),
        ("negative.csv", ValueError, "weights must be positive"),
        ("far.csv", points.PointsOutsideError, "1 of 2"),
        ("space.csv", ValueError, "third coordinates are not 0"),
        ("cloud.xyz", ValueError, "a cloud is read from .csv, .npz, .* not from '.xyz'"),
    ]:
        with pytest.raises(error, match=match):
            points.read_cloud(domain, directory / name)


# --- cells of Gmsh -------------------------------------------------------------------------------


def write_gmsh(path, dim, hexahedra=False, order=1):
    """Two physical groups: a disc (ball) of radius 0.5 in a square (cube), or two boxes."""
    gmsh = pytest.importorskip("gmsh")
    gmsh.initialize(readConfigFiles=False, interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        model, occ = gmsh.model, gmsh.model.occ
        if hexahedra:
            for start in (-1, 0):
                if dim == 2:
                    occ.addRectangle(start, -0.5, 0, 1, 1)
                else:
                    occ.addBox(start, -0.5, -0.5, 1, 1, 1)
            occ.fragment(occ.getEntities(dim), [])
        elif dim == 2:
            occ.addRectangle(-1, -1, 0, 2, 2)
            occ.fragment([(2, 1)], [(2, occ.addDisk(0, 0, 0, 0.5, 0.5))])
        else:
            occ.addBox(-1, -1, -1, 2, 2, 2)
            occ.fragment([(3, 1)], [(3, occ.addSphere(0, 0, 0, 0.5))])
        occ.synchronize()
        parts = sorted(model.getEntities(dim), key=lambda e: model.occ.getMass(*e))
        model.addPhysicalGroup(dim, [parts[0][1]], 7, "inner")
        model.addPhysicalGroup(dim, [parts[1][1]], 9, "outer")
        model.addPhysicalGroup(dim - 1, [1], 5, "side")
        gmsh.option.setNumber("Mesh.MeshSizeMax", 0.25)
        if hexahedra:
            for curve in model.getEntities(1):
                model.mesh.setTransfiniteCurve(curve[1], 3)
            for _, side in model.getEntities(2):
                model.mesh.setTransfiniteSurface(side)
                model.mesh.setRecombine(2, side)
            for _, box in model.getEntities(3):
                model.mesh.setTransfiniteVolume(box)
        model.mesh.generate(dim)
        model.mesh.setOrder(order)
        gmsh.write(str(path))
    finally:
        gmsh.finalize()


@pytest.mark.parametrize("dim", [2, 3])
def test_cells_of_a_physical_group(directory, dim):
    pytest.importorskip("gmsh")
    path = directory / "two.msh"
    on_rank_0(lambda: write_gmsh(path, dim))
    domain = plane() if dim == 2 else space()
    volumes = []
    for group, exact in (("inner", np.pi / 4 if dim == 2 else BALL / 8), (9, None)):
        part = points.read_cells(path, group, dim, COMM)
        solid = points.boundary_of(part)
        cells = points.quadrature(part, 1).volume()
        assert solid.volume == pytest.approx(cells, rel=1e-12)
        if exact:
            assert cells == pytest.approx(exact, rel=0.1)
        body = points.in_cells(domain, part, 0.1)
        assert body.volume() == pytest.approx(cells, rel=1e-13)
        assert np.all(solid.distance(body.x.T) < 0)
        assert solid.volume / 0.1**dim < body.size_global
        skin = points.on_surface(domain, solid, 0.2)
        np.testing.assert_allclose(total(skin, skin["normal"]), 0, atol=1e-13)
        # the same on one rank
        alone = points.read_cells(path, group, dim, MPI.COMM_SELF)
        mesh_alone = dmesh.create_rectangle(MPI.COMM_SELF, [(-1.5, -1.5), (1.5, 1.5)], [3, 3])
        if dim == 3:
            mesh_alone = dmesh.create_box(MPI.COMM_SELF, [(-1.5,) * 3, (1.5,) * 3], [3] * 3)
        single = points.in_cells(mesh_alone, alone, 0.1)
        order = np.argsort(single.id)
        for mine, name in zip(by_id(body), ("x", "weight"), strict=True):
            np.testing.assert_allclose(mine, single[name][order], rtol=1e-12, atol=1e-15)
        np.testing.assert_allclose(points.boundary_of(alone).facets, solid.facets, atol=1e-15)
        volumes.append(cells)
    both = points.read_cells(path, ["inner", "outer"], dim)
    assert points.boundary_of(both).volume == pytest.approx(2**dim, rel=1e-12)
    assert sum(volumes) == pytest.approx(2**dim, rel=1e-12)


@pytest.mark.parametrize("dim", [2, 3])
def test_quadrilaterals_and_hexahedra(directory, dim):
    pytest.importorskip("gmsh")
    path = directory / "boxes.msh"
    on_rank_0(lambda: write_gmsh(path, dim, hexahedra=True))
    part = points.read_cells(path, "outer", dim)
    solid = points.boundary_of(part)
    assert (solid.volume, solid.area) == (pytest.approx(1), pytest.approx(2 * dim))
    body = points.in_cells(plane() if dim == 2 else space(), part, 0.26)
    assert body.size_global == 2**dim * 2**dim
    np.testing.assert_allclose(body.weight, 0.25**dim, rtol=1e-12)


def test_bad_cells(directory):
    gmsh = pytest.importorskip("gmsh")
    two, curved = directory / "two.msh", directory / "curved.msh"

    def write():
        write_gmsh(two, 2)
        write_gmsh(curved, 2, order=2)
        (directory / "damaged.msh").write_text("$MeshFormat\n4.1 0 8\n")
        (directory / "mesh.foo").write_text("")

    on_rank_0(write)
    for path, group, dim, error, match in [
        (directory / "nothing.msh", 1, 2, FileNotFoundError, "no file"),
        (
            two,
            "steel",
            2,
            ValueError,
            r"no physical group 'steel' .* 7 'inner' .*, 9 'outer'",
        ),
        (two, "side", 2, ValueError, "no physical group 'side' of dimension 2"),
        (two, 7, 3, ValueError, r"dimension 3; available are: .*7 'inner' \(dimension 2\)"),
        (two, [], 2, ValueError, "not none at all"),
        (two, 7, 1, ValueError, "dim must be 2 or 3, not 1"),
        (curved, 7, 2, ValueError, "straight edges, not Triangle 6"),
        (directory / "damaged.msh", 7, 2, ValueError, "damaged.msh"),
        (directory / "mesh.foo", 7, 2, ValueError, "mesh.foo"),
    ]:
        with pytest.raises(error, match=match):
            points.read_cells(path, group, dim)
    part = points.read_cells(two, 7, 2)
    with pytest.raises(ValueError, match="must be positive, not 0"):
        points.in_cells(plane(), part, 0)
    assert not gmsh.isInitialized()
