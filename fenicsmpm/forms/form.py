# SPDX-License-Identifier: MIT
"""Compiled forms with integrals over points, cells and facets."""

from __future__ import annotations

from typing import Any

import ufl
from dolfinx import fem
from ufl.algorithms import expand_derivatives, extract_coefficients
from ufl.algorithms.check_arities import ArityMismatch, check_integrand_arity
from ufl.algorithms.remove_complex_nodes import remove_complex_nodes

from fenicsmpm import _jit
from fenicsmpm._display import Described, Facts
from fenicsmpm.forms.errors import UnsupportedFormError
from fenicsmpm.forms.integral import PointIntegral, selected_tags
from fenicsmpm.forms.regions import RegionForm, is_region
from fenicsmpm.points import MaterialPoints
from fenicsmpm.points.point_field import PointField


class Form(Described):
    """Compiled form with integrals over points, and over cells and facets by dolfinx.

    Create it with ``form``.

    Attributes:
        ufl_form: The UFL form.
        point_integrals: Integrals over points, one for each point set and tag.
        ordinary: Compiled dolfinx form with the integrals over fixed cells and facets, or None.
        region_forms: Forms over cells and facets that follow the points.
        function_spaces: Dolfinx spaces of the arguments, with the test space first.
        mesh: Dolfinx mesh.
    """

    def __init__(
        self,
        ufl_form: ufl.Form,
        point_integrals: list[PointIntegral],
        ordinary: fem.Form | None,
        region_forms: list[RegionForm],
        function_spaces: list[fem.FunctionSpace],
        mesh: Any,
    ) -> None:
        """Store the parts; see ``form``."""
        self.ufl_form = ufl_form
        self.point_integrals = point_integrals
        self.ordinary = ordinary
        self.region_forms = region_forms
        self.function_spaces = function_spaces
        self.mesh = mesh
        # grid functions that are derived from points, such as their volume at the nodes
        self._derived = [c for c in ufl_form.coefficients() if hasattr(c, "follow_points")]

    @property
    def rank(self) -> int:
        """Number of arguments: 0 for a scalar, 1 for a vector, 2 for a matrix."""
        return len(self.function_spaces)

    @property
    def versions(self) -> tuple[Any, ...]:
        """Version numbers of points and regions, which change whenever points have moved."""
        regions = tuple(form.region.version for form in self.region_forms)
        return (*(integral.points.version for integral in self.point_integrals), *regions)

    @property
    def has_mesh_forms(self) -> bool:
        """Whether there are integrals over cells or facets."""
        return self.ordinary is not None or bool(self.region_forms)

    def mesh_forms(self, varying: bool = False) -> list[fem.Form]:
        """Return the dolfinx forms of all integrals over the current cells and facets. Collective.

        Args:
            varying: Whether to omit forms without coefficients, whose tensors change only with the
                region and the constants.
        """
        fixed = [] if self.ordinary is None else [self.ordinary]
        selected = [f for f in self.region_forms if not (varying and f.is_constant)]
        return fixed + [form.current() for form in selected]

    def refresh(self) -> None:
        """Update the coefficients that are derived from points. Collective."""
        for function in self._derived:
            function.follow_points()

    @property
    def _kind(self) -> str:
        return ("scalar", "vector", "matrix")[self.rank]

    def _integrals(self) -> list[tuple[str, str]]:
        """Return the domains of integration, and the names of the coefficients in them."""
        found = [
            (
                f"{len(i.points)} points" + ("" if i.tag is None else f" with tag {i.tag}"),
                [source.item for source in i.lowered.inputs],
            )
            for i in self.point_integrals
        ]
        of_mesh: dict[str, list[Any]] = {}
        for integral in self.ufl_form.integrals():
            data = integral.subdomain_data()
            if not isinstance(data, MaterialPoints):
                which = "that follow points" if is_region(data) else "of the mesh"
                items = of_mesh.setdefault(f"cells or facets {which}", [])
                items += extract_coefficients(integral.integrand())
        return [(where, _names(items)) for where, items in [*found, *of_mesh.items()]]

    def _facts(self) -> Facts:
        sizes = [
            space.dofmap.index_map.size_global * space.dofmap.index_map_bs
            for space in self.function_spaces
        ]
        of = " x ".join(str(size) for size in sizes)
        facts = [("form", f"{self._kind} of {of} values" if sizes else self._kind)]
        return facts + [(f"over {where}", names) for where, names in self._integrals()]

    def __repr__(self) -> str:
        """Rank, and where the integrals are taken."""
        where = ", ".join(where for where, _ in self._integrals()) or "nothing"
        return f"Form({self._kind}, integrals over {where})"


def _names(items: list[Any]) -> str:
    """Return the names of functions and point fields, each once."""
    named = [item.name for item in items if isinstance(item, fem.Function | PointField)]
    return ", ".join(dict.fromkeys(named)) or "no coefficients"


