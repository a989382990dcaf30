"""The simulated MAVLink vehicles over real sockets: parameters, requests, signatures, losses, rubbish, ends."""

from __future__ import annotations

import math
import os
import random
import signal
import socket
import statistics
import struct
import subprocess
import sys
import time
from itertools import pairwise
from pathlib import Path

import pytest

from sim_backends.wire.world import Modifiers, World
from sim_backends.world import SimUav, SimUgv, WorldConfig
from tests.sim_backends.wire.mavlink_station import NAN, Station, flying, mavlink, process

pytestmark = pytest.mark.wire

ARM, TAKEOFF, LAND, SET_MODE = 400, 22, 21, 176
OFFBOARD, HOLD, LANDING = 0x60000, 0x3040000, 0x6040000


def test_parameters_of_both_dialects_survive_the_round_trip() -> None:
    with flying() as s:
        s.send(mavlink.MAVLink_param_request_list_message(1, 1))
        s.until(lambda: len(s.all["PARAM_VALUE"]) > s.all["PARAM_VALUE"][-1].param_count if s.all["PARAM_VALUE"] else 0)
        values = {m.param_id: m for m in s.all["PARAM_VALUE"]}
        assert s.all["PARAM_VALUE"][0].param_id == "_HASH_CHECK"
        m = values["COM_OBL_RC_ACT"]
        assert m.param_type == 6
        assert struct.unpack("<i", struct.pack("<f", m.param_value))[0] == 0
        assert values["COM_OF_LOSS_T"].param_value == 1.0
        wire = struct.unpack("<f", struct.pack("<i", 4))[0]
        s.all["PARAM_VALUE"].clear()
        s.send(mavlink.MAVLink_param_set_message(1, 1, b"COM_OBL_RC_ACT", wire, 6))
        s.until(lambda: s.all["PARAM_VALUE"])
        assert s.all["PARAM_VALUE"][0].param_value == wire
        s.send(mavlink.MAVLink_param_set_message(1, 1, b"NO_SUCH", 1.0, 9))
        s.until(lambda: any("unknown param: NO_SUCH" in text for text in s.texts))
    with flying("--autopilot", "ardupilot") as s:
        s.send(mavlink.MAVLink_param_set_message(1, 1, b"FS_GCS_ENABLE", 5.0, 2))
        s.until(lambda: s.all["PARAM_VALUE"])
        assert (s.all["PARAM_VALUE"][0].param_value, s.all["PARAM_VALUE"][0].param_type) == (5.0, 2)
        s.send(mavlink.MAVLink_param_request_read_message(1, 1, b"FS_GCS_ENABLE", -1))
        s.until(lambda: len(s.all["PARAM_VALUE"]) > 1)
        assert s.all["PARAM_VALUE"][1].param_value == 5.0


def test_missions_are_refused_in_words_and_requests_answered() -> None:
    with flying() as s:
        s.send(mavlink.MAVLink_mission_count_message(1, 1, 5, 0))
        s.until(lambda: "MISSION_ACK" in s.newest)
        assert s.newest["MISSION_ACK"].type == mavlink.MAV_MISSION_UNSUPPORTED
        s.until(lambda: any("Mission upload not supported" in text for text in s.texts))
        s.send(mavlink.MAVLink_mission_request_list_message(1, 1, 0))
        s.until(lambda: "MISSION_COUNT" in s.newest)
        assert s.newest["MISSION_COUNT"].count == 0
        assert s.command(512, 148) == 0
        s.until(lambda: "AUTOPILOT_VERSION" in s.newest)
        bits = s.newest["AUTOPILOT_VERSION"].capabilities
        assert bits & mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
        assert not bits & mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_INT
        assert s.command(241, 1) == 5, "a calibration takes its time"
        s.until(lambda: s.newest["COMMAND_ACK"].result == 0)
        assert s.command(31337) == 3
        assert s.command(511, 32, 20_000) == 0
        s.all["LOCAL_POSITION_NED"].clear()

        def period_ms() -> float:
            """The middle one of forty, by the vehicle's clock: pauses of a busy machine are outliers."""
            stamps = [m.time_boot_ms for m in s.all["LOCAL_POSITION_NED"][-41:]]
            return statistics.median(b - a for a, b in pairwise(stamps)) if len(stamps) == 41 else math.inf

        s.until(lambda: 18 <= period_ms() <= 28)
        s.send(mavlink.MAVLink_timesync_message(0, 12345))
        s.until(lambda: "TIMESYNC" in s.newest)
        assert s.newest["TIMESYNC"].ts1 == 12345


def test_only_the_right_key_is_obeyed() -> None:
    key, wrong = bytes(range(32)), bytes(32)
    with flying("--signing-key", key.hex(), key=key) as s:
        assert s.newest["HEARTBEAT"].get_signed()
        for other in (None, wrong):
            stranger = Station(key=other)
            stranger.peer = s.peer
            stranger.command(ARM, 1, wait=False)
            s.pump(1.2)
            assert not s.armed
            stranger.close()
        assert s.command(ARM, 1) == 0
        s.until(lambda: s.armed)


