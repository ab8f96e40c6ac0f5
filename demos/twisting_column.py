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


def twist(**options):
    return Case(
        "twisting_column",
        velocity,
        (-1.25, -1.25, 0.0),
        (1.25, 1.25, 7.0),
        "twisting_column.csv",
        **options,
    )


def velocity(x):
    spin = 100 * np.sin(np.pi * x[:, 2] / 12)  # rad/s
    return spin[:, None] * np.column_stack([x[:, 1], -x[:, 0], np.zeros(len(x))])


# ## Command line

if __name__ == "__main__":
    main(make=twist, end=0.03, full_end=0.5, description="Twisting column")
