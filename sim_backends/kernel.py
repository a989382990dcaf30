"""The physics of one fixed step, compiled. See ``docs/simulation.md`` for the model and ``arrays`` for the fields.

One file although it is long: numba's cache on disk notices a change in a function's own file only, so a part
moved elsewhere could run in an old version. Every random number is a hash of (seed, vehicle, step, purpose), so
that nothing depends on how often or when the loop looks.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from sim_backends.compiled import compiled

# phases of a UAV
GROUND, PAD, FLY, TAKEOFF, LAND, DOCK, ABORT, BRAKE, FALL, CRASHED = range(10)
# flags of a vehicle's telemetry
ARMED, AIRBORNE, TUMBLED, LOCKED, CHARGING, FULL = 1, 2, 4, 8, 16, 32
CODE = 256  # times the code of what is wrong
# codes of what is wrong, in the vehicle's own words, and causes of crashes
FINE, DOCK_MISSED, BATTERY_EMPTY, MOTOR_FAILURE, COLLIDED, STOPPED = range(6)
# kinds of violations
SEPARATION, UGV_SEPARATION, FENCE, CEILING, EMPTY_IN_AIR, CRASH, COLLISION = range(7)

GRAVITY = 9.81
YAW_RATE = 2.0
WANDER_S = 2.0
GUST_S = 20.0
ALIGN_S = 10.0
MASK = (1 << 63) - 1


@compiled
def mix(seed: Any, who: Any, step: Any, purpose: Any) -> Any:
    """63 random bits from four integers (the finaliser of SplitMix64, Steele et al. 2014, over a linear mix)."""
    z = (
        np.uint64(seed) * np.uint64(0x9E3779B97F4A7C15)
        + np.uint64(who) * np.uint64(0xD1B54A32D192ED03)
        + np.uint64(step) * np.uint64(0x8CB92BA72F3D8DD7)
        + np.uint64(purpose) * np.uint64(0xAEF17502108EF2D9)
    )
    for _ in range(2):
        z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        z = z ^ (z >> np.uint64(31))
    return z


@compiled
def uniform(seed: Any, who: Any, step: Any, purpose: Any) -> Any:
    """A number in [0, 1)."""
    return float(mix(seed, who, step, purpose) >> np.uint64(11)) / 9007199254740992.0


@compiled
def gauss(seed: Any, who: Any, step: Any, purpose: Any) -> Any:
    """Nearly normal, standard deviation 1, never beyond 3.5: the sum of four uniform 16-bit numbers."""
    z = mix(seed, who, step, purpose)
    low = np.uint64(0xFFFF)
    total = (z & low) + ((z >> np.uint64(16)) & low) + ((z >> np.uint64(32)) & low) + (z >> np.uint64(48))
    return (float(total) / 65535.0 - 2.0) * 1.7320508


@compiled
def approach_speed(dist: Any, accel: Any, h: Any) -> Any:
    """The fastest speed from which ``dist`` still suffices to stop, in steps of ``h``."""
    return min(accel * (math.sqrt(0.25 * h * h + 2.0 * dist / accel) - 0.5 * h), dist / h)


@compiled
def power(p0: Any, p1: Any, p2: Any, p3: Any, v: Any) -> Any:
    """Power in W at world speed ``v``."""
    return max(p0 + v * (p1 + v * (p2 + v * p3)), 0.0)


@compiled
def steer(u: Any, tx: Any, ty: Any, tz: Any, speed: Any, h: Any) -> Any:
    """Moves the reference of UAV ``u`` towards a point; true once it is there and at rest."""
    dx, dy, dz = tx - u.rx, ty - u.ry, tz - u.rz
    dist = math.sqrt(dx * dx + dy * dy + dz * dz)
    gx, gy, gz = 0.0, 0.0, 0.0
    if dist > 0.0:
        v = cruise = min(speed, u.max_speed)
        level = math.sqrt(dx * dx + dy * dy) / dist
        vertical_limit = u.climb if dz > 0 else u.descent
        if v * abs(dz) > vertical_limit * dist:
            v = vertical_limit * dist / abs(dz)
        if level > 1e-6:
            lost = max(u.wind + u.gust, 0.0)
            v = min(v, max(cruise - lost, 0.1 * cruise) / level)  # a steep climb hardly moves against the wind
        v = min(v, approach_speed(dist, u.accel, h))
        gx, gy, gz = dx / dist * v, dy / dist * v, dz / dist * v
    ax, ay, az = gx - u.vx, gy - u.vy, gz - u.vz
    change = math.sqrt(ax * ax + ay * ay + az * az)
    most = u.accel * h
    if change > most:
        ax, ay, az = ax * most / change, ay * most / change, az * most / change
    u.vx, u.vy, u.vz = u.vx + ax, u.vy + ay, u.vz + az
    u.rx, u.ry, u.rz = u.rx + u.vx * h, u.ry + u.vy * h, u.rz + u.vz * h
    left = math.sqrt((tx - u.rx) ** 2 + (ty - u.ry) ** 2 + (tz - u.rz) ** 2)
    if left < 1e-4 and change <= most:
        u.rx, u.ry, u.rz = tx, ty, tz
        if math.sqrt(u.vx**2 + u.vy**2 + u.vz**2) <= most:
            u.vx, u.vy, u.vz = 0.0, 0.0, 0.0
            return True
    return False


@compiled
def brake(u: Any, h: Any) -> Any:
    """Brakes the reference of UAV ``u``; true once it is at rest."""
    v = math.sqrt(u.vx**2 + u.vy**2 + u.vz**2)
    most = u.accel * h
    if v <= most:
        u.vx, u.vy, u.vz = 0.0, 0.0, 0.0
        return True
    keep = (v - most) / v
    u.vx, u.vy, u.vz = u.vx * keep, u.vy * keep, u.vz * keep
    u.rx, u.ry, u.rz = u.rx + u.vx * h, u.ry + u.vy * h, u.rz + u.vz * h
    return False


@compiled
def pad(g: Any, j: Any, slot: Any, docks: Any) -> Any:
    """Position of a dock of UGV ``g``."""
    c, s = math.cos(g.yaw), math.sin(g.yaw)
    ox, oy = docks[j, slot, 0], docks[j, slot, 1]
    return g.x + c * ox - s * oy, g.y + s * ox + c * oy


@compiled
def stand(u: Any, phase: Any, x: Any, y: Any, z: Any) -> None:
    """Puts UAV ``u`` down at a place."""
    u.phase = phase
    u.x, u.y, u.z = x, y, z
    u.rx, u.ry, u.rz = x, y, z
    u.vx, u.vy, u.vz = 0.0, 0.0, 0.0
    u.ex, u.ey, u.wx, u.wy, u.wz = 0.0, 0.0, 0.0, 0.0, 0.0
    u.sx, u.sy, u.sz = 0.0, 0.0, 0.0
    u.down_steps = 0


@compiled
def board(u: Any, g: Any, j: Any, slot: Any, docks: Any) -> None:
    """Puts UAV ``u`` on a dock, where its charger starts."""
    x, y = pad(g, j, slot, docks)
    stand(u, PAD, x, y, g.pad_z)
    u.ugv, u.slot, u.pad_yaw = j, slot, u.yaw - g.yaw
    u.charge_w = g.charge_w
    if g.charge_s == 0.0:
        u.charge_w = math.inf
    elif g.charge_s > 0.0:
        u.charge_w = (u.capacity - u.energy) / g.charge_s


@compiled
def fall(u: Any, cause: Any) -> None:
    """The motors of flying UAV ``u`` stop."""
    u.rx, u.ry, u.rz = u.x, u.y, u.z
    u.ex, u.ey, u.wx, u.wy, u.wz = 0.0, 0.0, 0.0, 0.0, 0.0
    u.phase, u.cause, u.locked, u.armed = FALL, cause, 1, 0
    u.code = cause if cause != STOPPED else u.code


@compiled
def flying(phase: Any) -> Any:
    """Whether a UAV in that phase is in the air."""
    return phase >= FLY and phase != CRASHED


@compiled
def note(w: Any, records: Any, kind: Any, k: Any, a: Any, b: Any, value: Any, scripted: Any, cause: Any) -> Any:
    """Files a violation; returns its number + 1, or 0 where there is no more room."""
    n = w.n_records
    if n >= len(records):
        w.lost_records += 1
        return 0
    r = records[n]
    r.kind, r.step, r.end, r.a, r.b, r.value, r.scripted, r.cause = kind, k, k, a, b, value, scripted, cause
    w.n_records = n + 1
    return n + 1


@compiled
def episode(
    w: Any, records: Any, opened: Any, a: Any, b: Any, bad: Any, kind: Any, k: Any, value: Any, scripted: Any
) -> None:
    """Keeps one record for as long as a violation lasts, with its least value."""
    at = opened[a, b]
    if not bad:
        opened[a, b] = 0
    elif at == 0:
        opened[a, b] = note(w, records, kind, k, a, b, value, scripted, FINE)
    else:
        r = records[at - 1]
        r.value = min(r.value, value)
        r.scripted = max(r.scripted, scripted)
        r.end = k


@compiled
def move_ugv(w: Any, g: Any, who: Any, k: Any, route: Any) -> Any:
    """One step of a UGV along its path; true when it has just come to rest."""
    h = w.h
    arrived = False
    going = g.driving == 1 and g.armed == 1 and g.locked == 0 and g.lost == 0 and g.energy > 0.0
    if g.v > 0.0 or going:
        left = route[g.n - 1, 2] - g.s
        limit = min(g.speed, g.max_speed) * g.slow if going else 0.0
        # a locked drive brakes as hard as the ground allows
        accel = g.accel * (3.0 if g.locked == 1 else 1.0)
        v, before = min(limit, approach_speed(left, g.accel, h)), g.v
        g.v = min(max(v, g.v - accel * h), g.v + g.accel * h, left / h)
        if g.v < 1e-9:
            g.v = 0.0
        g.s += g.v * h
        if route[g.n - 1, 2] - g.s < 1e-6:
            g.s = route[g.n - 1, 2]
            arrived = g.driving == 1
            g.driving, g.v = 0, 0.0
        arrived = arrived or (before > 0.0 and g.v == 0.0)
        while g.seg < g.n - 2 and g.s > route[g.seg + 1, 2]:
            g.seg += 1
        a, b = route[g.seg], route[g.seg + 1]
        length = b[2] - a[2]
        if length > 0.0:
            f = min((g.s - a[2]) / length, 1.0)
            g.rx, g.ry = a[0] + f * (b[0] - a[0]), a[1] + f * (b[1] - a[1])
            turn = math.atan2(b[1] - a[1], b[0] - a[0]) - g.yaw
            turn = math.atan2(math.sin(turn), math.cos(turn))
            g.yaw += min(max(turn, -YAW_RATE * h), YAW_RATE * h)
        if g.v > 0.0:
            f, size = h / WANDER_S, g.tracking * math.sqrt(4.0 * h / WANDER_S)
            g.sx += -f * g.sx + size * gauss(w.seed, who, k, 1)
            g.sy += -f * g.sy + size * gauss(w.seed, who, k, 2)
            g.wx += f * (g.sx - g.wx)
            g.wy += f * (g.sy - g.wy)
        x, y = g.rx + g.wx, g.ry + g.wy
        g.vx, g.vy = (x - g.x) / h, (y - g.y) / h
        g.x, g.y = x, y
    else:
        g.vx, g.vy = 0.0, 0.0
    mission_s = h / w.time_scale
    watts = power(g.p0, g.p1, g.p2, g.p3, g.v * w.time_scale / w.scale) if g.v > 0.0 else g.idle_w
    spent = min(watts * g.drain * mission_s, g.energy)
    g.energy -= spent
    g.used += spent
    if g.energy <= 0.0 and g.code == FINE:
        g.code = BATTERY_EMPTY
    return arrived


@compiled
def dock_step(w: Any, u: Any, i: Any, uavs: Any, ugvs: Any, docks: Any) -> None:
    """One step of a docking: above the pad, down onto it, or up again."""
    h, g = w.h, ugvs[u.ugv]
    px, py = pad(g, u.ugv, u.slot, docks)
    off = math.hypot(u.x - px, u.y - py)
    above = u.rz - g.pad_z
    missed = off > w.dock_range or above < -0.01 or math.hypot(g.vx, g.vy) > w.dock_speed
    for other in range(len(uavs)):
        o = uavs[other]
        if other != i and o.phase == PAD and o.ugv == u.ugv and o.slot == u.slot:
            missed = True
    # horizontally towards the pad, which it sees: errors of its estimate do not count
    dx, dy = px + u.ex - u.rx, py + u.ey - u.ry
    dist = math.hypot(dx, dy)
    gx, gy = g.vx, g.vy
    if dist > 0.0:
        v = min(u.max_speed, approach_speed(dist, u.accel, h))
        gx, gy = gx + dx / dist * v, gy + dy / dist * v
    aligned = off <= max(w.dock_tol, 0.3 * above)
    u.blocked = 0 if aligned else u.blocked + 1
    if u.blocked * h > ALIGN_S:
        missed = True
    down = min(u.speed, u.descent, approach_speed(max(above, 0.0), u.accel, h)) if aligned else 0.0
    ax, ay, az = gx - u.vx, gy - u.vy, -down - u.vz
    change = math.sqrt(ax * ax + ay * ay + az * az)
    most = u.accel * h
    if change > most:
        ax, ay, az = ax * most / change, ay * most / change, az * most / change
    u.vx, u.vy, u.vz = u.vx + ax, u.vy + ay, u.vz + az
    u.rx, u.ry, u.rz = u.rx + u.vx * h, u.ry + u.vy * h, u.rz + u.vz * h
    if not missed and u.rz - g.pad_z < 1e-3:
        if off <= w.dock_tol and u.dock_miss == 0:
            board(u, g, u.ugv, u.slot, docks)
            return
        missed = True
        u.dock_miss = max(u.dock_miss - 1, 0)
    if missed:
        u.phase, u.code = ABORT, DOCK_MISSED
        u.tx, u.ty, u.tz = u.rx, u.ry, max(u.abort_z, u.rz)


@compiled
def land_on_pad(w: Any, u: Any, i: Any, uavs: Any, ugvs: Any, docks: Any) -> Any:
    """Whether a vertical landing has come down on a free dock by its place; then it stands there."""
    for j in range(len(ugvs)):
        g = ugvs[j]
        if u.z > g.pad_z or u.z < g.pad_z - 0.5 * u.descent:
            continue
        for slot in range(docks.shape[1]):
            if math.isnan(docks[j, slot, 0]):
                continue
            px, py = pad(g, j, slot, docks)
            if math.hypot(u.x - px, u.y - py) > w.dock_tol:
                continue
            free = True
            for other in range(len(uavs)):
                o = uavs[other]
                if other != i and o.phase == PAD and o.ugv == j and o.slot == slot:
                    free = False
            if free:
                board(u, g, j, slot, docks)
                return True
    return False


@compiled
def estimate(w: Any, u: Any, out: Any, i: Any, k: Any) -> None:
    """The error of a UAV's own estimate: follows false poses it is fed, drifts without poses."""
    h, t = w.h, k * w.h
    # the age does not depend on how often the loop feeds as long as it feeds about once a second
    last = out.pose_stamp if out.pose_stamp - u.fed_t <= 1.5 else u.fed_t
    goal_x, goal_y, rate = 0.0, 0.0, w.estimate
    if u.lost > 0 or t - last > w.drift_after:
        turn = 6.2831853 * uniform(w.seed, i, int(t / 20.0), 3)
        u.ex += u.drift * math.cos(turn) * h
        u.ey += u.drift * math.sin(turn) * h
        return
    false = out.freeze == 1 or out.jump_x != 0.0 or out.jump_y != 0.0 or out.swap != i
    if u.trusting == 1 and out.visible == 1 and false:
        goal_x, goal_y = out.false_x - u.x, out.false_y - u.y
    dx, dy = goal_x - u.ex, goal_y - u.ey
    dist = math.hypot(dx, dy)
    if dist > 0.0:
        f = min(rate * h / dist, 1.0)
        u.ex += f * dx
        u.ey += f * dy


