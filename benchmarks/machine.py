# SPDX-License-Identifier: MIT
"""Processor, dolfinx version and commit for the head of a table of times."""

import platform
from pathlib import Path

import dolfinx

import fenicsmpm


def describe():
    """Return one line with processor, versions and commit."""
    return f"{_processor()}, dolfinx {dolfinx.__version__}, fenicsmpm {_commit()}"


def _processor():
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    names = [line.split(":")[1].strip() for line in lines if line.startswith("model name")]
    return f"{len(names)} x {names[0]}" if names else platform.machine()


def _commit():
    """Return the hash of the checked-out commit, without git, which may not be installed."""
    git = Path(__file__).parents[1] / ".git"
    try:
        head = (git / "HEAD").read_text().split()
        return (head[0] if len(head) == 1 else (git / head[1]).read_text().strip())[:10]
    except OSError:
        return fenicsmpm.__version__
