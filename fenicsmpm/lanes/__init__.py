# SPDX-License-Identifier: MIT
"""Eight numbers at once in one vector register, in loops compiled by numba."""

from fenicsmpm.lanes.memory import (
    line_at,
    line_of,
    load,
    load_columns,
    load_line,
    number_at,
    prefetch,
    store,
    store_columns,
    store_integers,
    store_line,
)
from fenicsmpm.lanes.rows import (
    LANES,
    LINE_LANES,
    add_scaled,
    between,
    choose,
    rough_inverse_cube_root,
    scaled,
    zero_line,
    zeros,
)
from fenicsmpm.lanes.tensors import tensors, works_on_rows

__all__ = [
    "LANES",
    "LINE_LANES",
    "add_scaled",
    "between",
    "choose",
    "line_at",
    "line_of",
    "load",
    "load_columns",
    "load_line",
    "number_at",
    "prefetch",
    "rough_inverse_cube_root",
    "scaled",
    "store",
    "store_columns",
    "store_integers",
    "store_line",
    "tensors",
    "works_on_rows",
    "zero_line",
    "zeros",
]
