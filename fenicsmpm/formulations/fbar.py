# SPDX-License-Identifier: MIT
"""How J is averaged against volumetric locking (F-bar, section 3)."""

from __future__ import annotations

import math
from dataclasses import dataclass

from fenicsmpm.materials import Law, bulk_to_shear


@dataclass(frozen=True)
class FBar:
    """Averages of J by which stresses are found, ``F_bar = (J_bar / J)^(1/d) F``.

    ``J_bar <- Pi((1 - r) J_bar dJ + r J)`` with the volume average Pi over the grid (eqs. 19-21).
    With r = 0 this is the paper's algorithm 1: what is averaged is averaged again in each step, so
    that J_bar and J drift apart, and a body under constant load creeps. With r = 1 it is its
    equation 18, an average of the true J only, less smooth. A small r keeps the smoothness, and
    J_bar close to J.

    Averages are those of J / J_0, with J_0 when they began: a stress to begin with
    (``initial_stress``) is not averaged, but its changes, and a body in equilibrium stays at rest.

    Before each step, ``F <- (J* / J)^(1/d) F`` with ``J* = J + min(s e, 1) (J_bar - J)`` and the
    norm e of the step's strain increment. It holds together the true J of neighbours where no
    stress does, in fluids and plastic flow; what is at rest does not creep by it.

    Attributes:
        r: share of the true J, 0 to 1.
        s: share of the difference by which the true J is corrected, per strain.

    Raises:
        ValueError: for shares out of range.
    """

    r: float = 0.03
    s: float = 0.0

    def __post_init__(self) -> None:
        """Check the shares."""
        if not (0 <= self.r <= 1 and 0 <= self.s < math.inf):
            raise ValueError(
                f"r of F-bar must lie in [0, 1], s be finite and not negative: {self.r}, {self.s}"
            )


ALGORITHM_1 = FBar(r=0.0)
TRUE_J = FBar(r=1.0)


# Bulk by shear modulus from which on elastic bodies lock: a Poisson's ratio of 0.475
_LOCKS = 20.0


def default_fbar(law: Law) -> FBar | None:
    """Averages that neither creep nor oscillate, for what flows or is nearly incompressible.

    A law that remembers something, such as plastic strain, is taken for one that flows. Elastic
    laws whose bulk modulus is less than 20 shear moduli have none: they do not lock, and averages
    would damp their waves and bend their stresses at walls.

    Args:
        law: constitutive law; one of one's own is asked for its moduli by small strains.
    """
    if law.is_fluid or law.n_state > 0:
        return FBar(r=0.3, s=100.0)
    return FBar() if bulk_to_shear(law) > _LOCKS else None
