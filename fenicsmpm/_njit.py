# SPDX-License-Identifier: MIT
"""Functions compiled by numba and cached on disk until something that they use changes.

Numba's own cache depends on the file of a function only. It does not notice changes of functions in
other files that the function calls, and it does not cache inner functions that use variables of the
enclosing one. This cache depends on what is compiled: bytecode and constants of a function, and of
everything that it refers to in globals and closures. We call this its fingerprint.

All uses of numba's internals are in this module.
"""

# mypy: disable-error-code=misc

from __future__ import annotations

import dis
import enum
import functools
import hashlib
import itertools
import logging
import os
import pickle
import secrets
import sys
import types
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import llvmlite
import numba
import numpy as np
from numba.core.bytecode import FunctionIdentity
from numba.core.caching import CompileResultCacheImpl, FunctionCache, NullCache
from numba.core.compiler import CompileResult
from numba.core.cpu_options import ParallelOptions
from numba.core.dispatcher import Dispatcher
from numba.core.errors import NumbaError
from numba.core.serialize import dumps
from numba.core.sigutils import normalize_signature
from numba.core.types import BaseTuple, Type
from numba.core.types import Callable as CallableType

logger = logging.getLogger(__name__)

# Symbols in compiled code consist of the name of the function and a number. Numba counts from 1 in
# each process. Code from the disk and code compiled now could therefore have the same symbol, and
# the linker would confuse them.
FunctionIdentity._unique_ids = itertools.count(secrets.randbits(60))

_VERSIONS = (numba.__version__, llvmlite.__version__, np.__version__, sys.version)
# Modules that are identified by these versions
_KNOWN = {*sys.stdlib_module_names, "numba", "llvmlite", "numpy"} - {"__main__"}
# Only loops by ``prange`` are parallel. Otherwise numba would also compile functions for sums and
# maxima of short arrays, and start threads for them.
_PRANGE = ParallelOptions(
    {
        "comprehension": False, "reduction": False, "inplace_binop": False, "setitem": False,
        "numpy": False, "stencil": False, "fusion": False, "prange": True,
    }
)  # fmt: skip
# Number of cached variants of a function: dimensions, bases, laws, and laws that have been edited
_MOST = 100
_DOES_NOT_COMPILE = "does not compile"
# Placeholder for a function while we walk through what it refers to
_RECURSION = "recursion"


def njit(function: Callable[..., Any] | None = None, **options: Any) -> Any:
    """Compile a function as ``numba.njit`` does, and cache the result on disk.

    The cache is in the directory that numba would use, and serves inner functions, too. A cached
    result is used if the function, the options and everything that the function refers to are the
    same: other compiled functions, constants, versions of numba and numpy. Functions without a
    cache directory, such as those typed on standard input, are compiled in each process.

    Args:
        function: Function to compile; if not given, a decorator is returned.
        **options: Options of ``numba.njit``, without ``cache``.
    """
    if function is None:
        return functools.partial(njit, **options)
    if options.get("parallel"):
        options = {**options, "parallel": _PRANGE}
    dispatcher = numba.njit(**options)(function)
    dispatcher._cache = _Cache(dispatcher)
    return dispatcher


def compiles(dispatcher: Any, signature: Any) -> bool:
    """Return whether numba can compile a function for a signature; the answer is cached."""
    if not isinstance(dispatcher._cache, _Cache):
        dispatcher._cache = _Cache(dispatcher)
    cache = dispatcher._cache
    codegen = dispatcher.targetctx.codegen()
    if cache.read(signature, codegen) == _DOES_NOT_COMPILE:
        return False
    try:
        dispatcher.compile(signature)
    except NumbaError:
        cache.write(signature, codegen, lambda: _DOES_NOT_COMPILE)
        return False
    return True


