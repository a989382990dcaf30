"""Compilation of the policy's inner loops, as ``planner.jit`` does it, bound to the policy's kernels as well."""

from __future__ import annotations

from pathlib import Path

from planner.jit import HERE, F, compiled, stamp

# What float arithmetic may be changed into. Infinity and not-a-number stay what they are.
FAST = {"reassoc", "contract", "arcp", "nsz"}
_STAMP = stamp(HERE, Path(__file__).parent)


def jit(function: F) -> F:
    """Compiles on first call with exact arithmetic: for times and energies.

    Nothing calls these as C functions; without that entrance they compile in less time.
    """
    return compiled(function, _STAMP, no_cfunc_wrapper=True)


def inlined(function: F) -> F:
    """Makes a small function part of every one that calls it, with exact arithmetic: for innermost loops."""
    return compiled(function, _STAMP, inline="always")


def fast_jit(function: F) -> F:
    """Compiles on first call with sums in any order: for networks."""
    return compiled(function, _STAMP, no_cfunc_wrapper=True, fastmath=FAST)
