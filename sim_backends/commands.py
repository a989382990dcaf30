"""What a command does to a simulated vehicle at the moment it arrives there."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from drivers.vehicle import (
    Arm,
    Command,
    Disarm,
    Dock,
    Drive,
    GoTo,
    Hold,
    Land,
    StopMotors,
    TakeOff,
    Vec2,
)
from sim_backends import kernel
from sim_backends.arrays import Arrays

IN_MOTION = (kernel.FLY, kernel.TAKEOFF, kernel.LAND, kernel.DOCK, kernel.ABORT, kernel.BRAKE)


class Receiver:
    """The vehicles' side of the command link: decides what is ignored and sets the motions going."""

    def __init__(self, arrays: Arrays, ugv_ids: Sequence[str]) -> None:
        self._arrays = arrays
        self._ugv_index = {ugv: j for j, ugv in enumerate(ugv_ids)}
        self._paths: list[tuple[Vec2, ...]] = [() for _ in ugv_ids]

    def uav(self, i: int, command: Command) -> bool:
        """Lets UAV ``i`` act on ``command``; true when a take-off was accepted."""
        u = self._arrays.uavs[i]
        if u["lost"]:
            return False
        up = u["phase"] in IN_MOTION
        match command:
            case Arm():
                if not (u["locked"] or u["tumbled"]):
                    u["armed"], u["down_steps"] = 1, 0
            case Disarm():
                if not up and u["phase"] != kernel.FALL:
                    u["armed"] = 0
            case StopMotors():
                if up:
                    kernel.fall(u, kernel.STOPPED)
                u["locked"], u["armed"] = 1, 0
            case TakeOff() if u["armed"]:
                return self._take_off(i, command)
            case GoTo() if up:
                target = (*command.position_m, command.speed_mps)
                if u["phase"] != kernel.FLY or target != (u["tx"], u["ty"], u["tz"], u["speed"]):
                    u["phase"], u["code"] = kernel.FLY, kernel.FINE
                    u["tx"], u["ty"], u["tz"], u["speed"] = target
            case Land() if up:
                u["phase"], u["speed"] = kernel.LAND, command.speed_mps
            case Dock() if up:
                self._dock(i, command)
            case Hold() if up:
                still = not (u["vx"] or u["vy"] or u["vz"])
                there = (u["rx"], u["ry"], u["rz"]) == (u["tx"], u["ty"], u["tz"])
                if not (u["phase"] == kernel.FLY and still and there):
                    u["phase"] = kernel.BRAKE
            case _:
                pass
        return False

    def _take_off(self, i: int, command: TakeOff) -> bool:
        u = self._arrays.uavs[i]
        if u["phase"] in (kernel.GROUND, kernel.PAD):
            if u["energy"] <= 0 or command.altitude_m <= u["z"]:
                return False
            u["rx"], u["ry"] = u["x"] + u["ex"], u["y"] + u["ey"]
            u["tx"], u["ty"] = u["rx"], u["ry"]
        elif u["phase"] != kernel.TAKEOFF:
            # a repeated one that has been done already must change nothing
            if u["phase"] == kernel.FLY and u["tz"] == command.altitude_m:
                return False
            u["tx"], u["ty"] = u["rx"], u["ry"]
        u["phase"], u["code"] = kernel.TAKEOFF, kernel.FINE
        u["tz"], u["speed"] = command.altitude_m, command.speed_mps
        return True

    def _dock(self, i: int, command: Dock) -> None:
        u, j = self._arrays.uavs[i], self._ugv_index[command.onto]
        same = u["ugv"] == j and u["slot"] == command.dock and u["abort_z"] == command.abort_altitude_m
        # while it climbs out of a missed attempt, a repeated command still means that attempt
        if same and u["phase"] in (kernel.DOCK, kernel.ABORT):
            return
        u["phase"], u["code"], u["blocked"] = kernel.DOCK, kernel.FINE, 0
        u["ugv"], u["slot"], u["abort_z"] = j, command.dock, command.abort_altitude_m
        u["speed"] = command.speed_mps

    def ugv(self, j: int, command: Command) -> bool:
        """Lets UGV ``j`` act on ``command``; true when a drive was accepted."""
        g = self._arrays.ugvs[j]
        if g["lost"]:
            return False
        match command:
            case Arm():
                if not g["locked"]:
                    g["armed"] = 1
            case Disarm():
                g["armed"], g["driving"] = 0, 0
            case StopMotors():
                g["locked"], g["armed"], g["driving"] = 1, 0, 0
            case Hold():
                g["driving"] = 0
            case Drive() if g["armed"] and not g["locked"]:
                self._drive(j, command)
                return True
            case _:
                pass
        return False

    def _drive(self, j: int, command: Drive) -> None:
        g, arrays = self._arrays.ugvs[j], self._arrays
        g["speed"] = command.speed_mps
        if command.path_m == self._paths[j]:
            # the same path again resumes it after a hold; at its end there is nothing left to do
            g["driving"] = int(g["s"] < arrays.path[j, g["n"] - 1, 2])
            return
        self._paths[j] = command.path_m
        points = [(float(g["rx"]), float(g["ry"]))]
        points += [p for k, p in enumerate(command.path_m) if p != (points[0] if k == 0 else command.path_m[k - 1])]
        if len(points) < 2:
            g["driving"] = 0
            return
        if len(points) > arrays.path.shape[1]:
            grown = np.zeros((len(arrays.path), 2 * len(points), 3))
            grown[:, : arrays.path.shape[1]] = arrays.path
            arrays.path = grown
        xy = np.array(points)
        arrays.path[j, : len(xy), :2] = xy
        arrays.path[j, : len(xy), 2] = [0.0, *np.cumsum(np.hypot(*np.diff(xy, axis=0).T))]
        g["n"], g["seg"], g["s"], g["driving"] = len(xy), 0, 0.0, 1


def limited(command: Command, arrays: Arrays, index: int) -> Command:
    """``command`` with the speed that the vehicle itself keeps to at the most; ``index`` is among its kind."""
    match command:
        case TakeOff(vehicle, altitude, speed):
            return TakeOff(vehicle, altitude, min(speed, float(arrays.uavs[index]["climb"])))
        case GoTo(vehicle, position, speed):
            return GoTo(vehicle, position, min(speed, float(arrays.uavs[index]["max_speed"])))
        case Land(vehicle, speed):
            return Land(vehicle, min(speed, float(arrays.uavs[index]["descent"])))
        case Dock(vehicle, onto, dock, speed, abort):
            return Dock(vehicle, onto, dock, min(speed, float(arrays.uavs[index]["descent"])), abort)
        case Drive(vehicle, path, speed):
            return Drive(vehicle, path, min(speed, float(arrays.ugvs[index]["max_speed"])))
    return command


def numbers(command: Command) -> tuple[float, ...]:
    """Every number of a command that must be finite."""
    match command:
        case TakeOff(_, altitude, speed):
            return (altitude, speed)
        case GoTo(_, position, speed):
            return (*position, speed)
        case Land(_, speed):
            return (speed,)
        case Dock(_, _, _, speed, abort):
            return (speed, abort)
        case Drive(_, path, speed):
            return (speed, *(c for point in path for c in point))
    return ()


def is_sound(command: Command) -> bool:
    """Whether every number is finite and the speed, where there is one, is above 0."""
    speed = getattr(command, "speed_mps", 1.0)
    return all(map(math.isfinite, numbers(command))) and speed > 0
