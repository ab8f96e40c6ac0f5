# SPDX-License-Identifier: MIT
"""Memory that the process does not need, given back to the system (Linux and glibc)."""

from __future__ import annotations

import ctypes
import mmap
import sys
from typing import Any

import numpy.typing as npt

# Options of glibc by their numbers: M_TRIM_THRESHOLD, M_TOP_PAD, M_MMAP_THRESHOLD, M_MMAP_MAX. The
# thresholds are as high as glibc itself raises them in a program that frees such arrays.
_OPTIONS = {-1: 2**24, -2: 2**17, -3: 2**23, -4: 65536}
_MADV_DONTNEED = 4


def return_freed_memory() -> None:
    """Let glibc return arrays of 8 MB or more to the system when they are freed, as by default.

    SuperLU_DIST, which Debian's PETSc loads, switches this off. Arrays over many points come and
    go, and would leave holes in the heap.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        for option, value in _OPTIONS.items():
            mallopt(option, value)


def release_zeros(array: npt.NDArray[Any]) -> None:
    """Release the memory of an array of zeros until its entries are written.

    Linux provides zeros where released memory is read. Functions on large lattices are zero at most
    of the nodes.

    Args:
        array: Contiguous array of zeros.
    """
    if sys.platform != "linux" or array.any():
        return
    page = mmap.PAGESIZE
    first = -(-array.ctypes.data // page) * page
    size = (array.ctypes.data + array.nbytes) // page * page - first
    if size > 0:
        ctypes.CDLL(None).madvise(ctypes.c_void_p(first), ctypes.c_size_t(size), _MADV_DONTNEED)
