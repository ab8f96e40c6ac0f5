# SPDX-License-Identifier: MIT

# # 6. Grid functions
#
# The bar of step 4 became rough when points crossed cells. The gradient of a linear function is
# constant in a cell and jumps at its edge, so the force of a point jumps when the point crosses.
# MPM has three kinds of remedies: functions that see a point as a small box (uGIMP, cpGIMP),
# functions with a continuous gradient (B-splines), or points that do not cross. `basis.use`
# chooses the functions of a body, and forms stay as they are.
#
# From here on, the loops of the package make the steps. `ExplicitMPM` takes a residual in UFL, as
# `NewtonSolver` does. Its unknown is a velocity on the grid.

# +
from mpi4py import MPI

import numpy as np
from dolfinx import mesh

from fenicsmpm import ExplicitMPM, basis, formulations, io, points
from fenicsmpm.materials import Hencky

L, N, E, RHO, V0 = 25.0, 28, 100.0, 1.0, 1.0  # m, cells, Pa, kg/m^3, m/s
omega = np.pi / (2 * L) * np.sqrt(E / RHO)


def swing(functions, until):
    """The bar at a time [s], swinging from a start with the velocity of the first mode."""
    domain = mesh.create_rectangle(
        MPI.COMM_WORLD, [(0, 0), (N, 4)], [N, 4], mesh.CellType.quadrilateral
    )
    bar = points.fill(domain, per_side=2, inside=lambda x: x[0] < L)
    basis.use(bar, functions, 0.25 if functions == "gimp" else None)
    formulations.set_initial_state(
        bar, RHO, lambda x: np.stack([V0 * np.sin(np.pi * x[0] / (2 * L)), 0 * x[0]])
    )
    z = formulations.Unknown(domain, "v")
    z.fix("v", lambda x: np.isclose(x[0], 0), component=0)
    z.fix("v", lambda x: np.isclose(x[1], 0) | np.isclose(x[1], 4), component=1)
    R = formulations.internal_force(z.test.v, bar, Hencky(E, nu=0.0))
    sim = ExplicitMPM(R, z, bar)
    for _ in sim.run(until):
        pass
    return bar


# -

# After a quarter of a period the bar is longest. Its stretch should be a smooth curve, a quarter
# of a cosine.

# +
quarter = np.pi / (2 * omega)
curves, roughness = {}, {}
for functions in "linear", "gimp", "quadratic":
    bar = swing(functions, quarter)
    row = np.flatnonzero(np.isclose(bar.x[:, 1], bar.x[0, 1]))
    row = row[np.argsort(bar.x[row, 0])]
    stretch = bar["F"][row, 0, 0]
    curves[functions] = bar.x[row, 0], stretch
    roughness[functions] = np.abs(np.diff(stretch, 2)).max()
    print(f"{functions:9s} largest kink of the stretch {roughness[functions]:.4f}")
assert roughness["quadratic"] < 0.2 * roughness["linear"]
io.plot("output/6_grid_functions.png", curves, "x [m]", "stretch [-]")
# -

# ## Your turn
#
# Let the bar swing for a whole period, `swing(functions, 4 * quarter)`, and compare the curves.
# Then go through `"linear", "gimp", "quadratic", "cubic"`. Functions that reach further are
# smoother, but they take more time and need more points near the boundary.
# [Grid functions](../explanation/grid_functions.md) explains the choice.
