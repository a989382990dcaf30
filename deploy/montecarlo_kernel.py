"""The compiled inner loop of the Monte Carlo: ``planner.kernel.run`` over sampled speeds, winds, drains and delays.

The order of the arithmetic is that of ``planner.kernel.run``, so that without any uncertainty both give the same
numbers; a test holds them together.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from planner import kernel as k
from planner.jit import jit

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

MIN_SHARE = 0.2
"""No draw makes a vehicle slower than this share of its speed: the tails of a normal factor mean nothing there."""
EPS_J = 1e-6

# entries of `par`, (15,)
(
    UAV_SPEED,
    UGV_SPEED,
    MOVE_SPEED,
    WIND,
    GUST,
    WIND_POWER,
    DRAIN,
    UGV_DRAIN,
    CHARGE,
    DEPARTURE_S,
    DOCKING_S,
    DELAY_SIGMA,
    STALLS_PER_S,
    STALL_S,
    STALL_SIGMA,
) = range(15)
# layers of `z_act`, (5, S, n + U): standard normals per action and, behind them, per recovery
Z_SPEED, Z_CHARGE, Z_DEPART, Z_DOCK, Z_LEAVE = range(5)
# columns of `over`, (U, 3)
OVER_LEG, OVER_DOWN, OVER_UP = range(3)
# first failure of a sample: an action's index, else n + ...
NO_FAILURE = -1


@jit
def _factor(spread: float, z: float) -> float:
    return max(MIN_SHARE, 1.0 + spread * z)


@jit
def _leg(
    metres: float,
    dx: float,
    dy: float,
    wx: float,
    wy: float,
    gust: float,
    speed: float,
    factor: float,
    over_s: float,
    wind_power: float,
) -> tuple[float, float]:
    """Duration in s of a straight flight, and the factor of its power."""
    if metres <= 0.0:
        return 0.0, 1.0
    head = gust - (wx * dx + wy * dy)
    share = max(MIN_SHARE, factor - head)
    return metres / (speed * share) + over_s, 1.0 + wind_power * max(0.0, head)


@jit
def propagate(
    acts: k.Codes,  # (n,), as planner.kernel packs them
    legs: Floats,  # (n + U, 3) metres and unit vector of each flight; behind the actions the recoveries
    drives: Floats,  # (n,) metres of each drive
    first: NDArray[np.uint8],  # (n + U,) 1 where the flight is the UAV's first, from its pad
    on_pad: NDArray[np.uint8],  # (U,) 1 where the last stop is a landing place already: no recovery flight
    uavs: Floats,
    ugvs: Floats,
    docks0: Floats,
    over: Floats,  # (U, 3) s per flight to a task; s of hovering within each docking and each leaving
    drive_over: Floats,  # (G,) s per drive beyond the schedule
    par: Floats,
    z_uav: Floats,  # (2, S, U) speed, drain
    z_ugv: Floats,  # (2, S, G) speed, drain
    z_wind: Floats,  # (2, S)
    z_act: Floats,
    u_stall: Floats,  # (S, n) uniform
    z_stall: Floats,  # (S, n)
    limit_s: float,
    end: Floats,  # (S, n) out: end of each action
    low: Floats,  # (S, n) out: energy at docking, at a visit's end, of the UGV at a drive's end
    land: Floats,  # (S, U) out: energy after the recovery
    makespan: Floats,  # (S,) out
    fail_zero: Ints,  # (S,) out: first failure with an empty battery, or late
    fail_reserve: Ints,  # (S,) out: first failure with a battery below reserve, or late
) -> None:
    """Runs every sample through the plan's precedences. Nothing starts by the clock.

    Failures are coded: action index ``i`` of the vehicle that acts; ``n + u`` recovery of UAV u; ``n + U + g`` UGV g
    giving energy or standing; ``n + U + G`` the makespan limit.
    """
    n_samples, n = end.shape
    n_uavs, n_ugvs, n_docks = uavs.shape[0], ugvs.shape[0], docks0.shape[1]
    us = np.empty((n_uavs, 2))
    gs = np.empty((n_ugvs, 4))
    docks = np.empty((n_ugvs, n_docks))
    for s in range(n_samples):
        wx, wy = par[WIND] * z_wind[0, s], par[WIND] * z_wind[1, s]
        for u in range(n_uavs):
            us[u, 0] = uavs[u, k.U_READY]
            us[u, 1] = uavs[u, k.U_ENERGY]
        for g in range(n_ugvs):
            gs[g, 0] = ugvs[g, k.G_READY]
            leave = ugvs[g, k.G_READY]
            for d in range(n_docks):
                docks[g, d] = docks0[g, d]
                if docks0[g, d] != np.inf:
                    leave = max(leave, docks0[g, d])
            gs[g, 1] = leave
            gs[g, 2] = 0.0
            gs[g, 3] = 0.0
        zero_t, reserve_t = np.inf, np.inf
        zero_i, reserve_i = NO_FAILURE, NO_FAILURE
        span, last = 0.0, 0.0
        for i in range(n):
            a = acts[i]
            kind, v, target = a >> k.KIND, (a >> k.VEHICLE) & k.MASK, a & k.MASK
            if kind == k.MOVE:
                drive = 0.0
                lost = 0.0
                if drives[i] > 0.0:
                    share = max(
                        MIN_SHARE,
                        1.0 + par[UGV_SPEED] * z_ugv[0, s, v] + par[MOVE_SPEED] * z_act[Z_SPEED, s, i],
                    )
                    drive = drives[i] / (ugvs[v, k.G_SPEED] * share) + drive_over[v]
                    lost = par[DEPARTURE_S] * math.exp(par[DELAY_SIGMA] * z_act[Z_DEPART, s, i])
                    if u_stall[s, i] < 1.0 - math.exp(-par[STALLS_PER_S] * drive):
                        lost += par[STALL_S] * math.exp(par[STALL_SIGMA] * z_stall[s, i])
                t1 = gs[v, 1] + lost + drive
                gs[v, 0] = t1
                gs[v, 1] = t1
                gs[v, 2] += drive
                stand = max(0.0, t1 - ugvs[v, k.G_READY] - gs[v, 2])
                watts = ugvs[v, k.G_DRIVE] * _factor(par[UGV_DRAIN], z_ugv[1, s, v])
                rest = ugvs[v, k.G_ENERGY] - watts * gs[v, 2] - ugvs[v, k.G_IDLE] * stand - gs[v, 3]
                if rest < -EPS_J:
                    if t1 < zero_t:
                        zero_t, zero_i = t1, i
                    if t1 < reserve_t:
                        reserve_t, reserve_i = t1, i
                e_low = rest
            else:
                drain = _factor(par[DRAIN], z_uav[1, s, v])
                hover_w = uavs[v, k.U_HOVER] * drain
                start, energy = us[v, 0], us[v, 1]
                if first[i] == 1:
                    start += par[DEPARTURE_S] * math.exp(par[DELAY_SIGMA] * z_act[Z_DEPART, s, i])
                fly, power = _leg(
                    legs[i, 0],
                    legs[i, 1],
                    legs[i, 2],
                    wx,
                    wy,
                    par[GUST] * z_act[Z_SPEED, s, i],
                    uavs[v, k.U_SPEED],
                    _factor(par[UAV_SPEED], z_uav[0, s, v]),
                    over[v, OVER_LEG] if kind == k.VISIT else 0.0,
                    par[WIND_POWER],
                )
                arrive = start + fly
                energy -= uavs[v, k.U_CRUISE] * drain * power * fly
                if kind == k.VISIT:
                    t1 = arrive + uavs[v, k.U_SERVICE]
                    energy -= hover_w * uavs[v, k.U_SERVICE]
                    span = max(span, t1)
                    at, e_low = t1, energy
                else:
                    g = target
                    d = 0
                    for j in range(1, n_docks):
                        if docks[g, j] < docks[g, d]:
                            d = j
                    work = max(arrive, gs[g, 0], docks[g, d])
                    energy -= uavs[v, k.U_WAIT] * drain * (work - arrive)
                    align = par[DOCKING_S] * math.exp(par[DELAY_SIGMA] * z_act[Z_DOCK, s, i])
                    energy -= hover_w * (align + over[v, OVER_DOWN])
                    at, e_low = work + align, energy
                    given = max(0.0, uavs[v, k.U_CAPACITY] - energy)
                    charge = ugvs[g, k.G_CHARGE_S]
                    if ugvs[g, k.G_CHARGE_W] > 0.0:
                        charge = given / ugvs[g, k.G_CHARGE_W]
                    charge *= _factor(par[CHARGE], z_act[Z_CHARGE, s, i])
                    # It blocks dock and UGV until it has really left.
                    leave = par[DEPARTURE_S] * math.exp(par[DELAY_SIGMA] * z_act[Z_LEAVE, s, i])
                    t1 = at + ugvs[g, k.G_DOCK] + charge + ugvs[g, k.G_UNDOCK] + leave
                    docks[g, d] = t1
                    gs[g, 1] = max(gs[g, 1], t1)
                    gs[g, 3] += given
                    energy += given - hover_w * over[v, OVER_UP]
                    stand = max(0.0, t1 - ugvs[g, k.G_READY] - gs[g, 2])
                    watts = ugvs[g, k.G_DRIVE] * _factor(par[UGV_DRAIN], z_ugv[1, s, g])
                    rest = ugvs[g, k.G_ENERGY] - watts * gs[g, 2] - ugvs[g, k.G_IDLE] * stand - gs[g, 3]
                    if rest < -EPS_J:
                        if t1 < zero_t:
                            zero_t, zero_i = t1, n + n_uavs + g
                        if t1 < reserve_t:
                            reserve_t, reserve_i = t1, n + n_uavs + g
                us[v, 0] = t1
                us[v, 1] = energy
                if e_low < -EPS_J and at < zero_t:
                    zero_t, zero_i = at, i
                if e_low < uavs[v, k.U_RESERVE] - EPS_J and at < reserve_t:
                    reserve_t, reserve_i = at, i
            end[s, i] = t1
            low[s, i] = e_low
            last = max(last, t1)
        for u in range(n_uavs):
            if on_pad[u] == 1:
                land[s, u] = us[u, 1]
                continue
            i = n + u
            drain = _factor(par[DRAIN], z_uav[1, s, u])
            hover_w = uavs[u, k.U_HOVER] * drain
            t1, energy = us[u, 0], us[u, 1]
            if legs[i, 0] > 0.0:
                fly, power = _leg(
                    legs[i, 0],
                    legs[i, 1],
                    legs[i, 2],
                    wx,
                    wy,
                    par[GUST] * z_act[Z_SPEED, s, i],
                    uavs[u, k.U_SPEED],
                    _factor(par[UAV_SPEED], z_uav[0, s, u]),
                    0.0,
                    par[WIND_POWER],
                )
                t1 += fly
                energy -= uavs[u, k.U_CRUISE] * drain * power * fly
            energy -= hover_w * over[u, OVER_DOWN]
            land[s, u] = energy
            if energy < -EPS_J and t1 < zero_t:
                zero_t, zero_i = t1, i
            if energy < uavs[u, k.U_RESERVE] - EPS_J and t1 < reserve_t:
                reserve_t, reserve_i = t1, i
        for g in range(n_ugvs):
            stand = max(0.0, last - ugvs[g, k.G_READY] - gs[g, 2])
            watts = ugvs[g, k.G_DRIVE] * _factor(par[UGV_DRAIN], z_ugv[1, s, g])
            if ugvs[g, k.G_ENERGY] - watts * gs[g, 2] - ugvs[g, k.G_IDLE] * stand - gs[g, 3] < -EPS_J:
                if last < zero_t:
                    zero_t, zero_i = last, n + n_uavs + g
                if last < reserve_t:
                    reserve_t, reserve_i = last, n + n_uavs + g
        if span > limit_s:
            if zero_i == NO_FAILURE:
                zero_i = n + n_uavs + n_ugvs
            if reserve_i == NO_FAILURE:
                reserve_i = n + n_uavs + n_ugvs
        makespan[s] = span
        fail_zero[s] = zero_i
        fail_reserve[s] = reserve_i
