# SPDX-License-Identifier: MIT
"""Checks of the numbers that users give."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt


def finite(values: npt.ArrayLike, what: str) -> npt.NDArray[np.float64]:
    """Return a float64 copy of finite real numbers of any shape.

    Args:
        values: Values to be checked.
        what: Meaning of the values for the message, in the plural.

    Raises:
        ValueError: If the values are anything else, such as text.
    """
    array = _real(values)
    if array is None:
        raise ValueError(f"{what} must be numbers, not {values!r}")
    if not np.isfinite(array).all():
        raise ValueError(f"{what} must be finite: {values!r}")
    return array


def number(value: float, symbol: str, meaning: str, unit: str) -> float:
    """Return a value as float if it is one real number.

    Args:
        value: Value to be checked.
        symbol: Name of the parameter.
        meaning: Meaning of the parameter.
        unit: Unit of the value.

    Raises:
        ValueError: If it is not. The message names the parameter and its value.
    """
    array = _real(value)
    if array is None or array.shape != ():
        raise ValueError(f"{meaning} must be one number [{unit}]: {symbol} = {value!r}")
    return float(array)


def _real(values: npt.ArrayLike) -> npt.NDArray[np.float64] | None:
    """Return a float64 copy of the values, or None unless all are real numbers."""
    try:
        array = np.array(values)
    except ValueError:  # rows of different lengths
        return None
    return array.astype(np.float64) if array.dtype.kind in "biuf" else None


def positive(value: float, symbol: str, meaning: str, unit: str) -> float:
    """Return a value as ``number`` does, if it is positive and finite.

    Args:
        value: Value to be checked.
        symbol: Name of the parameter.
        meaning: Meaning of the parameter.
        unit: Unit of the value.

    Raises:
        ValueError: If it is not.
    """
    result = number(value, symbol, meaning, unit)
    if not 0 < result < np.inf:
        raise ValueError(f"{meaning} must be positive and finite: {symbol} = {result} {unit}")
    return result


def not_negative(value: float, symbol: str, meaning: str, unit: str) -> float:
    """Return a value as ``number`` does, if it is finite and not negative.

    Args:
        value: Value to be checked.
        symbol: Name of the parameter.
        meaning: Meaning of the parameter.
        unit: Unit of the value.

    Raises:
        ValueError: If it is not.
    """
    result = number(value, symbol, meaning, unit)
    if not 0 <= result < np.inf:
        raise ValueError(f"{meaning} must be finite and not negative: {symbol} = {result} {unit}")
    return result
