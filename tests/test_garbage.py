# SPDX-License-Identifier: MIT
"""Functions of one's own in loops, when garbage is collected at other times on other ranks.

A new vector ``f.x.petsc_vec`` in each step, none of its space being kept, would hang here on
several ranks: see "Functions of your own in a loop" in docs/howto/parallel.md.
"""

import gc
import random

from mpi4py import MPI

import pytest
from dolfinx import fem, mesh

pytestmark = pytest.mark.ranks

COMM = MPI.COMM_WORLD
STEPS = 60


def of_one_value(V, value):
    """A function that only garbage collection takes away, as it does one in a form."""
    f = fem.Function(V)
    f.held = f
    f.x.array[:] = value
    f.x.scatter_forward()
    return f


def made_once(V):
    f = of_one_value(V, 0.0)

    def total(value):
        f.x.array[:] = value
        return f.x.petsc_vec.sum()

    return total


def arrays_only(V):
    owned = V.dofmap.index_map.size_local
    return lambda value: COMM.allreduce(of_one_value(V, value).x.array[:owned].sum())


def one_is_kept(V):
    kept = of_one_value(V, 1.0).x
    return lambda value: of_one_value(V, value).x.petsc_vec.sum() * kept.petsc_vec.max()[1]


@pytest.mark.mpi
@pytest.mark.parametrize("way", [made_once, arrays_only, one_is_kept])
def test_ways_that_do_not_wait_for_garbage(way):
    V = fem.functionspace(mesh.create_unit_square(COMM, 6, 6), ("Lagrange", 1))
    total, n = way(V), V.dofmap.index_map.size_global
    chance = random.Random(COMM.rank)
    for step in range(STEPS):
        assert total(step) == pytest.approx(step * n, rel=1e-13)
        if chance.random() < 0.3:
            gc.collect()
    gc.collect()
