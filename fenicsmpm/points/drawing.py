# SPDX-License-Identifier: MIT
"""What draws points: `fenicsmpm.io.picture`, some floors above, which registers itself here."""

from collections.abc import Callable

from fenicsmpm._display import Picture

picture: Callable[..., Picture]
