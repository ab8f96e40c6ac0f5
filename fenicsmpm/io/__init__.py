# SPDX-License-Identifier: MIT
"""Output for people and for other programs."""

from fenicsmpm.io.console import progress, show_log

__all__ = ["progress", "show_log"]
