"""The failsafe table as a page of the manual. ``docs/failsafe.md`` holds it; a test keeps that file current."""

from __future__ import annotations

from deploy.events import Action
from deploy.failsafe import FIXED, TABLE, Situation

WORDS = {
    Action.NOTE: "write down",
    Action.WARN: "warn",
    Action.RETIME: "re-time",
    Action.REPLAN: "replan",
    Action.REPLAN_WITHOUT: "replan without it",
    Action.HOLD: "hold",
    Action.DIVERT: "divert to the nearest site",
    Action.LAND_HERE: "land here",
    Action.TEAM_RECOVERY: "bring everybody down",
    Action.STOP_MOTORS: "stop motors",
}
HEAD = """\
# What the supervisor does about each event

Written from `deploy/failsafe.py` by `deploy/failsafe_manual.py`; do not edit by hand.

Columns are what the vehicle is doing; *mission* is for events that concern no single vehicle. An empty cell means that
the event is only written down. A mission may change a cell with `failsafe: {event/situation: action}` or a whole row
with `failsafe: {event: action}`; a cell goes before its row. Rows marked † cannot be changed.

"""


def page() -> str:
    """The whole page, in Markdown."""
    situations = [s for s in Situation if s is not Situation.GONE]
    lines = [
        "| Event | Severity | " + " | ".join(situations) + " | Why |",
        "|" + " --- |" * (len(situations) + 3),
    ]
    for kind, row in TABLE.items():
        cells = [
            WORDS[row.actions[s]] if row.actions.get(s, Action.NOTE) is not Action.NOTE else "" for s in situations
        ]
        mark = " †" if kind in FIXED else ""
        lines.append(f"| `{kind}`{mark} | {row.severity.name.lower()} | " + " | ".join(cells) + f" | {row.why} |")
    actions = ", ".join(f"`{a.name.lower()}` ({WORDS[a]})" for a in Action)
    return HEAD + "\n".join(lines) + f"\n\nActions, mildest first: {actions}.\n"
