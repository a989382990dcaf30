"""CP-SAT against HiGHS on the exact method's model: how many small instances each proves, and in which time.

python -m benchmarks.bench_milp [--tasks 7] [--team 2-1] [--instances 10] [--time 60]

HiGHS (scipy's; highspy and OR-Tools cannot be loaded into one process) gets the same model: conditions become big-M
rows with the tightest M, circuits become degrees and orders (Miller, Tucker and Zemlin), docks are left out (they never
bind where there are as many docks as UAVs). Both get the same first plan's length as a limit, and one thread.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from typing import Any

import numpy as np
from ortools.sat.python import cp_model
from scipy.optimize import Bounds, LinearConstraint, milp
from scipy.sparse import csr_array

from planner.instances import DataSet
from planner.milp_data import MAX_RECHARGES, Data
from planner.milp_model import Model
from planner.solve import Stop, solve

KINDS = ("linear", "bool_or", "bool_and", "exactly_one", "circuit", "interval", "cumulative")


class Linear:
    """A CP-SAT model as rows over its variables."""

    def __init__(self, proto: Any) -> None:
        self.rows: list[tuple[list[int], list[float], float, float]] = []
        self.lower = [float(next(iter(v.domain))) for v in proto.variables]
        self.upper = [float(list(v.domain)[-1]) for v in proto.variables]
        self.whole = [1] * len(self.lower)
        self.cost = np.zeros(len(self.lower))
        for index, value in zip(proto.objective.vars, proto.objective.coeffs, strict=True):
            self.cost[index] = float(value)
        for constraint in proto.constraints:
            self.add(constraint)
        self.cost = np.concatenate([self.cost, np.zeros(len(self.lower) - len(self.cost))])

    def row(self, terms: dict[int, float], constant: float, low: float, high: float) -> None:
        """Adds ``low <= terms + constant <= high``."""
        used = [(k, v) for k, v in terms.items() if v]
        self.rows.append(([k for k, _ in used], [v for _, v in used], low - constant, high - constant))

    @staticmethod
    def literal(terms: dict[int, float], ref: int, weight: float) -> float:
        """Adds ``weight`` times a literal; returns the constant that a negation leaves."""
        if ref >= 0:
            terms[ref] = terms.get(ref, 0.0) + weight
            return 0.0
        terms[-ref - 1] = terms.get(-ref - 1, 0.0) - weight
        return weight

    def add(self, c: Any) -> None:
        """Adds a constraint of the model."""
        kind = next(k for k in KINDS if getattr(c, f"has_{k}")())
        conditions = list(c.enforcement_literal)
        if kind == "linear":
            terms: dict[int, float] = {}
            for k, v in zip(c.linear.vars, c.linear.coeffs, strict=True):
                terms[k] = terms.get(k, 0.0) + float(v)
            domain = list(c.linear.domain)  # its -1 is not the last one
            low, high = float(domain[0]), float(domain[-1])
            least = sum(min(v * self.lower[k], v * self.upper[k]) for k, v in terms.items())
            most = sum(max(v * self.lower[k], v * self.upper[k]) for k, v in terms.items())
            for bound, reach, sign in ((low, least, 1.0), (high, most, -1.0)):
                if abs(bound) > 1e17 or sign * (bound - reach) <= 0:
                    continue
                row, constant = dict(terms), 0.0
                big = bound - reach  # what is missing at worst
                for ref in conditions:  # relaxed by ``big`` for each condition that does not hold
                    constant += big + self.literal(row, ref, -big)
                self.row(row, constant, bound if sign > 0 else -np.inf, bound if sign < 0 else np.inf)
        elif kind in ("bool_or", "bool_and", "exactly_one"):
            refs = list(getattr(c, kind).literals)
            for group in [[r] for r in refs] if kind == "bool_and" else [refs]:
                row, constant = {}, 0.0
                for ref in [*group, *(-r - 1 for r in conditions)]:
                    constant += self.literal(row, ref, 1.0)
                self.row(row, constant, 1.0, 1.0 if kind == "exactly_one" else np.inf)
        elif kind == "circuit":
            self.circuit(list(zip(c.circuit.tails, c.circuit.heads, c.circuit.literals, strict=True)))

    def circuit(self, arcs: list[tuple[int, int, int]]) -> None:
        """Adds a circuit through node 0."""
        nodes = sorted({a for a, _, _ in arcs} | {b for _, b, _ in arcs})
        n = len(nodes)
        first = len(self.lower)
        self.lower += [0.0] * n
        self.upper += [float(n)] * n
        self.whole += [0] * n
        for node in nodes:
            for side in (0, 1):
                row, constant = {}, 0.0
                for arc in arcs:
                    if arc[side] == node:
                        constant += self.literal(row, arc[2], 1.0)
                self.row(row, constant, 1.0, 1.0)
        for a, b, ref in arcs:
            if b not in (a, 0):
                row = {first + nodes.index(b): 1.0, first + nodes.index(a): -1.0}
                constant = self.literal(row, ref, -float(n))
                self.row(row, constant, 1.0 - n, np.inf)

    def solve(self, limit_s: float) -> tuple[bool, float, float]:
        """Whether it was proven, the makespan in s and the bound."""
        index = [(r, k) for r, row in enumerate(self.rows) for k in row[0]]
        value = [v for row in self.rows for v in row[1]]
        matrix = csr_array((value, tuple(np.array(index).T)), shape=(len(self.rows), len(self.lower)))
        low, high = [row[2] for row in self.rows], [row[3] for row in self.rows]
        found = milp(
            self.cost, integrality=self.whole, bounds=Bounds(self.lower, self.upper),
            constraints=LinearConstraint(matrix, low, high), options={"time_limit": limit_s, "mip_rel_gap": 1e-6},
        )  # fmt: skip
        value_s = found.fun / 1e3 if found.fun is not None else float("nan")
        return found.status == 0, value_s, (found.mip_dual_bound or 0.0) / 1e3


def main() -> None:
    parser = argparse.ArgumentParser(description="CP-SAT against HiGHS on the same model.")
    parser.add_argument("--tasks", type=int, default=7)
    parser.add_argument("--team", default="2-1")
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--instances", type=int, default=10)
    parser.add_argument("--time", type=float, default=60.0)
    given = parser.parse_args()
    u, g = given.team.split("-")
    one = DataSet("T15-P5", (int(u), int(g)))
    for index in range(given.first, given.first + given.instances):
        problem = one.instance(index)
        n = given.tasks
        problem = replace(problem, tasks=problem.tasks[:n], visited=problem.visited[:n])
        limit = solve(problem, Stop(iterations=200_000), index).plan.makespan_s
        data = Data.of(problem, (), (), limit)
        slots = {v: min(data.most_recharges(v) or 0, MAX_RECHARGES) for v in data.uav_ids}
        model = Model(data, slots).model
        solver = cp_model.CpSolver()
        solver.parameters.num_workers = 1
        solver.parameters.presolve_inclusion_work_limit = 0
        solver.parameters.max_time_in_seconds = given.time
        begun = time.perf_counter()
        status = solver.solve(model)
        took = time.perf_counter() - begun
        bound = solver.best_objective_bound / 1e3
        words = "proven" if status == cp_model.OPTIMAL else "not proven"
        print(f"{given.team} {index}: search {limit:.1f} s, slots {sum(slots.values())}")
        print(f"   CP-SAT {solver.objective_value / 1e3:9.1f} s, bound {bound:9.1f}, {words}, {took:.1f} s")
        begun = time.perf_counter()
        proven, value, bound = Linear(model.proto).solve(given.time)
        took = time.perf_counter() - begun
        words = "proven" if proven else "not proven"
        print(f"   HiGHS  {value:9.1f} s, bound {bound:9.1f}, {words}, {took:.1f} s", flush=True)


if __name__ == "__main__":
    main()
