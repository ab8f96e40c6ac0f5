# SPDX-License-Identifier: MIT

# # Your own term in explicit steps
#
# Explicit steps take any residual of rank 1, not only those that the package knows. Here an elastic
# bar gets a viscous stress, written in one line of UFL, and swings until it has lost half of its
# energy. The same lines run on a lattice with B-splines, where fused kernels compute the internal
# forces, and on triangles, where compiled forms do.
#
# ## Problem
#
# The bar of length $L$ is held at its left end and moves along itself, with $\nu = 0$. With the
# viscous stress $\eta\,\nabla\mathbf v$, the amplitude $a$ of its first mode $\sin kx$,
# $k = \pi/(2L)$, obeys
#
# $$
# \rho\,\ddot a + \eta k^2\,\dot a + E k^2\,a = 0 .
# $$
#
# With $\delta = \eta k^2/(2\rho)$ and $\omega^2 = E k^2/\rho - \delta^2$, its rate is that of a
# damped oscillator,
#
# $$
# \dot a = \dot a_0\,e^{-\delta t} \left(\cos\omega t - \frac\delta\omega \sin\omega t\right),
# $$
#
# and the energy falls as $e^{-2\delta t}$ from period to period.

# +
from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import mesh

from fenicsmpm import ExplicitMPM, basis, formulations, io, points
from fenicsmpm.diagnostics import kinetic_energy, momentum, strain_energy
from fenicsmpm.materials import Hencky

# -

L, E, RHO, ETA = 1.0, 100.0, 1.0, 0.1  # m, Pa, kg/m^2, Pa s
H, PERIODS = 0.025, 8  # size of cells in m
SPEED = 0.01  # of the right end at the start, m/s
LAW = Hencky(E, nu=0.0)
KINDS = {"quadratic": mesh.CellType.quadrilateral, "linear": mesh.CellType.triangle}
K = np.pi / (2 * L)
DELTA = ETA * K**2 / (2 * RHO)
OMEGA = np.sqrt(E * K**2 / RHO - DELTA**2)  # 1/s
END = PERIODS * 2 * np.pi / OMEGA  # s

# ## Simulation
#
# The bar starts with the velocity of its first mode. The history has its energy and its momentum,
# which is proportional to $\dot a$, as shares of those at the start.


def velocity(x):
    return np.array([SPEED * np.sin(K * x[0]), 0 * x[0]])


def energy(sim):
    (body,) = sim.bodies
    return (kinetic_energy(body) + strain_energy(body, LAW)) / (0.25 * RHO * SPEED**2 * L * 3 * H)


def swing(sim):
    (body,) = sim.bodies
    return momentum(body)[0] / (RHO * SPEED * 3 * H / K)


# The term of your own is the line with `ETA`.

swings, energies, deviations = {}, {}, []
for functions, cells in KINDS.items():
    n = round(1.2 * L / H)
    domain = mesh.create_rectangle(MPI.COMM_WORLD, [(0, 0), (n * H, 3 * H)], [n, 3], cells)
    body = points.lattice(domain, H / 2, inside=lambda x: x[0] < L)
    if functions == "quadratic":
        basis.use(body, functions)
    formulations.set_initial_state(body, RHO, velocity)

    z = formulations.Unknown(domain, "v")
    z.fix("v", lambda x: np.isclose(x[0], 0), component=0)
    z.fix("v", lambda x: np.isclose(x[1], 0) | np.isclose(x[1], 3 * H), component=1)
    R = formulations.internal_force(z.test.v, body, LAW)
    R += ETA * ufl.inner(ufl.grad(z.v), ufl.grad(z.test.v)) * body.dx
    history = io.History({"energy": energy, "momentum": swing})
    sim = ExplicitMPM(R, z, body, observers=[history])
    for _ in io.watch(sim.run(END), END, functions):
        pass

    swings[f"{functions} functions"] = history["t [s]"], history["momentum"]
    energies[f"{functions} functions"] = history["t [s]"], history["energy"]
    left, exact = history["energy"][-1], np.exp(-2 * DELTA * END)
    deviations.append(abs(left / exact - 1))
    io.say(f"{functions} functions: share of the energy that is left {left:.4f}, exact {exact:.4f}")

# ## Results
#
# Both bars swing like the oscillator. The envelope is $e^{-\delta t}$.

t = np.linspace(0, END, 500)
decay = np.exp(-DELTA * t)
rate = decay * (np.cos(OMEGA * t) - DELTA / OMEGA * np.sin(OMEGA * t))
reference = {"oscillator": (t, rate), "exp(-delta t)": (t, decay)}
labels = "t [s]", "momentum / momentum at the start [-]"
io.plot("output/viscous_bar.png", swings, *labels, reference=reference)

# The energy falls in small steps, because a bar dissipates most when it moves most.

labels = "t [s]", "energy / energy at the start [-]"
reference = {"exp(-2 delta t)": (t, decay**2)}
io.plot("output/viscous_bar_energy.png", energies, *labels, reference=reference)

assert max(deviations) < 0.01  # the damped oscillator
