"""Compilation of the planner's inner loops with numba: cached on disk, free of the GIL."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

from numba import njit

F = TypeVar("F", bound=Callable[..., Any])
HERE = Path(__file__).parent
VERSION = "_version"  # where numba keeps the version that a cache has to have been written by


def stamp(*folders: Path) -> str:
    """Hash of the text of all kernel files in some folders."""
    digest = hashlib.sha256()
    for path in (path for folder in folders for path in sorted(folder.glob("*kernel*.py"))):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def compiled(function: F, text: str, **options: Any) -> F:
    """Compiles ``function`` on its first call and keeps the machine code on disk.

    numba notices changes of a function's own file only, not of compiled functions in other files that it calls; a
    stale copy of the evaluator inside the search would plan by outdated rules. So the cache is bound to the text of all
    kernel files as well, beside numba's version: of a cache with another one nothing more is read, and it may name
    classes that are not there any more.

    Args:
        function: what to compile.
        text: ``stamp`` of all files whose functions it may call.
        options: of ``numba.njit``.
    """
    options = {"nogil": True, "error_model": "numpy", **options}
    try:
        made = njit(cache=True, **options)(function)
    except RuntimeError:  # there is no place to keep anything
        return cast(F, njit(**options)(function))
    if made is function:  # numba is switched off
        return function
    file = getattr(made._cache, "_cache_file", None)
    if not hasattr(file, VERSION):  # a numba that keeps machine code in another way: better none than a stale one
        return cast(F, njit(**options)(function))
    setattr(file, VERSION, f"{getattr(file, VERSION)} {text}")
    return cast(F, made)


_STAMP = stamp(HERE)


def jit(function: F) -> F:
    """Compiles on first call with exact arithmetic: evaluator, search."""
    return compiled(function, _STAMP)
