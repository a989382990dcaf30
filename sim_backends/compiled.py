"""Numba's ``njit`` with a type that strict checking accepts."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., Any])


def compiled(function: F) -> F:
    """Compiles ``function`` on its first call and keeps the result on disk."""
    return cast(F, numba.njit(cache=True, error_model="numpy")(function))
