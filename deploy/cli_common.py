"""What every command does alike: exit codes, errors without tracebacks, JSON for machines."""

from __future__ import annotations

import functools
import json
import math
import os
import shutil
import signal
import sys
import textwrap
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from types import FrameType
from typing import Any, ParamSpec

import typer
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from deploy.display import SteadyConsole
from deploy.errors import DeployError
from deploy.screen import clock_text
from drivers.errors import DriverError
from planner.errors import PlannerError
from sim_backends.errors import SimulationError

DONE, FAILED, BAD_INPUT, ABORTED = 0, 1, 2, 3
"""Exit codes: done or passed; the mission or a check failed; bad input; aborted by the operator."""

P = ParamSpec("P")


def guarded(command: Callable[P, int]) -> Callable[P, None]:
    """Turns a command's result into the exit code, and everything a user can cause into one line on standard error.

    With ``--json`` the error is a JSON object on standard output as well.
    """

    @functools.wraps(command)
    def run(*args: P.args, **kwargs: P.kwargs) -> None:
        code, message = BAD_INPUT, None
        try:
            code = command(*args, **kwargs)
        except KeyboardInterrupt:
            code, message = ABORTED, "aborted by the operator"
        except BrokenPipeError:
            # whoever read standard output has gone; what was asked for went as far as they cared
            code = DONE
        except DeployError as error:
            code, message = error.exit_code, str(error)
        except (PlannerError, SimulationError) as error:
            message = str(error)
        except DriverError as error:
            code, message = FAILED, str(error)
        except OSError as error:
            message = f"{error.filename}: {error.strerror}" if error.filename else str(error.strerror or error)
        except MemoryError:
            code, message = FAILED, "not enough memory; close other programs or plan a smaller mission"
        if message is not None:
            _say_error(message, code, as_json=bool(kwargs.get("as_json")))
        _flush()
        raise typer.Exit(code)

    return run


@contextmanager
def orderly_end() -> Iterator[None]:
    """Makes the end of the terminal or of the service (SIGHUP, SIGTERM) one that closes links and ends children.

    An interrupt (SIGINT) counts too where a shell has switched it off, as it does for what a script starts with `&`.

    In flight the operator's own handlers take over: everybody comes down first.
    """

    def end(number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.signal(number, end) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _say_error(message: str, code: int, *, as_json: bool) -> None:
    try:
        print(f"error: {message}" if code != ABORTED else message, file=sys.stderr)
        if as_json:
            print_json({"error": message, "exit_code": code})
    except OSError:
        pass  # nobody is left to be told


def _flush() -> None:
    """Writes out standard output now, so that a closed pipe shows here and not in the interpreter's exit."""
    try:
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def print_json(value: Mapping[str, Any]) -> None:
    """One JSON object on standard output; numbers that JSON has no word for are null."""
    print(json.dumps(finite(value), indent=2))


def finite(value: Any) -> Any:
    """``value`` with every number that is not finite as None, in mappings and lists too."""
    if isinstance(value, Mapping):
        return {str(key): finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


@contextmanager
def working(text: str, *, quiet: bool = False) -> Iterator[None]:
    """Shows that something long is going on, on standard error and only where that is a terminal."""
    console = SteadyConsole(stderr=True)
    if quiet or not console.is_terminal:
        yield
        return
    columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as progress:
        progress.add_task(text, total=None)
        yield


def duration_text(seconds: float | None) -> str:
    """A duration for people: h:mm:ss; a dash where there is none."""
    return "-" if seconds is None or not math.isfinite(seconds) else clock_text(seconds)


def show_rows(rows: Iterable[tuple[str, str]]) -> None:
    """Names and values, one a line, for people and ``grep``; in a terminal, long words go on below their beginning."""
    rows = list(rows)
    width = max(len(name) for name, _ in rows)
    room = max(20, shutil.get_terminal_size().columns - width - 2) if sys.stdout.isatty() else sys.maxsize
    for name, value in rows:
        lines = textwrap.wrap(value, room, break_long_words=False, break_on_hyphens=False) or [""]
        print(f"{name:<{width}}  {lines[0]}")
        for line in lines[1:]:
            print(f"{'':<{width}}  {line}")
