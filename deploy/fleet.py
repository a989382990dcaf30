"""Everything that a flight needs of the outside, from connecting to closing."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from deploy.display import Display, NullDisplay
from deploy.feeding import PoseFeeder
from deploy.guard import wills_of
from deploy.startup import POSES, connect_all
from drivers.clock import Clock
from drivers.errors import DriverError
from drivers.guardian import Guardian
from drivers.vehicle import PoseSource, SelfCheck, Vehicle
from sim_backends.truth import Truth

CONNECT_S = 30.0
"""So long every vehicle has to answer, where the mission does not say how long."""
CLOSE_S = 5.0
"""So long the links may take to close; then the program goes on without them."""


@dataclass
class Fleet:
    """The vehicles and the motion capture of one mission.

    Attributes:
        vehicles: by id, UAVs first.
        poses: motion capture.
        clock: the loop's.
        name: of the backend, for recordings: ``kinematic``, ``wire`` or ``real``.
        virtual: the clock jumps; nothing waits for the wall clock.
        truth: the simulated world's own audit until now; None where nobody knows.
        planner_delay_s: arena s by which a planning call that begins now is slowed by a scripted fault.
        bodies: vehicle id by body.
        connect_s: deadline for connecting.
        more_checks: findings about the fleet as a whole.
        trouble: which part of a simulation has ended by itself; None while all is well.
        end: what is to be ended after the links.
    """

    vehicles: Mapping[str, Vehicle]
    poses: PoseSource
    clock: Clock
    name: str
    virtual: bool
    truth: Callable[[], Truth] | None = None
    planner_delay_s: Callable[[], float] = lambda: 0.0
    bodies: Mapping[str, str] = field(default_factory=dict)
    connect_s: float = CONNECT_S
    more_checks: Callable[[], Sequence[SelfCheck]] = tuple
    trouble: Callable[[], str | None] = lambda: None
    end: Callable[[], None] = lambda: None
    _feeder: PoseFeeder | None = None
    _guardian: Guardian | None = None

    def connect(self, deadline_s: float | None = None, display: Display | None = None) -> dict[str, str]:
        """Connects motion capture and every vehicle; real ones are fed with poses from then on until ``hand_over``.

        Args:
            deadline_s: on the clock; default: in ``connect_s``.
            display: shown everybody's progress, where it takes any time.

        Returns:
            why somebody could not be reached, by vehicle id and ``poses``; empty when all went well.
        """
        deadline_s = self.clock.now() + self.connect_s if deadline_s is None else deadline_s
        if self.virtual:  # a virtual clock stands still between two calls, and nobody else may move it
            return self._connect_in_turn(deadline_s)
        self._feeder = feeder = PoseFeeder(self.vehicles, self.bodies, self.poses)
        with (display or NullDisplay()).progress() as tell:
            return connect_all(self.vehicles, self.poses, self.clock, deadline_s, tell, feeder.poses_connected)

    def _connect_in_turn(self, deadline_s: float) -> dict[str, str]:
        errors: dict[str, str] = {}
        everybody: dict[str, Vehicle | PoseSource] = {POSES: self.poses, **self.vehicles}
        for name, who in everybody.items():
            try:
                who.connect(deadline_s)
            except DriverError as error:
                errors[name] = str(error)
        return errors

    def checks(self) -> Sequence[SelfCheck]:
        """Findings about the fleet as a whole and about this computer."""
        return (*self.more_checks(), *([self._feeder.timing()] if self._feeder is not None else []))

    @property
    def listening(self) -> PoseSource | PoseFeeder:
        """Where poses are read before the flight."""
        return self._feeder if self._feeder is not None else self.poses

    def hand_over(self) -> None:
        """The loop reads and feeds poses itself from now on."""
        if self._feeder is not None:
            self._feeder.stop()
            self._feeder = None

    def guarded(self, say: Callable[[str], None]) -> Guardian | None:
        """Starts the process that brings everybody down when this one dies; none for bodies that die with it.

        Args:
            say: told when nobody guards any more.
        """
        if not self.virtual:
            self._guardian = Guardian(wills_of(self.vehicles), say=say)
        return self._guardian

    def close(self) -> None:
        """Releases every link and ends every process; call it when everybody is down. A link that hangs is left."""
        self.hand_over()
        if self._guardian is not None:
            self._guardian.close()  # with somebody still under way it takes over here
        everybody: tuple[Vehicle | PoseSource, ...] = (*self.vehicles.values(), self.poses)
        if self.virtual:
            for who in everybody:
                who.close()
        else:
            threads = [threading.Thread(target=_close, args=(who,), daemon=True) for who in everybody]
            for thread in threads:
                thread.start()
            end_s = time.monotonic() + CLOSE_S
            for thread in threads:
                thread.join(max(0.0, end_s - time.monotonic()))
        if self._guardian is not None:
            self._guardian.wait()
        self.end()


def _close(who: Vehicle | PoseSource) -> None:
    with contextlib.suppress(DriverError):
        who.close()
