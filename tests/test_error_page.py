# SPDX-License-Identifier: MIT
"""The page about errors quotes messages that the package has."""

import ast
import re
from pathlib import Path

import pytest

import fenicsmpm

PACKAGE = Path(fenicsmpm.__file__).parent
PAGE = PACKAGE.parent / "docs" / "howto" / "errors.md"
GAP = "…"


def texts():
    """All strings of the package, with a gap for each value that is put in."""
    for file in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.JoinedStr):
                parts = [p.value if isinstance(p, ast.Constant) else GAP for p in node.values]
                yield "".join(map(str, parts))
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                yield re.sub(r"%(s|d|g|\.\d+f)", GAP, node.value)


def quoted():
    """Messages in the first column of the tables headed "message"."""
    rows, is_table = [], False
    for line in PAGE.read_text().splitlines():
        if not line.startswith("|"):
            is_table = False
        elif line.startswith("| message"):
            is_table = True
        elif is_table:
            rows += re.findall(r"`([^`]+)`", line.split("|")[1])
    return rows


ALL = "\n".join(texts())


@pytest.mark.parametrize("message", quoted())
def test_quoted_message(message):
    pieces = [piece.strip() for piece in message.split(GAP) if piece.strip()]
    assert pieces
    assert all(piece in ALL for piece in pieces), message


def test_quoted_messages_are_many():
    assert len(quoted()) > 50
