# SPDX-License-Identifier: MIT
"""Updated Lagrangian kinematics at material points.

The unknown of a step is the displacement increment u from x_n to x_{n+1} on the undeformed
background mesh, on which integrals are taken with the volumes V_n. Tensors are 3x3, in plane
strain too.
"""

from __future__ import annotations

from typing import Any

import ufl

from fenicsmpm.points import MaterialPoints


def embed(A: Any) -> Any:
    """3x3 tensor with the given 2x2 or 3x3 one in its corner, zeros elsewhere."""
    if A.ufl_shape == (3, 3):
        return A
    return ufl.as_tensor([[A[0, 0], A[0, 1], 0], [A[1, 0], A[1, 1], 0], [0, 0, 0]])


def gradient_before(points: MaterialPoints) -> Any:
    """Deformation gradient at the beginning of a step, 3x3 UFL: field "F", or I without one."""
    return points.field("F") if "F" in points else ufl.Identity(3)


class Kinematics:
    """Deformation of a step at the points, as UFL expressions.

    Args:
        u: displacement increment of the step [m].
        points: material points; their field "F" (3x3), if they have one, is the deformation
            gradient at the beginning of the step, otherwise they are undeformed.

    Attributes:
        points: the material points.
        u: displacement increment of the step [m].
        f: gradient of the increment's motion, I + grad(u), d x d.
        j: det f, ratio of the volumes V_{n+1} / V_n.
        F: deformation gradient f F_n, 3x3.
        J: det F.
        J_n: det F_n, ratio of the volumes V_n / V_0.
    """

    def __init__(self, u: Any, points: MaterialPoints) -> None:
        """Write down f, j, F and J."""
        dim = points.mesh.geometry.dim
        self.points, self.u = points, u
        self.f = ufl.Identity(dim) + ufl.grad(u)
        self.j = ufl.det(self.f)
        F_n = gradient_before(points)
        self.F = (ufl.Identity(3) + embed(ufl.grad(u))) * F_n
        self.J_n = ufl.det(F_n)
        self.J = self.j * self.J_n

    def cofactor(self) -> Any:
        """Cofactor j f^-T, without a division: turns areas of step n and gradients times j."""
        f = self.f
        if f.ufl_shape == (2, 2):
            return ufl.as_tensor([[f[1, 1], -f[1, 0]], [-f[0, 1], f[0, 0]]])
        rows = [[f[i, k] for k in range(3)] for i in range(3)]
        a, b, c = (ufl.as_vector(row) for row in rows)
        return ufl.as_tensor([ufl.cross(b, c), ufl.cross(c, a), ufl.cross(a, b)])

    def grad(self, g: Any) -> Any:
        """Spatial gradient of a function g on the background mesh: its gradient times f^-1."""
        return ufl.dot(ufl.grad(g), ufl.inv(self.f))

    def div(self, w: Any) -> Any:
        """Spatial divergence."""
        return ufl.tr(self.grad(w))