def form(
    F: ufl.Form,
    *,
    form_compiler_options: dict[str, Any] | None = None,
    jit_options: dict[str, Any] | None = None,
) -> Form:
    """Compile a UFL form with integrals over material points, cells or facets. Collective.

    Integrals over ``points.dx`` are sums over the points with their weights. dolfinx compiles all
    other integrals (``dx``, ``ds``, ``dS``).

    Args:
        F: UFL form of rank 0, 1 or 2 on one mesh.
        form_compiler_options: FFCx options for the integrals over cells and facets.
        jit_options: Options of ``dolfinx.jit.ffcx_jit`` for all integrals. The compiler flags of
            point integrals are chosen for speed unless ``cffi_extra_compile_args`` is given.

    Returns:
        The compiled form.

    Raises:
        TypeError: If F is not a UFL form.
        ValueError: If the form has no integrals, more than two arguments, or parts on different
            meshes.
        UnsupportedFormError: If a part of an integrand has no meaning over points. The message
            names it.
    """
    if not isinstance(F, ufl.Form):
        raise TypeError(f"a UFL form is needed, not {type(F).__name__}: {F}")
    if F.empty():
        raise ValueError("the form has no integrals")
    arguments = F.arguments()
    if len(arguments) > 2:
        raise ValueError(f"a form of rank 0, 1 or 2 is needed, not of rank {len(arguments)}")
    over_points: dict[tuple[int, int | None], tuple[MaterialPoints, Any]] = {}
    ordinary_integrals = []
    by_region: dict[int, list[ufl.Integral]] = {}
    for integral in F.integrals():
        points = integral.subdomain_data()
        if is_region(points):
            by_region.setdefault(id(points), []).append(integral)
            continue
        if not isinstance(points, MaterialPoints):
            ordinary_integrals.append(integral)
            continue
        if integral.integral_type() != "cell":
            raise UnsupportedFormError(
                f"facet integral over material points: {integral}. Seed boundary points instead."
            )
        if integral.metadata():
            raise UnsupportedFormError(
                f"quadrature options for an integral over points: {integral.metadata()}. "
                "The points themselves are the quadrature rule."
            )
        if integral.ufl_domain() is not points.mesh.ufl_domain():
            raise ValueError(
                "the measure of an integral over points belongs to another mesh: use points.dx"
            )
        for tag in selected_tags(integral):
            previous = over_points.get((id(points), tag), (points, 0))[1]
            over_points[id(points), tag] = (points, previous + integral.integrand())

    mesh = _mesh_of(F, [points for points, _ in over_points.values()], arguments)
    options = jit_options or {}
    point_integrals = []
    for (_, tag), (points, integrand) in over_points.items():
        expanded = expand_derivatives(integrand * points.dx)
        if expanded.empty():
            continue
        integrand = sum(i.integrand() for i in expanded.integrals())
        _check_arity(integrand, arguments)
        point_integrals.append(PointIntegral(integrand, points, tag, options))
    mesh_options = {"form_compiler_options": form_compiler_options, "jit_options": jit_options}
    ordinary = None
    if _has_integrals(ordinary_integrals, arguments):
        ordinary = _jit.mesh_form(ufl.Form(ordinary_integrals), **mesh_options)
    region_forms = [
        RegionForm(integrals, mesh_options)
        for integrals in by_region.values()
        if _has_integrals(integrals, arguments)
    ]
    if not (point_integrals or region_forms or arguments) and ordinary is None:
        raise ValueError("the form is identically zero")
    if mesh is None and ordinary is not None:  # integrals of constants over cells or facets
        mesh = ordinary.mesh
    spaces = [_space(a) for a in arguments]
    return Form(F, point_integrals, ordinary, region_forms, spaces, mesh)


def _space(argument: ufl.Argument) -> fem.FunctionSpace:
    space = argument.ufl_function_space()
    if not isinstance(space, fem.FunctionSpace):
        raise ValueError(
            f"argument without a dolfinx function space: {argument}. "
            "Use fem.functionspace(mesh, element)."
        )
    if space.component():
        raise ValueError(
            f"argument on a part of a mixed space: {argument}. "
            "Use a test function of the whole space and ufl.split, or V.sub(i).collapse()."
        )
    return space


def _check_arity(integrand: Any, arguments: Any) -> None:
    """Raise UnsupportedFormError unless every term is linear in each argument of the form."""
    try:
        real = remove_complex_nodes(integrand)
    except ValueError as error:
        raise UnsupportedFormError(f"complex number over material points: {error}") from None
    try:
        check_integrand_arity(real, arguments)
    except (ArityMismatch, ValueError) as error:
        # ArityMismatch is a BaseException and would pass most handlers. The ValueError comes from
        # UFL itself, while it formats the message for sums of terms with and without arguments.
        reason = error if isinstance(error, ArityMismatch) else "its terms differ in rank"
        raise UnsupportedFormError(
            f"integral over points that is not linear in the arguments "
            f"{', '.join(map(str, arguments)) or '(the form has none)'}: {reason}"
        ) from None


def _mesh_of(F: ufl.Form, point_sets: list[MaterialPoints], arguments: Any) -> Any:
    meshes = [p.mesh for p in point_sets] + [_space(a).mesh for a in arguments]
    meshes += [c.function_space.mesh for c in F.coefficients() if isinstance(c, fem.Function)]
    for mesh in meshes:
        if mesh.ufl_domain() is not meshes[0].ufl_domain():
            raise ValueError(
                "points and function spaces live on different meshes: define all spaces of a "
                "form on the background mesh of its points"
            )
    return meshes[0] if meshes else None


def _has_integrals(integrals: list[ufl.Integral], arguments: Any) -> bool:
    """Check integrals over cells and facets, and return whether any of them is not zero."""
    if not integrals:
        return False
    ordinary = ufl.Form(integrals)
    if ordinary.arguments() != arguments:
        raise UnsupportedFormError(
            "integrals over cells or facets with the arguments "
            f"{', '.join(map(str, ordinary.arguments())) or '(none)'} in a form with the arguments "
            f"{', '.join(map(str, arguments)) or '(none)'}"
        )
    for coefficient in ordinary.coefficients():
        if isinstance(coefficient, PointField):
            raise UnsupportedFormError(
                f"point field {coefficient.name!r} in an integral over cells or facets: it has "
                "values at its points only. Integrate over points.dx, or project it first."
            )
    return not expand_derivatives(ordinary).empty()
