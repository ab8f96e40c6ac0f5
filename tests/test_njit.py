# SPDX-License-Identifier: MIT
"""Compiled functions on disk: kept from one process to the next, and never out of date."""

import os
import subprocess
import sys
from pathlib import Path

import numba
import numpy as np
import pytest

from fenicsmpm import _njit
from fenicsmpm._njit import njit

# Prints how many functions were compiled, after what the script prints.
COUNT = """
import atexit
from numba.core import event
class Counter(event.Listener):
    count = 0
    def on_start(self, _): Counter.count += 1
    def on_end(self, _): pass
event.register("numba:compile", Counter())
atexit.register(lambda: print(Counter.count))
"""


class Scripts:
    """Python files in a directory, run in processes of their own with a cache of their own."""

    def __init__(self, directory: Path) -> None:
        self.directory, self.cache = directory / "scripts", directory / "cache"
        self.directory.mkdir()
        self._time = 1e9

    def write(self, name: str, text: str) -> None:
        """Write a file, with a new time of change."""
        (self.directory / name).write_text(text)
        self._time += 10  # else Python could take an old .pyc
        os.utime(self.directory / name, (self._time, self._time))

    def start(self, *arguments: str, **options) -> subprocess.Popen:
        environment = os.environ | {"NUMBA_CACHE_DIR": str(self.cache)}
        return subprocess.Popen(
            [sys.executable, *(arguments or ("main.py",))],
            cwd=self.directory,
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            **options,
        )

    def run(self, *arguments: str, stdin: str = "") -> tuple[list[str], int]:
        """What a script prints, and how many functions were compiled."""
        return self.result(self.start(*arguments, stdin=subprocess.PIPE), stdin)

    def result(self, process: subprocess.Popen, stdin: str = "") -> tuple[list[str], int]:
        out, error = process.communicate(stdin)
        assert (process.returncode, error) == (0, "")
        *printed, compiled = out.split()
        return printed, int(compiled)

    def files(self) -> list[Path]:
        return sorted(path for path in self.cache.rglob("*") if path.is_file())


@pytest.fixture
def scripts(tmp_path):
    return Scripts(tmp_path)


LAW = """
import math
from fenicsmpm.materials import compiled
from helpers import twice
import constants
FACTOR = 3.0
@compiled
def energy(F, parameters, state):
    return FACTOR * twice(F[0, 0]) + constants.SHIFT + math.sqrt(4.0) * parameters[0]
"""
HELPERS = """
import numba
import more_helpers
@numba.njit(cache=True)
def twice(x):
    return more_helpers.add(x, x)
"""
MORE_HELPERS = """
import numba
@numba.njit
def add(x, y):
    return x + y
"""
# the loop of the package that compiles the law in
MAIN = (
    COUNT
    + """
import numpy as np
from fenicsmpm.materials import Law, compiled
from fenicsmpm.materials import energy as energies
from law import energy
law = Law(energy, [10.0], 1.0, energy=energy)
print(energies(law, np.full((1, 3, 3), 5.0))[0])
"""
)


def test_what_was_edited_takes_effect(scripts):
    sources = {
        "law.py": LAW,
        "helpers.py": HELPERS,
        "more_helpers.py": MORE_HELPERS,
        "constants.py": "SHIFT = 1.0\n",
        "main.py": MAIN,
    }
    for name, text in sources.items():
        scripts.write(name, text)
    printed, compiled = scripts.run()
    assert printed == ["51.0"]
    assert compiled > 0
    assert scripts.run() == (["51.0"], 0)
    for module, old, new, value in (
        ("law.py", "FACTOR *", "2.0 * FACTOR *", 81.0),
        ("law.py", "FACTOR = 3.0", "FACTOR = 4.0", 61.0),
        ("helpers.py", "add(x, x)", "add(x, 2.0 * x)", 66.0),
        ("more_helpers.py", "x + y", "x + y + 100.0", 351.0),
        ("constants.py", "SHIFT = 1.0", "SHIFT = 2.0", 52.0),
    ):
        assert old in sources[module]
        scripts.write(module, sources[module].replace(old, new))
        printed, compiled = scripts.run()
        assert printed == [str(value)]
        assert compiled > 0
        scripts.write(module, sources[module])
    # another line above: nothing that is compiled has changed, and the first is still there
    for module in ("law.py", "helpers.py", "more_helpers.py", "constants.py"):
        scripts.write(module, "# a comment\n" + sources[module])
    assert scripts.run() == (["51.0"], 0)