@compiled
def wander(w: Any, u: Any, i: Any, k: Any) -> None:
    """The UAV's deviation from its reference: smooth, with a standard deviation of about its tracking noise."""
    h = w.h
    size = u.dock_noise if u.phase == DOCK else u.tracking
    f, kick = h / WANDER_S, size * math.sqrt(4.0 * h / WANDER_S)
    u.sx += -f * u.sx + kick * gauss(w.seed, i, k, 4)
    u.sy += -f * u.sy + kick * gauss(w.seed, i, k, 5)
    u.sz += -f * u.sz + 0.3 * kick * gauss(w.seed, i, k, 6)
    u.wx += f * (u.sx - u.wx)
    u.wy += f * (u.sy - u.wy)
    u.wz += f * (u.sz - u.wz)
    if w.gust > 0.0:
        u.gust += -h / GUST_S * u.gust + w.gust * math.sqrt(2.0 * h / GUST_S) * gauss(w.seed, i, k, 7)


@compiled
def move_uav(w: Any, u: Any, i: Any, k: Any, uavs: Any, ugvs: Any, docks: Any, out: Any, records: Any) -> Any:
    """One step of a UAV; true when a motion has just ended."""
    h = w.h
    if u.motor_fail == 1 and u.locked == 0:
        u.locked, u.armed, u.code = 1, 0, MOTOR_FAILURE
        if flying(u.phase):
            fall(u, MOTOR_FAILURE)
    if u.lost > 0:
        u.lost_steps += 1
        if u.lost_steps >= w.lost_steps and flying(u.phase) and u.phase not in (FALL, LAND):
            u.phase, u.speed = LAND, u.descent
    else:
        u.lost_steps = 0
    if u.phase == PAD:
        g = ugvs[u.ugv]
        u.x, u.y = pad(g, u.ugv, u.slot, docks)
        u.rx, u.ry, u.yaw = u.x, u.y, g.yaw + u.pad_yaw
    if not flying(u.phase):
        u.down_steps += 1
        if w.disarm_steps >= 0 and u.down_steps == w.disarm_steps:
            u.armed = 0
        return False
    if u.phase == FALL:
        u.vx, u.vy, u.vz = u.vx * (1.0 - 0.5 * h), u.vy * (1.0 - 0.5 * h), u.vz - GRAVITY * h
        u.x, u.y, u.z = u.x + u.vx * h, u.y + u.vy * h, u.z + u.vz * h
        if u.z <= 0.0:
            stand(u, CRASHED, u.x, u.y, 0.0)
            u.tumbled = 1
            note(w, records, CRASH, k + 1, i, -1, 0.0, int(u.cause == MOTOR_FAILURE), u.cause)
        return False
    wander(w, u, i, k)
    estimate(w, u, out, i, k)
    ended = False
    if u.phase == BRAKE:
        if brake(u, h):
            u.phase, u.tx, u.ty, u.tz = FLY, u.rx, u.ry, u.rz
            ended = True
    elif u.phase == DOCK:
        dock_step(w, u, i, uavs, ugvs, docks)
        ended = u.phase != DOCK
    elif u.phase == LAND:
        # first stop sideways, then down: a landing out of a flight must not drag
        if math.hypot(u.vx, u.vy) > 0.0:
            if brake(u, h):
                u.tx, u.ty = u.rx, u.ry
        else:
            ended = steer(u, u.rx, u.ry, 0.0, min(u.speed, u.descent), h)
    else:
        moving = abs(u.vx) + abs(u.vy) + abs(u.vz) > 0.0 or u.rx != u.tx or u.ry != u.ty or u.rz != u.tz
        if moving:
            ended = steer(u, u.tx, u.ty, u.tz, u.speed, h)
        if (ended or not moving) and u.phase != FLY:
            u.phase = FLY
            ended = True
    if flying(u.phase):
        u.x, u.y = u.rx - u.ex + u.wx, u.ry - u.ey + u.wy
        u.z = max(u.rz + u.wz * min(u.rz, 1.0), 0.0)
        if u.phase == LAND:
            if ended or u.rz <= 0.0:
                stand(u, GROUND, u.x, u.y, 0.0)
                ended = True
            elif land_on_pad(w, u, i, uavs, ugvs, docks):
                ended = True
            if not flying(u.phase) and u.lost > 0:
                u.armed = 0
    return ended


