"""What telemetry means: bits, battery, log blocks, estimator gate, radio budget, options, checks, senses."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from drivers.crazyflie_battery import LIPO_CURVE, BatteryGauge, interpolate, is_curve
from drivers.crazyflie_bits import Bits, bits_of, charging_of, decode, loaded_of, words
from drivers.crazyflie_checks import Facts, self_checks
from drivers.crazyflie_estimator import VARIANCES, EstimatorGate, SetParameter
from drivers.crazyflie_logs import BLOCK_BYTES, SIZES, WANTED, pack, plan_blocks
from drivers.crazyflie_options import CrazyflieOptions
from drivers.crazyflie_radio_budget import radio_checks, radio_of
from drivers.crazyflie_senses import Telemetry, Track, ground_m, pad_m
from drivers.errors import DriverError
from drivers.limits import Pads, PoseBook
from drivers.vehicle import Pose

TYPES = {
    "supervisor.info": "uint16_t", "stateEstimate.x": "float", "stateEstimate.y": "float", "stateEstimate.z": "float",
    "stateEstimate.yaw": "float", "pm.state": "int8_t", "pm.vbat": "float", "pm.batteryLevel": "uint8_t",
    "kalman.varPX": "float", "kalman.varPY": "float", "kalman.varPZ": "float", "locSrvZ.tick": "uint16_t",
    "radio.rssi": "uint8_t", "stabilizer.thrust": "float", "sys.canfly": "uint8_t", "sys.isFlying": "uint8_t",
    "sys.isTumbled": "uint8_t",
}  # fmt: skip


# --- bits


@pytest.mark.parametrize(
    ("info", "expected"),
    [
        (0x0E, Bits(armed=True, auto_arm=True, can_fly=True)),
        (0x1E, Bits(armed=True, auto_arm=True, can_fly=True, flying=True)),
        (0x44, Bits(auto_arm=True, locked=True)),
        (0x01, Bits(can_be_armed=True)),
        (0xA0, Bits(tumbled=True, crashed=True)),
        (0x11A, Bits(armed=True, can_fly=True, flying=True, hl_active=True, hl_finished=False)),
        (0x31A, Bits(armed=True, can_fly=True, flying=True, hl_active=True, hl_finished=True)),
        (0x800, Bits(deck_fault=True)),
    ],
)
def test_bits(info: int, expected: Bits) -> None:
    assert decode(info) == expected
    assert bits_of({"supervisor.info": info}) == expected


def test_bits_of_old_firmware() -> None:
    assert bits_of({}) is None
    flying = bits_of({"sys.canfly": 1, "sys.isFlying": 1, "sys.isTumbled": 0})
    assert flying is not None
    assert flying.armed
    assert flying.auto_arm
    assert flying.flying


@pytest.mark.parametrize(("state", "expected"), [(0, False), (1, True), (2, True), (3, False), (4, False)])
def test_charging(state: int, expected: bool) -> None:
    assert charging_of({"pm.state": state}) is expected


def test_what_is_not_logged_is_unknown() -> None:
    assert charging_of({}) is None
    assert not loaded_of({})
    assert loaded_of({"stabilizer.thrust": 30000.0})
    assert loaded_of({"supervisor.info": 0x1E})


def test_words_name_the_remedy() -> None:
    assert words(Bits()) is None
    assert "reboot" in (words(Bits(locked=True)) or "")
    assert "upright" in (words(Bits(tumbled=True)) or "")
    assert "upright" in (words(Bits(crashed=True)) or "")
    assert "deck" in (words(Bits(deck_fault=True)) or "")


# --- battery


def test_curve() -> None:
    assert interpolate(LIPO_CURVE, 2.5) == 0.0
    assert interpolate(LIPO_CURVE, 4.3) == 1.0
    assert interpolate(LIPO_CURVE, 3.805) == pytest.approx(0.15)
    assert is_curve(LIPO_CURVE)
    assert not is_curve(((3.0, 0.0),))
    assert not is_curve(((4.0, 0.0), (3.0, 1.0)))
    assert not is_curve(((3.0, 0.0), (4.0, 1.5)))


def test_flying_does_not_empty_the_gauge() -> None:
    gauge = BatteryGauge(LIPO_CURVE, 0.25)
    for i in range(100):
        flying = 20 <= i < 70
        gauge.put(0.1 * i, {"pm.vbat": 3.97 - (0.25 if flying else 0.0)}, flying, False)
        assert gauge.share == pytest.approx(0.625, abs=0.01)


def test_the_voltage_counts_for_nothing_while_it_settles() -> None:
    gauge = BatteryGauge(LIPO_CURVE, 0.25)
    gauge.put(0.0, {"pm.vbat": 3.97}, False, False)
    gauge.put(0.1, {"pm.vbat": 3.97}, True, False)
    assert gauge.share == pytest.approx(0.625)


def test_the_gauge_follows_slowly_and_knows_the_charger() -> None:
    gauge = BatteryGauge(LIPO_CURVE, 0.25)
    gauge.put(0.0, {"pm.vbat": 3.92}, False, False)
    assert gauge.share == pytest.approx(0.5)
    gauge.put(0.3, {"pm.vbat": 4.15}, False, True)
    assert gauge.share == pytest.approx(0.54)


def test_what_is_charged_never_gets_emptier() -> None:
    gauge = BatteryGauge(LIPO_CURVE, 0.25)
    gauge.put(0.0, {"pm.vbat": 4.2}, False, False)
    gauge.put(3.0, {"pm.vbat": 4.15, "pm.state": 1}, False, True)
    assert gauge.share == 1.0
    gauge.put(4.0, {"pm.vbat": 4.10, "pm.state": 0}, False, False)
    gauge.put(60.0, {"pm.vbat": 4.10, "pm.state": 2}, False, True)
    assert gauge.share == 1.0, "its charger says so"


def test_a_level_alone_is_taken_as_it_is() -> None:
    gauge = BatteryGauge(LIPO_CURVE, 0.25)
    gauge.put(0.0, {}, False, False)
    assert gauge.share is None
    gauge.put(0.0, {"pm.batteryLevel": 70}, False, False)
    assert gauge.share == 0.7


# --- logs


def test_blocks_fit_and_hold_everything_that_exists() -> None:
    blocks, missing = plan_blocks(TYPES, 50, 200)
    assert missing == []
    held = [name for block in blocks for name in block.variables]
    assert sorted(held) == sorted(WANTED)
    for block in blocks:
        assert sum(SIZES[TYPES[name]] for name in block.variables) <= BLOCK_BYTES
    assert "supervisor.info" in blocks[0].variables
    assert blocks[0].period_ms == 50
    assert len(blocks) == 2


def test_what_is_missing_is_said_and_replaced() -> None:
    types = {k: v for k, v in TYPES.items() if not k.startswith(("pm.", "supervisor.", "locSrvZ."))}
    blocks, missing = plan_blocks(types, 50, 200)
    assert missing == ["supervisor.info", "pm.state", "pm.vbat", "pm.batteryLevel", "locSrvZ.tick"]
    assert {"sys.canfly", "sys.isFlying", "sys.isTumbled"} <= set(blocks[0].variables)
    assert plan_blocks({}, 50, 200) == ([], list(WANTED))


def test_pack_opens_a_new_block_when_one_is_full() -> None:
    types = {f"a.{i}": "float" for i in range(8)} | {"a.odd": "double"}
    blocks = pack([*types, "a.none"], types, 100)
    assert [len(b.variables) for b in blocks] == [6, 2]


# --- estimator


def gate() -> EstimatorGate:
    return EstimatorGate(window_s=1.0, samples=5, spread=0.001, timeout_s=4.0)


def run(g: EstimatorGate, variance: float | None, from_s: float, to_s: float, poses: bool = True) -> list[SetParameter]:
    said: list[SetParameter] = []
    pose = Pose("cf0", (1.0, 2.0, 0.0), 0.5, 0.0)
    for i in range(round((to_s - from_s) / 0.02)):
        now = from_s + 0.02 * i
        if poses:
            g.fed(now)
        if variance is not None and i % 5 == 0:
            g.logged(now, [variance * (1 + (now - from_s))] * 3)
        said += g.step(now, pose)
    return said


def test_nothing_is_reset_before_poses_come() -> None:
    g = gate()
    assert run(g, 100.0, 0.0, 3.0, poses=False) == []
    assert g.phase == "no poses"


def test_reset_then_settle() -> None:
    g = gate()
    said = run(g, 1e-5, 0.0, 3.0)
    assert said[0] == SetParameter("stabilizer.estimator", 2)
    assert SetParameter("kalman.initialX", 1.0) in said
    assert SetParameter("kalman.initialYaw", 0.5) in said
    assert said[-2:] == [SetParameter("kalman.resetEstimation", 1), SetParameter("kalman.resetEstimation", 0)]
    assert g.ready
    assert g.resets == 1


def test_a_variance_that_moves_is_not_ready_and_is_reset_again() -> None:
    g = gate()
    run(g, 0.1, 0.0, 3.0)
    assert not g.ready
    run(g, 0.1, 3.0, 8.0)
    assert not g.ready
    assert g.resets == 2


def test_poses_that_stop_while_it_settles_do_not_count() -> None:
    g = gate()
    run(g, 1e-5, 0.0, 0.6)
    run(g, 1e-5, 0.6, 8.0, poses=False)
    assert g.phase == "failed"


def test_a_settled_estimate_that_goes_bad_is_reset() -> None:
    g = gate()
    run(g, 1e-5, 0.0, 3.0)
    run(g, 5.0, 3.0, 4.0)
    assert not g.ready
    assert g.resets == 2


def test_without_variances_the_window_passes_unseen() -> None:
    g = gate()
    g.can_tell = False
    run(g, None, 0.0, 3.0)
    assert g.ready
    g.restart()
    assert g.phase == "no poses"


# --- radios


def uris(n: int, radio: str = "0") -> dict[str, str]:
    return {f"uav{i}": f"radio://{radio}/80/2M/E7E7E7E7{i:02X}" for i in range(n)}


@pytest.mark.parametrize(("n", "verdict"), [(1, "pass"), (4, "pass"), (5, "warn")])
def test_radio_budget(n: int, verdict: str) -> None:
    (check,) = radio_checks(uris(n))
    assert check.verdict == verdict
    assert check.value == n


def test_each_radio_counts_for_itself() -> None:
    checks = radio_checks({**uris(3), **{f"b{k}": v for k, v in uris(5, "abc").items()}, "x": "udp://127.0.0.1:19850"})
    assert [c.verdict for c in checks] == ["pass", "warn"]
    assert radio_of("radio://abc/80/2M") == "ABC"
    assert radio_of("udp://127.0.0.1:1") is None
    assert radio_checks({"x": "usb://0"}) == []


def test_two_vehicles_at_one_address() -> None:
    same = "radio://0/80/2M/E7E7E7E7E7"
    (check,) = radio_checks({"a": same, "b": same.lower()})
    assert check.verdict == "fail"


# --- options


@pytest.mark.parametrize(
    "wrong",
    [
        {"answer_s": 0.0}, {"telemetry_s": math.nan}, {"fast_ms": 5}, {"slow_ms": 3000}, {"converge_samples": 1},
        {"converge_s": 0.5}, {"battery_curve": ((3.0, 1.0),)}, {"battery_sag_v": -1.0},
    ],
)  # fmt: skip
def test_options_refuse(wrong: dict[str, object]) -> None:
    with pytest.raises(DriverError, match=next(iter(wrong))):
        replace(CrazyflieOptions(), **wrong)


# --- checks

GOOD = Facts(
    protocol=12, values={"pm.vbat": 4.1, "pm.state": 0, "radio.rssi": 45}, missing=(), bits=decode(0x0E),
    estimator="ready", resets=1, variance_m2=1e-4, quality=99.0, latency_s=0.01, fed=500, tick_moves=True, heading=True,
)  # fmt: skip


def verdicts(facts: Facts) -> dict[str, str]:
    return {c.name: c.verdict for c in self_checks(facts)}


def test_a_good_one_passes_everything() -> None:
    assert set(verdicts(GOOD).values()) == {"pass"}
    assert len(verdicts(GOOD)) == 10


@pytest.mark.parametrize(
    ("change", "name", "verdict"),
    [
        ({"protocol": 11}, "firmware", "warn"),
        ({"protocol": 3}, "firmware", "fail"),
        ({"missing": ("pm.state",)}, "log variables", "warn"),
        ({"bits": None}, "supervisor", "fail"),
        ({"bits": decode(0x44)}, "supervisor", "fail"),
        ({"bits": decode(0x04)}, "supervisor", "fail"),
        ({"bits": decode(0x01)}, "supervisor", "pass"),
        ({"estimator": "no poses"}, "estimator", "not run"),
        ({"estimator": "settling"}, "estimator", "not run"),
        ({"estimator": "settling", "resets": 3}, "estimator", "fail"),
        ({"estimator": "failed"}, "estimator", "fail"),
        ({"variance_m2": None}, "estimator", "warn"),
        ({"fed": 0}, "pose path", "not run"),
        ({"tick_moves": None}, "pose path", "not run"),
        ({"tick_moves": False}, "pose path", "fail"),
        ({"heading": False}, "heading", "warn"),
        ({"values": {}}, "battery telemetry", "warn"),
        ({"values": {}}, "charger telemetry", "warn"),
        ({"values": {}, "quality": None}, "radio", "not run"),
        ({"quality": 40.0}, "radio", "warn"),
        ({"values": {"radio.rssi": 90}}, "radio", "warn"),
        ({"latency_s": None}, "link latency", "not run"),
        ({"latency_s": 0.3}, "link latency", "warn"),
    ],
)
def test_checks(change: dict[str, object], name: str, verdict: str) -> None:
    assert verdicts(replace(GOOD, **change))[name] == verdict  # type: ignore[arg-type]


# --- senses


def test_a_clock_that_runs_backwards_is_a_reboot() -> None:
    telemetry = Telemetry()
    telemetry.put(1.0, 60_000, {"pm.vbat": 4.0})
    telemetry.put(1.1, 59_990, {"pm.vbat": 4.0})
    assert telemetry.reboots == 0
    telemetry.put(1.2, 500, {"supervisor.info": 14})
    assert telemetry.reboots == 1
    assert telemetry.snapshot() == (1.2, {"supervisor.info": 14})
    clock_ms = 500
    for _ in range(40):
        clock_ms = (clock_ms + 500_000) % (1 << 24)
        telemetry.put(1.3, clock_ms, {})
    telemetry.put(1.4, clock_ms, {})
    assert telemetry.reboots == 1, "the clock wraps"
    assert telemetry.age_s("supervisor.info", 2.2) == pytest.approx(1.0)
    assert telemetry.age_s("nothing", 2.2) == math.inf


@pytest.mark.parametrize(
    ("gap_s", "ahead_ms", "new_link", "reboots"),
    [
        (0.05, 50, False, 0),
        (10.0, 9_700, False, 0),  # silent, with a slow clock
        (10.0, 300, False, 1),  # off and on again in the meantime
        (2.0, 50, False, 0),  # our own process was held up: the block waited for it
        (2.5, 2_450, True, 0),
        (2.5, 300, True, 1),
        (5.0, -3_000, False, 1),
    ],
)
def test_a_reboot_shows_in_the_clocks(gap_s: float, ahead_ms: int, new_link: bool, reboots: int) -> None:
    telemetry = Telemetry()
    telemetry.put(100.0, 4_000, {})
    telemetry.new_link = new_link
    telemetry.put(100.0 + gap_s, 4_000 + ahead_ms, {})
    assert telemetry.reboots == reboots


def test_a_track_measures_motion() -> None:
    track = Track()
    assert track.newest is None
    assert track.moved_m() == 0.0
    for i in range(100):
        track.put(Pose("limo0", (0.1 * 0.02 * i, 0.0, 0.0), 0.0, 0.02 * i))
    assert track.moved_m(0.5) == pytest.approx(0.05, abs=0.003)


def test_a_dock_turns_with_its_ugv_and_counts_as_ground() -> None:
    pose = Pose("limo0", (1.0, 2.0, 0.1), math.pi / 2, 0.0)
    x, y, z = pad_m(pose, (0.2, 0.0), 0.3)
    assert (x, y, z) == (pytest.approx(1.0), pytest.approx(2.2), 0.3)
    book = PoseBook()
    pads = {"ugv0": Pads("limo0", ((0.2, 0.0),), 0.3, 0.05)}
    assert ground_m((1.0, 2.2, 1.0), pads, book) == 0.0, "nobody knows where the UGV is"
    book.put(pose)
    assert ground_m((1.0, 2.2, 1.0), pads, book) == 0.3
    assert ground_m((1.0, 2.3, 1.0), pads, book) == 0.3, "its roof"
    assert ground_m((1.0, 2.5, 1.0), pads, book) == 0.0
    assert ground_m((1.0, 2.2, 0.1), pads, book) == 0.0, "below it"


def test_variances_are_the_ones_that_are_logged() -> None:
    assert set(VARIANCES) <= set(WANTED)
