# SPDX-License-Identifier: MIT
"""Memory that goes back to the system."""

import sys

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh

import fenicsmpm  # noqa: F401
from fenicsmpm._memory import release_zeros
from fenicsmpm.formulations import Unknown

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")

MB = 2**20


def resident():
    """Memory of this process in bytes."""
    with open("/proc/self/status") as status:
        return next(1024 * int(line.split()[1]) for line in status if line.startswith("VmRSS"))


def test_large_arrays_go_back_when_they_are_freed():
    before = resident()
    array = np.ones(100 * MB // 8)
    assert resident() > before + 90 * MB
    del array
    assert resident() < before + 10 * MB


def test_zeros_need_no_memory_until_they_are_written():
    array = np.empty(100 * MB // 8)
    array[:] = 0.0
    full = resident()
    release_zeros(array[3:-5])
    assert resident() < full - 90 * MB
    array[1000] = 1.0
    assert array[1000] == array.sum() == 1.0
    assert resident() < full - 90 * MB  # reading needs none


def test_arrays_that_are_not_zero_are_kept():
    array = np.zeros(MB)
    array[MB // 2] = 2.0
    release_zeros(array)
    assert array[MB // 2] == array.sum() == 2.0


def test_functions_of_an_unknown_are_zero_and_can_be_written():
    domain = mesh.create_unit_square(MPI.COMM_SELF, 100, 100)
    z = Unknown(domain, "u", "p")
    assert not z.U.x.array.any()
    z.U.x.array[:] = 3.0
    z.U.x.scatter_forward()
    assert np.all(z.U.x.array == 3.0)
    assert fem.assemble_scalar(fem.form(z.p * z.p * ufl.dx(domain))) == pytest.approx(9.0)