@compiled
def energy(w: Any, u: Any, i: Any, k: Any, ugvs: Any, records: Any) -> None:
    """Drains or charges the battery of a UAV for one step."""
    mission_s = w.h / w.time_scale
    if flying(u.phase) and u.phase != FALL:
        v = math.hypot(u.vx, u.vy)
        if v > 0.01 * u.max_speed:
            # the wind's share of the air speed has been taken off the ground speed before
            v = min(v + max(u.wind + u.gust, 0.0), max(v, min(u.speed, u.max_speed)))
        watts = power(u.p0, u.p1, u.p2, u.p3, v * w.time_scale / w.scale)
        spent = min(watts * u.drain * mission_s, u.energy)
        u.energy -= spent
        u.used += spent
        if u.energy <= 0.0:
            note(w, records, EMPTY_IN_AIR, k + 1, i, -1, u.z, 0, BATTERY_EMPTY)
            fall(u, BATTERY_EMPTY)
    elif u.phase == PAD and u.energy < u.capacity:
        g = ugvs[u.ugv]
        give = min(u.charge_w * u.charge_factor * mission_s, u.capacity - u.energy, g.energy)
        if u.charge_factor > 0.0 and give > 0.0:
            # the last step's rounding must not leave a battery a hair below full
            u.energy = u.capacity if u.capacity - u.energy - give < 1e-6 * u.capacity else u.energy + give
            g.energy -= give
            g.given += give


