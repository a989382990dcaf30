"""Compilation of the planner's inner loops with numba: cached on disk, free of the GIL."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

from numba import njit

F = TypeVar("F", bound=Callable[..., Any])
HERE = Path(__file__).parent


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
    made = njit(cache=True, nogil=True, error_model="numpy", **options)(function)
    cache_file = getattr(getattr(made, "_cache", None), "_cache_file", None)
    if cache_file is not None and hasattr(cache_file, "_version"):
        cache_file._version = f"{cache_file._version} {text}"
    return cast(F, made)


_STAMP = stamp(HERE)


def jit(function: F) -> F:
    """Compiles on first call with exact arithmetic: evaluator, search."""
    return compiled(function, _STAMP)
