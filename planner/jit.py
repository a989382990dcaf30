"""Compilation of the planner's inner loops with numba: cached on disk, free of the GIL."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from contextlib import suppress
from glob import escape
from pathlib import Path
from typing import Any, TypeVar, cast

from numba import njit

F = TypeVar("F", bound=Callable[..., Any])
HERE = Path(__file__).parent
FILE = ("_cache_path", "_index_name", "_index_path", "_data_name_pattern", "_load_index")  # what numba calls them


def stamp(*folders: Path) -> str:
    """Hash of the text of all kernel files in some folders, and of how they are compiled."""
    digest = hashlib.sha256()
    for folder in folders:
        for path in [*sorted(folder.glob("*kernel*.py")), folder / "jit.py"]:
            digest.update(path.read_bytes())
    return digest.hexdigest()


def compiled(function: F, text: str, **options: Any) -> F:
    """Compiles ``function`` on its first call and keeps the machine code on disk.

    numba notices changes of a function's own file only, not of compiled functions in other files that it calls; a
    stale copy of the evaluator inside the search would plan by outdated rules. So the files that it keeps are named by
    the text of all kernel files as well. What cannot be read or written there is compiled anew.

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
    if not _bind(made._cache, text):
        return cast(F, njit(**options)(function))
    return cast(F, made)


def _bind(cache: Any, text: str) -> bool:
    """Has a numba cache keep its files by the name of ``text``; False where this numba has no such files."""
    file: Any = getattr(cache, "_cache_file", None)
    if not all(hasattr(file, name) for name in FILE):
        return False
    folder, base = Path(file._cache_path), file._index_name.removesuffix(".nbi")
    mine = f"{base}-{text[:16]}"
    file._index_name, file._data_name_pattern = f"{mine}.nbi", f"{mine}.{{number:d}}.nbc"
    file._index_path = str(folder / file._index_name)
    load, save, index = cache.load_overload, cache.save_overload, file._load_index

    def load_index() -> Any:
        try:
            return index()
        except Exception:  # a damaged file may raise anything
            return {}

    def load_overload(*given: Any) -> Any:
        try:
            return load(*given)
        except Exception:  # likewise
            return None

    def save_overload(*given: Any) -> None:
        with suppress(OSError):  # the disk is full, or not ours: the machine code is in memory
            for old in [*folder.glob(f"{escape(base)}-*.nb?"), *folder.glob(f"{escape(base)}.*nb?")]:
                if not old.name.startswith(f"{mine}."):
                    old.unlink(missing_ok=True)
            save(*given)

    file._load_index, cache.load_overload, cache.save_overload = load_index, load_overload, save_overload
    return True


_STAMP = stamp(HERE)


def jit(function: F) -> F:
    """Compiles on first call with exact arithmetic: evaluator, search."""
    return compiled(function, _STAMP)
