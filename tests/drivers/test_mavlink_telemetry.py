"""Messages become telemetry, telemetry becomes findings; with pymavlink's own message objects."""

from __future__ import annotations

import math
import struct
from pathlib import Path
from typing import Any

import pytest

from drivers import mavlink_ardupilot, mavlink_px4
from drivers.errors import DriverError
from drivers.geodesy import GeoFrame
from drivers.limits import Pads
from drivers.mavlink_checks import Shown, findings
from drivers.mavlink_frames import MavlinkFrame
from drivers.mavlink_link import mavlink as m
from drivers.mavlink_link import read_key
from drivers.mavlink_options import MavlinkOptions
from drivers.mavlink_pad import PadTracker
from drivers.mavlink_telemetry import TUMBLED_S, Telemetry, parameter_value, version_text
from drivers.vehicle import Pose

INSIDE, OUTSIDE = MavlinkFrame(), MavlinkFrame(GeoFrame(48.0, 11.0), 500.0)


def told(*messages: Any, frame: MavlinkFrame = INSIDE, at_s: float = 1.0) -> Telemetry:
    t = Telemetry()
    for message in messages:
        t.take(message, at_s, frame)
    return t


def heartbeat(armed: bool = False, mode: int = 4, status: int = 3) -> Any:
    return m.MAVLink_heartbeat_message(2, 3, 1 | (128 if armed else 0), mode, status, 3)


def battery(percent: int = 80, current_ca: int = -1, state: int = 0, number: int = 0) -> Any:
    return m.MAVLink_battery_status_message(number, 0, 1, 2000, [4000] * 10, current_ca, 0, 0, percent, 0, state)


def attitude(roll: float, boot_ms: int = 1000) -> Any:
    return m.MAVLink_attitude_message(boot_ms, roll, 0.0, 0.5, 0.0, 0.0, 0.0)


def test_heartbeats_tell_arming_mode_and_kind() -> None:
    t = told(heartbeat(armed=True, mode=9, status=4))
    assert (t.armed, t.custom_mode, t.system_status, t.autopilot, t.type) == (True, 9, 4, 3, 2)
    assert t.heartbeat_s == t.stamp_s == 1.0


@pytest.mark.parametrize(
    ("state", "on_ground", "airborne"), [(1, True, False), (2, False, True), (3, False, True), (4, False, True)]
)
def test_landed_states(state: int, on_ground: bool, airborne: bool) -> None:
    t = told(heartbeat(armed=True), m.MAVLink_extended_sys_state_message(0, state))
    assert (t.on_ground, t.airborne) == (on_ground, airborne)


def test_an_unknown_landed_state_changes_nothing() -> None:
    landed = m.MAVLink_extended_sys_state_message(0, 1)
    assert told(landed, m.MAVLink_extended_sys_state_message(0, 0)).on_ground


@pytest.mark.parametrize(
    ("message", "charging"),
    [
        (battery(state=7), True),
        (battery(current_ca=-150), True),
        (battery(current_ca=300), False),
        (battery(state=1), False),
        (battery(), None),
    ],
)
def test_charging_by_state_or_current(message: Any, charging: bool | None) -> None:
    assert told(message).charging is charging


def test_battery_levels() -> None:
    assert told(battery(55)).battery == pytest.approx(0.55)
    assert told(battery(-1)).battery is None
    assert told(battery(55), battery(10, number=1)).battery == pytest.approx(0.55), (
        "the second battery is not the first"
    )


def test_tumbled_is_leaning_for_a_while() -> None:
    t = told(attitude(math.pi))
    assert not t.tumbled(1.0)
    assert t.tumbled(1.0 + TUMBLED_S)
    t.take(attitude(0.2), 2.0, INSIDE)
    assert not t.tumbled(9.0)


def test_local_positions_are_for_inside_and_global_ones_for_outside() -> None:
    local = m.MAVLink_local_position_ned_message(0, 2.0, 1.0, -3.0, 0.2, 0.1, -0.3)
    world = m.MAVLink_global_position_int_message(0, 480000000, 110000000, 512000, 0, 10, 20, -30, 65535)
    t = told(local, world)
    assert t.position_m == (1.0, 2.0, 3.0)
    assert t.velocity_mps == pytest.approx((0.1, 0.2, 0.3))
    t = told(world, local, frame=OUTSIDE)
    assert t.position_m == pytest.approx((0.0, 0.0, 12.0), abs=0.02)
    assert t.velocity_mps == pytest.approx((0.2, 0.1, 0.3))


