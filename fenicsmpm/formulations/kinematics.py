# SPDX-License-Identifier: MIT
"""Updated Lagrangian kinematics at material points.

The unknown of a step is the displacement increment u from x_n to x_{n+1} on the undeformed
background mesh. Integrals are taken on this mesh with the volumes V_n. Tensors are 3x3, also in
plane strain.
"""

from __future__ import annotations

from typing import Any

import ufl

from fenicsmpm.points import MaterialPoints


def embed(A: Any) -> Any:
    """Return the 3x3 tensor whose leading block is the given one, with zeros elsewhere.

    Args:
        A: Tensor ``(2, 2)`` or ``(3, 3)``, UFL.
    """
    if A.ufl_shape == (3, 3):
        return A
    return ufl.as_tensor([[A[0, 0], A[0, 1], 0], [A[1, 0], A[1, 1], 0], [0, 0, 0]])


def gradient_before(points: MaterialPoints) -> Any:
    """Return the deformation gradient F_n at the start of a step ``(3, 3)``, UFL.

    It is the field "F" of the points, or the identity if they have no such field.

    Args:
        points: The point set.
    """
    return points.field("F") if "F" in points else ufl.Identity(3)


class Kinematics:
    """Deformation of the points in a step, as UFL expressions.

    Args:
        u: Displacement increment of the step ``(d,)`` [m].
        points: Material points. Their field "F" ``(3, 3)`` is the deformation gradient at the start
            of the step. Points without this field are undeformed.

    Attributes:
        points: The material points.
        u: Displacement increment of the step ``(d,)`` [m].
        f: Incremental deformation gradient I + grad(u), ``(d, d)`` [-].
        j: det f, the ratio of the volumes V_{n+1} / V_n [-].
        F: Deformation gradient f F_n, ``(3, 3)`` [-].
        J: det F [-].
        J_n: det F_n, the ratio of the volumes V_n / V_0 [-].
    """

    def __init__(self, u: Any, points: MaterialPoints) -> None:
        """Define f, j, F and J."""
        dim = points.mesh.geometry.dim
        self.points, self.u = points, u
        self.f = ufl.Identity(dim) + ufl.grad(u)
        self.j = ufl.det(self.f)
        F_n = gradient_before(points)
        self.F = (ufl.Identity(3) + embed(ufl.grad(u))) * F_n
        self.J_n = ufl.det(F_n)
        self.J = self.j * self.J_n

    def cofactor(self) -> Any:
        """Return the cofactor j f^-T of f ``(d, d)`` [-], UFL, computed without a division.

        It maps area vectors at t_n to those at t_{n+1}, and gradients to j times spatial gradients.
        """
        f = self.f
        if f.ufl_shape == (2, 2):
            return ufl.as_tensor([[f[1, 1], -f[1, 0]], [-f[0, 1], f[0, 0]]])
        rows = [[f[i, k] for k in range(3)] for i in range(3)]
        a, b, c = (ufl.as_vector(row) for row in rows)
        return ufl.as_tensor([ufl.cross(b, c), ufl.cross(c, a), ufl.cross(a, b)])

    def grad(self, g: Any) -> Any:
        """Return the spatial gradient of a function on the background mesh, UFL.

        Args:
            g: Scalar or vector on the background mesh, UFL.
        """
        return ufl.dot(ufl.grad(g), ufl.inv(self.f))

    def div(self, w: Any) -> Any:
        """Return the spatial divergence of a vector on the background mesh, UFL.

        Args:
            w: Vector ``(d,)`` on the background mesh, UFL.
        """
        return ufl.tr(self.grad(w))
