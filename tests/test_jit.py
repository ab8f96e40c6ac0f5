# SPDX-License-Identifier: MIT
"""Compilations by FFCx: processes that are killed, and several that compile the same."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

COMPILE = """
import numpy as np, ufl
from mpi4py import MPI
from dolfinx import fem, mesh
from fenicsmpm import forms, points
domain = mesh.create_unit_square(MPI.COMM_WORLD, 2, 2)
V = fem.functionspace(domain, ("Lagrange", 1))
body = points.fill(domain, 2)
v = ufl.TestFunction(V)
measure = {measure}
b = forms.assemble_vector(forms.form(ufl.exp(ufl.SpatialCoordinate(domain)[0]) * v * measure))
print("sum", b.array.sum())
"""


@pytest.fixture
def start(tmp_path):
    """Starts a script with an empty cache of forms and a compiler that takes its time."""
    compiler = tmp_path / "slow_gcc"
    compiler.write_text('#!/bin/sh\nsleep "${COMPILER_SLEEPS:-0}"\nexec gcc "$@"\n')
    compiler.chmod(0o755)
    script = tmp_path / "script.py"
    running = []

    def started(measure, sleep):
        script.write_text(COMPILE.format(measure=measure))
        environment = os.environ | {
            "XDG_CACHE_HOME": str(tmp_path), "CC": str(compiler), "COMPILER_SLEEPS": str(sleep),
        }  # fmt: skip
        running.append(
            subprocess.Popen(
                [sys.executable, str(script)],
                env=environment,
                text=True,
                start_new_session=True,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
            )
        )
        return running[-1]

    yield started
    for process in running:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()


def unfinished(cache: Path) -> list[Path]:
    """Sources in FFCx's cache that are being compiled."""
    sources = (cache / "fenics").glob("libffcx_*.c")
    return [path for path in sources if not path.with_suffix(".c.cached").exists()]


def wait_for_source(cache: Path) -> Path:
    """The first source that is being compiled."""
    end = time.monotonic() + 60
    while not (found := unfinished(cache)):
        assert time.monotonic() < end
        time.sleep(0.05)
    return found[0]


@pytest.mark.parametrize("measure", ["body.dx", "ufl.dx"])
def test_a_compilation_that_was_killed_is_done_again(start, tmp_path, measure):
    killed = start(measure, sleep=60)
    source = wait_for_source(tmp_path)
    os.killpg(killed.pid, signal.SIGKILL)
    killed.wait()
    long_ago = time.time() - 100
    os.utime(source, (long_ago, long_ago))
    again = start(measure, sleep=0)
    out, err = again.communicate(timeout=60)
    assert again.returncode == 0, err
    assert out.startswith("sum 1.7")
    assert f"compiling {source.name} again" in err
    assert not unfinished(tmp_path)


def test_a_second_process_waits_for_the_first(start, tmp_path):
    first = start("body.dx", sleep=5)
    wait_for_source(tmp_path)
    second = start("body.dx", sleep=5)
    results = [process.communicate(timeout=90) for process in (first, second)]
    assert [process.returncode for process in (first, second)] == [0, 0], results
    assert results[0][0] == results[1][0]
    assert "waiting for another process that compiles the same" in results[1][1]
    assert "again" not in results[1][1]
