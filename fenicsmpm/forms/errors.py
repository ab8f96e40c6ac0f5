# SPDX-License-Identifier: MIT
"""Errors of forms over material points."""


class UnsupportedFormError(ValueError):
    """Error for a form over material points with a part that has no meaning or support there."""
