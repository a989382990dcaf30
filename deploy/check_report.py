"""What the checks say: rows with a verdict, bound to the problem and plan that were checked, and void after a while."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Any


class Verdict(StrEnum):
    """The result of one check; a warning is not a failure."""

    PASS = "pass"
    WARN = "warn"
    FAIL = "fail"
    NOT_RUN = "not run"


@dataclass(frozen=True, slots=True)
class CheckRow:
    """One check.

    Attributes:
        name: one of ``docs/checks.md``.
        group: what it is about: mission, plan, energy, space, chance or backend.
        verdict: its result.
        measured: the number that was judged; None where there is none.
        unit: of ``measured`` and ``limit``.
        limit: the number it was judged by (where it fails; where it warns if nothing fails); None where there is none.
        text: one sentence, and what to do unless it passed.
    """

    name: str
    group: str
    verdict: Verdict
    measured: float | None
    unit: str
    limit: float | None
    text: str


@dataclass(frozen=True, slots=True)
class CheckReport:
    """All rows.

    Attributes:
        rows: in the order of ``docs/checks.md``.
        problem_digest, plan_digest: what was checked.
        made_at_s: when, on the caller's clock.
        valid_s: how long it counts.
    """

    rows: tuple[CheckRow, ...]
    problem_digest: str
    plan_digest: str
    made_at_s: float
    valid_s: float

    @property
    def passed(self) -> bool:
        """Whether nothing failed. Warnings and checks that were not run do not fail."""
        return not self.failures

    @property
    def failures(self) -> tuple[CheckRow, ...]:
        """The rows that failed."""
        return tuple(row for row in self.rows if row.verdict is Verdict.FAIL)

    @property
    def valid_until_s(self) -> float:
        """When it expires, on the clock of ``made_at_s``."""
        return self.made_at_s + self.valid_s

    def valid_for(self, problem_digest: str, plan_digest: str, now_s: float) -> bool:
        """Whether it speaks of this very problem and plan, and still counts at ``now_s``."""
        same = (problem_digest, plan_digest) == (self.problem_digest, self.plan_digest)
        return same and self.made_at_s <= now_s < self.valid_until_s

    def row(self, name: str) -> CheckRow:
        """The row of that name.

        Raises:
            KeyError: when there is none.
        """
        for row in self.rows:
            if row.name == name:
                return row
        raise KeyError(name)

    def count(self, verdict: Verdict) -> int:
        """How many rows have this verdict."""
        return sum(row.verdict is verdict for row in self.rows)

    @property
    def summary(self) -> str:
        """One line, "14 passed, 2 warnings, 1 failed, 4 not run"."""
        passed, warned = self.count(Verdict.PASS), self.count(Verdict.WARN)
        failed, skipped = self.count(Verdict.FAIL), self.count(Verdict.NOT_RUN)
        warnings = f"{warned} warning{'' if warned == 1 else 's'}"
        return f"{passed} passed, {warnings}, {failed} failed, {skipped} not run"

    def to_json(self) -> dict[str, Any]:
        """For ``--json`` and the run folder; numbers that JSON has no word for are null."""

        def number(value: float | None) -> float | None:
            return value if value is not None and math.isfinite(value) else None

        return {
            "passed": self.passed,
            "problem_digest": self.problem_digest,
            "plan_digest": self.plan_digest,
            "made_at_s": self.made_at_s,
            "valid_s": self.valid_s,
            "rows": [
                {
                    "name": r.name,
                    "group": r.group,
                    "verdict": r.verdict.value,
                    "measured": number(r.measured),
                    "unit": r.unit,
                    "limit": number(r.limit),
                    "text": r.text,
                }
                for r in self.rows
            ],
        }


def at_least(
    name: str, group: str, measured: float, unit: str, *, warn: float, fail: float | None, text: str, remedy: str
) -> CheckRow:
    """A row that is judged by a lower limit: fails below ``fail`` (None: never), warns below ``warn``."""
    if fail is not None and measured < fail:
        verdict, limit = Verdict.FAIL, fail
    elif measured < warn:
        verdict, limit = Verdict.WARN, warn
    else:
        verdict, limit = Verdict.PASS, warn if fail is None else fail
    return CheckRow(
        name, group, verdict, measured, unit, limit, text if verdict is Verdict.PASS else f"{text}; {remedy}"
    )


def at_most(
    name: str, group: str, measured: float, unit: str, *, warn: float, fail: float | None, text: str, remedy: str
) -> CheckRow:
    """A row that is judged by an upper limit: fails above ``fail`` (None: never), warns above ``warn``."""
    if fail is not None and measured > fail:
        verdict, limit = Verdict.FAIL, fail
    elif measured > warn:
        verdict, limit = Verdict.WARN, warn
    else:
        verdict, limit = Verdict.PASS, warn if fail is None else fail
    return CheckRow(
        name, group, verdict, measured, unit, limit, text if verdict is Verdict.PASS else f"{text}; {remedy}"
    )


def not_run(name: str, group: str, why: str, unit: str = "") -> CheckRow:
    """A row that says why it was not run."""
    return CheckRow(name, group, Verdict.NOT_RUN, None, unit, None, why)
