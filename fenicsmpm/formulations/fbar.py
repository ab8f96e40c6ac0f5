# SPDX-License-Identifier: MIT
"""Averages of J against volumetric locking (F-bar, section 3)."""

from __future__ import annotations

import math
from dataclasses import dataclass

from fenicsmpm.materials import Law, bulk_to_shear


@dataclass(frozen=True)
class FBar:
    """Parameters of the averages of J for stresses, ``F_bar = (J_bar / J)^(1/d) F``.

    The average is ``J_bar <- Pi((1 - r) J_bar dJ + r J)`` with the volume average Pi over the grid
    (equations 19 to 21). With r = 0 this is algorithm 1 of the paper. It averages the averages
    again in each step, so that J_bar and J drift apart, and a body under constant load creeps. With
    r = 1 it is equation 18 of the paper, an average of the true J only, which is less smooth. A
    small r preserves the smoothness and keeps J_bar close to J.

    The averages are those of J / J_0, where J_0 is the value of J when the averages began. An
    initial stress (``initial_stress``) is therefore not averaged, only its changes are. A body in
    equilibrium stays at rest.

    Before each step, ``F <- (J* / J)^(1/d) F`` with ``J* = J + min(s e, 1) (J_bar - J)``, where e
    is the norm of the strain increment of the step. This keeps the true J of neighbours together if
    no stress does so, as in fluids and in plastic flow. A body at rest does not creep because of
    it.

    Args:
        r: Share of the true J [-], 0 to 1.
        s: Share of the difference J_bar - J by which the true J is corrected, per strain [-].

    Raises:
        ValueError: If r lies outside [0, 1], or s is negative or not finite.
    """

    r: float = 0.03
    s: float = 0.0

    def __post_init__(self) -> None:
        """Check the shares."""
        if not (0 <= self.r <= 1 and 0 <= self.s < math.inf):
            raise ValueError(
                f"r of F-bar must lie in [0, 1], and s must be finite and not negative: r = "
                f"{self.r}, s = {self.s}"
            )


ALGORITHM_1 = FBar(r=0.0)
TRUE_J = FBar(r=1.0)


# Ratio of bulk to shear modulus above which elastic bodies lock, for a Poisson's ratio of 0.495.
# Cook's membrane in coarse cells then loses 1 to 7 percent of its motion, at 0.49 up to 4 percent.
_LOCKS = 99.0


def default_fbar(law: Law) -> FBar | None:
    """Return averages that neither creep nor oscillate, or None for laws that do not lock.

    Fluids get averages, and so do nearly incompressible elastic laws. Laws with a state, such as
    plastic strain, are treated as laws that flow. Elastic laws with a bulk modulus below 99 shear
    moduli, a Poisson's ratio below 0.495, get none: they lock by a few percent at most, and
    averages would damp their waves and distort their stresses below free surfaces.

    Args:
        law: Constitutive law. The ratio of its moduli is found by small strains.
    """
    if law.is_fluid or law.n_state > 0:
        return FBar(r=0.3, s=100.0)
    return FBar() if bulk_to_shear(law) > _LOCKS else None
