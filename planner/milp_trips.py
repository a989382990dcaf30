"""One UAV in the exact model: trips between recharges, each a circuit through a hub."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from ortools.sat.python import cp_model

from planner.milp_data import FAR_MS, SLACK_UNITS, UNIT, Data

Literal = Any  # the solver's own types are not annotated
MAX_EXTRA = 50  # charges beyond the slots: more than any task list needs
FINE = 100  # fine energy units (0.1 mJ) in a unit: waiting costs few units a millisecond


@dataclass
class Slot:
    """Recharge ``number`` of a UAV: where, by whom and when; all literals are false where it is not used.

    Attributes:
        at: by site.
        by: by UGV.
        work, size, end: begin of docking, duration and end in ms.
        given: energy given in units; None where nobody asks.
    """

    uav: int
    number: int
    used: Literal
    at: list[Literal]
    by: dict[int, Literal]
    work: Any
    size: Any
    end: Any
    given: Any = None


@dataclass
class Trip:
    """Arcs of trip ``number`` of a UAV with their times (ms) and energies (units).

    Nodes: 0 is the hub, 1..M are tasks, then come the sites that it may start from, then those that it may fly to.
    A task or site that is not used has a loop; so has the hub of a trip that is not flown.
    """

    uav: int
    number: int
    model: cp_model.CpModel
    arcs: dict[tuple[int, int], Literal] = field(default_factory=dict)
    lengths: dict[tuple[int, int], int] = field(default_factory=dict)
    times: list[tuple[int, Literal]] = field(default_factory=list)
    costs: list[tuple[int, Literal]] = field(default_factory=list)

    def fly(self, start: int, end: int, time: int, cost: int) -> Literal:
        """A new arc."""
        literal = self.arcs[start, end] = self.model.new_bool_var("")
        self.lengths[start, end] = time
        self.times.append((time, literal))
        self.costs.append((cost, literal))
        return literal


class UavModel:
    """Trips and slots of UAV ``u``, in order of flight; ``served[k]`` holds who serves task ``k`` on which trip.

    Where ``more``, plans with more recharges than slots must not be ruled out: then the last trip may use more than one
    charge, and pays for it in time as if a UGV flew along. That can only be too good. ``extra`` is how many charges.
    """

    def __init__(
        self,
        data: Data,
        model: cp_model.CpModel,
        u: int,
        recharges: int,
        more: bool,
        makespan: Any,
        served: list[list[Literal]],
    ) -> None:
        self.data, self.model, self.u = data, model, u
        self.uav = data.problem.uavs[u]
        self.ms, self.units, self.home = data.fly_ms(u), data.fly_units(u), data.home_units(u)
        self.trips: list[Trip] = []
        self.slots: list[Slot] = []
        self.extra: Any = None
        self.served = served
        ready = int(self.uav.ready_s * 1000.0)
        busy: list[Any] = []  # everything the UAV does takes that long, one after the other
        needs: list[Any] = []
        for j in range(recharges + 1):
            depart = ready if j == 0 else self.slots[j - 1].end
            slot = self._slot(j) if j < recharges else None
            trip = Trip(u, j, model)
            visiting, flying = self._circuit(trip, slot)
            self.trips.append(trip)
            busy.append(flying)
            budget = data.budget_units(u, j)
            if budget < 0:
                model.add_bool_or([False])
            top: Any = max(budget, 0)
            if slot is None and more:
                self.extra, charging = self._extra()
                busy.append(charging)
                visiting += charging
                top += MAX_EXTRA * max(0, data.budget_units(u, 1))
            need = model.new_int_var(0, top, "")
            model.add(need == sum(cost * literal for cost, literal in trip.costs))
            if slot is None and more:
                self._pay(need - budget, charging)
            model.add(makespan >= depart + visiting)
            needs.append(need)
            if slot is not None:
                model.add(slot.work >= depart + flying)
                busy.append(sum(data.recharge_ms(g) * slot.by[g] for g in data.ugv_ids))
                self._charging(slot, self._waiting(slot, need, depart + flying, budget), j)
                self.slots.append(slot)
        model.add(makespan >= ready + sum(busy))
        if data.lean:
            for slot in self.slots:
                j = slot.number
                least = data.charge_units(u, j) - SLACK_UNITS
                model.add(needs[j] + needs[j + 1] >= least).only_enforce_if(slot.used)

    def _circuit(self, trip: Trip, slot: Slot | None) -> tuple[Any, Any]:
        """Adds the arcs; returns the time to the last task and the whole flying time."""
        d, model = self.data, self.model
        n, s = len(d.tasks), d.n_sites
        ms, units = self.ms.tolist(), self.units.tolist()
        budget = d.budget_units(self.u, trip.number)
        before = self.slots[-1] if self.slots else None
        out0, in0 = n + 1, n + 1 + s
        if before is None:
            starts = [(0, 0)]  # node, row of the tables
            hub = trip.arcs[0, 0] = model.new_bool_var("")  # the UAV stays where it is
            if self.home[0] > budget:
                model.add_bool_or([~hub])
        else:
            starts = [(out0 + p, 1 + n + p) for p in range(s)]
            hub = trip.arcs[0, 0] = ~before.used
            for p in range(s):
                trip.arcs[0, out0 + p] = before.at[p]
                trip.arcs[out0 + p, out0 + p] = ~before.at[p]
        ends = []
        for k in range(n):
            loop = trip.arcs[k + 1, k + 1] = model.new_bool_var("")
            self.served[k].append(~loop)
            model.add_implication(~loop, ~hub)  # else tasks could go in circles without the hub
            for node, row in starts:
                if units[row][k] <= budget:
                    trip.fly(node, k + 1, ms[row][k], units[row][k])
            for other in range(n):
                if other != k:
                    trip.fly(other + 1, k + 1, ms[other + 1][k], units[other + 1][k])
            ends.append(trip.fly(k + 1, 0, 0, int(self.home[k + 1])))  # the recovery: energy, but no time
        visiting = sum(time * literal for time, literal in trip.times)
        if slot is not None:
            for p in range(s):
                trip.arcs[in0 + p, 0] = slot.at[p]
                trip.arcs[in0 + p, in0 + p] = ~slot.at[p]
                for k in range(n):
                    trip.fly(k + 1, in0 + p, ms[k + 1][n + p], units[k + 1][n + p])
                for node, row in starts:
                    again = before is not None and node == out0 + p
                    if units[row][n + p] <= budget and not (again and d.lean):
                        trip.fly(node, in0 + p, ms[row][n + p], units[row][n + p])
            model.add_implication(slot.used, ~hub)
        if before is not None:  # nobody recharges without flying on
            model.add_bool_or([~before.used, *ends, *([] if slot is None else [slot.used])])
        model.add_circuit([(a, b, literal) for (a, b), literal in trip.arcs.items()])
        return visiting, sum(time * literal for time, literal in trip.times)

    def _slot(self, j: int) -> Slot:
        d, model = self.data, self.model
        used = model.new_bool_var("")
        at = [model.new_bool_var("") for _ in range(d.n_sites)]
        by = {g: model.new_bool_var("") for g in d.ugv_ids}
        model.add_exactly_one([*at, ~used])
        model.add_exactly_one([*by.values(), ~used])
        work, size, end = (model.new_int_var(0, d.limit_ms, "") for _ in range(3))
        model.add(end == work + size)
        soonest = {g: [min(int(t), FAR_MS) for t in d.reach_ms(g)] for g in d.ugv_ids}
        for g, times in soonest.items():
            for p, time in enumerate(times):
                if time > d.limit_ms:
                    model.add_bool_or([~at[p], ~by[g]])
            reach = sum(min(t, d.limit_ms) * x for t, x in zip(times, at, strict=True))
            model.add(work >= reach).only_enforce_if(by[g])
        first = [min(d.limit_ms, *(times[p] for times in soonest.values())) for p in range(d.n_sites)]
        model.add(work >= sum(t * x for t, x in zip(first, at, strict=True)))  # the same without a condition
        return Slot(self.u, j, used, at, by, work, size, end)

    def _extra(self) -> tuple[Any, Any]:
        """Charges beyond the slots, and the time that they take."""
        return self.model.new_int_var(0, MAX_EXTRA, ""), self.model.new_int_var(0, self.data.limit_ms, "")

    def _pay(self, over: Any, charging: Any) -> None:
        """``over`` units more than one charge are used on the last trip."""
        d, model = self.data, self.model
        model.add(over <= max(0, d.budget_units(self.u, 1)) * self.extra)
        model.add(charging >= d.least_recharge_ms * self.extra)
        watts = [d.problem.ugvs[g].charge_w for g in d.ugv_ids]
        if all(w is not None for w in watts):
            per_ms = int(max(w for w in watts if w is not None) * UNIT * FINE / 1000.0) + 1
            model.add(per_ms * (charging + 1) >= FINE * over)

    def _waiting(self, slot: Slot, need: Any, arrive: Any, budget: int) -> Any:
        """Energy used at docking, in fine units; it must not exceed the budget."""
        if self.uav.waiting == "landed" or self.uav.hover_w == 0.0:
            return FINE * need
        d, model = self.data, self.model
        wait = model.new_int_var(0, d.limit_ms, "")
        model.add(wait >= slot.work - arrive).only_enforce_if(slot.used)
        used = FINE * need + int(self.uav.hover_w * UNIT * FINE / 1000.0) * wait
        model.add(used <= FINE * budget)
        return used

    def _charging(self, slot: Slot, used: Any, j: int) -> None:
        """How long the recharge takes, and how much the UGV gives."""
        d, model, uav = self.data, self.model, self.uav
        over = uav.energy_j - uav.capacity_j  # at the start, and possibly ever after
        missing = int(-over * UNIT * FINE) - 1 if j == 0 else -int(max(0.0, over) * UNIT * FINE) - 1
        for g in d.ugv_ids:
            ugv = d.problem.ugvs[g]
            model.add(slot.size >= d.recharge_ms(g)).only_enforce_if(slot.by[g])
            if ugv.charge_w is not None:
                per_ms = int(ugv.charge_w * UNIT * FINE / 1000.0) + 1
                charging = slot.size - d.recharge_ms(g) + 1
                model.add(per_ms * charging >= used + missing).only_enforce_if(slot.by[g])
        if not d.ugvs_have_plenty:
            slot.given = model.new_int_var(0, max(1, int(uav.capacity_j * UNIT)), "")
            model.add(FINE * slot.given + FINE >= used + missing).only_enforce_if(slot.used)
