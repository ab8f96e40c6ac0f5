# SPDX-License-Identifier: MIT
"""Rigid bodies: their shape and motion, and the contact law at material points."""

from fenicsmpm.rigid.body import RigidBody
from fenicsmpm.rigid.inertia import Inertia, inertia_of

__all__ = ["Inertia", "RigidBody", "inertia_of"]
