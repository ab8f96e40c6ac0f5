# SPDX-License-Identifier: MIT
"""Pictures of points and grid functions, rendered by pyvista without a window."""

from __future__ import annotations

import io
import os
import shutil
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
from dolfinx import fem
from scipy.spatial import cKDTree

from fenicsmpm._display import Picture
from fenicsmpm.io.results import gather_cells, gather_functions, gather_points
from fenicsmpm.points import MaterialPoints, drawing
from fenicsmpm.points.agreement import do_there

if TYPE_CHECKING:  # the import takes a second
    import pyvista

Array: TypeAlias = npt.NDArray[np.float64]
Bounds = tuple[Sequence[float], Sequence[float]]
Drawable: TypeAlias = (
    "MaterialPoints | Sequence[MaterialPoints] | fem.Function | pyvista.DataSet | None"
)

_POINTS = (MaterialPoints, Sequence)
_COLOURS = "viridis"
_ONE_COLOUR, _LINES = "tab:blue", "silver"
# Diameter of a point divided by the distance of its neighbours, with colours and without
_DOT, _SMALL_DOT = 1.1, 0.5
_PIXELS = 1200  # larger side of a rendered panel; drawn on half as many, which smooths edges
_INCHES = 3.75  # larger side of a panel on paper
_TICK = 0.7  # inches of an axis for each number, so that they do not touch
_LETTER = 0.1  # inches of a title for each letter


@dataclass
class _Panel:
    """One field in one picture; without a dataset on ranks that do not draw."""

    title: str
    data: pyvista.DataSet | None
    field: str | None
    component: int | None = None
    displacement: str | None = None
    grid: pyvista.DataSet | None = None  # cells drawn in the background

    def values(self) -> Array:
        """Return the values to be coloured, one for each point or node."""
        assert self.data is not None and self.field is not None
        if self.field not in self.data.point_data:
            raise ValueError(_unknown(self.field, self.data))
        values = np.asarray(self.data.point_data[self.field], dtype=np.float64)
        if values.ndim == 1:
            return values
        if self.component is None:
            return np.linalg.norm(values, axis=1)
        if not 0 <= self.component < values.shape[1]:
            raise ValueError(
                f"component {self.component} does not exist: field {self.field!r} has "
                f"components 0 to {values.shape[1] - 1}"
            )
        return values[:, self.component]


def _unknown(name: str, data: pyvista.DataSet) -> str:
    return f"no field {name!r} to draw; there are {', '.join(data.point_data.keys())}"


