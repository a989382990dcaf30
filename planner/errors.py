"""The planner's error root."""

import sys
from collections.abc import Callable


class PlannerError(ValueError):
    """A problem, plan or planner setting is wrong; the message says what, where and what to do."""


def exit_on_error(main: Callable[[], None]) -> None:
    """Runs a command line; what its user caused is one line on standard error and exit code 2."""
    try:
        main()
    except PlannerError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
