"""The decorator that compiles the inner loops with numba, and the cache of its results.

Why numba: `docs/decisions/0010-numba.md`. numba keeps what it has compiled on disk, but checks for changes only in the
file of the function itself, although functions and constants of other files are compiled in with it. Here the cache of
a function is valid for one digest: that of the source of its module, of all modules of the same top-level package that
this module imports, directly or not, and of the versions of numba and numpy. There is one file per function and Python
version; a new result overwrites the outdated one, so that nothing accumulates and nothing has to be deleted by hand.

The files lie in `__pycache__` beside the source, in the user's cache folder where that is read-only, or where
`NUMBA_CACHE_DIR` says; where none of them can be written, each process compiles again.
"""

from __future__ import annotations

import ast
import contextlib
import hashlib
import inspect
import pickle
import sys
from collections.abc import Callable
from functools import cache
from typing import Any, TypeVar

import numba
import numba.core.caching
import numpy as np

F = TypeVar("F", bound=Callable[..., Any])


def compiled(function: F) -> F:
    """Compile with numba; keep the result on disk for the next process where there is a place for it."""
    dispatcher: Any = numba.njit(error_model="numpy")(function)
    with contextlib.suppress(RuntimeError, OSError):  # no folder that can be written to, or no source to be read
        dispatcher._cache = _source_keyed_cache(function)
    result: F = dispatcher
    return result


def _source_keyed_cache(function: Callable[..., Any]) -> Any:
    """Numba's cache of one function, its index valid for one `source_digest` instead of one state of a file."""
    caching: Any = numba.core.caching  # publishes no types
    kept = caching.FunctionCache(function)
    python = f"py{sys.version_info.major}{sys.version_info.minor}"
    file = caching.IndexDataCacheFile(
        cache_path=kept.cache_path,
        filename_base=f"{function.__module__.rpartition('.')[2]}.{function.__qualname__}.{python}",
        source_stamp=source_digest(function.__module__),
    )
    file._load_index = _forgiving(file._load_index)
    kept._cache_file = file
    return kept


def _forgiving(load_index: Callable[[], dict[Any, str]]) -> Callable[[], dict[Any, str]]:
    """The index of a cache; empty where it names types that are gone: numba reads those before the stamp."""

    def load() -> dict[Any, str]:
        try:
            return load_index()
        except (AttributeError, ImportError, EOFError, pickle.UnpicklingError):
            return {}

    return load


def source_digest(module: str) -> str:
    """Hash of all that can be compiled into a function of this module, and of the compiler's versions.

    Raises OSError where a module has no source.
    """
    digest = hashlib.sha256(f"numba {numba.__version__} numpy {np.__version__}".encode())
    sources = {__name__: inspect.getsource(sys.modules[__name__])}
    _collect_sources(module, sources)
    for name in sorted(sources):
        digest.update(f"\n{name}\n{sources[name]}".encode())
    return digest.hexdigest()


def _collect_sources(module: str, sources: dict[str, str]) -> None:
    """Add the source of this module and of those that it imports from its own top-level package."""
    if module in sources or module not in sys.modules:  # what was not imported can't be compiled in
        return
    sources[module] = inspect.getsource(sys.modules[module])
    top = module.partition(".")[0]
    for name in _imported_names(module, sources[module], hasattr(sys.modules[module], "__path__")):
        if name.partition(".")[0] == top:
            _collect_sources(name, sources)


@cache
def _imported_names(module: str, source: str, is_package: bool) -> tuple[str, ...]:
    """Full names of what a module imports; an imported name may be a module or something in one: both are given.

    Kept: parsing all of them again for each compiled function was a third of the time to import the diagnosis.
    """
    names: list[str] = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                package = module.split(".") if is_package else module.split(".")[:-1]
                base = ".".join([*package[: len(package) - node.level + 1], *([base] if base else [])])
            names += [base, *(f"{base}.{alias.name}" for alias in node.names)]
    return tuple(names)


def entry_point(function: F) -> F:
    """A compiled function as Python calls it: the types of its arguments are determined once, at the first call.

    numba determines them at every call, which takes microseconds for each NamedTuple. Callers must always pass the same
    types (mypy checks all but the arrays' layout: contiguous, C order). Compiled code calls the function itself.
    """
    compile_for: Callable[..., Any] | None = getattr(function, "compile", None)
    if compile_for is None:  # numba is switched off, for debugging
        return function
    typeof: Any = numba.typeof
    entry: Callable[..., Any] | None = None

    def call(*arguments: Any) -> Any:
        nonlocal entry
        if entry is None:
            entry = compile_for(tuple(typeof(argument) for argument in arguments))
        return entry(*arguments)

    result: Any = call
    typed: F = result
    return typed
