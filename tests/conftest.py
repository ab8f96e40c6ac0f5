# SPDX-License-Identifier: MIT
# Copyright (c) The fenicsmpm developers
"""What tests of several files need."""

import logging

import pytest


@pytest.fixture
def said(monkeypatch):
    """The lines that the package logs while the test runs.

    Not caplog: some versions of pytest put two of its handlers in the way of a logger that
    propagates for one test only, and each line counts twice.
    """
    lines, handler, logger = [], logging.Handler(), logging.getLogger("fenicsmpm")
    handler.emit = lambda record: lines.append(record.getMessage())
    monkeypatch.setattr(logger, "handlers", [handler])
    return lines
