"""What the checks compare with: the ``checks`` section of ``mission.yaml``, each default with its reason."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

from annotated_types import Ge, Gt, Le

from deploy.settings import Fraction, NotNegative, Positive

Spread = Annotated[float, Ge(0), Le(0.5)]
"""A standard deviation as a share of the mean; above one half a normal factor is no model of anything."""


@dataclass(frozen=True, slots=True)
class Uncertainty:
    """What the Monte Carlo draws. Ratios are standard deviations over the mean; times are mission s.

    The defaults are cautious guesses for small multirotors and skid-steered rovers in light wind, to be replaced
    by what one's own flights show (``docs/checks.md`` says how). All of them at 0 reproduce the schedule.
    """

    uav_speed: Spread = 0.02
    """Per UAV and run: airspeed calibration and the speed lost in turns."""
    ugv_speed: Spread = 0.05
    """Per UGV and run: tyre pressure, load, battery voltage."""
    move_speed: Spread = 0.05
    """Per drive: surface, slopes, other traffic."""
    wind: Spread = 0.05
    """Steady wind, one vector per run, each component as a share of cruise speed: 0.5 m/s at 10 m/s."""
    gust: Spread = 0.05
    """Head wind of each leg on top of it, as a share of cruise speed."""
    wind_power: NotNegative = 0.2
    """Growth of cruise power per share of cruise speed blown against: the paper's power curve gains 8.5 %
    from 10 to 14 m/s, that is 0.21."""
    drain: Spread = 0.03
    """Per UAV and run: cell ageing and temperature, as a factor of all its power."""
    ugv_drain: Spread = 0.05
    """Per UGV and run: rolling resistance, as a factor of its driving power."""
    charge: Spread = 0.05
    """Per recharge: factor of the charging time."""
    departure_s: NotNegative = 2.0
    """Median delay before each departure from pad or dock (a UGV: from standstill): confirmations, arming."""
    docking_s: NotNegative = 5.0
    """Median time lost in each docking, hovering: alignment, second attempts."""
    delay_sigma: Annotated[float, Ge(0), Le(2)] = 0.8
    """Sigma of both lognormal delays: one in ten is then 2.8 times the median."""
    stalls_per_h: NotNegative = 0.02
    """Stalls of a UGV per hour of driving: one in fifty hours."""
    stall_s: NotNegative = 120.0
    """Median duration of a stall."""
    stall_sigma: Annotated[float, Ge(0), Le(2)] = 0.5
    """Sigma of its lognormal distribution."""


CERTAIN = Uncertainty(
    uav_speed=0.0,
    ugv_speed=0.0,
    move_speed=0.0,
    wind=0.0,
    gust=0.0,
    wind_power=0.0,
    drain=0.0,
    ugv_drain=0.0,
    charge=0.0,
    departure_s=0.0,
    docking_s=0.0,
    stalls_per_h=0.0,
)
"""Nothing varies: the Monte Carlo then computes the schedule itself."""


@dataclass(frozen=True, slots=True)
class CheckLimits:
    """Limits of the checks."""

    energy_margin_warn: Fraction = 0.05
    """Least energy above reserve, as a share of capacity, at every rendezvous, landing and of every UGV: below is a
    warning (the paper's UAV hovers 63 s on 5 %)."""
    energy_margin_fail: Fraction = 0.0
    """Below this the check fails. The reserve itself covers errors, so the default asks for no more than it."""
    success_probability_warn: Fraction = 0.90
    """Estimated probability that the plan ends in time with no battery empty and no replan made: below is a warning."""
    success_probability_fail: Fraction = 0.50
    """Below this the check fails: bringing everybody home would depend on replanning."""
    reserve_probability_warn: Fraction = 0.50
    """The same with no UAV below its reserve: below is a warning, never a failure, for the reserve is there to be used
    when something goes wrong, and replans mend it."""
    makespan_limit_s: Annotated[float, Gt(0)] | None = None
    """Latest allowed end of the last visit, mission s; null for no limit."""
    slack_warn_s: NotNegative = 30.0
    """Least time by which any UAV may be kept waiting at a rendezvous before it falls below reserve, mission s."""
    battery_warn: Fraction = 0.95
    """Measured charge before take-off, as a share of what the plan starts with: below is a warning."""
    battery_fail: Fraction = 0.80
    """Below this the check fails."""
    samples: Annotated[int, Ge(10), Le(100_000)] = 1000
    """Of the Monte Carlo estimate: 1,000 give the probability to 3 points."""
    validity_s: Positive = 600.0
    """Results expire after this wall-clock time, s: batteries discharge and vehicles get moved."""
    uncertainty: Uncertainty = field(default_factory=Uncertainty)
    """What the Monte Carlo draws."""

    def __post_init__(self) -> None:
        for name in ("energy_margin", "success_probability", "battery"):
            warn, fail = getattr(self, f"{name}_warn"), getattr(self, f"{name}_fail")
            if fail > warn:
                raise ValueError(
                    f"{name}_fail ({fail:g}) is above {name}_warn ({warn:g}); a failure is worse than a warning"
                )
