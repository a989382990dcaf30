"""Any network that plans, from its weights file."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from planner.policy.config import PlusConfig
from planner.policy.decode import Policy
from planner.policy.paper_decode import PaperPolicy
from planner.policy.weights import read


@cache
def network(path: Path) -> Policy | PaperPolicy:
    """The network in a weights file, once in a program for each file.

    Raises:
        PlannerError: where it is missing, damaged, or of no network.
    """
    config, _, _ = read(path)
    return Policy.load(path) if isinstance(config, PlusConfig) else PaperPolicy.load(path)