def picture(
    path: str | Path | None,
    data: Drawable | Mapping[str, Drawable],
    field: str | None = None,
    label: str | None = None,
    *,
    component: int | None = None,
    displacement: str | None = None,
    limits: tuple[float, float] | None = None,
    cut: float = 0.0,
    bounds: Bounds | None = None,
    comm: MPI.Comm = MPI.COMM_WORLD,
) -> Picture:
    """Draw one field of points or a grid function and write the picture to a file. Collective.

    Several datasets are drawn beside each other, with one colour bar. 2D problems are seen from the
    front with axes in m, 3D problems obliquely. Rank 0 draws. If VTK needs an X server and there is
    none, a virtual one (Xvfb) runs meanwhile. A notebook shows the picture if the call is the last
    line of a cell.

    Args:
        path: File to write, such as "pressure.png"; missing directories are created. None for a
            picture in a notebook without a file.
        data: Points, a sequence of point sets drawn as one, a P1 function, or an earlier result of
            ``gather_points`` or ``gather_functions``. A mapping from titles to any of these gives
            several panels.
        field: Name of the field that gives the colours. Vectors and tensors are shown by their
            norm, values that are not a number in grey. None for the values of a function; points
            are then drawn in one colour, in 2D with the cells of their mesh.
        label: Text beside the colour bar, with the unit; None for the name of the field.
        component: Component shown instead of the norm, from 0 to 2 of a vector or 0 to 8 of a
            tensor.
        displacement: Name of a vector field in m by which the picture is deformed; None for the
            positions as they are.
        limits: Values of the first and the last colour; None for the range of all data.
        cut: Percentage of the values of each dataset that ``limits=None`` leaves out at either
            end, so that singular points do not use up the colour range.
        bounds: Lower and upper corner of the visible box in m, the same for all pictures of an
            animation; None for those of the data.
        comm: Communicator of the mesh.

    Returns:
        The picture, which is printed as its path.

    Raises:
        RuntimeError: On all ranks, if rendering is impossible; says what to install.
        ValueError: On all ranks, for fields or components that the data do not have, functions that
            ``gather_functions`` does not take, and if the field is ambiguous.
    """
    named = data if isinstance(data, Mapping) else {"": data}
    if not named:
        raise ValueError(f"{path or 'picture'}: nothing to draw")
    names = [one.name if isinstance(one, fem.Function) else None for one in named.values()]
    plain = field is None and all(isinstance(one, _POINTS) for one in named.values())
    if not plain and field is None and None in names:
        raise ValueError(
            f"{path or 'picture'}: which field should be drawn? Name it, as in field='p'"
        )
    panels = [
        _Panel(title, _gathered(one), field or name, component, displacement, _cells(one, plain))
        for (title, one), name in zip(named.items(), names, strict=True)
    ]
    text = label or panels[0].field or ""

    def draw() -> bytes | None:
        target = io.BytesIO() if path is None else Path(path)
        with _display():
            _draw(target, panels, text, limits, cut, bounds)
        return target.getvalue() if isinstance(target, io.BytesIO) else None

    return Picture(path, do_there(comm, comm.rank == 0, draw))


drawing.picture = picture


def _cells(data: Drawable, plain: bool) -> pyvista.DataSet | None:
    """Return the cells behind points drawn in one colour; in 3D they would hide the points."""
    first = data[0] if isinstance(data, Sequence) else data
    if plain and isinstance(first, MaterialPoints) and first.geometry.dim == 2:
        return gather_cells(first.mesh)
    return None


def _gathered(data: Drawable) -> pyvista.DataSet | None:
    if isinstance(data, fem.Function):
        return gather_functions([data])
    if isinstance(data, _POINTS):
        return gather_points(data)
    return data


def _colour_range(values: Sequence[Array], cut: float = 0.0) -> tuple[float, float]:
    """Return the range of values of some panels, without a percentage of each at either end."""
    ends = np.array([np.nanpercentile(one, [cut, 100 - cut]) for one in values])
    return float(ends[:, 0].min()), float(ends[:, 1].max())


