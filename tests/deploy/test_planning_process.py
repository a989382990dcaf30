"""The planner in its own process: answers, and survives its own death."""

from __future__ import annotations

import time

import pytest
import world

from deploy.observation import PlanReply, PlanRequest
from deploy.planning import ProcessPlanner, ReplanSettings

pytestmark = pytest.mark.slow


def reply_of(planner: ProcessPlanner, number: int, limit_s: float = 120.0) -> PlanReply:
    planner.submit(PlanRequest(number, world.problem(n_uavs=1, n_ugvs=1), (), "test", urgent=False), 0.0)
    end_s = time.monotonic() + limit_s
    while time.monotonic() < end_s:
        if (reply := planner.poll(0.0)) is not None:
            return reply
        time.sleep(0.05)
    raise AssertionError("no reply")


def test_it_answers_and_a_dead_worker_is_an_answer_too() -> None:
    planner = ProcessPlanner(ReplanSettings(time_s=0.2))
    try:
        reply = reply_of(planner, 1)
        assert reply.number == 1 and reply.usable and reply.feasible
        for process in planner._pool._processes.values():
            process.kill()
        assert reply_of(planner, 2).number == 2  # usable or not, depending on when the death is noticed
        again = reply_of(planner, 3)
        assert again.number == 3 and again.usable and again.feasible
    finally:
        planner.close()
