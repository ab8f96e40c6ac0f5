# SPDX-License-Identifier: MIT
"""The house: lower floors do not import higher ones."""

import ast
from pathlib import Path

import fenicsmpm

ROOT = Path(fenicsmpm.__file__).parent
# From the ground up, as in CONTRIBUTING.md
FLOORS = [
    "_display", "_jit", "_compat", "_njit", "_garbage", "_memory", "_numbers",
    "lanes", "shapes", "points", "basis", "rigid", "forms", "materials", "transfer", "cells",
    "formulations", "solvers", "diagnostics", "simulation", "io", "verification", "__init__",
]  # fmt: skip


def imports():
    """Pairs of modules (importing, imported), by their paths in the package."""
    for file in ROOT.rglob("*.py"):
        module = file.relative_to(ROOT).with_suffix("").parts
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("fenicsmpm."):
                yield module, tuple(node.module.split(".")[1:])
            elif isinstance(node, ast.ImportFrom) and node.module == "fenicsmpm":
                yield from ((module, (alias.name,)) for alias in node.names)


def test_lower_floors_do_not_import_higher_ones():
    floor = {name: i for i, name in enumerate(FLOORS)}
    found = list(imports())
    assert len(found) > 200
    wrong = [
        f"{'/'.join(one)} imports {'.'.join(other)}"
        for one, other in found
        if other[0] in floor and floor[other[0]] > floor[one[0]]
    ]
    assert not wrong
    known = {path.stem for path in ROOT.iterdir() if path.suffix == ".py" or path.is_dir()}
    assert known - {"__pycache__"} == set(FLOORS)


def test_what_looks_like_a_value_does_not_communicate():
    """A property that is collective would hang where one rank reads it, to print it, say."""
    properties, calls = 0, {"scatter_forward", "scatter_reverse", "raise_together", "functionspace"}
    for file in ROOT.rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            if not isinstance(node, ast.FunctionDef):
                continue
            if not any("property" in ast.unparse(d) for d in node.decorator_list):
                continue
            properties += 1
            called = {
                ast.unparse(call.func).rpartition(".")[2].lower()
                for call in ast.walk(node)
                if isinstance(call, ast.Call)
            }
            found = {name for name in called if name in calls or name.startswith("all")} - {"all"}
            assert not found and "ollective" not in (ast.get_docstring(node) or ""), node.name
    assert properties > 50


def test_forms_stand_alone():
    """UFL over points knows nothing of the material point method."""
    below = {
        "_display",
        "_jit",
        "_compat",
        "_njit",
        "_garbage",
        "lanes",
        "shapes",
        "points",
        "basis",
        "forms",
    }
    used = {other[0] for one, other in imports() if one[0] == "forms"}
    assert used <= below
