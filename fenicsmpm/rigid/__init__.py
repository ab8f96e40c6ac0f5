# SPDX-License-Identifier: MIT
"""Rigid bodies: shape, motion, and the contact law between them and a material point."""

from fenicsmpm.rigid.body import RigidBody
from fenicsmpm.rigid.inertia import Inertia, inertia_of

__all__ = ["Inertia", "RigidBody", "inertia_of"]
