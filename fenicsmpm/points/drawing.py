# SPDX-License-Identifier: MIT
"""Hook for drawing points: `fenicsmpm.io.picture`, a higher floor, registers itself here."""

from collections.abc import Callable

from fenicsmpm._display import Picture

picture: Callable[..., Picture]