def test_no_fix_is_no_position() -> None:
    nowhere = m.MAVLink_global_position_int_message(0, 0, 0, 0, 0, 0, 0, 0, 0)
    assert told(nowhere, frame=OUTSIDE).position_m is None
    nan = m.MAVLink_local_position_ned_message(0, math.nan, 0.0, 0.0, 0.0, 0.0, 0.0)
    assert told(nan).position_m is None


def test_a_clock_that_goes_back_is_a_reboot() -> None:
    assert not told(attitude(0.0, 60_000), attitude(0.0, 59_900)).rebooted
    assert told(attitude(0.0, 60_000), attitude(0.0, 900)).rebooted
    assert told(*(attitude(0.0, ms) for ms in (900_000, 70_000, 70_050))).rebooted


def test_a_late_packet_is_no_reboot() -> None:
    t = told(*(attitude(0.0, ms) for ms in (900_000, 896_000, 900_050, 896_100, 900_100)))
    assert not t.rebooted
    assert t.boot_ms == 900_100


def test_who_is_armed_was_not_rebooted() -> None:
    late = [attitude(0.0, ms) for ms in (900_000, 896_000, 896_050)]
    assert told(*late).rebooted
    assert not told(*late, heartbeat(armed=True)).rebooted
    assert told(*late, heartbeat(armed=False)).rebooted


def test_long_texts_are_put_together() -> None:
    first = m.MAVLink_statustext_message(2, b"Arming denied: Resolve system health fail", 7, 0)
    t = told(first, m.MAVLink_statustext_message(2, b"ures first", 7, 1))
    assert t.why(0.0) == "Arming denied: Resolve system health failures first"


def test_reasons_are_recent_and_grave() -> None:
    t = told(m.MAVLink_statustext_message(4, b"old"), at_s=1.0)
    t.take(m.MAVLink_statustext_message(6, b"chatter"), 5.0, INSIDE)
    t.take(m.MAVLink_statustext_message(2, b"no position"), 5.0, INSIDE)
    assert t.why(4.0) == "no position"


def test_parameters_of_both_encodings() -> None:
    as_bytes = struct.unpack("<f", struct.pack("<i", 4))[0]
    assert parameter_value(as_bytes, 6, bytewise=True) == 4.0
    assert parameter_value(4.0, 6, bytewise=False) == 4.0
    assert parameter_value(1.5, 9, bytewise=True) == 1.5
    minus = struct.unpack("<f", struct.pack("<i", -1))[0]
    assert parameter_value(minus, 6, bytewise=True) == -1.0


@pytest.mark.parametrize(
    ("version", "text"),
    [(0x011000FF, "1.16.0"), (0x040600C1, "4.6.0 release candidate"), (0x01100040, "1.16.0 (not a")],
)
def test_versions(version: int, text: str) -> None:
    assert version_text(version).startswith(text)


# ----------------------------------------------------------------------------------------------------- checks


def shown(t: Telemetry, *, outdoors: bool = False, pose: Pose | None = None, **others: Any) -> dict[str, str]:
    values = {"kind": "uav", "dialect": mavlink_ardupilot.COPTER, "options": MavlinkOptions(), "parameters": {}}
    found = findings(Shown(telemetry=t, outdoors=outdoors, pose=pose, now_s=1.0, **(values | others)))
    assert len({f.name for f in found}) == len(found)
    assert all(f.text for f in found)
    return {f.name: f.verdict for f in found}


def health(bits: int) -> Any:
    return m.MAVLink_sys_status_message(bits, bits, bits, 0, 15000, -1, 80, 0, 0, 0, 0, 0, 0)


