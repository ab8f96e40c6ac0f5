# SPDX-License-Identifier: MIT
#
# # Twisting column
#
# The column of `bending_beam.py` starts to spin about its axis, faster towards its top:
# $v_0 = 100 \sin(\pi z / 12) \, (y, -x, 0)$. It is wound up by more than a full turn and contracts
# on the way. Incompressibility and large rotations make it a hard test of a formulation; without a
# residual-based stabilization it fails.
#
# It is section 6.4 of Moreno, Wüchner and Larese, *A mixed stabilized MPM formulation for
# incompressible hyperelastic materials using Variational Subgrid-Scales*. Formulation,
# implementation and options are those of the bending beam.

import numpy as np
from bending_beam import Case, main


def twist(spin=100.0, reference="twisting_column.csv", **options):
    def velocity(x):
        rate = spin * np.sin(np.pi * x[:, 2] / 12)  # rad/s
        return rate[:, None] * np.column_stack([x[:, 1], -x[:, 0], np.zeros(len(x))])

    corners = (-1.25, -1.25, 0.0), (1.25, 1.25, 7.0)
    return Case("twisting_column", velocity, *corners, reference, **options)


def slides(**options):
    """The faster column of Moreno, Contri and Larese, CMN 2022, with Miehe's volumetric law."""
    return twist(
        105.0, None, h=0.2, per_cell=16, volumetric="miehe", transient=True, tied=True, **options
    )


# ## Command line

if __name__ == "__main__":
    main(make=twist, slides=slides, end=0.03, full_end=0.5, description="Twisting column")
