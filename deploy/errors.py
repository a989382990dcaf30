"""The ground station's error root."""

from __future__ import annotations

from pathlib import Path


class DeployError(Exception):
    """Something the user can mend; the command line prints the message alone and exits with ``exit_code``."""

    exit_code = 1


class InputError(DeployError):
    """Bad input: a file, a key in it, or an option.

    The message reads ``FILE: KEY: what is wrong (value); what to do``.
    """

    exit_code = 2

    def __init__(self, what: str, *, file: Path | str | None = None, key: str | None = None) -> None:
        self.file, self.key, self.what = file, key, what
        super().__init__(": ".join(str(part) for part in (file, key, what) if part not in (None, "")))