class _Cache(NullCache):
    """Cache of a dispatcher: a file of compiled code for each signature."""

    def __init__(self, dispatcher: Dispatcher) -> None:
        """Create the cache of a dispatcher."""
        self._dispatcher = dispatcher
        # fingerprints for which signatures were compiled in this process
        self.compiled_as: set[str] = set()

    def load_overload(self, signature: Any, target_context: Any) -> Any:
        """Return compiled code from the disk, or None."""
        target_context.refresh()
        try:
            self.compiled_as.add(_Walk().of_dispatcher(self._dispatcher))
        except _UnknownError:
            return None
        payload = self.read(signature, target_context.codegen())
        if payload is None or payload == _DOES_NOT_COMPILE:
            return None
        return CompileResult._rebuild(target_context, *payload)

    def save_overload(self, signature: Any, result: Any) -> None:
        """Store compiled code on disk, if possible."""
        place = self._place
        if place is not None and place.check_cachable(result):
            self.write(signature, result.codegen, lambda: place.reduce(result))

    @property
    def cache_path(self) -> str | None:
        """Directory of the cache."""
        return None if self._place is None else self._place.locator.get_cache_path()

    @functools.cached_property
    def _place(self) -> CompileResultCacheImpl | None:
        """Return what knows numba's directory for the function; None if there is none."""
        try:
            return CompileResultCacheImpl(self._dispatcher.py_func)
        except (RuntimeError, OSError, TypeError) as error:
            logger.debug("not kept on disk: %s", error)
            return None

    def _path(self, signature: Any, codegen: Any, to_write: bool) -> Path | None:
        """Return the file for a signature."""
        if self._place is None:
            return None
        walk = _Walk()
        try:
            known = [walk.of_dispatcher(self._dispatcher), walk.of_signature(signature)]
        except _UnknownError as unknown:
            logger.debug("%r is not kept on disk: %s", self._dispatcher, unknown)
            return None
        if to_write and walk.outdated:
            logger.debug("not kept on disk, as globals have changed since: %s", walk.outdated)
            return None
        name = f"{self._name}.{_digest([*known, repr(codegen.magic_tuple())])}.fenicsmpm"
        return Path(self._place.locator.get_cache_path(), name)

    @property
    def _name(self) -> str:
        function = self._dispatcher.py_func
        module = Path(function.__code__.co_filename).stem
        return f"{module}.{function.__qualname__}".replace("<", "").replace(">", "")[:150]

    def read(self, signature: Any, codegen: Any) -> Any:
        """Return what was stored for a signature, or None."""
        path = self._path(signature, codegen, to_write=False)
        if path is None:
            return None
        try:
            content = path.read_bytes()
            os.utime(path)  # so that it is not removed as one of the oldest
        except OSError:
            return None
        check, data = content[:32], content[32:]
        if hashlib.sha256(data).digest() != check:
            logger.debug("damaged file, compiled anew: %s", path)
            return None
        # the check guards against other reasons for which this would fail
        return pickle.loads(data)

    def write(self, signature: Any, codegen: Any, payload: Callable[[], Any]) -> None:
        """Store something for a signature; other processes see all of it or nothing."""
        path = self._path(signature, codegen, to_write=True)
        if path is None:
            return
        data = dumps(payload())
        draft = path.with_name(f"{path.name}.{secrets.token_hex(8)}.tmp")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            draft.write_bytes(hashlib.sha256(data).digest() + data)
            os.replace(draft, path)
            self._remove_oldest(path.parent)
        except OSError as error:
            logger.debug("not kept on disk: %s", error)
            draft.unlink(missing_ok=True)

    def _remove_oldest(self, directory: Path) -> None:
        files = [
            (entry.stat().st_mtime, entry.path)
            for entry in os.scandir(directory)
            if entry.name.startswith(f"{self._name}.") and entry.name.endswith(".fenicsmpm")
        ]
        for _, path in sorted(files, reverse=True)[_MOST:]:
            Path(path).unlink(missing_ok=True)


# --- references of a function --------------------------------------------------------------------


class _UnknownError(Exception):
    """Error for objects that may differ in another process."""


def _digest(parts: Iterable[str]) -> str:
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:40]


def _is_known(name: str | None) -> bool:
    """Return whether a module is identified by our list of versions."""
    return name is not None and name.partition(".")[0] in _KNOWN


