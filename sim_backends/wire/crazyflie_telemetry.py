"""The log variables: their names, types and where each value comes from.

Names and types are the firmware's (``LOG_ADD`` in the files named after the groups); units are the firmware's too:
degrees for ``stabilizer``, mm for ``stateEstimateZ``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from sim_backends.wire.crazyflie_body import quaternion
from sim_backends.wire.crazyflie_control import GRAVITY
from sim_backends.wire.crazyflie_logs import Readers
from sim_backends.wire.crazyflie_power import CHARGING, percent
from sim_backends.wire.crazyflie_supervisor import CAN_FLY, FLYING, TUMBLED

if TYPE_CHECKING:
    from sim_backends.wire.crazyflie_firmware import Firmware

Reader = tuple[str, Callable[[], float]]


def readers(f: Firmware) -> Readers:
    """All variables of a firmware, sorted by name as the TOC lists them."""
    table: dict[str, Reader] = {}
    for part in (_state, _kalman, _sensors, _power, _localization, _system):
        table.update(part(f))
    return dict(sorted(table.items()))


def _zero() -> float:
    return 0.0


def _item(vector: Callable[[], Sequence[float]], index: int, factor: float = 1.0) -> Callable[[], float]:
    return lambda: factor * vector()[index]


def _call(function: Callable[..., float], *arguments: object) -> Callable[[], float]:
    return lambda: function(*arguments)


def _degrees(f: Firmware, index: int) -> float:
    if index == 2:
        return math.degrees(math.remainder(f.estimate.yaw_rad, math.tau))
    # the firmware's pitch is positive nose up
    return math.degrees(f.body.rpy[index]) * (-1.0 if index == 1 else 1.0)


def _quaternion(f: Firmware) -> tuple[float, float, float, float]:
    roll, pitch, _ = f.body.rpy
    return quaternion(roll, pitch, f.estimate.yaw_rad)


def _state(f: Firmware) -> dict[str, Reader]:
    table: dict[str, Reader] = {}
    for i, axis in enumerate("xyz"):
        table[f"stateEstimate.{axis}"] = ("f", _item(lambda: f.estimate.position_m, i))
        table[f"stateEstimate.v{axis}"] = ("f", _item(lambda: f.estimate.velocity_mps, i))
        table[f"stateEstimate.a{axis}"] = ("f", _item(lambda: f.body.accel_mps2, i, 1.0 / GRAVITY))
        table[f"stateEstimateZ.{axis}"] = ("h", _item(lambda: f.estimate.position_m, i, 1000.0))
        table[f"stateEstimateZ.v{axis}"] = ("h", _item(lambda: f.estimate.velocity_mps, i, 1000.0))
        table[f"ctrltarget.{axis}"] = ("f", _item(lambda: f.commander.setpoint.goal.position_m, i))
        table[f"ctrltarget.v{axis}"] = ("f", _item(lambda: f.commander.setpoint.goal.velocity_mps, i))
    for i, name in enumerate(("roll", "pitch", "yaw")):
        for group in ("stateEstimate", "stabilizer"):
            table[f"{group}.{name}"] = ("f", _call(_degrees, f, i))
    for i, name in enumerate(("qx", "qy", "qz", "qw")):
        table[f"stateEstimate.{name}"] = ("f", _item(lambda: _quaternion(f), i))
    table["ctrltarget.yaw"] = ("f", lambda: math.degrees(f.commander.setpoint.goal.yaw_rad))
    table["stabilizer.thrust"] = ("f", lambda: _motor(f))
    return table


def _kalman(f: Firmware) -> dict[str, Reader]:
    table: dict[str, Reader] = {}
    for i, axis in enumerate("XYZ"):
        table[f"kalman.state{axis}"] = ("f", _item(lambda: f.estimate.position_m, i))
        table[f"kalman.var{axis}"] = ("f", lambda: f.estimator.variance)
        table[f"kalman.varP{axis}"] = ("f", lambda: f.estimator.variance)
        table[f"kalman.stateP{axis}"] = ("f", _item(lambda: f.estimate.velocity_mps, i))
        table[f"kalman.varD{i}"] = ("f", lambda: f.estimator.yaw_variance)
    return table


def _sensors(f: Firmware) -> dict[str, Reader]:
    table: dict[str, Reader] = {}
    for i, axis in enumerate("xyz"):
        table[f"acc.{axis}"] = ("f", _call(_acc, f, i))
        table[f"gyro.{axis}"] = ("f", _item(lambda: f.body.dynamics.state, 9 + i, math.degrees(1.0)))
    table["baro.asl"] = ("f", lambda: f.body.position_m[2])
    table["baro.pressure"] = ("f", lambda: 1013.25)
    table["baro.temp"] = ("f", lambda: 25.0)
    table["range.zrange"] = ("H", lambda: 1000.0 * max(0.0, f.body.position_m[2] - f.body.ground.height_m))
    for i in range(1, 5):
        table[f"motor.m{i}"] = ("H", lambda: _motor(f))
        table[f"pwm.m{i}_pwm"] = ("I", lambda: _motor(f))
    return table


def _acc(f: Firmware, axis: int) -> float:
    rest = 0.0 if axis < 2 else -1.0 if f.body.tumbled else 1.0
    return rest + f.body.accel_mps2[axis] / GRAVITY


def _motor(f: Firmware) -> float:
    return 65535.0 * f.drive.thrust_n / f.body.airframe.thrust_n


def _power(f: Firmware) -> dict[str, Reader]:
    return {
        "pm.vbat": ("f", lambda: f.power.vbat),
        "pm.vbatMV": ("H", lambda: 1000.0 * f.power.vbat),
        "pm.extVbat": ("f", _zero),
        "pm.extCurr": ("f", _zero),
        "pm.chargeCurrent": ("f", lambda: 0.9 if f.power.state == CHARGING else 0.0),
        "pm.state": ("b", lambda: f.power.state),
        "pm.batteryLevel": ("B", lambda: percent(f.power.vbat)),
        "pm.temp": ("f", lambda: 30.0),
    }


def _localization(f: Firmware) -> dict[str, Reader]:
    table: dict[str, Reader] = {
        # 16 bits of the firmware's ms, as there
        "locSrvZ.tick": ("H", lambda: f.localization.tick_ms & 0xFFFF),
    }
    for i, axis in enumerate("xyz"):
        table[f"locSrv.{axis}"] = ("f", _item(lambda: f.localization.position_m, i))
    for i, name in enumerate(("qx", "qy", "qz", "qw")):
        table[f"locSrv.{name}"] = ("f", _item(lambda: f.localization.quaternion, i))
    return table


def _system(f: Firmware) -> dict[str, Reader]:
    return {
        "supervisor.info": ("H", f.info),
        "sys.canfly": ("B", lambda: bool(f.info() & CAN_FLY)),
        "sys.isFlying": ("B", lambda: bool(f.info() & FLYING)),
        "sys.isTumbled": ("B", lambda: bool(f.info() & TUMBLED)),
        "sys.armed": ("B", lambda: f.supervisor.armed),
        "sys.testLogParam": ("b", _zero),
        "radio.rssi": ("B", lambda: 40),
        "radio.isConnected": ("B", lambda: 1),
        "radio.numRxBc": ("H", _zero),
        "radio.numRxUc": ("H", lambda: f.packets & 0xFFFF),
        "crtp.rxRate": ("H", _zero),
        "crtp.txRate": ("H", _zero),
        "health.motorPass": ("B", _zero),
        "health.batteryPass": ("B", _zero),
        "tick.ms": ("I", lambda: 1000.0 * f.now_s),
    }
