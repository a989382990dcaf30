"""JSON of what is recorded: equal after a round trip, to the last bit."""

from __future__ import annotations

import math
import struct
import time

import fabricated_run
import orjson
import pytest
from hypothesis import given
from hypothesis import strategies as st

from deploy.errors import InputError
from deploy.events import Action as Response
from deploy.events import Event, EventKind, Severity
from deploy.observation import Observation, OperatorInput, PlanReply, PlanRequest, Refusal
from deploy.serial import command_to_json, decode, encode, from_json, plan_from_json, plan_to_json
from deploy.status import Status, VehicleStatus
from drivers.vehicle import (
    Arm,
    Command,
    Disarm,
    Dock,
    Drive,
    GoTo,
    Hold,
    Land,
    Pose,
    StopMotors,
    TakeOff,
    VehicleState,
)
from planner.errors import PlannerError
from planner.plan import Action, Move, Recharge, Visit

number = st.floats(allow_nan=False, allow_infinity=False)
name = st.text(max_size=8)
vec3 = st.tuples(number, number, number)
index = st.integers(0, 10**6)
commands: st.SearchStrategy[Command] = st.one_of(
    st.builds(Arm, name),
    st.builds(Disarm, name),
    st.builds(TakeOff, name, number, number),
    st.builds(GoTo, name, vec3, number),
    st.builds(Land, name, number),
    st.builds(Dock, name, name, index, number, number),
    st.builds(Drive, name, st.lists(st.tuples(number, number), max_size=4).map(tuple), number),
    st.builds(Hold, name),
    st.builds(StopMotors, name),
)
actions: st.SearchStrategy[Action] = st.one_of(
    st.builds(Visit, index, index), st.builds(Move, index, st.none() | index), st.builds(Recharge, index, index)
)
refusals = st.builds(Refusal, commands, name)
wishes = st.sampled_from(["checked", "arm", "start", "hold", "resume", "recover", "stop"])
operator = st.builds(OperatorInput, wishes, st.none() | name, st.none() | st.floats(allow_nan=False))
replies = st.builds(
    PlanReply,
    index,
    st.booleans(),
    st.lists(actions, max_size=5).map(tuple),
    name,
    number,
    st.none() | name,
    note=st.none() | name,
)
states = st.builds(
    VehicleState, name, number, *([st.booleans()] * 6), battery=st.none() | number, fault=st.none() | name
)
observations = st.builds(
    Observation,
    number,
    st.lists(st.builds(Pose, name, vec3, number, number), max_size=3).map(tuple),
    st.lists(states, max_size=3).map(tuple),
    st.lists(operator, max_size=2).map(tuple),
    st.none() | replies,
    st.lists(refusals, max_size=2).map(tuple),
    number,
)
events = st.builds(
    Event,
    number,
    st.sampled_from(EventKind),
    st.sampled_from(Severity),
    st.none() | name,
    st.sampled_from(Response),
    name,
)
statuses = st.builds(
    Status,
    number,
    number,
    name,
    st.lists(st.booleans(), max_size=4).map(tuple),
    index,
    st.none() | number,
    st.lists(
        st.builds(
            VehicleStatus,
            name,
            name,
            name,
            st.none() | vec3,
            number,
            number,
            number,
            name,
            st.none() | vec3,
            st.none() | number,
        ),
        max_size=2,
    ).map(tuple),
)


def bits(value):
    """``value`` with every float as its bits, so that -0.0 and 0.0 differ."""
    if isinstance(value, float):
        return struct.pack("<d", value)
    if isinstance(value, tuple):
        return tuple(map(bits, value))
    slots = getattr(type(value), "__slots__", None)
    return (type(value), *(bits(getattr(value, s)) for s in slots)) if slots else value


@given(observations)
def test_observation(value):
    assert bits(decode(Observation, encode(value))) == bits(value)


@given(st.lists(commands, max_size=5).map(tuple))
def test_commands(value):
    assert bits(from_json(tuple[Command, ...], orjson.loads(encode(value)))) == bits(value)


@pytest.mark.parametrize(
    ("kind", "values"),
    [(Event, events), (Status, statuses), (Refusal, refusals), (OperatorInput, operator), (PlanReply, replies)],
)
def test_the_others(kind, values):
    @given(values)
    def check(value):
        assert bits(decode(kind, encode(value))) == bits(value)

    check()


def test_a_command_says_what_it_is():
    assert command_to_json(Hold("a")) == {"kind": "Hold", "vehicle": "a"}


def test_plan_request_keeps_the_problem():
    request = PlanRequest(3, fabricated_run.problem(), (Visit(0, 1), Move(0, None)), "late", True)
    back = decode(PlanRequest, encode(request))
    assert back.problem.digest == request.problem.digest
    assert (back.number, back.start, back.reason, back.urgent) == (3, request.start, "late", True)


def test_plan_keeps_its_schedule_and_infinite_slack():
    plan = fabricated_run.plan(fabricated_run.FIRST)
    assert any(math.isinf(row.slack_s) for row in plan.schedule.actions)
    assert plan_from_json(orjson.loads(encode(plan))) == plan
    with pytest.raises(PlannerError, match="not a plan"):
        plan_from_json({**plan_to_json(plan), "schedule": None})


def test_what_is_not_finite_in_a_status_becomes_none_or_nan():
    row = VehicleStatus("a", "uav", "flying", None, 0.0, math.nan, math.inf, "", None, math.inf)
    back = decode(Status, encode(Status(0.0, 0.0, "running", (), 0, math.inf, (row,))))
    assert back.predicted_makespan_s is None
    assert back.vehicles[0].slack_s is None
    assert math.isnan(back.vehicles[0].energy_j)


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"[]",
        b"{}",
        b"null",
        b'{"now_s": "x"}',
        b'{"now_s": 1, "later": 2}',
        b'{"now_s": 1, "poses": [{"body": "a", "position_m": ["1", 2, 3], "yaw_rad": 0, "stamp_s": 0}]}',
        b'{"now_s": 1, "refusals": [{"command": {"kind": "Jump"}, "reason": ""}]}',
        b'{"now_s": 1, "operator": [{"wish": "dance"}]}',
    ],
)
def test_damage_is_one_clear_error(data):
    with pytest.raises(InputError, match="damaged"):
        decode(Observation, data)


def test_encoding_is_fast_enough_for_the_loop():
    poses = tuple(Pose(f"uav{i}", (i / 3, i / 7, i / 11), i / 13, 0.1) for i in range(6))
    vehicles = tuple(VehicleState(f"uav{i}", 0.1, True, True, battery=i / 7) for i in range(6))
    observation = Observation(1 / 3, poses, vehicles)
    best = math.inf
    for _ in range(50):
        start = time.perf_counter()
        for _ in range(20):
            encode(observation)
        best = min(best, (time.perf_counter() - start) / 20)
    assert best < 50e-6
