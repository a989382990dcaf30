"""The world's state as arrays for the compiled kernel; the fields' meaning is told here, their use in ``kernel``."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim_backends import kernel
from sim_backends.world import GRID_S, WorldConfig

RECORDS = 4096
"""Room for violations; more are counted, not kept."""


def _dtype(floats: str, ints: str) -> np.dtype[Any]:
    return np.dtype([(name, "f8") for name in floats.split()] + [(name, "i8") for name in ints.split()])


UAV = _dtype(
    # true position; reference (where its controller wants to be), its velocity; yaw
    "x y z rx ry rz vx vy vz yaw "
    # error of its estimate; wandering (two stages of smoothing); gust; path of the pad while on board
    "ex ey wx wy wz sx sy sz gust pad_yaw "
    # target and speed of the motion; limits; docking
    "tx ty tz speed max_speed accel climb descent abort_z "
    "tracking dock_noise drift p0 p1 p2 p3 capacity energy used charge_w "
    # modifiers set by faults
    "wind drain charge_factor fed_t",
    "phase armed locked tumbled code ugv slot blocked down_steps lost lost_steps motor_fail dock_miss cause trusting",
)
UGV = _dtype(
    "x y rx ry wx wy sx sy vx vy yaw s v speed max_speed accel tracking p0 p1 p2 p3 idle_w capacity energy used "
    "given charge_s charge_w pad_z slow drain",
    "n seg driving armed locked code lost",
)
OUT = _dtype(
    # the newest pose and telemetry that have been received; the pose without noise, faults included
    "px py pz pyaw pose_stamp tele_stamp battery jump_x jump_y false_x false_y",
    # sample: newest pose sample seen; msg: newest message due; stream, quiet: what the loop noticed last
    "sample msg flags visible stream quiet link dead_steps notice dropout freeze swap tele_lost occluded_to",
)
HIST = _dtype("x y z yaw battery", "flags")
RECORD = _dtype("value", "kind step end a b scripted cause")
WORLD = _dtype(
    "h scale time_scale pose_rate pose_latency pose_noise pose_noise_rad occlusion_p occlusion_s tele_rate "
    "tele_latency tele_drop gust dock_tol dock_range dock_speed collision estimate drift_after sep_h sep_v sep_ugv "
    "ceiling min_h min_uav min_ugv",
    "seed link_steps lost_steps disarm_steps notice_steps quiet_steps event n_records lost_records",
)


@dataclass(slots=True)
class Arrays:
    """All of the world's state. Vehicles are numbered UAVs first, then UGVs."""

    world: NDArray[Any]  # (1,)
    uavs: NDArray[Any]  # (n_uav,)
    ugvs: NDArray[Any]  # (n_ugv,)
    docks: NDArray[np.float64]  # (n_ugv, most docks, 2), nan where there is none
    out: NDArray[Any]  # (n,)
    hist: NDArray[Any]  # (steps kept, n)
    path: NDArray[np.float64]  # (n_ugv, points, 3): x, y, length up to there
    fence: NDArray[np.float64]  # (corners, 2)
    records: NDArray[Any]  # (RECORDS,)
    open: NDArray[np.int64]  # (n, n): number of the open record + 1, or 0


def _padded(power_w: tuple[float, ...]) -> tuple[float, ...]:
    return (*power_w, *([0.0] * (4 - len(power_w))))


def build_arrays(config: WorldConfig) -> Arrays:
    """The state at time 0."""
    n_uav, n_ugv = len(config.uavs), len(config.ugvs)
    n, h = n_uav + n_ugv, config.step_s
    latency = max(
        config.pose_latency_s + 1 / config.pose_rate_hz, config.telemetry_latency_s + 1 / config.telemetry_rate_hz
    )
    most_docks = max((len(g.dock_offsets_m) for g in config.ugvs), default=0)
    arrays = Arrays(
        world=np.zeros(1, WORLD),
        uavs=np.zeros(n_uav, UAV),
        ugvs=np.zeros(n_ugv, UGV),
        docks=np.full((n_ugv, max(most_docks, 1), 2), np.nan),
        out=np.zeros(n, OUT),
        hist=np.zeros((math.ceil(latency / h) + 3, n), HIST),
        path=np.zeros((n_ugv, 16, 3)),
        fence=np.array(config.fence_m, dtype=np.float64).reshape(-1, 2),
        records=np.zeros(RECORDS, RECORD),
        open=np.zeros((n, n), np.int64),
    )
    _fill_world(arrays.world, config)
    for j, ugv in enumerate(config.ugvs):
        _fill_ugv(arrays, j, config)
        arrays.docks[j, : len(ugv.dock_offsets_m)] = np.array(ugv.dock_offsets_m).reshape(-1, 2)
    for i in range(n_uav):
        _fill_uav(arrays, i, config)
    for b in range(n):
        out = arrays.out[b]
        out["swap"], out["link"], out["msg"], out["sample"], out["stream"] = b, 1, -1, -1, 8 * b
        out["pose_stamp"] = -math.inf
    arrays.out["battery"] = [v["energy"] / v["capacity"] for v in (*arrays.uavs, *arrays.ugvs)]
    return arrays