class _Walk:
    """Fingerprints of functions and everything that they refer to.

    Attributes:
        outdated: Compiled functions that were compiled when they referred to something else.
    """

    def __init__(self) -> None:
        """Start without any fingerprint."""
        self._functions: dict[int, str] = {}
        self.outdated: list[Dispatcher] = []

    def of_dispatcher(self, dispatcher: Dispatcher) -> str:
        """Return the fingerprint of a compiled function."""
        if id(dispatcher) in self._functions:
            return self._functions[id(dispatcher)]
        self._functions[id(dispatcher)] = _RECURSION
        options = self._of((dispatcher.targetoptions, dispatcher.locals))
        result = _digest([self._of_function(dispatcher.py_func), options, *_VERSIONS])
        self._functions[id(dispatcher)] = result
        cache = dispatcher._cache
        if isinstance(cache, FunctionCache):
            # It may contain code compiled with functions that have changed since.
            if dispatcher.overloads:
                raise _UnknownError(f"{dispatcher} was in the cache of numba")
            dispatcher._cache = _Cache(dispatcher)
        elif isinstance(cache, _Cache) and dispatcher.overloads and cache.compiled_as != {result}:
            self.outdated.append(dispatcher)
        return result

    def of_signature(self, signature: Any) -> str:
        """Return a text that identifies the types of arguments."""
        arguments, returned = normalize_signature(signature)
        return self._of((*arguments, returned))

    def _of_function(self, function: types.FunctionType) -> str:
        if id(function) in self._functions:
            return self._functions[id(function)]
        self._functions[id(function)] = _RECURSION
        code, names = function.__code__, _global_names(function.__code__)
        parts = [_of_code(code), self._of((function.__defaults__, function.__kwdefaults__))]
        for name, cell in zip(code.co_freevars, function.__closure__ or (), strict=True):
            try:
                value = cell.cell_contents
            except ValueError:
                raise _UnknownError(f"{name} of {function} has no value yet") from None
            parts.append(self._of_variable(name, value, code))
        for name in names:
            if name in function.__globals__:
                parts.append(self._of_variable(name, function.__globals__[name], code))
        self._functions[id(function)] = _digest(parts)
        return self._functions[id(function)]

    def _of_variable(self, name: str, value: Any, code: types.CodeType) -> str:
        """Return the text of a variable; for a module, of all that the code could use of it."""
        if not isinstance(value, types.ModuleType):
            return f"{name} = {self._of(value)}"
        parts = [f"{name} = {value.__name__}"]
        if not _is_known(value.__name__):
            for attribute in _attribute_names(code) & vars(value).keys():
                parts.append(self._of_variable(attribute, vars(value)[attribute], code))
        return _digest(sorted(parts))

    def _of(self, value: Any) -> str:
        kind = type(value)
        if value is None or isinstance(
            value, bool | int | float | complex | str | bytes | np.generic | np.dtype | np.ufunc
        ):
            return f"{kind.__module__}.{kind.__qualname__} {value!r}"
        if isinstance(value, tuple | list):
            return f"{kind.__qualname__} [{', '.join(self._of(each) for each in value)}]"
        if isinstance(value, set | frozenset):
            return f"set {sorted(self._of(each) for each in value)}"
        if isinstance(value, dict):
            return f"dict {sorted((self._of(k), self._of(v)) for k, v in value.items())}"
        if isinstance(value, np.ndarray) and not value.dtype.hasobject:
            numbers = hashlib.sha256(value.tobytes()).hexdigest()
            return f"array {value.dtype!r} {value.shape} {value.flags.writeable} {numbers}"
        if isinstance(value, Dispatcher):
            return self.of_dispatcher(value)
        if isinstance(value, Type):
            return self._of_type(value)
        if isinstance(value, enum.Enum):
            return f"{kind.__qualname__} {value.name} {self._of(value.value)}"
        module = getattr(value, "__module__", None)
        if _is_known(module):
            return f"{module} {getattr(value, '__qualname__', kind.__qualname__)}"
        if isinstance(value, types.FunctionType):
            return self._of_function(value)
        if isinstance(value, type):
            members = list(value) if issubclass(value, enum.Enum) else ()
            fields = getattr(value, "_fields", ())
            return f"class {module} {value.__qualname__} {fields} {self._of(members)}"
        if _is_known(kind.__module__) and module is not None:
            # numba's own extensions, such as an intrinsic
            return f"{value!r} {self._of(getattr(value, '__wrapped__', None))} {_sources(module)}"
        raise _UnknownError(f"{value!r} is no constant")

    def _of_type(self, value: Type) -> str:
        if isinstance(value, BaseTuple):
            fields, each = getattr(value, "fields", ()), [self._of(t) for t in value.types]
            return f"{value.name} {fields} {each}"
        if isinstance(value, CallableType):
            raise _UnknownError(f"{value} is a type of one process")
        module = type(value).__module__
        return f"{value}" if _is_known(module) else f"{value} {_sources(module)}"


@functools.cache
def _of_code(code: types.CodeType) -> str:
    """Return a text that identifies bytecode and constants, but not the place in a file."""
    constants = [
        _of_code(c) if isinstance(c, types.CodeType) else f"{type(c)} {_ordered(c)}"
        for c in code.co_consts
    ]
    arguments = (code.co_argcount, code.co_posonlyargcount, code.co_kwonlyargcount, code.co_flags)
    names = (code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars)
    return _digest([code.co_code.hex(), repr(arguments), repr(names), *constants])


def _ordered(constant: Any) -> str:
    """Return the text of a constant, the same in each process."""
    if isinstance(constant, frozenset):
        return repr(sorted(map(repr, constant)))
    if isinstance(constant, tuple):
        return repr([(type(each).__name__, _ordered(each)) for each in constant])
    return repr(constant)


@functools.cache
def _nested(code: types.CodeType) -> tuple[types.CodeType, ...]:
    """Return code and the code of inner functions."""
    inner = [_nested(c) for c in code.co_consts if isinstance(c, types.CodeType)]
    return (code, *itertools.chain(*inner))


@functools.cache
def _global_names(code: types.CodeType) -> list[str]:
    """Return the names that are looked up in globals, sorted."""
    instructions = itertools.chain(*(dis.get_instructions(each) for each in _nested(code)))
    loads = ("LOAD_GLOBAL", "LOAD_NAME")
    return sorted({each.argval for each in instructions if each.opname in loads})


@functools.cache
def _attribute_names(code: types.CodeType) -> set[str]:
    """Return names that include those of all attributes."""
    return {name for each in _nested(code) for name in each.co_names}


@functools.cache
def _sources(module: str) -> str:
    """Return a text that identifies the sources of a module and of others in its package."""
    loaded = sys.modules.get(module)
    path = Path(getattr(loaded, "__file__", None) or "")
    if not path.is_file():
        raise _UnknownError(f"module {module} has no file")
    in_package = bool(getattr(loaded, "__package__", ""))
    files = sorted(path.parent.glob("*.py")) if in_package else [path]
    return _digest(hashlib.sha256(file.read_bytes()).hexdigest() for file in files)
