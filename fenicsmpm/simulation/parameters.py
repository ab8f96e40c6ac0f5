# SPDX-License-Identifier: MIT
"""Choices of a script as texts, which checkpoints record and compare."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence

import numpy as np
import ufl

from fenicsmpm.formulations import LumpedProjection
from fenicsmpm.points import MaterialPoints


def of_residual(R: ufl.Form) -> str:
    """Return a digest of a form with all numbers in it, but without values of ``fem.Constant``.

    Args:
        R: Residual.
    """
    projected = [c.sums for c in R.coefficients() if isinstance(c, LumpedProjection)]
    said = "".join(form.signature() for form in (R, *projected))
    return f"of digest {hashlib.sha256(said.encode()).hexdigest()[:16]}"


def of_points(point_sets: Sequence[MaterialPoints]) -> dict[str, str]:
    """Return the grid functions of point sets, as chosen by ``basis.use``.

    Args:
        point_sets: Bodies and carried points.
    """
    said = {}
    for k, points in enumerate(point_sets):
        name, size = points.grid_functions or ("linear", None)
        shown = "" if size is None else f" of half size {np.asarray(size).tolist()} m"
        said[f"grid functions of point set {k}"] = name + shown
    return said
