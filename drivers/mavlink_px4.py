"""PX4's dialect (1.14 to 1.16). Sources: ``px4_custom_mode.h``, ``commander_params.c``, its page on offboard mode."""

from __future__ import annotations

from drivers import mavlink_words as w
from drivers.mavlink_dialect import Dialect, Parameters
from drivers.vehicle import SelfCheck

OFFBOARD, AUTO, LAND = 6, 4, 6
OFFBOARD_LOSS = {
    0: "goes to position mode", 1: "goes to altitude mode", 2: "goes to manual mode", 3: "returns", 4: "lands",
    5: "holds", 6: "terminates", 7: "disarms",
}  # fmt: skip
LINK_LOSS = {0: "does nothing", 1: "holds", 2: "returns", 3: "lands", 5: "terminates", 6: "disarms"}


def custom_mode(main: int, sub: int = 0) -> int:
    """PX4's ``custom_mode`` of a main and a sub mode."""
    return main << 16 | sub << 24


def mode_name(mode: int) -> str:
    """``custom_mode`` in words."""
    main, sub = mode >> 16 & 0xFF, mode >> 24 & 0xFF
    if main == AUTO and sub in w.PX4_AUTO:
        return w.PX4_AUTO[sub]
    return w.PX4_MAIN.get(main, f"mode {mode:#x}")


def by_pilot(mode: int) -> bool:
    """A pilot steers."""
    return mode >> 16 & 0xFF in w.PX4_PILOT


def copter_death(parameters: Parameters, system_id: int) -> list[SelfCheck]:
    """What PX4 does with a copter when this program dies: set-points and heartbeats stop."""
    return [_offboard(parameters, safe=(4,), wanted="4 (land)"), _link(parameters, safe=(3,), wanted="3 (land)")]


def rover_death(parameters: Parameters, system_id: int) -> list[SelfCheck]:
    """The same for a rover, for which holding is enough."""
    return [
        _offboard(parameters, safe=(4, 5, 7), wanted="5 (hold)"),
        _link(parameters, safe=(1, 3, 6), wanted="1 (hold)"),
    ]


def _offboard(parameters: Parameters, safe: tuple[int, ...], wanted: str) -> SelfCheck:
    name = "set-point loss"
    action, after_s = parameters.get("COM_OBL_RC_ACT"), parameters.get("COM_OF_LOSS_T")
    if action is None or after_s is None:
        return SelfCheck(name, "not run", "COM_OBL_RC_ACT or COM_OF_LOSS_T could not be read; look them up by hand")
    does = OFFBOARD_LOSS.get(round(action), f"does {action:g}")
    if round(action) not in safe:
        text = f"when set-points stop it {does} (COM_OBL_RC_ACT); set it to {wanted}"
        return SelfCheck(name, "warn", text, after_s, "s")
    if after_s > 3.0:
        text = f"waits {after_s:g} s before it {does} (COM_OF_LOSS_T); set it to 1"
        return SelfCheck(name, "warn", text, after_s, "s")
    return SelfCheck(name, "pass", f"{does} {after_s:g} s after set-points stop", after_s, "s")


def _link(parameters: Parameters, safe: tuple[int, ...], wanted: str) -> SelfCheck:
    name = "link loss"
    action = parameters.get("NAV_DLL_ACT")
    if action is None:
        return SelfCheck(name, "not run", "NAV_DLL_ACT could not be read; look it up by hand")
    does = LINK_LOSS.get(round(action), f"does {action:g}")
    if round(action) not in safe:
        return SelfCheck(name, "warn", f"without heartbeats it {does} (NAV_DLL_ACT); set it to {wanted}")
    return SelfCheck(name, "pass", f"{does} without heartbeats")


PARAMETERS = ("COM_OF_LOSS_T", "COM_OBL_RC_ACT", "NAV_DLL_ACT", "COM_DL_LOSS_T", "COM_RC_IN_MODE", "COM_DISARM_LAND")
COPTER = Dialect(
    name="PX4",
    guided=custom_mode(OFFBOARD),
    guided_parameters=(OFFBOARD, 0.0),
    landing_parameters=(AUTO, LAND),
    streams_on_ground=True,
    lifts_by_command=False,
    turns_on_spot_by_rate=False,
    terminates=True,
    bytewise=True,
    wants_origin=False,
    estimator=("ESTIMATOR_STATUS", w.ESTIMATOR_STATUS),
    parameters=(*PARAMETERS, "EKF2_EV_CTRL"),
    returns=frozenset(custom_mode(AUTO, sub) for sub in (5, LAND, 9)),
    mode_name=mode_name,
    by_pilot=by_pilot,
    death_checks=copter_death,
)
ROVER = Dialect(
    name="PX4",
    guided=custom_mode(OFFBOARD),
    guided_parameters=(OFFBOARD, 0.0),
    landing_parameters=None,
    streams_on_ground=True,
    lifts_by_command=False,
    turns_on_spot_by_rate=False,
    terminates=True,
    bytewise=True,
    wants_origin=False,
    estimator=("ESTIMATOR_STATUS", w.ESTIMATOR_STATUS),
    parameters=PARAMETERS,
    returns=frozenset(),
    mode_name=mode_name,
    by_pilot=by_pilot,
    death_checks=rover_death,
)
