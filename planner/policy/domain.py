"""What a network has seen in training, and what of a problem lies outside of it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from planner.errors import PlannerError
from planner.policy.batches import Pool
from planner.policy.features_kernel import N_PAIR, N_SITE, N_TASK, N_UAV, N_UGV, Singles, View

SLACK = 0.25  # of the range seen, on either side
LEAST = 0.05  # and at least that much

# Names of the features, as ``features_kernel.fill_view`` fills them in.
NAMES: Mapping[str, tuple[str, ...]] = {
    "task": (
        "x", "y", "distance", "distance to the nearest site", "energy to spare after the visit", "visit offered",
        "lead of another UAV", "UAVs that are there first", "nearest other task", "second nearest other task",
        "tasks near", "tasks around", "energy to spare back at a UGV", "end of the visit",
        "in its outlined route", "place in that route", "first in another UAV's route",
    ),
    "site": (
        "x", "y", "distance", "energy to spare on arrival", "meeting offered", "soonest UGV", "least wait",
        "UGVs present", "nearest task", "tasks near", "tasks around", "depot",
    ),
    "uav": (
        "x", "y", "distance", "energy", "ready", "distance to the nearest site", "acts now", "speed", "range",
        "tasks for each UAV", "power when waiting", "service time", "nearest task", "full", "tasks left", "UAVs",
        "behind the latest", "meetings in a row", "before the makespan", "done offered", "last task",
        "end of its outlined route", "charges that route lacks", "tasks of that route", "ahead of the outlined end",
    ),
    "ugv": (
        "x", "y", "distance", "there", "free to leave", "driving time left", "charges left", "speed", "charging time",
        "docking time", "first dock free", "second dock free", "on the road", "docks",
    ),
    "pair": (
        "meeting offered", "flight", "drive", "UGV there", "UAV's wait", "UGV's wait", "end", "energy on docking",
        "at the UGV's place", "charging time", "driving time left",
    ),
}  # fmt: skip
assert [len(x) for x in NAMES.values()] == [N_TASK, N_SITE, N_UAV, N_UGV, N_PAIR]


def _rows(view: View | Pool, counts: Singles | Any, k: int | None = None) -> dict[str, Singles]:
    """The rows of each kind that are filled in, (rows, features)."""
    m, s, u, g = (int(x) for x in counts[:4])
    whole = {"task": view.task, "site": view.site, "uav": view.uav, "ugv": view.ugv, "pair": view.pair}
    one = whole if k is None else {name: x[k] for name, x in whole.items()}
    return {
        "task": one["task"][:m],
        "site": one["site"][:s],
        "uav": one["uav"][:u],
        "ugv": one["ugv"][:g],
        "pair": one["pair"][:g, :s].reshape(-1, N_PAIR),
    }


@dataclass(frozen=True, slots=True)
class Domain:
    """Least and largest value of every feature, (features,) for each kind of row."""

    least: Mapping[str, Singles]
    most: Mapping[str, Singles]

    @classmethod
    def of(cls, pools: Iterable[Pool]) -> Domain:
        """What is seen in some decisions.

        Raises:
            PlannerError: where there are none.
        """
        least = {name: np.full(len(names), np.inf, np.float32) for name, names in NAMES.items()}
        most = {name: np.full(len(names), -np.inf, np.float32) for name, names in NAMES.items()}
        n = 0
        for pool in pools:
            for k, counts in enumerate(pool.counts):
                n += 1
                for name, rows in _rows(pool, counts, k).items():
                    if len(rows):
                        np.minimum(least[name], rows.min(axis=0), out=least[name])
                        np.maximum(most[name], rows.max(axis=0), out=most[name])
        if n == 0:
            raise PlannerError("there are no decisions to tell a network's domain from")
        return cls(least, most)

    def outside(self, view: View) -> str | None:
        """The feature of a decision that is furthest from what was seen, in words; None where all is within reach."""
        worst, what = 0.0, None
        for name, rows in _rows(view, view.counts).items():
            if not len(rows):
                continue
            low, high = self.least[name], self.most[name]
            room = np.maximum(LEAST, SLACK * (high - low))
            excess = np.maximum(low - rows.min(axis=0), rows.max(axis=0) - high) / room
            k = int(excess.argmax())
            if excess[k] > max(1.0, worst):
                worst = float(excess[k])
                low_k, high_k = float(low[k]), float(high[k])
                value = float(rows[:, k].max() if rows[:, k].max() > high_k else rows[:, k].min())
                what = f"{name}: {NAMES[name][k]} is {value:.2f}, trained on {low_k:.2f} to {high_k:.2f}"
        return what

    def to_json(self) -> dict[str, Any]:
        """A JSON object."""
        return {
            name: [[float(np.float32(round(float(x), 4))) for x in side[name]] for side in (self.least, self.most)]
            for name in NAMES
        }

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Domain:
        """Reads ``to_json``'s object.

        Raises:
            PlannerError: where it is not one.
        """
        try:
            sides = {name: np.array(data[name], dtype=np.float32) for name in NAMES}
        except (KeyError, TypeError, ValueError) as error:
            raise PlannerError(f"a network's domain is incomplete: {error!r}") from error
        for name, names in NAMES.items():
            if sides[name].shape != (2, len(names)):
                raise PlannerError(f"a network's domain: {name} is {sides[name].shape}; it should be (2, {len(names)})")
        return cls({k: v[0] for k, v in sides.items()}, {k: v[1] for k, v in sides.items()})
