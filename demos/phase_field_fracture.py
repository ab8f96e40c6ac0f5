# SPDX-License-Identifier: MIT

# # Fracture by a phase field
#
# A crack needs no special mesh here, no criterion of growth and no code in the package. A second
# field of the unknown is 0 where the body is sound and 1 in the crack. It takes a few lines of UFL.
# The demo checks it against two exact results: the softening of a short bar, and the load at which
# a long crack runs.
#
# ## Problem
#
# The phase field $d$ smears the crack over a length $l$. The energy of the body is split into
# $\psi^+$ of tension and shear and $\psi^-$ of compression, which cracks do not release. In the
# model AT1 (K. Pham et al., Int. J. Damage Mech. 20, 2011), for all $\mathbf w$ and $s$,
#
# $$
# \begin{aligned}
# (\mathbf P, \operatorname{Grad}\mathbf w) &= 0, \\
# \frac{\partial}{\partial\mathbf F} \left((1 - d)^2\,\psi^+ + \psi^-\right) &= \mathbf P, \\
# \frac{3 G_c}{8 l} \left((1, s) + 2 l^2 (\nabla d, \nabla s)\right)
# - 2\,((1 - d)\,\mathcal H, s) &= 0 .
# \end{aligned}
# $$
#
# Cracks do not heal. So $\mathcal H$ is the largest $\psi^+$ so far, a field of the points that
# each step renews as $\mathcal H \leftarrow \max(\mathcal H, \psi^+)$ (C. Miehe, M. Hofacker and F.
# Welschinger, CMAME 199, 2010). It starts from the threshold $\mathcal H_c = 3 G_c/(16 l)$, below
# which $d$ is zero.
#
# The stress $\mathbf P$ takes $d$ from before the step, which makes each step robust. If $d$
# changes in a step, further steps follow under the same load, until $d$ stands still. So a crack
# runs under constant load.
#
# ## References
#
# 1. A bar stretched without lateral motion stays homogeneous if it is short:
#    $d = 1 - \mathcal H_c/\psi$.
# 2. A strip between rigid clamps is cut along half of its length. Far ahead of the crack, the strip
#    is stretched uniformly. Far behind the crack, it is free of stress. As the crack grows,
#    stretched parts become free of stress. So the crack runs when $\psi$ times the height of the
#    strip is $G_c$, however long the crack is (R. Rivlin and A. Thomas, J. Polym. Sci. 10, 1953).
#    On a mesh, $d = 1$ in a whole row of cells of size $h$, with the energy $3 G_c/(8 l)$ per
#    volume. So the crack takes $G_c\,(1 + 3h/(8l))$.

# +
from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import mesh

from fenicsmpm import ImplicitMPM, formulations, io, points
from fenicsmpm.materials import NeoHookean
from fenicsmpm.simulation import Reaction

# -

H, PER_SIDE, LENGTH = 0.04, 2, 0.08  # cells in m, points along their sides, l in m
LAW, G_C = NeoHookean(E=1e6, nu=0.3), 2.7  # Pa, J/m^2
STEP, END, STILL = 5e-5, 6e-3, 0.005  # stretch of a step and the largest; change of d to wait for
PROBLEMS = {"bar": (1, 2, 0.0), "strip": (40, 25, 0.8)}  # cells across and along, cut in m
H_C = 3 * G_C / (16 * LENGTH)  # J/m^3

# ## Energies


def tension(F):
    J = ufl.det(F)
    return LAW.energy(F, J) + LAW.kappa / 2 * ufl.max_value(J - 1, 0) ** 2


def compression(F):
    return LAW.kappa / 2 * ufl.min_value(ufl.det(F) - 1, 0) ** 2


# Energy and stress of the homogeneous bar, over its stretch:

s = np.linspace(0, END, 2000)
psi = LAW.mu / 2 * ((1 + s) ** (-2 / 3) * (2 + (1 + s) ** 2) - 3) + LAW.kappa / 2 * s**2
known = np.gradient(psi, s) * (H_C / np.maximum(psi, H_C)) ** 2 / 1e3  # kPa

