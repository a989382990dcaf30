"""Compilation of the planner's inner loops with numba: cached on disk, free of the GIL."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

from numba import njit

F = TypeVar("F", bound=Callable[..., Any])


def _stamp() -> str:
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parent.glob("*kernel*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()


_STAMP = _stamp()


def jit(function: F) -> F:
    """Compiles ``function`` on its first call and keeps the machine code on disk.

    numba notices changes of a function's own file only, not of compiled functions in other files that it calls; a
    stale copy of the evaluator inside the search would plan by outdated rules. So the cache is bound to the text of all
    kernel files as well.
    """
    compiled = njit(cache=True, nogil=True, error_model="numpy")(function)
    cache_file = getattr(getattr(compiled, "_cache", None), "_cache_file", None)
    if cache_file is not None and hasattr(cache_file, "_source_stamp"):
        cache_file._source_stamp = (cache_file._source_stamp, _STAMP)
    return cast(F, compiled)
