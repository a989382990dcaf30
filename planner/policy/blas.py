"""One thread for the linear algebra library while the network decodes.

Its matrices are small: more threads make a plan no faster on a quiet machine, and on a busy one they wait for one
another, up to seconds a plan.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, wraps
from typing import ParamSpec, TypeVar

import scipy.linalg.cython_blas  # noqa: F401  (numba takes its matrix products from there: it has to be loaded)
from threadpoolctl import ThreadpoolController

P = ParamSpec("P")
R = TypeVar("R")


@cache
def _libraries() -> ThreadpoolController:
    return ThreadpoolController()


def one_thread(function: Callable[P, R]) -> Callable[P, R]:
    """Wraps a function: while it runs, matrix products use one thread, in the whole program."""

    @wraps(function)
    def alone(*args: P.args, **kwargs: P.kwargs) -> R:
        with _libraries().limit(limits=1, user_api="blas"):
            return function(*args, **kwargs)

    return alone
