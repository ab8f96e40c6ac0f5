# SPDX-License-Identifier: MIT

# # 8. Two ranks, files and a restart
#
# A script for one process is also a script for many. dolfinx spreads the cells of the mesh over
# the ranks, and a point lives on the rank that owns its cell. It moves to another rank when it
# enters a cell there. So the beam of step 7 needs no change:
#
# ```sh
# mpirun -n 2 python 8_two_ranks.py
# ```
#
# What is new here is what one wants of longer runs: results in a file for ParaView, and a
# checkpoint from which a run can go on.

# +
from mpi4py import MPI

import numpy as np
from dolfinx import mesh

from fenicsmpm import ImplicitMPM, formulations, io, points
from fenicsmpm.cells import ActiveCells, correct_weights
from fenicsmpm.diagnostics import momentum
from fenicsmpm.materials import NeoHookean

H, DT, RHO = 0.25, 0.02, 1000.0  # m, s, kg/m^3


def beam(*observers):
    """The beam of step 7 at its start: simulation and points."""
    domain = mesh.create_rectangle(MPI.COMM_WORLD, [(0, -3), (5, 2)], [round(5 / H), round(5 / H)])
    body = points.lattice(domain, H / 6, inside=lambda x: (x[0] < 4) & (np.abs(x[1]) < 0.5))
    formulations.set_initial_state(body, RHO)
    law = NeoHookean(E=4e6, nu=0.5)
    z = formulations.Unknown(domain, "u", "p")
    z.fix("u", lambda x: np.isclose(x[0], 0))
    scheme = formulations.Bossak(z, dt=DT)
    force = scheme.force(body, (0.0, -9.81))
    cells = ActiveCells(body)
    R = formulations.mixed(z, body, law, force=force)
    R += formulations.asgs(z, body, law, force=force) + formulations.ghost_penalty(z, cells, law)
    weights = lambda sim, step: correct_weights(body, cells)  # noqa: E731
    return ImplicitMPM(R, z, scheme, body, observers=[weights, *observers]), body


_, body = beam()
print(f"rank {MPI.COMM_WORLD.rank} has {len(body)} of {body.size_global} points")
# -

# On two ranks this line is printed twice. Use `io.say` for what should be printed once, and ask
# all ranks for what all of them know together: `momentum(body)` is a sum over all points of all
# ranks.
#
# ## A series for ParaView
#
# `io.Series` is an observer that writes points at given intervals, all ranks into one file. A
# checkpoint has all that a run needs to go on.

# +
series = io.Series("output/8_beam.vtkhdf", lambda sim: sim.bodies[0], every=0.1)
sim, body = beam(series)
for _ in sim.run(0.3):
    pass
io.checkpoint.save("output/8_beam.h5", sim)
for _ in sim.run(0.4):
    pass
end = momentum(body)
io.say(f"momentum at {sim.time:.1f} s: {end.round(3)} kg m/s")
# -

# ## A restart
#
# A new simulation is built as before, on any number of ranks, and takes its state from the file.
# It ends where the first one ended.

# +
again, body = beam()
io.checkpoint.restore("output/8_beam.h5", again)
for _ in again.run(0.4):
    pass
difference = np.abs(momentum(body) - end).max() / np.abs(end).max()
io.say(f"the restarted run differs by {difference:.0e}")
assert difference < 1e-6
# -

# ## Your turn
#
# Run the script on one rank and on two, and compare the momenta. Then save on two ranks and
# restore on three: copy the script, take out of one copy the section "A restart", and of the other
# one the section "A series for ParaView". In the second copy, print the momentum in place of the
# last three lines: `io.say(f"momentum {momentum(body).round(3)} kg m/s")`.
#
# Open the series in ParaView; [a page of its own](../howto/paraview.md) says how.
#
# This is the end of the tutorial. The [gallery](../gallery/index.md) has what can be done from
# here, and the [how-to guides](../howto/index.md) have the steps for tasks of your own.
