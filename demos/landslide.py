# SPDX-License-Identifier: MIT

# # Landslide
#
# A slope of sensitive clay stands under its weight. Then its strength is reduced, as by water, and
# it fails. Once sheared, this clay keeps only a sixteenth of its strength, so a slice slides down,
# runs out, and leaves a scarp. A chart of 1937 tells when the slope must fail, and where the slice
# must begin. This demo meets both.
#
# The problem is a plane section of the landslide in section 4.4 of Y. Zhao, C. Jiang and J. Choo,
# *Circumventing volumetric locking in explicit material point methods: A simple, efficient, and
# general approach* (F-bar). `studies/explicit.py landslide` has it in space, with the paper's cells
# and until 4.5 s.
#
# ## Problem
#
# The clay obeys Hencky's elasticity and von Mises' plasticity. With the plastic strain
# $\varepsilon_p$, its yield stress falls from the peak to the residual one:
#
# $$
# \begin{gathered}
# \kappa = \kappa_r + (\kappa_p - \kappa_r)\,e^{-\eta\,\varepsilon_p}, \\
# \kappa_p = 50\ \mathrm{kPa}, \quad \kappa_r = 3\ \mathrm{kPa}, \quad \eta = 5 .
# \end{gathered}
# $$
#
# Averages of $J$ keep it from locking, as in the [strip footing](strip_footing.py). The law has no
# internal length, so shear bands are as wide as some cells.
#
# The strength in plane strain is $s = \kappa_p/\sqrt 3$. By slip circles, a slope of 45 degrees and
# height $H$ on a firm base needs $s = 0.164\,\rho g H$ (D. W. Taylor, J. Boston Soc. Civil
# Engineers 24, 1937). Its factor of safety is thus 1.67 before the reduction. A reduction by 1.35
# leaves 1.24 and must not harm the slope. The paper's reduction by 1.65 leaves 1.01, and what
# softens on the way to failure makes up for the hundredth. The circle that needs most strength
# begins $1.8 H$ behind the toe.

# +
from mpi4py import MPI

import numpy as np
from dolfinx import mesh

from fenicsmpm import ExplicitMPM, basis, formulations, io, points
from fenicsmpm.materials import VonMises

# -

H = 1 / 3  # size of cells, m; twice as many points along a line
BASE, HEIGHT, LENGTH = 15.0, 5.0, 30.0  # of the slope, of the mesh, m
DENSITY, GRAVITY = 2150.0, 9.81  # kg/m^3, m/s^2
PEAK, RESIDUAL, REDUCTION = 50e3, 3e3, 1.65  # yield stresses in Pa
STAGES = {1.0: 0.5, 1.35: 1.0}  # s with damping, at these reductions, before the failure
TIMES = 1.5, 3.0  # of pictures after the reduction, s
TAYLOR, CIRCLE = 0.164, 1.8  # s / (rho g H), and the distance of toe and scarp by H

# ## Slope
#
# Points see quadratic B-splines. The base is fixed, the ends are rollers.


def clay(reduction):
    return VonMises(E=25e6, nu=0.499, sigma_y=PEAK / reduction, sigma_r=RESIDUAL, eta=5.0)


def largest(values):
    return MPI.COMM_WORLD.allreduce(float(values.max(initial=0.0)), MPI.MAX)


domain = mesh.create_rectangle(
    MPI.COMM_WORLD, [(0, 0), (LENGTH, HEIGHT + 1)], [round(LENGTH / H), round((HEIGHT + 1) / H)],
    mesh.CellType.quadrilateral,
)  # fmt: skip
body = points.lattice(domain, H / 2, inside=lambda x: (x[1] < HEIGHT) & (x[0] + x[1] < BASE - 1e-9))
basis.use(body, "quadratic")
formulations.set_initial_state(body, DENSITY)
z = formulations.Unknown(domain, "v")
z.fix("v", lambda x: np.isclose(x[1], 0))
z.fix("v", lambda x: np.isclose(x[0], 0) | np.isclose(x[0], LENGTH), component=0)
R = formulations.internal_force(z.test.v, body, clay(1.0))
R += formulations.body_force(z.test.v, body, (0.0, -GRAVITY))
history = io.History({"run-out [m]": lambda sim: body.bounds()[1][0] - BASE})
sim = ExplicitMPM(R, z, body, cfl=0.35, damping=0.5, observers=[history])

# ## Reduction of the strength
#
# First the weight comes on, then the strength is reduced a little. With damping, the slope comes to
# rest in both stages. `sim.laws` may be replaced between steps. Each softening law warns that it
# has no length scale.

for reduction, seconds in STAGES.items():
    sim.laws[body] = clay(reduction)
    end = sim.time + seconds
    for _ in io.watch(sim.run(end, 0.05), end, f"reduced by {reduction:g}"):
        pass
    safety = PEAK / 3**0.5 / reduction / (TAYLOR * DENSITY * GRAVITY * HEIGHT)
    creep = np.ptp(history["run-out [m]"][-11:])
    io.say(f"factor of safety {safety:.2f}: in 0.5 s the toe moves by {1e3 * creep:.2f} mm")

# ## Failure
#
# Then the damping goes, and the paper's reduction comes.

start, sim.damping, sim.laws[body] = sim.time, 0.0, clay(REDUCTION)
clouds = {}
for time in TIMES:
    for _ in io.watch(sim.run(start + time, 0.05), start + time, "landslide"):
        pass
    clouds[f"t = {time:g} s"] = io.gather_points(body)

# ## Results
#
# The shear band is a circle, as in Taylor's analysis:

io.picture("output/landslide.png", clouds, "eps_p", "plastic strain", limits=(0.0, 2.0))

# The toe stands still in the first stages. Then it runs.

io.plot("output/landslide_run_out.png", history)

# The scarp is where the points that were at the top still stand.

run_out, top = history["run-out [m]"][-1], body.x[:, 1] - body["u"][:, 1] > HEIGHT - H
stands = top & (np.linalg.norm(body["u"], axis=1) < 0.2)
scarp = (BASE - largest(body.x[stands, 0])) / HEIGHT
volumetric = largest(np.abs(body["J"] - 1))
io.say(f"run-out {run_out:.2f} m; scarp {scarp:.2f} H behind the toe, by Taylor {CIRCLE}")

assert creep < 1e-3 < 2.5 < run_out  # it stands, and it fails: Taylor's chart
assert abs(scarp - CIRCLE) < 0.2  # his circle
assert volumetric < 0.02  # nu = 0.499
