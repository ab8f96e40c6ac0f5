# SPDX-License-Identifier: MIT
"""UFL forms over material points."""

from fenicsmpm.forms import petsc
from fenicsmpm.forms.assembly import (
    apply_lifting,
    assemble_matrix,
    assemble_scalar,
    assemble_vector,
    create_matrix,
    inactive_dofs,
)
from fenicsmpm.forms.errors import UnsupportedFormError
from fenicsmpm.forms.evaluate import FieldUpdates, PointExpression, describe_not_finite, evaluate
from fenicsmpm.forms.form import Form, form

__all__ = [
    "FieldUpdates",
    "Form",
    "PointExpression",
    "UnsupportedFormError",
    "apply_lifting",
    "assemble_matrix",
    "assemble_scalar",
    "assemble_vector",
    "create_matrix",
    "describe_not_finite",
    "evaluate",
    "form",
    "inactive_dofs",
    "petsc",
]
