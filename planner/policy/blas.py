"""One thread for the linear algebra library of a program that decodes plans.

Its matrices are small: more threads make a plan no faster on a quiet machine, and on a busy one they wait for one
another, up to seconds a plan.
"""

from __future__ import annotations

from functools import cache

import scipy.linalg.cython_blas  # noqa: F401  (numba takes its matrix products from there: it has to be loaded)
from threadpoolctl import threadpool_info, threadpool_limits


@cache
def one_thread() -> None:
    """From the first call on, matrix products use one thread, in the whole program.

    For good: the number belongs to the program, so plans that overlap could not give it back to one another.
    """
    threadpool_limits(limits=1, user_api="blas")


def kernels() -> str:
    """The linear algebra libraries of this program (numpy's, scipy's), and the processors that they take this one for.

    OpenBLAS can be told to take a processor for an older one (OPENBLAS_CORETYPE); plans then take longer.
    """
    found = [x for x in threadpool_info() if x["user_api"] == "blas"]
    return ", ".join(f"{x['internal_api']} {x['version']} for {x.get('architecture', 'unknown')}" for x in found)
