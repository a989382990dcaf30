"""What the planner answers a running mission."""

from __future__ import annotations

import pytest
import world

from deploy.observation import PlanRequest
from deploy.planning import ReplanSettings, answer
from planner.solve import Stop

pytestmark = pytest.mark.slow  # the network's kernels are compiled


def test_an_answer_says_that_search_took_over_from_the_network() -> None:
    problem = world.problem(n_uavs=1, n_ugvs=1, charge_s=1e5)  # a day to charge
    request = PlanRequest(1, problem, (), "test", urgent=False)
    reply = answer(request, ReplanSettings(method="copcs"), Stop(iterations=500))
    assert reply.usable and reply.note is not None
    assert reply.note.startswith("search took over: the network was trained on other problems")
    assert answer(request, ReplanSettings(), Stop(iterations=500)).note is None