def good() -> Telemetry:
    local = m.MAVLink_local_position_ned_message(0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    ekf = m.MAVLink_ekf_status_report_message(0b111111, 0.1, 0.1, 0.1, 0.1, 0.1)
    version = m.MAVLink_autopilot_version_message(0, 0x040600FF, 0, 0, 0, [0] * 8, [0] * 8, [0] * 8, 0, 0, 0)
    return told(heartbeat(), local, ekf, version, battery(80, state=1), health(1 << 28 | 1 << 16))


def test_a_good_vehicle_passes() -> None:
    got = shown(good(), pose=Pose("b", (0.0, 0.0, 0.0), 0.0, 1.0))
    names = ("firmware", "mode", "estimator", "position", "battery", "charger", "pre-arm", "remote control", "radio")
    assert {name: got[name] for name in names} == dict.fromkeys(names, "pass")


def test_a_silent_vehicle_is_not_run_and_never_a_crash() -> None:
    got = shown(Telemetry())
    assert got["firmware"] == got["estimator"] == got["pre-arm"] == got["link loss"] == "not run"
    assert got["position"] == "fail"


@pytest.mark.parametrize(
    ("change", "name", "verdict"),
    [
        (heartbeat(armed=True), "mode", "warn"),
        (m.MAVLink_ekf_status_report_message(0b10000001, 0.1, 0.1, 0.1, 0.1, 0.1), "estimator", "fail"),
        (m.MAVLink_local_position_ned_message(0, 2.0, 0.0, 0.0, 0.0, 0.0, 0.0), "position", "fail"),
        (battery(10, state=1), "battery", "warn"),
        (health(1 << 16), "pre-arm", "not run"),
        (m.MAVLink_sys_status_message(1 << 28, 0, 0, 0, 15000, -1, 80, 0, 0, 0, 0, 0, 0), "pre-arm", "warn"),
        (health(1 << 28), "remote control", "not run"),
        (
            m.MAVLink_autopilot_version_message(0, 0x040000FF, 0, 0, 0, [0] * 8, [0] * 8, [0] * 8, 0, 0, 0),
            "firmware",
            "warn",
        ),
    ],
)
def test_each_shortcoming_shows(change: Any, name: str, verdict: str) -> None:
    t = good()
    t.take(change, 1.0, INSIDE)
    assert shown(t, pose=Pose("b", (0.0, 0.0, 0.0), 0.0, 1.0))[name] == verdict


@pytest.mark.parametrize(("fix", "verdict"), [(1, "fail"), (3, "warn"), (6, "pass")])
def test_satellites(fix: int, verdict: str) -> None:
    t = good()
    t.take(m.MAVLink_gps_raw_int_message(0, fix, 0, 0, 0, 60, 90, 0, 0, 17), 1.0, OUTSIDE)
    assert shown(t, outdoors=True)["satellites"] == verdict


def test_signing_and_radio() -> None:
    assert shown(good())["signing"] == "not run"
    assert shown(good(), signing=True)["signing"] == "pass"
    assert shown(good(), signing=True, unsigned=3)["signing"] == "warn"
    assert shown(good(), signing=True, key_is_open=True)["signing"] == "warn"
    assert shown(good(), lost=0.3)["radio"] == "warn"
    assert shown(good(), streams_missing=("ATTITUDE",))["radio"] == "warn"


def test_both_dialects_have_checks_of_their_own() -> None:
    assert "set-point loss" in shown(good(), dialect=mavlink_px4.COPTER)
    assert "ground station id" in shown(good())


# ------------------------------------------------------------------------------------------- keys, options, pads


def test_keys_are_32_bytes_or_64_digits_and_never_shown(tmp_path: Path) -> None:
    raw, text, bad = tmp_path / "raw", tmp_path / "text", tmp_path / "bad"
    raw.write_bytes(bytes(range(32)))
    text.write_text(bytes(range(32)).hex() + "\n")
    bad.write_text("secret")
    assert read_key(raw) == read_key(text) == bytes(range(32))
    with pytest.raises(DriverError, match="32 bytes") as error:
        read_key(bad)
    assert "secret" not in str(error.value)
    with pytest.raises(DriverError, match="signing_key_file"):
        read_key(tmp_path / "none")


@pytest.mark.parametrize(
    "wrong",
    [
        {"system_id": 0}, {"setpoint_hz": 1.0}, {"telemetry_hz": 0.0}, {"link_timeout_s": math.nan},
        {"indoor_origin_deg": (91.0, 0.0)}, {"floor_amsl_m": math.inf},
    ],
)  # fmt: skip
def test_options_validate_themselves(wrong: dict[str, Any]) -> None:
    with pytest.raises(DriverError, match=next(iter(wrong))):
        MavlinkOptions(**wrong)


def test_a_pad_is_where_its_ugv_is_and_as_fast() -> None:
    tracker, pads = PadTracker(), Pads("g", ((1.0, 0.0),), 0.5, 0.1)
    seen = None
    for k in range(40):
        pose = Pose("g", (0.5 * 0.05 * k, 2.0, 0.0), math.pi / 2, 0.05 * k)
        seen = tracker.look(pads, 0, pose, 0.05 * k, 0.5)
    assert seen is not None
    assert seen.position_m == pytest.approx((0.5 * 0.05 * 39, 3.0, 0.5))
    assert seen.velocity_mps == pytest.approx((0.5, 0.0))
    assert tracker.look(pads, 0, pose, 0.05 * 39 + 0.6, 0.5) is None, "stale"
    assert tracker.look(pads, 1, pose, 0.05 * 39, 0.5) is None, "no such dock"
    assert tracker.look(pads, 0, None, 0.0, 0.5) is None