# ## Simulation
#
# Bar and strip differ in their sizes only. The cut of the strip is a row of points with a large
# $\mathcal H$. `Reaction` tells the force at the lower clamp. The loop ends when the stress has
# fallen to two percent of its peak. Of the strip it keeps the states in which $d$ has changed.

curves, states = {}, []
for name, (across, along, cut) in PROBLEMS.items():
    width, height = across * H, along * H
    domain = mesh.create_rectangle(
        MPI.COMM_WORLD, [(0, 0), (width, height)], [across, along], mesh.CellType.quadrilateral
    )
    body = points.fill(domain, PER_SIDE)
    formulations.set_initial_state(body, density=1.0)
    in_cut = (body.x[:, 0] < cut) & (np.abs(body.x[:, 1] - height / 2) < H / 2)
    body.add_field("H", (), np.where(in_cut, 1e3 * H_C, H_C))
    body.add_field("d", ())

    z = formulations.Unknown(domain, "u", "d")
    pull = 0.0
    z.fix("u", lambda x: np.isclose(x[0], 0) | np.isclose(x[0], width), component=0)
    z.fix("u", lambda x: np.isclose(x[1], height), lambda start, end: (0, pull))
    clamp = Reaction(z.fix("u", lambda x: np.isclose(x[1], 0)))
    k = formulations.Kinematics(z.u, body)
    driving = ufl.max_value(body.field("H"), tension(k.F))
    body.field("H").renew(driving)
    sound = (1 - body.field("d")) ** 2 + 1e-5
    P = formulations.Response(lambda F: sound * tension(F) + compression(F), body, k.F).P
    spread = 2 * LENGTH**2 * ufl.inner(k.grad(z.d), k.grad(z.test.d))
    crack = 2 * H_C * (z.test.d + spread) - 2 * (1 - z.d) * driving * z.test.d
    R = formulations.stress_power(P, z.test.u, body) + crack / k.J_n * body.dx
    scheme = formulations.QuasiStatic(z, dt=1.0)
    sim = ImplicitMPM(R, z, scheme, body, observers=[clamp])

    rows, change = [(0.0, 0.0)], 0.0  # stretch and stress, as soon as d is still
    while rows[-1][0] < END - STEP / 2 and rows[-1][1] >= 0.02 * max(stress for _, stress in rows):
        pull = STEP * height if change < STILL else 0.0
        before = body["d"].copy()
        sim.step()
        change = domain.comm.allreduce(np.abs(body["d"] - before).max(initial=0.0), MPI.MAX)
        if name == "strip" and change > STILL:
            states.append(io.gather_points(body))
        row = rows[-1][0] + pull / height, -clamp.value[1] / width
        rows = [*rows, row] if pull > 0 else [*rows[:-1], row]
    stretch, stress = np.array(rows).T
    curves[name] = 100 * stretch, stress / 1e3

# ## Results
#
# The crack runs through the strip under a load that does not grow any more:

shown = {"at rest": 1, "on its way": len(states) // 2, "through": -1}
clouds = {title: states[k] for title, k in shown.items()}
io.picture("output/phase_field_fracture.png", clouds, "d", "phase field d [-]", limits=(0.0, 1.0))

# The bar softens as it must. The strip breaks at Griffith's load.

stretch, stress = curves["bar"]
deviation = np.abs(stress - np.interp(stretch, 100 * s, known)).max() / known.max()
stretch, stress = curves["strip"]
critical = stretch[np.flatnonzero(stress > stress.max() / 2)[-1] + 1] / 100
griffith = np.interp(G_C * (1 + 3 * H / (8 * LENGTH)) / height, psi, s)
io.say(f"bar: largest deviation {deviation:.2%} of its strength")
io.say(f"strip: breaks at a stretch of {critical:.3%}, Griffith {griffith:.3%}")
reference = {"homogeneous bar": (100 * s, known), "Griffith": (2 * [100 * griffith], [0, 2])}
labels = "stretch [%]", "mean stress [kPa]"
io.plot("output/phase_field_fracture_stress.png", curves, *labels, reference=reference)

assert deviation < 0.01  # d = 1 - H_c / psi
assert abs(critical / griffith - 1) < 0.03  # Rivlin and Thomas
