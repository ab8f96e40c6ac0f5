# SPDX-License-Identifier: MIT
"""Fracture by a phase field.

The phase field d is 0 where a body is sound and 1 in a crack, which is smeared over the length l.
It is a part of the unknown beside the increment of displacement, and a history: its value is given
back to the points. What is irreversible is a field of the points that says itself how it is
renewed, H <- max(H, psi+) with the energy psi+ of tension and shear (C. Miehe, M. Hofacker and
F. Welschinger, CMAME 199, 2010). In the model AT1 (K. Pham et al., Int. J. Damage Mech. 20, 2011)
the equations are, for all w and s,

    (P, Grad w) = 0,   P = d/dF ((1 - d)^2 psi+ + psi-),
    3 G_c / (8 l) ((1, s) + 2 l^2 (grad d, grad s)) - 2 ((1 - d) H, s) = 0.

H starts from the threshold H_c = 3 G_c / (16 l), below which d is zero. In P stands the d that
points have had before the step, so that each step is robust; while d still changes, the load is
held for further steps until both agree. So a crack runs under constant load.

1. A bar stretched without lateral motion stays homogeneous if it is short: d = 1 - H_c / psi.
2. A strip between rigid clamps is cut along half of its length. All far ahead of the crack is
   stretched alike, all far behind is free of stress, and if the crack gets longer, the one becomes
   the other. So it runs where psi times the height of the strip is G_c, however long the crack is
   (R. Rivlin and A. Thomas, J. Polym. Sci. 10, 1953). As d = 1 in a whole row of cells of size h,
   with the energy 3 G_c / (8 l) per area, the crack takes G_c (1 + 3 h / (8 l)).
"""

from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import mesh

from fenicsmpm import ImplicitMPM, formulations, io, points
from fenicsmpm.materials import NeoHookean
from fenicsmpm.simulation import Reaction

H, PER_SIDE, LENGTH = 0.04, 2, 0.08  # cells in m, points along their sides, l in m
LAW, G_C = NeoHookean(E=1e6, nu=0.3), 2.7  # Pa, J/m^2
STEP, END, STILL = 5e-5, 6e-3, 0.005  # stretch of a step and the largest; change of d to wait for
PROBLEMS = {"bar": (1, 2, 0.0), "strip": (40, 25, 0.8)}  # cells across and along, cut in m
H_C = 3 * G_C / (16 * LENGTH)  # J/m^3


def tension(F):
    J = ufl.det(F)
    return LAW.energy(F, J) + LAW.kappa / 2 * ufl.max_value(J - 1, 0) ** 2


def compression(F):
    return LAW.kappa / 2 * ufl.min_value(ufl.det(F) - 1, 0) ** 2


s = np.linspace(0, END, 2000)  # what is known: stretch, energy and stress of the homogeneous bar
psi = LAW.mu / 2 * ((1 + s) ** (-2 / 3) * (2 + (1 + s) ** 2) - 3) + LAW.kappa / 2 * s**2
known = np.gradient(psi, s) * (H_C / np.maximum(psi, H_C)) ** 2 / 1e3  # kPa
curves = {}

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
        row = rows[-1][0] + pull / height, -clamp.value[1] / width
        rows = [*rows, row] if pull > 0 else [*rows[:-1], row]
    stretch, stress = np.array(rows).T
    curves[name] = 100 * stretch, stress / 1e3

stretch, stress = curves["bar"]
deviation = np.abs(stress - np.interp(stretch, 100 * s, known)).max() / known.max()
stretch, stress = curves["strip"]
critical = stretch[np.flatnonzero(stress > stress.max() / 2)[-1] + 1] / 100
griffith = np.interp(G_C * (1 + 3 * H / (8 * LENGTH)) / height, psi, s)
io.say(f"bar: largest deviation {deviation:.2%} of its strength")
io.say(f"strip: breaks at a stretch of {critical:.3%}, Griffith {griffith:.3%}")
reference = {"homogeneous bar": (100 * s, known), "Griffith": (2 * [100 * griffith], [0, 2])}
labels = "stretch [%]", "mean stress [kPa]"
io.plot("output/phase_field_fracture.png", curves, *labels, reference=reference)

assert deviation < 0.01  # d = 1 - H_c / psi
assert abs(critical / griffith - 1) < 0.03  # Rivlin and Thomas
