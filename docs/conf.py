# SPDX-License-Identifier: MIT
"""Settings of Sphinx; ``docs/build.py`` calls it with the pages and the executed notebooks."""

import re
import typing

import numpy as np
import numpy.typing as npt
from docutils import nodes

import fenicsmpm

project = "fenicsmpm"
author = "The fenicsmpm developers"
copyright = author
version = release = fenicsmpm.__version__

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "sphinx_autodoc_typehints",
    "sphinx.ext.viewcode",
    "sphinx_copybutton",
    "sphinx_design",
    "sphinx-mathjax-offline",
]
myst_enable_extensions = ["amsmath", "attrs_inline", "colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3
nb_execution_mode = "off"  # docs/build.py has executed them
nb_merge_streams = True
math_numfig = False

autodoc_default_options = {"members": True, "member-order": "groupwise"}
autosummary_generate = False
typehints_use_rtype = False
typehints_document_rtype_none = False


def typehints_formatter(annotation, config):
    """Arrays as they are called by those who use them, instead of numpy's long unions."""
    parts = typing.get_args(annotation)
    array_like = typing.get_args(npt.ArrayLike)
    if all(part in parts for part in array_like):
        rest = [part for part in parts if part not in array_like]
        names = [
            "None" if part is type(None) else getattr(part, "__name__", str(part)) for part in rest
        ]
        return " | ".join(f"``{name}``" for name in ["array_like", *names])
    if typing.get_origin(annotation) is np.ndarray:
        (dtype,) = typing.get_args(parts[1])
        return f"``ndarray[{getattr(dtype, '__name__', dtype)}]``"
    return None


python_use_unqualified_type_names = True
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_rtype = False
napoleon_use_ivar = True

html_theme = "pydata_sphinx_theme"
html_title = "fenicsmpm"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_copy_source = False
html_theme_options = {
    "navigation_with_keys": False,
    "show_toc_level": 2,
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": ["copyright"],
    "footer_end": [],
}


UNIT = r" (?:%|percent|[kMG]?Pa|[kmµ]?m|[mµn]?s|kg|N|J|degrees)(?!\w)"
TOGETHER = re.compile(rf"(\d[\d.]*e-\d+(?:{UNIT})?|\d[\d.]*{UNIT})")
CODE = nodes.FixedTextElement, nodes.literal, nodes.math


def kept(*parts):
    """Return what stays on one line, by site.css."""
    return nodes.inline("", "", *parts, classes=["keep-together"])


def keep_together(app, doctree, docname):
    """Let no line end in a number with its unit, or between a formula and its punctuation."""
    for text in list(doctree.findall(nodes.Text)):
        parts = [] if isinstance(text.parent, CODE) else TOGETHER.split(text)
        if len(parts) > 1:
            parts = [nodes.Text(part) for part in parts]
            parts[1::2] = [kept(part) for part in parts[1::2]]
            text.parent.replace(text, parts)
    for formula in list(doctree.findall(nodes.math)):
        parent = formula.parent
        at = parent.index(formula)
        before, after = parent[:at], parent[at + 1 :]
        head, tail = "", ""
        if before and isinstance(before[-1], nodes.Text):
            head = re.search(r"\(?$", before[-1])[0]
        if after and isinstance(after[0], nodes.Text):
            tail = re.match(r"[,.;:?!)]*", after[0])[0]
        if not (head or tail):
            continue
        if head:
            before[-1] = nodes.Text(before[-1].removesuffix(head))
        if tail:
            after[0] = nodes.Text(after[0].removeprefix(tail))
        parent[:] = [*before, kept(nodes.Text(head), formula, nodes.Text(tail)), *after]


def setup(app):
    """Called by Sphinx."""
    app.connect("doctree-resolved", keep_together)
