"""The ground station's error root."""

from __future__ import annotations

from pathlib import Path


class DeployError(Exception):
    """Something the user can mend; the command line prints the message alone and exits with ``exit_code``."""

    exit_code = 1


class InputError(DeployError):
    """Bad input: a file, a key in it, or an option.

    The message reads ``FILE:LINE: KEY: what is wrong (value); what to do``; parts that are not known are left out.
    """

    exit_code = 2

    def __init__(
        self, what: str, *, file: Path | str | None = None, key: str | None = None, line: int | None = None
    ) -> None:
        self.file, self.key, self.what, self.line = file, key, what, line
        where = file if line is None or file is None else f"{file}:{line}"
        super().__init__(": ".join(str(part) for part in (where, key, what) if part not in (None, "")))
