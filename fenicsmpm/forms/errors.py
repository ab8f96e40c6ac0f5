# SPDX-License-Identifier: MIT
"""Errors of forms over material points."""


class UnsupportedFormError(ValueError):
    """A form over material points contains something that has no meaning or no support there."""
