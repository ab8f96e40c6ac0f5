# SPDX-License-Identifier: MIT
"""Forms over points at a quadrature rule agree with dolfinx' own assembly to round-off."""

import functools

import numpy as np
import pytest
import ufl
from dolfinx import fem, la
from dolfinx.fem.petsc import assemble_matrix
from forms_table import CELLS, FORMS, SIMPLEX_FORMS, Setting

from fenicsmpm import forms

TOLERANCE = 1e-12


@functools.cache
def setting(cell, degree):
    return Setting(cell, degree)


def cell_volume(s):
    """DG0 function of cell volumes."""
    volume = fem.Function(s.D)
    fem.assemble_vector(volume.x.array, fem.form(ufl.TestFunction(s.D) * ufl.dx))
    volume.x.scatter_forward()
    return volume


def gathered(comm, array):
    """Largest absolute value over all ranks."""
    return max(comm.allgather(float(np.max(np.abs(array), initial=0.0))))


def assert_equal(s, form_over_points, form_over_cells):
    """Compare scalar, vector or matrix with dolfinx, relative to the largest entry."""
    comm = s.domain.comm
    ours = forms.form(form_over_points)
    theirs = fem.form(form_over_cells)
    if ours.rank == 0:
        reference = comm.allreduce(fem.assemble_scalar(theirs))
        assert forms.assemble_scalar(ours) == pytest.approx(reference, rel=TOLERANCE)
        return reference
    if ours.rank == 1:
        computed = forms.assemble_vector(ours)
        expected = fem.assemble_vector(theirs)
        for vector in (computed, expected):
            vector.scatter_reverse(la.InsertMode.add)
        owned = computed.index_map.size_local * computed.block_size
        difference = computed.array[:owned] - expected.array[:owned]
        scale = gathered(comm, expected.array[:owned])
    else:
        computed = forms.petsc.assemble_matrix(ours)
        expected = assemble_matrix(theirs)
        expected.assemble()
        scale = gathered(comm, expected.getValuesCSR()[2])
        expected.axpy(-1.0, computed)
        difference = expected.getValuesCSR()[2]
    assert gathered(comm, difference) <= TOLERANCE * scale
    return scale


def cases():
    """On ranks, and with another dolfinx, each form is assembled at its highest degree only."""
    for cell in CELLS:
        for name in FORMS:
            # cost: the large forms at the highest degree on one cell type of each kind
            is_large = name not in ("mass", "stiffness", "all functions", "hyperelastic tangent")
            highest = 2 if is_large and cell in ("tetrahedron", "hexahedron") else 3
            for degree in range(1, highest + 1):
                mark = pytest.mark.mpi if degree == highest else pytest.mark.once
                yield pytest.param(cell, degree, name, marks=mark)


@pytest.mark.parametrize("cell,degree,name", cases())
def test_form_agrees_with_dolfinx(cell, degree, name):
    s = setting(cell, degree)
    form = FORMS[name]
    over_cells = form(s, s.over_cells, s.at_quadrature)
    if not s.is_simplex:
        # dolfinx knows the volume of affine simplices only: give it the volumes as a function
        over_cells = ufl.replace(over_cells, {ufl.CellVolume(s.domain): cell_volume(s)})
    scale = assert_equal(s, form(s, s.points.dx, s.at_points), over_cells)
    linear = degree == 1 and s.is_simplex
    if not (linear and name in ("second gradient", "laplacian", "second gradients")):
        assert scale != 0


@pytest.mark.parametrize("name", SIMPLEX_FORMS)
@pytest.mark.parametrize("cell", ["triangle", "tetrahedron"])
def test_cell_sizes_agree_with_dolfinx(cell, name):
    s = setting(cell, 2)
    form = SIMPLEX_FORMS[name]
    assert_equal(s, form(s, s.points.dx, s.at_points), form(s, s.over_cells, s.at_quadrature))