@compiled
def flags_of_uav(u: Any, ugvs: Any) -> Any:
    """What UAV ``u`` says about itself."""
    flags = u.armed * ARMED + u.tumbled * TUMBLED + u.locked * LOCKED + u.code * CODE
    if flying(u.phase):
        flags += AIRBORNE
    if u.phase == PAD and u.charge_factor > 0.0 and ugvs[u.ugv].energy > 0.0:
        flags += CHARGING
        if u.energy >= u.capacity:
            flags += FULL
    return flags


@compiled
def receive(w: Any, out: Any, hist: Any, b: Any, k: Any, shown: Any) -> Any:
    """What of vehicle ``b`` reaches the ground station by step ``k``; true when the loop may notice."""
    h, t, seed, rows = w.h, k * w.h, w.seed, len(hist)
    noticed = False
    o = out[b]
    # --- poses
    if w.occlusion_p > 0.0 and uniform(seed, b, k, 8) < w.occlusion_p:
        length = w.occlusion_s * (0.5 + uniform(seed, b, k, 9))
        o.occluded_to = max(o.occluded_to, k + math.ceil(length / h))
    sample = math.floor((t - w.pose_latency) * w.pose_rate + 1e-6)
    hidden = o.dropout == 1 or k <= o.occluded_to or shown == 0
    visible = 0
    if sample >= 0:
        if not hidden:
            visible = 1
            if sample > o.sample:
                o.pose_stamp = sample / w.pose_rate + w.pose_latency
                if o.freeze == 0:
                    at = sample / w.pose_rate / h
                    j = math.floor(at + 1e-9)
                    f = max(at - j, 0.0)
                    c, d = hist[j % rows, o.swap], hist[(j + 1) % rows, o.swap]
                    if j >= k:
                        d = c
                    o.false_x, o.false_y = c.x + f * (d.x - c.x) + o.jump_x, c.y + f * (d.y - c.y) + o.jump_y
                    o.px = o.false_x + w.pose_noise * gauss(seed, b, sample, 10)
                    o.py = o.false_y + w.pose_noise * gauss(seed, b, sample, 11)
                    o.pz = c.z + f * (d.z - c.z) + w.pose_noise * gauss(seed, b, sample, 12)
                    o.pyaw = c.yaw + w.pose_noise_rad * gauss(seed, b, sample, 13)
        o.sample = sample
    stream = visible + 2 * o.freeze + 4 * int(o.jump_x != 0.0 or o.jump_y != 0.0) + 8 * o.swap
    noticed = noticed or stream != o.stream
    o.visible, o.stream = visible, stream
    # --- telemetry
    message = math.floor((t - w.tele_latency) * w.tele_rate + 1e-6)
    o.quiet += 1
    if message > o.msg:
        o.msg = message
        if o.tele_lost == 0 and shown == 1 and not uniform(seed, b, message, 14) < w.tele_drop:
            c = hist[math.floor(message / w.tele_rate / h + 1e-9) % rows, b]
            noticed = noticed or o.flags != c.flags or o.quiet > w.quiet_steps
            o.flags, o.battery, o.quiet = c.flags, c.battery, 0
            o.tele_stamp = message / w.tele_rate + w.tele_latency
    noticed = noticed or o.quiet == w.quiet_steps
    # --- link
    o.dead_steps = 0 if shown == 1 else o.dead_steps + 1
    link = int(o.dead_steps < w.link_steps)
    noticed = noticed or link != o.link
    o.link = link
    if o.notice > 0:
        o.notice -= 1
        noticed = noticed or o.notice == 0
    return noticed