def _draw(
    target: Path | io.BytesIO,
    panels: Sequence[_Panel],
    label: str,
    limits: tuple[float, float] | None,
    cut: float,
    bounds: Bounds | None,
) -> None:
    import pyvista
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator

    shapes = [_shape(panel) for panel in panels]
    colours = [None if panel.field is None else panel.values() for panel in panels]
    values = [colour for colour in colours if colour is not None]
    if values and limits is None:
        limits = _colour_range(values, cut)
    around = [shape.points for shape in shapes]
    around += [panel.grid.points for panel in panels if panel.grid is not None]
    lower = np.min([x.min(axis=0) for x in around], axis=0)
    upper = np.max([x.max(axis=0) for x in around], axis=0)
    dots = [_DOT * _spacing(shape) for shape in shapes if isinstance(shape, pyvista.PolyData)]
    margin = max(0.02 * float((upper - lower).max()), *(dot / 2 for dot in dots), 0.0)
    plane = bool(lower[2] == upper[2])
    lower, upper = lower - margin, upper + margin
    if bounds is not None:
        lower, upper = (np.resize([*corner, 0.0], 3) for corner in bounds)
    images = [
        _image_of_plane(shape, colour, limits, lower, upper, panel.grid)
        if plane
        else _image_of_space(shape, colour, limits, lower, upper)
        for shape, colour, panel in zip(shapes, colours, panels, strict=True)
    ]
    extent = (lower[0], upper[0], lower[1], upper[1]) if plane else None

    height, width = np.max([image.shape[:2] for image in images], axis=0)
    inches = _INCHES / max(height, width)
    columns = len(panels) if len(panels) <= 4 else int(np.ceil(np.sqrt(len(panels))))
    if width > 2 * height:
        columns = 1  # flat panels below each other
    rows = -(-len(panels) // columns)
    letters = max(len(line) for panel in panels for line in panel.title.split("\n"))
    across = max(width * inches, _LETTER * letters)  # titles may be wider than their panels
    size = (columns * (across + 0.15) + 1.2, rows * (height * inches + 0.4) + 0.5)
    figure = Figure(figsize=size, layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False, sharex=plane, sharey=plane).ravel()
    for ax in axes[len(panels) :]:
        ax.remove()
    for ax, panel, image in zip(axes, panels, images, strict=False):
        ax.set_title(panel.title)
        ax.imshow(image, extent=extent, interpolation="antialiased")
        if extent is None:
            ax.set_axis_off()
        else:
            ax.xaxis.set_major_locator(MaxNLocator(max(1, int(width * inches / _TICK))))
            ax.set_xlabel("x [m]")
            ax.set_ylabel("y [m]")
            ax.label_outer()
    if limits is not None:
        figure.colorbar(
            ScalarMappable(Normalize(*limits), _COLOURS),
            ax=list(axes[: len(panels)]),
            label=label,
            extend=_cut(values, limits),
            pad=0.02,
        )
    if isinstance(target, Path):
        target.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(target, dpi=160)


def _cut(values: Sequence[Array], limits: tuple[float, float]) -> str:
    """Return which ends of the colour bar stand for values beyond it."""
    low, high = _colour_range(values)
    span = 1e-9 * (limits[1] - limits[0])
    below, above = low < limits[0] - span, high > limits[1] + span
    return {(0, 0): "neither", (1, 0): "min", (0, 1): "max", (1, 1): "both"}[(below, above)]


def _shape(panel: _Panel) -> Any:
    """Return points or cells of a panel without data, at the positions to be drawn."""
    assert panel.data is not None
    shape = panel.data.copy(deep=False)
    shape.clear_data()
    if panel.displacement is not None:
        if panel.displacement not in panel.data.point_data:
            raise ValueError(_unknown(panel.displacement, panel.data))
        shape.points = shape.points + panel.data.point_data[panel.displacement]
    return shape


def _image_of_plane(
    shape: Any,
    values: Array | None,
    limits: tuple[float, float] | None,
    lower: Array,
    upper: Array,
    grid: pyvista.DataSet | None,
) -> npt.NDArray[np.uint8]:
    """Return an image of exactly the box from lower to upper, seen from the front."""
    size = (upper - lower)[:2]
    scale = _PIXELS / size.max()  # pixels per m
    window = [max(1, round(s)) for s in scale * size]
    with _plotter(shape, values, limits, window, scale * _spacing(shape), False) as plotter:
        if grid is not None:
            behind = grid.translate((0, 0, -1e-3 * size.max()), inplace=False)
            plotter.add_mesh(behind, style="wireframe", color=_LINES, line_width=2, lighting=False)
        plotter.view_xy()
        centre = (lower + upper) / 2
        plotter.camera.focal_point = centre
        plotter.camera.position = centre + [0, 0, size.max()]
        plotter.camera.parallel_scale = size[1] / 2
        return np.asarray(plotter.screenshot(return_img=True))


def _image_of_space(
    shape: Any,
    values: Array | None,
    limits: tuple[float, float] | None,
    lower: Array,
    upper: Array,
) -> npt.NDArray[np.uint8]:
    """Return an image of the box from lower to upper, seen obliquely, as large as it appears."""
    x, y, z = upper - lower
    size = np.array([(x + y) / np.sqrt(2), (x + y + 2 * z) / np.sqrt(6)])  # isometric view
    scale = _PIXELS / size.max()  # pixels per m
    window = [max(1, round(s)) for s in scale * size]
    with _plotter(shape, values, limits, window, scale * _spacing(shape), True) as plotter:
        plotter.add_axes()
        plotter.view_isometric()
        centre = (lower + upper) / 2
        plotter.camera.focal_point = centre
        plotter.camera.position = centre + (x + y + z) * np.ones(3)
        plotter.camera.parallel_scale = size[1] / 2
        plotter.reset_camera_clipping_range()
        return np.asarray(plotter.screenshot(return_img=True))


@contextmanager
def _plotter(
    shape: Any,
    values: Array | None,
    limits: tuple[float, float] | None,
    window: list[int],
    point_size: float,
    lighting: bool,
) -> Iterator[Any]:
    """Yield a plotter with the coloured shape, in parallel projection."""
    import pyvista

    dot = _SMALL_DOT if values is None else _DOT
    plotter: Any = pyvista.Plotter(off_screen=True, window_size=window)
    try:
        plotter.set_background("white")
        plotter.add_mesh(
            shape,
            scalars=values,
            color=_ONE_COLOUR,
            clim=limits,
            cmap=_COLOURS,
            show_scalar_bar=False,
            lighting=lighting,
            ambient=0.4 if lighting else 0.0,
            diffuse=0.6 if lighting else 1.0,
            # small points overlap more: gaps of less than a pixel would give a moire pattern
            point_size=max(dot * point_size, min(1.5 * point_size, 6.0), 2.0),
            render_points_as_spheres=True,
        )
        plotter.enable_parallel_projection()
        yield plotter
    finally:
        plotter.close()


def _spacing(shape: Any) -> float:
    """Return the distance of neighbours in m: in a lattice, 3^d - 1 points are within sqrt(d)."""
    x = shape.points
    dim = np.count_nonzero(np.ptp(x, axis=0))
    neighbours = min(3**dim, len(x))  # including the point itself
    if neighbours < 2:
        return 0.0
    some = x[:: len(x) // 1000 + 1]
    distances = cKDTree(x).query(some, k=[neighbours])[0]
    return float(np.median(distances) / np.sqrt(dim))


@contextmanager
def _display() -> Iterator[None]:
    """Run a virtual X server meanwhile, if VTK needs one and there is none."""
    if os.environ.get("DISPLAY") or not _needs_x_server():
        yield
        return
    command = shutil.which("Xvfb")
    if command is None:
        raise RuntimeError(
            "pictures cannot be rendered: this VTK needs an X server, but DISPLAY is not set and "
            "there is no Xvfb. Install Xvfb (Debian: apt install xvfb) or VTK >= 9.4 from PyPI"
        )
    read, write = os.pipe()
    # the shell ends the server when its input ends: when we are done, or were killed
    options = f"-displayfd {write} -screen 0 1280x1024x24 -nolisten tcp -noreset"
    server = subprocess.Popen(
        ["sh", "-c", f"'{command}' {options} & read _; kill $!; wait"],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        pass_fds=[write],
        start_new_session=True,
    )
    os.close(write)
    try:
        with os.fdopen(read) as answer:
            number = answer.readline().strip()
        if not number:
            raise RuntimeError(f"pictures cannot be rendered: {command} does not start")
        os.environ["DISPLAY"] = f":{number}"
        yield
    finally:
        os.environ.pop("DISPLAY", None)
        server.communicate()


def _needs_x_server() -> bool:
    """Return whether VTK was built for X and needs it: from 9.4 on it finds other ways."""
    import pyvista
    import vtkmodules.vtkRenderingOpenGL2  # noqa: F401  # brings the class that draws
    from vtkmodules.vtkRenderingCore import vtkRenderWindow

    if pyvista.vtk_version_info >= (9, 4):
        return False
    return vtkRenderWindow().GetClassName() == "vtkXOpenGLRenderWindow"
