# SPDX-License-Identifier: MIT

# # 5. Incompressible material
#
# Rubber, water and saturated clay keep their volume. Linear elements do not like that: with $\nu
# \to 0.5$ the displacement element of step 3 becomes far too stiff. It *locks*, because each cell
# has more conditions on its volume than it has freedom. This step shows the fault and the cure.
#
# The beam is 4 m long and 1 m high. Its mesh fits, so that nothing but the element is tested.

# +
from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import fem, mesh

from fenicsmpm import forms, formulations, io, points, solvers
from fenicsmpm.materials import NeoHookean

E, LOAD = 2e6, -2e3  # Pa, Pa
domain = mesh.create_rectangle(MPI.COMM_WORLD, [(0, 0), (4, 1)], [64, 16])
body = points.quadrature(domain, degree=2)
end = points.on_facets(domain, lambda x: np.isclose(x[0], 4))
bending = E / (1 - 0.5**2) / 12  # per unit width, plane strain, nu = 0.5
exact = -LOAD * 4**3 / (3 * bending) - LOAD * 4 * 3 / E * 6 / 5  # beam theory with shear


def deflection(z):
    """Downward displacement at the loaded end, averaged over the end [m]."""
    return -forms.assemble_scalar(forms.form(z.u[1] * end.dx))


# -

# ## Displacements only

# The moduli are constants of dolfinx, so that the form is compiled once for all values.

# +
mu, lmbda = fem.Constant(domain, 1.0), fem.Constant(domain, 1.0)
z = formulations.Unknown(domain, "u")
z.fix("u", lambda x: np.isclose(x[0], 0))
F = ufl.variable(ufl.Identity(2) + ufl.grad(z.u))
J = ufl.det(F)
psi = mu / 2 * (ufl.inner(F, F) - 2 - 2 * ufl.ln(J)) + lmbda / 2 * ufl.ln(J) ** 2
R = ufl.inner(ufl.diff(psi, F), ufl.grad(z.test.u)) * body.dx
R -= LOAD * z.test.u[1] * end.dx
newton = solvers.NewtonSolver(R, z.U, z.bcs)
for nu in 0.3, 0.49, 0.4999:
    mu.value, lmbda.value = E / (2 * (1 + nu)), E * nu / ((1 + nu) * (1 - 2 * nu))
    z.U.x.array[:] = 0.0
    newton.solve()
    print(f"nu = {nu}: {deflection(z):.4f} m")
print(f"beam theory for nu = 0.5: {exact:.4f} m")
# -

# ## Displacement and pressure
#
# The cure is a second unknown, the mean stress $p$. The stress is split into a deviator, which
# follows from the strain, and $p$, which follows from the condition on the volume:
#
# $$(\boldsymbol\sigma_{\mathrm{dev}}, \nabla \mathbf w) + (p, \nabla\!\cdot \mathbf w)
#   = (\mathbf t, \mathbf w), \qquad (J - 1, q) = 0 .$$
#
# `formulations.mixed` writes this down for a law. With linear functions for both fields it is not
# yet sound: the pressure oscillates from cell to cell. `formulations.asgs` adds the terms of
# algebraic subgrid scales (Moreno, Wüchner and Larese), which act on the residual and leave the
# exact solution as it is.

# +
rubber = NeoHookean(E=E, nu=0.5)
pressures = {}
for name in "mixed", "mixed and ASGS":
    z = formulations.Unknown(domain, "u", "p")
    z.fix("u", lambda x: np.isclose(x[0], 0))
    R = formulations.mixed(z, body, rubber)
    if name == "mixed and ASGS":
        R += formulations.asgs(z, body, rubber)
    R -= LOAD * z.test.u[1] * end.dx
    solvers.NewtonSolver(R, z.U, z.bcs).solve()
    print(f"{name}: {deflection(z):.4f} m")
    pressures[name] = io.gather_functions([z.function("p")])
assert abs(deflection(z) / exact - 1) < 0.06
io.picture("output/5_mixed.png", pressures["mixed"], "p", "mean stress p [Pa]")
# -

io.picture(
    "output/5_incompressible.png", pressures["mixed and ASGS"], "p", "mean stress p [Pa]", cut=1
)

# Displacements are right in both cases, but only the second pressure can be used: the first one
# is noise of a size that has nothing to do with the load. (Beam theory does not know that the
# clamp also holds the height of the beam, hence the last few percent.)
#
# ## Your turn
#
# A stabilization is a UFL form. Replace the line `R += formulations.asgs(z, body, rubber)` by
# your own:
#
# ```python
# h = formulations.element_size(body)
# R -= h**2 / (2 * rubber.mu) * ufl.inner(ufl.grad(z.p), ufl.grad(z.test.p)) * body.dx
# ```
#
# The pressure is smooth again. How does the deflection change?
# [A page of its own](../howto/own_stabilization.md) measures the order of convergence of your term.
