# SPDX-License-Identifier: MIT
"""Bodies in free flight, and simulations of them, for tests of energy and momenta."""

from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import mesh

from fenicsmpm import (
    ImplicitMPM,
    basis,
    diagnostics,
    formulations,
    points,
)
from fenicsmpm.formulations import EnergyMomentum, Midpoint, Response, Unknown, stress_power
from fenicsmpm.materials import Hencky, VonMises

E, NU, DENSITY = 100.0, 0.3, 2.0


def neo_hooke(F):
    """An energy in UFL, compressible."""
    mu, lame = E / (2 * (1 + NU)), E * NU / ((1 + NU) * (1 - 2 * NU))
    J = ufl.det(F)
    return mu / 2 * (ufl.inner(F, F) - 3) - mu * ufl.ln(J) + lame / 2 * ufl.ln(J) ** 2


MATERIALS = {
    "Hencky": Hencky(E, NU),
    "plastic": VonMises(E, NU, sigma_y=4.0, H=5.0),
    "softening": VonMises(E, NU, sigma_y=4.0, sigma_r=3.0, eta=2.0),
    "UFL": neo_hooke,
}


def block(dim=2, functions="linear", comm=MPI.COMM_SELF, per_cell=4):
    """A block of 2 x 1 (x 1) m that flies, turns and is stretched."""
    lower, upper = [0.0] * dim, [6.0, 4.0, 4.0][:dim]
    cells = [6, 4, 4][:dim]
    kinds = {2: mesh.CellType.quadrilateral, 3: mesh.CellType.hexahedron}
    simplices = {2: mesh.CellType.triangle, 3: mesh.CellType.tetrahedron}
    kind = (simplices if functions == "simplex" else kinds)[dim]
    create = mesh.create_rectangle if dim == 2 else mesh.create_box
    options = {"partitioner": basis.shared_vertex_partitioner}
    domain = create(comm, [lower, upper], cells, kind, **options)
    middle = np.array([2.2, 1.9, 2.1][:dim])[:, None]
    half = np.array([1.0, 0.5, 0.5][:dim])[:, None]
    spacing = 1 / per_cell

    def within(x):
        return np.all(np.abs(x[:dim] - middle) < half, axis=0)

    body = points.lattice(domain, spacing, inside=within)
    if functions == "gimp":
        basis.use(body, "gimp", spacing / 2)
    elif functions == "quadratic":
        basis.use(body, "quadratic")
    gradient = np.zeros((dim, dim))
    gradient[0, 1], gradient[1, 0], gradient[0, 0] = -1.5, 2.0, 1.0
    flight = np.array([1.5, 0.3, 0.0][:dim])[:, None]
    formulations.set_initial_state(body, DENSITY, lambda x: gradient @ (x[:dim] - middle) + flight)
    return body


def simulation(body, material, scheme=Midpoint, kind=ImplicitMPM, dt=0.05, **options):
    z = Unknown(body.mesh, "u")
    time = scheme(z, dt=dt, **options)
    if scheme is Midpoint:
        stress = EnergyMomentum(material, body, z)
        power = stress.power()
    else:
        stress = Response(material, body, formulations.Kinematics(z.u, body).F)
        power = stress_power(stress.P, z.test.u, body)
    R = power + time.inertia(body)
    newton = {"rtol": 1e-12, "line_search": True}
    return kind(R, z, time, body, newton=newton)


def total_energy(body):
    work = body.mesh.comm.allreduce(float(body["V_0"] @ body["work"]))
    return diagnostics.kinetic_energy(body) + work
