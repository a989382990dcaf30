"""Exact JSON of everything that enters and leaves a turn of the loop; what is decoded equals what was encoded.

Members of a union carry their class name as ``kind``. Finite floats keep every bit (shortest round-trip decimal form).
A float that is not finite is written as null and read as not-a-number, or None where the field allows it; such values
occur only in a ``Status``, and in ``valid_until_s`` of a wish, which is written in words so that infinity survives.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields
from typing import Any, TypeVar, get_args

import cattrs
import orjson

from deploy.errors import InputError
from deploy.observation import Observation, OperatorInput, PlanReply, PlanRequest, Refusal
from deploy.status import VehicleStatus
from drivers.vehicle import Command, Pose, Vec3, VehicleState
from planner.errors import PlannerError
from planner.plan import (
    Action,
    Plan,
    Recovery,
    Schedule,
    ScheduledAction,
    actions_from_json,
    actions_to_json,
)
from planner.problem import Problem

T = TypeVar("T")
_NUMPY = orjson.OPT_SERIALIZE_NUMPY  # a stray numpy scalar must not end a flight
_COMMANDS: dict[str, type[Any]] = {c.__name__: c for c in get_args(Command)}
_NAMES: dict[type[Any], tuple[str, ...]] = {
    c: tuple(f.name for f in fields(c)) for c in (*_COMMANDS.values(), Observation, OperatorInput)
}


def command_to_json(command: Command) -> dict[str, Any]:
    """A command with its class name as ``kind``."""
    kind = type(command)
    return {"kind": kind.__name__, **{name: getattr(command, name) for name in _NAMES[kind]}}


def plan_to_json(plan: Plan) -> dict[str, Any]:
    """The ``copcs-plan/1`` object."""
    return plan.to_json()


def plan_from_json(data: Mapping[str, Any]) -> Plan:
    """Reads a ``copcs-plan/1`` object with its schedule; numbers that are null there are infinite (slack, makespan).

    Raises:
        PlannerError: naming what is wrong.
    """
    try:
        schedule = Schedule(
            feasible=bool(data["feasible"]),
            violation=data["violation"],
            makespan_s=_or_inf(data["makespan_s"]),
            uav_energy_j=_or_inf(data["uav_energy_j"]),
            ugv_energy_j=_or_inf(data["ugv_energy_j"]),
            energy_given_j=_or_inf(data["energy_given_j"]),
            waiting_s=_or_inf(data["waiting_s"]),
            recovery_s=_or_inf(data["recovery_s"]),
            actions=tuple(_row(ScheduledAction, row, ("action", "dock")) for row in data["schedule"]),
            recovery=tuple(_row(Recovery, row, ("uav", "site")) for row in data["recovery"]),
        )
        return Plan(
            actions=actions_from_json(data["actions"]),
            schedule=schedule,
            method=data["method"],
            planning_s=data["planning_s"],
            lower_bound_s=data["lower_bound_s"],
            note=data.get("note"),
        )
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise PlannerError(f"not a plan with its schedule: {error!r}") from error


def _row(kind: type[T], row: Mapping[str, Any], whole: tuple[str, str]) -> T:
    return kind(**{name: value if name in whole else _or_inf(value) for name, value in row.items()})


def _or_inf(value: float | None) -> float:
    return math.inf if value is None else float(value)


def encode(value: object) -> bytes:
    """JSON of an observation, command, event, status, refusal, wish, plan request, plan reply or plan.

    Lists, tuples and dicts of them are fine as well.
    """
    if type(value) is Observation and not (value.refusals or value.operator) and value.plan_reply is None:
        return orjson.dumps(
            value, option=_NUMPY
        )  # nearly every turn: no union inside, so orjson's own dataclass path is exact
    return orjson.dumps(to_json(value), option=_NUMPY)


def to_json(value: object) -> Any:
    """As ``encode``, as objects that orjson writes."""
    kind = type(value)
    if kind in _COMMANDS.values():
        return command_to_json(value)  # type: ignore[arg-type]
    match value:
        case Observation():
            return {name: to_json(getattr(value, name)) for name in _NAMES[Observation]}
        case Refusal():
            return {"command": command_to_json(value.command), "reason": value.reason}
        case OperatorInput():
            return {name: _in_words(getattr(value, name)) for name in _NAMES[OperatorInput]}
        case PlanReply():
            return {**_members(value), "actions": actions_to_json(value.actions)}
        case PlanRequest():
            return {**_members(value), "problem": value.problem.to_json(), "start": actions_to_json(value.start)}
        case Plan():
            return plan_to_json(value)
        case dict():
            return {name: to_json(item) for name, item in value.items()}
        case list() | tuple():
            return [to_json(item) for item in value]
        case _:
            return value  # Pose, VehicleState, Event, Status and plain values need nothing


def _members(value: PlanReply | PlanRequest) -> dict[str, Any]:
    """Every member, so that none is forgotten when one is added."""
    return {f.name: getattr(value, f.name) for f in fields(value)}


def _in_words(value: object) -> object:
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value


def decode(kind: type[T], data: bytes) -> T:
    """The object of class ``kind`` that ``data`` was encoded from.

    Raises:
        InputError: when ``data`` is not JSON of that kind.
    """
    try:
        return from_json(kind, orjson.loads(data))
    except orjson.JSONDecodeError as error:
        raise InputError(f"not JSON: {error}; the recording is damaged") from error


def from_json(kind: type[T], data: Any) -> T:
    """As ``decode``, from JSON objects; ``kind`` may be ``tuple[Command, ...]`` and the like.

    Raises:
        InputError: when ``data`` is not of that kind.
    """
    try:
        return _converter.structure(data, kind)
    except Exception as error:  # cattrs' own roots vary with its version; nothing here but data can be wrong
        name = getattr(kind, "__name__", str(kind))
        raise InputError(f"not a recorded {name} ({error}); the recording is damaged or of another version") from error


def _command(data: Any, _: Any) -> Any:
    kind = _COMMANDS.get(data.get("kind"))
    if kind is None:
        raise ValueError(f"unknown command {data.get('kind')!r}")
    return _converter.structure({k: v for k, v in data.items() if k != "kind"}, kind)


def _float(value: Any, _: Any) -> float:
    return math.nan if value is None else float(value)


def _bool(value: Any, _: Any) -> bool:
    if value is not True and value is not False:
        raise ValueError(f"{value!r} is neither true nor false")
    return value


def _vec3(value: Any) -> Vec3:
    x, y, z = value
    return (x * 1.0, y * 1.0, z * 1.0)  # refuses what is no number, keeps the sign of zero


def _pose(row: Any, _: Any) -> Pose:
    return Pose(row["body"], _vec3(row["position_m"]), row["yaw_rad"] * 1.0, row["stamp_s"] * 1.0)


def _vehicle_state(row: Any, _: Any) -> VehicleState:
    return VehicleState(**row)


def _vehicle_status(row: Any, _: Any) -> VehicleStatus:
    position, goal = row["position_m"], row["goal_m"]
    return VehicleStatus(
        row["vehicle"],
        row["kind"],
        row["phase"],
        None if position is None else _vec3(position),
        _float(row["yaw_rad"], float),
        _float(row["energy_j"], float),
        _float(row["energy_fraction"], float),
        row["doing"],
        None if goal is None else _vec3(goal),
        row["slack_s"],
    )


def _make_converter() -> cattrs.Converter:
    converter = cattrs.Converter(detailed_validation=False, forbid_extra_keys=True)
    converter.register_structure_hook(float, _float)
    converter.register_structure_hook(bool, _bool)
    # by hand, three times as fast: thousands of these are in every minute of a recording
    converter.register_structure_hook(Pose, _pose)
    converter.register_structure_hook(VehicleState, _vehicle_state)
    converter.register_structure_hook(VehicleStatus, _vehicle_status)
    converter.register_structure_hook_func(lambda kind: kind == Command, _command)
    converter.register_structure_hook_func(lambda kind: kind == tuple[Action, ...], lambda v, _: actions_from_json(v))
    converter.register_structure_hook(Problem, lambda value, _: Problem.from_json(value))
    converter.register_structure_hook(Plan, lambda value, _: plan_from_json(value))
    return converter


_converter = _make_converter()
