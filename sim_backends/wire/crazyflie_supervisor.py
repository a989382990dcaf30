"""The firmware's supervisor: who may arm, when motors may run, when it is over until a reboot.

Source: ``supervisor.c`` and ``supervisor_state_machine.c`` of the firmware. Times are the firmware's, in s.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum, auto

from sim_backends.wire.crazyflie_planner import Phase

(
    CAN_BE_ARMED,
    ARMED,
    AUTO_ARM,
    CAN_FLY,
    FLYING,
    TUMBLED,
    LOCKED,
    CRASHED,
    HL_ACTIVE,
    HL_FINISHED,
    HL_DISABLED,
    DECK_FAULT,
) = (1 << bit for bit in range(12))

IS_FLYING_S = 2.0
"""It calls itself flying this long after the motors ran for the last time."""
LEVEL_OUT_S, SHUTDOWN_S = 0.5, 2.0
"""Age of the newest set-point in flight."""
WATCHDOG_S = 1.0
"""Between two packets of the emergency-stop watchdog, once it is on."""


class State(Enum):
    """States of ``supervisor_state_machine.c``."""

    NOT_READY = auto()
    CHECKS_PASSED = auto()
    READY = auto()
    FLYING = auto()
    LANDED = auto()
    RESET = auto()
    LEVEL_OUT = auto()
    FREE_FALL = auto()
    LOCKED = auto()
    CRASHED = auto()


MOTORS_MAY_RUN = {State.READY, State.FLYING, State.LEVEL_OUT, State.LANDED}
STAYS_ARMED = MOTORS_MAY_RUN


@dataclass(frozen=True, slots=True)
class Inputs:
    """What the supervisor looks at in each step.

    Attributes:
        now_s: the firmware's clock.
        thrust: the motors run above idle.
        setpoint_s: time stamp of the newest set-point.
        tilted: it lies on its side or back.
    """

    now_s: float
    thrust: bool
    setpoint_s: float
    tilted: bool


class Supervisor:
    """The state machine with its timers."""

    def __init__(self, auto_arm: bool, modern: bool, say: Callable[[str], None]) -> None:
        """Starts as after a reboot.

        Args:
            auto_arm: brushed motors: it arms itself.
            modern: it knows disarming by time and recovery from a crash; older firmware locks instead.
            say: prints on the console.
        """
        self._auto_arm, self._modern, self._say = auto_arm, modern, say
        self.state = State.NOT_READY
        self.armed = self.crashed = self.stopped = self.tumbled = False
        self.preflight_s, self.landed_s = 30.0, 3.0
        self._thrust_s: float | None = None
        self._entered_s = 0.0
        self._watchdog_s: float | None = None

    @property
    def may_run(self) -> bool:
        """Motors may run: ``can fly``."""
        return self.state in MOTORS_MAY_RUN

    @property
    def locked(self) -> bool:
        """Until a reboot."""
        return self.state is State.LOCKED

    def arm(self, arm: bool) -> bool:
        """Asks for arming or disarming; false when it is refused."""
        if arm and not self.armed and self.state is not State.CHECKS_PASSED:
            return False
        self.armed = arm
        return True

    def recover(self) -> bool:
        """Asks to recover from a crash; false while it still lies there."""
        if self.crashed and self.tumbled:
            return False
        self.crashed = False
        return True

    def emergency_stop(self) -> None:
        """Stops the motors and locks, with the next step that allows it."""
        self.stopped = True

    def watchdog(self, now_s: float) -> None:
        """A packet of the emergency-stop watchdog: from now on they must keep coming."""
        self._watchdog_s = now_s

    def step(self, inputs: Inputs) -> None:
        """One step."""
        now_s = inputs.now_s
        if inputs.thrust:
            self._thrust_s = now_s
        flying = self._thrust_s is not None and now_s - self._thrust_s < IS_FLYING_S
        self.tumbled = inputs.tilted
        stop = self.stopped or (self._watchdog_s is not None and now_s - self._watchdog_s > WATCHDOG_S)
        new = self._next(inputs, flying, stop)
        if new is not self.state:
            self._enter(new, now_s)

    def _next(self, inputs: Inputs, flying: bool, stop: bool) -> State:
        state, in_state_s = self.state, inputs.now_s - self._entered_s
        age_s = inputs.now_s - inputs.setpoint_s
        if state is State.NOT_READY:
            return State.FREE_FALL if stop else state if self.tumbled else State.CHECKS_PASSED
        if state is State.CHECKS_PASSED:
            if stop:
                return State.FREE_FALL
            return State.NOT_READY if self.tumbled else State.READY if self.armed else state
        if state is State.READY:
            if stop:
                return State.FREE_FALL
            if self.tumbled or not self.armed:
                return State.NOT_READY
            if self._modern and in_state_s > self.preflight_s:
                return State.CHECKS_PASSED
            return State.FLYING if flying else state
        if state is State.FLYING or state is State.LEVEL_OUT:
            if stop or age_s > SHUTDOWN_S or not self.armed:
                return State.FREE_FALL
            if self.tumbled:
                return State.CRASHED if self._modern and state is State.FLYING else State.FREE_FALL
            if age_s > LEVEL_OUT_S:
                return State.LEVEL_OUT
            return State.FLYING if flying or state is State.LEVEL_OUT else State.LANDED
        if state is State.LANDED:  # as in the firmware, a stop takes effect when this state is over
            if not self._modern or in_state_s > self.landed_s:
                return State.RESET
            return State.FLYING if flying else state
        if state is State.RESET:
            return State.NOT_READY
        if state is State.CRASHED:
            return State.LOCKED if stop else state if self.crashed or self.tumbled else State.NOT_READY
        return State.LOCKED

    def _enter(self, new: State, now_s: float) -> None:
        old, self.state, self._entered_s = self.state, new, now_s
        if new is State.READY and not self._auto_arm:
            self._say("SUP: Ready to fly\n")
        if old in STAYS_ARMED and new in (State.RESET, State.CHECKS_PASSED) and not self._auto_arm:
            self._say("SUP: Disarming\n")
        if new is State.LOCKED:
            self._say("SUP: Locked, reboot required\n")
        if new is State.CRASHED:
            self._say("SUP: Crashed, recovery required\n")
            self.crashed = True
        if new not in STAYS_ARMED:
            self.armed = False
        if self._auto_arm and new is State.CHECKS_PASSED:
            self.armed = True

    def info(self, phase: Phase, finished: bool) -> int:
        """The state bits, with those of the high-level commander where this firmware has them.

        ``HL_DISABLED`` and ``DECK_FAULT`` are never set: a low-level set-point stops the planner here, as in
        ``commander.c``, instead of disabling it, and there are no decks.
        """
        bits = CAN_BE_ARMED if self.state is State.CHECKS_PASSED else 0
        bits |= ARMED if self.armed else 0
        bits |= AUTO_ARM if self._auto_arm else 0
        bits |= CAN_FLY if self.may_run else 0
        bits |= FLYING if self.state in (State.FLYING, State.LEVEL_OUT) else 0
        bits |= TUMBLED if self.tumbled else 0
        bits |= LOCKED if self.locked else 0
        bits |= CRASHED if self.crashed else 0
        if self._modern:
            bits |= HL_ACTIVE if phase is not Phase.IDLE else 0
            bits |= HL_FINISHED if finished else 0
        return bits