def team(folder: Path, **more: object) -> World:
    uav = SimUav("uav0", "u", on="ugv0", capacity_j=2000.0, energy_j=1000.0)
    ugv = SimUgv("ugv0", "g", (5.0, 2.0), max_speed_mps=2.0, pad_height_m=0.5, dock_offsets_m=((0.0, 0.0),),
                 charge_s=None, charge_w=40.0)  # fmt: skip
    return World.create(folder, WorldConfig(uavs=(uav,), ugvs=(ugv,), **more))  # type: ignore[arg-type]


def test_a_lossy_link_still_works_with_repetitions(tmp_path: Path) -> None:
    world = team(tmp_path)
    with flying("--position", "gps", "--world", str(tmp_path), "--vehicle", "uav0") as s:
        world.modify(0, Modifiers(loss=0.3))
        for confirmation in range(20):
            s.command(ARM, 1, confirmation=confirmation, wait=False)
            s.pump(0.1)
        s.until(lambda: s.armed)
        acks = [a for a in s.all["COMMAND_ACK"] if a.command == ARM]
        assert 1 <= len(acks) < 20
        assert {a.result for a in acks} == {0}


def test_it_listens_on_udp_and_tcp_and_ends_at_once() -> None:
    with process("--port", "0", "--tcp", "0", "--autopilot", "ardupilot", "--type", "rover") as child:
        words = child.ready.split()  # type: ignore[attr-defined]
        s = Station()
        s.peer = ("127.0.0.1", int(words[words.index("udp") + 1]))
        s.until(lambda: "HEARTBEAT" in s.newest)
        assert s.newest["HEARTBEAT"].type == mavlink.MAV_TYPE_GROUND_ROVER
        with socket.create_connection(("127.0.0.1", int(words[words.index("tcp") + 1])), timeout=20.0) as tcp:
            assert tcp.recv(100)[0] == 0xFD
        os.kill(child.pid, signal.SIGTERM)
        assert child.wait(5.0) == 0
        s.close()


def test_rubbish_harms_nobody() -> None:
    with flying() as s:
        generator = random.Random(5)
        nasty = (NAN, math.inf, -math.inf, 3e38, -3e38, 0.0, 1.0, -1.0, 1e9)
        for command in (16, 17, 20, 21, 22, 176, 178, 179, 185, 192, 193, 241, 246, 300, 400, 410, 510, 511, 512, 520):
            for _ in range(6):
                s.command(command, *(generator.choice(nasty) for _ in range(7)), wait=False)
            p = [generator.choice(nasty) for _ in range(5)]
            xy = [generator.choice((2**31 - 1, -(2**31), 0, 10**9)) for _ in range(2)]
            s.send(mavlink.MAVLink_command_int_message(1, 1, 5, command, 0, 0, *p[:4], *xy, p[4]))
        for mask in (0, 0xFFF, 0b110111000111, 0b110111111000):
            p = [generator.choice(nasty) for _ in range(11)]
            for frame in (1, 5, 7, 8, 9, 255):
                s.send(mavlink.MAVLink_set_position_target_local_ned_message(0, 1, 1, frame, mask, *p))
                place = (2**31 - 1, -(2**31), p[0])
                s.send(mavlink.MAVLink_set_position_target_global_int_message(0, 1, 1, frame, mask, *place, *p[3:]))
        for value in nasty:
            s.send(mavlink.MAVLink_vision_position_estimate_message(0, value, value, value, 0.0, 0.0, value))
            s.send(mavlink.MAVLink_param_set_message(1, 1, b"MPC_XY_VEL_MAX", value, 9))
        s.send(mavlink.MAVLink_set_gps_global_origin_message(1, 2**31 - 1, -(2**31), 0))
        s.send(mavlink.MAVLink_set_mode_message(1, 1, 2**32 - 1))
        assert s.peer is not None
        for size in (0, 1, 12, 280, 4000):
            s.socket.sendto(generator.randbytes(size), s.peer)
            s.socket.sendto(b"\xfd" + generator.randbytes(size), s.peer)
        s.pump(0.5)
        n = len(s.all["HEARTBEAT"])
        s.until(lambda: len(s.all["HEARTBEAT"]) >= n + 2)


def test_a_vehicle_ends_with_its_parent() -> None:
    code = (
        "import subprocess, sys, os, time;"
        "p = subprocess.Popen([sys.executable, '-m', 'sim_backends.wire.mavlink_vehicle', '--port', '0',"
        " '--parent', str(os.getpid())], stdout=subprocess.PIPE, text=True);"
        "p.stdout.readline(); print(p.pid, flush=True)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    pid = int(done.stdout)
    end_s = time.monotonic() + 20.0
    while Path(f"/proc/{pid}/stat").exists() and Path(f"/proc/{pid}/stat").read_text().split()[2] != "Z":
        assert time.monotonic() < end_s, "it outlives its parent"
        time.sleep(0.05)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((), "nobody could hear"),
        (("--port", "0", "--sysid", "0"), "sysid is 0"),
        (("--port", "0", "--signing-key", "abc"), "64 hex digits"),
        (("--port", "0", "--param", "NO_SUCH=1"), "NO_SUCH"),
        (("--port", "0", "--world", "/nowhere", "--vehicle", "x"), "holds no simulated world"),
    ],
)
def test_mistakes_are_named(arguments: tuple[str, ...], words: str) -> None:
    command = [sys.executable, "-m", "sim_backends.wire.mavlink_vehicle", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 2
    assert words in done.stderr
    assert "Traceback" not in done.stderr
