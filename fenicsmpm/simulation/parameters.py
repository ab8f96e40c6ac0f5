# SPDX-License-Identifier: MIT
"""What a script has chosen, in words that checkpoints record and compare."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence

import numpy as np
import ufl

from fenicsmpm.formulations import LumpedProjection
from fenicsmpm.points import MaterialPoints


def of_residual(R: ufl.Form) -> str:
    """A digest of a form with all numbers in it; what ``fem.Constant``s have is not in it.

    Args:
        R: residual.
    """
    projected = [c.sums for c in R.coefficients() if isinstance(c, LumpedProjection)]
    said = "".join(form.signature() for form in (R, *projected))
    return f"of digest {hashlib.sha256(said.encode()).hexdigest()[:16]}"


def of_points(point_sets: Sequence[MaterialPoints]) -> dict[str, str]:
    """Grid functions that point sets see, as ``basis.use`` has chosen.

    Args:
        point_sets: bodies and carried points.
    """
    said = {}
    for k, points in enumerate(point_sets):
        name, size = points.grid_functions or ("linear", None)
        shown = "" if size is None else f" of half size {np.asarray(size).tolist()} m"
        said[f"grid functions of point set {k}"] = name + shown
    return said
