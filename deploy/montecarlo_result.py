"""What the Monte Carlo says: shares with intervals, quantiles, margins, and what most often goes wrong."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
_Z95 = 1.959963984540054


@dataclass(frozen=True, slots=True)
class Share:
    """A probability estimated from ``count`` of ``samples``, with its Wilson 95 % interval.

    Source: Wilson, Probable inference, the law of succession, and statistical inference, 1927.
    """

    count: int
    samples: int

    @property
    def estimate(self) -> float:
        """The share itself."""
        return self.count / self.samples

    @property
    def interval(self) -> tuple[float, float]:
        """Lower and upper bound; unlike the textbook interval it is not empty at 0 and 1."""
        n, p = self.samples, self.estimate
        centre = (p + _Z95**2 / (2 * n)) / (1 + _Z95**2 / n)
        half = _Z95 / (1 + _Z95**2 / n) * math.sqrt(p * (1 - p) / n + _Z95**2 / (4 * n * n))
        return max(0.0, centre - half), min(1.0, centre + half)


@dataclass(frozen=True, slots=True)
class Spread:
    """Quantiles of a sampled number."""

    p5: float
    p50: float
    p95: float

    @classmethod
    def of(cls, values: Floats) -> Spread:
        """Of ``values`` (S,)."""
        return cls(*(float(q) for q in np.quantile(values, (0.05, 0.5, 0.95))))


@dataclass(frozen=True, slots=True)
class Margin:
    """Energy above reserve at one rendezvous, or at the landing after the last action.

    Attributes:
        where: in words, "uav1 at its 2nd rendezvous (ugv0)".
        action: index of the recharge in the plan; None for the landing.
        uav: index of the UAV.
        spread_j: quantiles of the margin, J.
        below: share of samples below reserve.
    """

    where: str
    action: int | None
    uav: int
    spread_j: Spread
    below: Share


@dataclass(frozen=True, slots=True)
class Estimate:
    """What the Monte Carlo says about a plan.

    Attributes:
        success: every task visited in time with no battery ever empty.
        success_reserve: the same with no UAV ever below its reserve.
        makespan_s: as flown, failed samples included (they are propagated as if they had gone on).
        margins: per rendezvous in the plan's order, then per landing.
        causes: first failures with an empty battery (or late) in words, most frequent first, with their shares.
        causes_reserve: the same for failures below reserve.
    """

    success: Share
    success_reserve: Share
    makespan_s: Spread
    margins: tuple[Margin, ...]
    causes: tuple[tuple[str, float], ...]
    causes_reserve: tuple[tuple[str, float], ...]

    @property
    def cause(self) -> str | None:
        """The most frequent failure in words, "uav1 at its 2nd rendezvous (ugv0), 7 %"; None where there is none."""
        for causes in (self.causes, self.causes_reserve):
            if causes:
                return f"{causes[0][0]}, {100 * causes[0][1]:.3g} %"
        return None