@compiled
def inside(fence: Any, x: Any, y: Any) -> Any:
    """Whether a point lies in the polygon (even-odd rule)."""
    result = False
    j = len(fence) - 1
    for i in range(len(fence)):
        xi, yi, xj, yj = fence[i, 0], fence[i, 1], fence[j, 0], fence[j, 1]
        if (yi > y) != (yj > y) and x < (xj - xi) * (y - yi) / (yj - yi) + xi:
            result = not result
        j = i
    return result


@compiled
def audit(w: Any, uavs: Any, ugvs: Any, fence: Any, records: Any, opened: Any, k: Any) -> None:
    """Compares the truth with the rules; lets UAVs that touch fall."""
    n = len(uavs)
    for i in range(n):
        u = uavs[i]
        up = flying(u.phase)
        hit = int(u.lost > 0 or u.motor_fail == 1)
        outside = len(fence) > 0 and up and not inside(fence, u.x, u.y)
        bad = up and (outside or u.z > w.ceiling)
        kind = FENCE if outside else CEILING
        episode(w, records, opened, i, i, bad, kind, k, -u.z if kind == CEILING else 0.0, hit)
        for j in range(i + 1, n):
            o = uavs[j]
            if not (up and flying(o.phase)):
                opened[i, j] = 0
                continue
            level = math.hypot(u.x - o.x, u.y - o.y)
            height = abs(u.z - o.z)
            near = math.hypot(level, height)
            both = max(hit, int(o.lost > 0 or o.motor_fail == 1))
            w.min_uav = min(w.min_uav, near)
            if height < w.sep_v:
                w.min_h = min(w.min_h, level)
            bad = height < w.sep_v and level < w.sep_h
            episode(w, records, opened, i, j, bad, SEPARATION, k, level, both)
            if near < w.collision and FALL not in (u.phase, o.phase):
                note(w, records, COLLISION, k, i, j, near, both, COLLIDED)
                fall(u, COLLIDED)
                fall(o, COLLIDED)
    for i in range(len(ugvs)):
        g = ugvs[i]
        outside = len(fence) > 0 and not inside(fence, g.x, g.y)
        episode(w, records, opened, n + i, n + i, outside, FENCE, k, 0.0, 0)
        for j in range(i + 1, len(ugvs)):
            near = math.hypot(g.x - ugvs[j].x, g.y - ugvs[j].y)
            w.min_ugv = min(w.min_ugv, near)
            episode(w, records, opened, n + i, n + j, near < w.sep_ugv, UGV_SEPARATION, k, near, 0)


