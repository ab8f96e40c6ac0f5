# SPDX-License-Identifier: MIT
"""Implicit steps take any problem; demos show more of them."""

from mpi4py import MPI

import basix.ufl
import numpy as np
import pytest
from dolfinx import fem, la, mesh

from fenicsmpm import ImplicitMPM, forms, points
from fenicsmpm import formulations as fm


@pytest.mark.mpi
def test_what_is_the_grids_alone_need_not_be_linear():
    """A pressure that is constant in each cell beside a motion that is mapped by lumped mass."""
    domain = mesh.create_unit_square(MPI.COMM_WORLD, 4, 4)
    body = points.fill(domain, 2)
    fm.set_initial_state(body, 1.0)
    cell = domain.basix_cell()
    elements = [
        basix.ufl.element("Lagrange", cell, 1, shape=(2,)),
        basix.ufl.element("DG", cell, 0),
    ]
    W = fem.functionspace(domain, basix.ufl.mixed_element(elements))
    z = fm.Unknown(fem.Function(W), "u", fm.Part("p", role="grid"))
    # nothing leaves the mesh
    z.fix("u", lambda x: np.full(x.shape[1], True), lambda x, t: -0.1 * t * x[:2])
    k = fm.Kinematics(z.u, body)
    R = (k.J - 1 - z.p / 7.0) / k.J_n * z.test.p * body.dx
    sim = ImplicitMPM(R, z, fm.QuasiStatic(z, dt=1.0), body)
    sim.step()
    assert body["J"] == pytest.approx(0.9**2)
    pressure = z.function("p").x.array
    assert pressure == pytest.approx(7.0 * (0.9**2 - 1))
    for lumping in (0.0, 0.3, 1.0):
        scheme = fm.Midpoint(z, dt=1.0, lumping=lumping)
        z.interpolate("u", lambda x: np.ones((2, x.shape[1])))
        inertia = forms.assemble_vector(forms.form(scheme.inertia(body)))
        inertia.scatter_reverse(la.InsertMode.add)
        owned = z.space.dofmap.index_map.size_local
        # a = 2 u / dt^2 in both directions, of a mass of 1 kg
        assert domain.comm.allreduce(inertia.array[:owned].sum()) == pytest.approx(4.0)