SMALL = (
    COUNT
    + """
from fenicsmpm._njit import njit
@njit
def thrice(x):
    return 3.0 * x
print(thrice(2.0))
"""
)


@pytest.mark.parametrize(("arguments", "stdin"), [(("-c", SMALL), ""), (("-",), SMALL)])
def test_functions_without_a_file_are_compiled(scripts, arguments, stdin):
    assert scripts.run(*arguments, stdin=stdin) == (["6.0"], 1)
    assert scripts.files() == []


def test_processes_that_compile_at_the_same_time(scripts):
    scripts.write("main.py", SMALL)
    for process in [scripts.start() for _ in range(3)]:
        printed, compiled = scripts.result(process)
        assert printed == ["6.0"]
        assert compiled in (0, 1)
    assert len(scripts.files()) == 1
    assert scripts.run() == (["6.0"], 0)


# Variants have the same names and types. With numba's own numbers, which start with 1 in each
# process, their symbols have the same names, too. A recursion is not inlined.
VARIANTS = (
    COUNT
    + """
import sys
import numba
from fenicsmpm._njit import njit
def variant(n):
    @numba.njit
    def inner(x, k):
        if k <= 0:
            return x**n
        return inner(x, k - 1)
    @njit
    def outer(x):
        return inner(x, 1 + int(x))
    return outer
for n in map(int, sys.argv[1:]):
    print(variant(n)(2.0))
"""
)


@pytest.mark.parametrize(("kept", "printed"), [("2", "4.0"), ("3", "8.0")])
def test_variants_of_a_closure_are_not_mixed_up(scripts, kept, printed):
    """One is compiled and the other one from the disk, in both orders."""
    scripts.write("main.py", VARIANTS)
    values, compiled = scripts.run("main.py", kept)
    assert values == [printed]
    assert scripts.run("main.py", "3", "2") == (["8.0", "4.0"], compiled)
    assert scripts.run("main.py", "2", "3") == (["4.0", "8.0"], 0)


LAW_IN_LOOPS = (
    COUNT
    + """
from mpi4py import MPI
import numpy as np
import ufl
from dolfinx import fem, mesh
from fenicsmpm import ExplicitMPM, basis, forms, formulations, points
from fenicsmpm.materials import Hencky, Law, compiled, tangent
@compiled
def update(F, L, parameters, state, sigma):
    # not for eight points at once, as it has a branch
    for i in range(3):
        for j in range(3):
            sigma[i, j] = parameters[0] * (F[i, j] - 1.0 if i == j else 0.0)
@compiled
def slope(F, parameters, state, dPdF):
    dPdF[:] = parameters[0]
quadrilateral = mesh.CellType.quadrilateral
domain = mesh.create_rectangle(MPI.COMM_SELF, [(0, 0), (1, 1)], [4] * 2, quadrilateral)
body = points.lattice(domain, 1 / 8)
law = Law(update, [1e6], 1e6, tangent=slope)
basis.use(body, "quadratic")
formulations.set_initial_state(body, density=1000.0)
z = formulations.Unknown(domain, "v")
R = formulations.internal_force(z.test.v, body, law)
ExplicitMPM(R, z, body).step()
print(tangent(law, np.eye(3)[None]).max())
# the loop of forms
stretched = ufl.as_matrix(np.diag([1.1, 1.0, 1.0]).tolist())
P = formulations.Response(Hencky(E=1e6, nu=0.0), body, stretched).P
print(forms.evaluate(P, body)[0, 0, 0] > 0)
"""
)


