# SPDX-License-Identifier: MIT

# # Dam break, implicit and incompressible
#
# A column of water, twice as high as it is wide, collapses and runs along a dry floor. This
# experiment of 1952 is still the benchmark for free surfaces. Here the water is incompressible,
# $\det\mathbf f = 1$ in each step, so no sound waves limit the steps. Front and height are compared
# with the measurements of J. C. Martin and W. J. Moyce (Phil. Trans. R. Soc. A 244, 1952).
#
# The data are those of L. Moreno, A. Contri and A. Larese, *A VMS-stabilized mixed formulation for
# non-linear incompressible solid mechanics problems using the implicit Material Point Method*
# (2022). `studies/dam_break_implicit.py` has other meshes and time schemes.
#
# ## Problem
#
# With the velocity $\mathbf v$ and the acceleration $\mathbf a$ of the time scheme and the
# deformation $\mathbf f$ of a step,
#
# $$
# \begin{aligned}
# \rho\,\mathbf a &= \nabla\cdot\boldsymbol\sigma + \rho\,\mathbf g, \\
# \boldsymbol\sigma &= 2\mu \operatorname{sym}\nabla\mathbf v + p\,\mathbf I, \\
# \det\mathbf f &= 1 .
# \end{aligned}
# $$
#
# The weak form is that of a solid with another law, and so are the subgrid scales (ASGS). Water
# slips along the walls at the sides and sticks to the floor. The points carry the free surface.

# +
from mpi4py import MPI

import numpy as np
from dolfinx import fem, mesh

from fenicsmpm import ImplicitMPM, formulations, io, points

# -

WIDTH, HEIGHT, BOX = 1.0, 2.0, (6.0, 2.4)  # of the water and the mesh, m
H, DT, END = 0.1, 3e-3, 0.72  # m, s, s
DENSITY, VISCOSITY, GRAVITY = 1000.0, 1e-3, 9.81  # kg/m^3, Pa s, m/s^2
SHOWN = 0.25, 0.5, 0.72  # s

# ## Measurements
#
# The width of the column is $a$. Table 2 of Martin and Moyce has the front, $x/a$ over
# $t\sqrt{2g/a}$, and table 6 the height at the wall, $y/2a$ over $t\sqrt{g/a}$.

FRONT = np.array([
    [0.41, 1.11], [0.84, 1.22], [1.19, 1.44], [1.43, 1.67], [1.63, 1.89], [1.83, 2.11],
    [1.98, 2.33], [2.20, 2.56], [2.32, 2.78], [2.51, 3.00], [2.65, 3.22], [2.83, 3.44],
])  # fmt: skip
RESIDUAL = np.array([
    [0.56, 0.94], [0.77, 0.89], [0.93, 0.83], [1.08, 0.78], [1.28, 0.72], [1.46, 0.67],
    [1.66, 0.61], [1.84, 0.56], [2.00, 0.50], [2.21, 0.44],
])  # fmt: skip

# ## Weak form
#
# The mass on the grid is lumped. Where a cell has a single point, the consistent mass is singular,
# and Newton's method fails in the film at the floor. The subgrid scales see the inertia of the
# points, so `force` differs between the two lines.

domain = mesh.create_rectangle(
    MPI.COMM_WORLD, [(0, 0), BOX], [round(side / H) for side in BOX],
    diagonal=mesh.DiagonalType.crossed,
)  # fmt: skip
water = points.quadrature(domain, degree=4, inside=lambda x: (x[0] < WIDTH) & (x[1] < HEIGHT))
formulations.set_initial_state(water, DENSITY)
z = formulations.Unknown(domain, "u", "p")
z.fix("u", lambda x: np.isclose(x[0], 0) | np.isclose(x[0], BOX[0]), component=0)
z.fix("u", lambda x: np.isclose(x[1], 0))
scheme = formulations.BDF2(z, dt=DT)
law = formulations.NewtonianFlow(VISCOSITY, DENSITY, scheme)
g = fem.Constant(domain, (0.0, -GRAVITY))
R = formulations.mixed(z, water, law, force=formulations.density(water) * g)
R += scheme.lumped(water) + formulations.asgs(z, water, law, force=scheme.force(water, g))

# ## Time steps
#
# The front is where a thousandth of the water is ahead. Single points run ahead of the tongue: this
# is spray and should not count as the front. The third observation is the sum of
# $\det\mathbf f - 1$ over the water.


def front(sim):
    x, volume = (np.concatenate(domain.comm.allgather(a)) for a in (water.x[:, 0], water["V_0"]))
    order = np.argsort(-x)
    ahead = np.cumsum(volume[order])
    return x[order[np.searchsorted(ahead, 1e-3 * ahead[-1])]] / WIDTH


def height(sim):
    at_wall = water.x[water.x[:, 0] < H, 1]
    return domain.comm.allreduce(at_wall.max(initial=0.0), MPI.MAX) / HEIGHT


volume = {"change": lambda sim: domain.comm.allreduce(water["V_0"] @ water["dilation"])}
history = io.History({"front": front, "height": height, **volume})
sim = ImplicitMPM(R, z, scheme, water, observers=[history])
clouds = {}
for step in io.watch(sim.run(END), END, "dam break"):
    if any(abs(step.time - time) < DT / 2 for time in SHOWN):
        clouds[f"t = {step.time:.2g} s"] = io.gather_points(water)

# ## Results

io.picture("output/dam_break_implicit.png", clouds, "p", "mean stress [Pa]", cut=1)

# The front is as fast as in the experiment, until it has run 3.5 times the width of the column. The
# volume is kept to round-off.

t, rate = history["t [s]"], np.sqrt(GRAVITY / WIDTH)
places = np.interp(FRONT[:, 0], t * np.sqrt(2) * rate, history["front"])
heights = np.interp(RESIDUAL[:, 0], t * rate, history["height"])
off = np.abs(places / FRONT[:, 1] - 1).max(), np.abs(heights - RESIDUAL[:, 1]).max()
change = np.abs(history["change"]).max() / (WIDTH * HEIGHT)
io.say(f"deviations: front {off[0]:.1%}, height {off[1]:.1%}; change of volume {change:.1e}")
reference = {"Martin and Moyce": tuple(FRONT.T)}
curves = {f"h = {H:g} m": (t * np.sqrt(2) * rate, history["front"])}
labels = "t sqrt(2 g / a)", "front / a"
io.plot("output/dam_break_implicit_front.png", curves, *labels, reference=reference)

assert off[0] < 0.08 and off[1] < 0.05  # Martin and Moyce
assert change < 1e-10  # det f = 1
