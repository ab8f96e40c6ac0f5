# SPDX-License-Identifier: MIT
"""Material Point Method on FEniCSx background meshes, with every weak form in UFL."""

__version__ = "0.1.0"