@pytest.mark.slow
def test_the_second_start_compiles_nothing(scripts):
    scripts.write("main.py", LAW_IN_LOOPS)
    printed, compiled = scripts.run()
    assert printed == ["1000000.0", "True"]
    assert compiled > 10
    assert scripts.run() == (printed, 0)


# --- in this process -----------------------------------------------------------------------------


@pytest.fixture
def cache(tmp_path, monkeypatch):
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    return lambda: [path for path in tmp_path.rglob("*") if path.is_file()]


def power(n):
    @njit
    def power_of(x):
        return x**n

    return power_of


def test_files_are_numbered_by_what_they_are_compiled_from(cache):
    assert power(2.0)(3.0) == 9.0
    assert power(2.0)(3.0) == 9.0
    assert len(cache()) == 1
    assert power(2)(3.0) == 9.0
    assert power(3.0)(3.0) == 27.0
    assert len(cache()) == 3


@pytest.mark.parametrize("damage", ["empty", "truncated", "garbage", "a byte"])
def test_damaged_files_are_compiled_anew(cache, damage):
    def start():
        function = power(2.0)
        assert function(3.0) == 9.0
        return sum(function.stats.cache_hits.values())

    assert (start(), start()) == (0, 1)
    (file,) = cache()
    content = file.read_bytes()
    middle = len(content) // 2
    damaged = {
        "empty": b"",
        "truncated": content[:middle],
        "garbage": b"garbage" * 100,
        "a byte": content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :],
    }
    file.write_bytes(damaged[damage])
    assert (start(), start()) == (0, 1)
    assert cache() == [file]


def test_a_place_where_nothing_can_be_written(cache):
    assert power(2.0)(3.0) == 9.0
    (file,) = cache()
    file.unlink()
    file.mkdir()
    assert power(2.0)(3.0) == 9.0
    assert cache() == []


def test_the_oldest_variants_are_removed(cache, monkeypatch):
    monkeypatch.setattr(_njit, "_MOST", 3)
    for n in range(5):
        assert power(float(n))(2.0) == 2.0**n
    assert len(cache()) == 3


SCALE = 2.0


@njit
def scaled(x):
    return SCALE * x


def test_functions_that_numba_froze_before_a_global_changed_are_not_kept(cache, monkeypatch):
    """A new process would compile the callee with the new value."""

    def caller():
        @njit
        def call(x):
            return scaled(x)

        return call

    assert caller()(3.0) == 6.0
    assert len(cache()) == 2
    monkeypatch.setattr(sys.modules[__name__], "SCALE", 5.0)
    assert caller()(3.0) == 6.0  # as numba has it: globals are constants
    assert len(cache()) == 2


def test_arrays_among_the_globals_count(cache):
    def summing(weights):
        @njit
        def total(x):
            return x * weights[0] + weights[1]

        return total

    assert summing(np.array([1.0, 2.0]))(3.0) == 5.0
    assert summing(np.array([1.0, 7.0]))(3.0) == 10.0
    assert len(cache()) == 2


def test_functions_as_arguments_are_compiled_but_not_kept(cache):
    @njit
    def apply(function, x):
        return function(x)

    assert apply(power(2.0), 3.0) == 9.0
    assert [path.name.split(".")[1] for path in cache()] == ["power"]


def test_recursion(cache):
    def new():
        @njit
        def factorial(n):
            if n <= 1:
                return 1
            return n * factorial(n - 1)

        return factorial

    assert new()(5) == 120
    again = new()
    assert again(5) == 120
    assert sum(again.stats.cache_hits.values()) == 1


def test_answers_whether_a_function_compiles_are_kept(cache):
    def branch():
        @njit
        def sign(x):
            return "a" + 1 if x else 2

        return sign

    signature = numba.void(numba.float64)
    assert not _njit.compiles(branch(), signature)
    assert len(cache()) == 1
    again = branch()
    assert not _njit.compiles(again, signature)
    assert again.stats.cache_misses == {}
    assert _njit.compiles(power(2.0), (numba.float64,))