def _fill_world(world: NDArray[Any], config: WorldConfig) -> None:
    w, h = world[0], config.step_s
    values = {
        "h": round(h / GRID_S) * GRID_S,
        "scale": config.scale,
        "time_scale": config.time_scale,
        "pose_rate": config.pose_rate_hz,
        "pose_latency": config.pose_latency_s,
        "pose_noise": config.pose_noise_m,
        "pose_noise_rad": config.pose_noise_rad,
        "occlusion_p": config.occlusions_per_s * h,
        "occlusion_s": config.occlusion_s,
        "tele_rate": config.telemetry_rate_hz,
        "tele_latency": config.telemetry_latency_s,
        "tele_drop": config.telemetry_drop,
        "gust": config.gust_mps,
        "dock_tol": config.dock_tolerance_m,
        "dock_range": config.dock_range_m,
        "dock_speed": config.dock_speed_mps,
        "collision": config.collision_m,
        "estimate": config.estimate_mps,
        "drift_after": config.drift_after_s,
        "sep_h": config.separation_h_m,
        "sep_v": config.separation_v_m,
        "sep_ugv": config.separation_ugv_m,
        "ceiling": config.ceiling_m,
        "min_h": math.inf,
        "min_uav": math.inf,
        "min_ugv": math.inf,
        "seed": config.seed,
        "link_steps": math.ceil(config.link_timeout_s / h),
        "lost_steps": math.ceil(config.lost_land_s / h),
        "disarm_steps": -1 if config.auto_disarm_s is None else math.ceil(config.auto_disarm_s / h),
        # an arrival is worth a look once the pose that shows it has been received
        "notice_steps": math.ceil((config.pose_latency_s + 1 / config.pose_rate_hz) / h) + 1,
        "quiet_steps": math.ceil(max(0.3, 3 / config.telemetry_rate_hz) / h),
    }
    for name, value in values.items():
        w[name] = value


def _fill_ugv(arrays: Arrays, j: int, config: WorldConfig) -> None:
    ugv, g = config.ugvs[j], arrays.ugvs[j]
    g["x"], g["y"] = g["rx"], g["ry"] = ugv.start_m
    g["yaw"], g["max_speed"], g["accel"], g["tracking"] = (
        ugv.yaw_rad,
        ugv.max_speed_mps,
        ugv.accel_mps2,
        ugv.tracking_noise_m,
    )
    g["p0"], g["p1"], g["p2"], g["p3"] = _padded(ugv.power_w)
    g["idle_w"], g["capacity"] = ugv.idle_w, ugv.capacity_j
    g["energy"] = ugv.capacity_j if ugv.energy_j is None else ugv.energy_j
    g["charge_s"] = -1.0 if ugv.charge_s is None else ugv.charge_s
    g["charge_w"] = ugv.charge_w or 0.0
    g["pad_z"], g["slow"], g["drain"] = ugv.pad_height_m, 1.0, 1.0


def _fill_uav(arrays: Arrays, i: int, config: WorldConfig) -> None:
    uav, u = config.uavs[i], arrays.uavs[i]
    u["x"], u["y"] = uav.start_m
    u["max_speed"], u["accel"], u["climb"], u["descent"] = (
        uav.max_speed_mps,
        uav.accel_mps2,
        uav.climb_mps,
        uav.descent_mps,
    )
    u["tracking"], u["dock_noise"], u["drift"] = uav.tracking_noise_m, uav.dock_noise_m, uav.drift_mps
    u["p0"], u["p1"], u["p2"], u["p3"] = _padded(uav.power_w)
    u["capacity"] = uav.capacity_j
    u["energy"] = uav.capacity_j if uav.energy_j is None else uav.energy_j
    u["drain"], u["charge_factor"], u["ugv"] = 1.0, 1.0, -1
    if uav.on is not None:
        u["ugv"] = [g.id for g in config.ugvs].index(uav.on)
        u["slot"] = uav.dock
        kernel.board(arrays.uavs[i], arrays.ugvs[u["ugv"]], u["ugv"], u["slot"], arrays.docks)
