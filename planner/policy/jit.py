"""Compilation of the policy's inner loops, as ``planner.jit`` does it, bound to the policy's kernels as well."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

from numba import njit

F = TypeVar("F", bound=Callable[..., Any])

# What float arithmetic may be changed into. Infinity and not-a-number stay what they are.
FAST = {"reassoc", "contract", "arcp", "nsz"}


def _stamp() -> str:
    digest = hashlib.sha256()
    here = Path(__file__).parent
    for path in [*sorted(here.parent.glob("*kernel*.py")), *sorted(here.glob("*kernel*.py"))]:
        digest.update(path.read_bytes())
    return digest.hexdigest()


_STAMP = _stamp()


def _compiled(function: F, **options: Any) -> F:
    # Nothing calls these as C functions; without that entrance they compile in less time.
    compiled = njit(cache=True, nogil=True, error_model="numpy", **{"no_cfunc_wrapper": True, **options})(function)
    cache_file = getattr(getattr(compiled, "_cache", None), "_cache_file", None)
    if cache_file is not None and hasattr(cache_file, "_source_stamp"):
        cache_file._source_stamp = (cache_file._source_stamp, _STAMP)
    return cast(F, compiled)


def jit(function: F) -> F:
    """Compiles on first call with exact arithmetic: for times and energies."""
    return _compiled(function)


def fast_jit(function: F) -> F:
    """Compiles on first call with sums in any order: for networks."""
    return _compiled(function, fastmath=FAST)