@compiled
def observe(w: Any, uavs: Any, ugvs: Any, out: Any, hist: Any, fence: Any, records: Any, opened: Any, k: Any) -> Any:
    """Everything that follows from the state at step ``k``; true when the loop may notice something."""
    n, row = len(uavs), hist[k % len(hist)]
    audit(w, uavs, ugvs, fence, records, opened, k)
    for i in range(n):
        u, c = uavs[i], row[i]
        c.x, c.y, c.z, c.yaw, c.battery = u.x, u.y, u.z, u.yaw, u.energy / u.capacity
        c.flags = flags_of_uav(u, ugvs)
    for j in range(len(ugvs)):
        g, c = ugvs[j], row[n + j]
        c.x, c.y, c.z, c.yaw, c.battery = g.x, g.y, 0.0, g.yaw, g.energy / g.capacity
        c.flags = g.armed * ARMED + g.locked * LOCKED + g.code * CODE
    noticed = False
    for b in range(len(out)):
        lost = uavs[b].lost if b < n else ugvs[b - n].lost
        noticed = receive(w, out, hist, b, k, int(lost == 0)) or noticed
    return noticed


@compiled
def advance(
    world: Any,
    uavs: Any,
    ugvs: Any,
    docks: Any,
    out: Any,
    hist: Any,
    path: Any,
    fence: Any,
    records: Any,
    opened: Any,
    first: Any,
    last: Any,
) -> Any:
    """Steps from ``first`` to ``last`` or to the first step where the loop may notice something.

    Returns:
        The step reached, and 1 where something may be noticed.
    """
    w, n = world[0], len(uavs)
    for k in range(first, last):
        for j in range(len(ugvs)):
            if move_ugv(w, ugvs[j], n + j, k, path[j]):
                out[n + j].notice = w.notice_steps
        for i in range(n):
            u = uavs[i]
            if move_uav(w, u, i, k, uavs, ugvs, docks, out[i], records):
                out[i].notice = w.notice_steps
            energy(w, u, i, k, ugvs, records)
        if observe(w, uavs, ugvs, out, hist, fence, records, opened, k + 1):
            return k + 1, 1
    return last, 0
