"""From a mission and its fleet file to drivers and endpoints, without connecting anybody."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest

from deploy.backends import connect, require_ready
from deploy.errors import InputError
from deploy.localisation import geo_frame
from deploy.mission import Mission, load
from deploy.mission_copy import save_copy
from deploy.real_fleet import Place, build_poses, build_vehicles, fleet_of, pads_of, uav_limits
from deploy.wire import endpoints_of
from drivers.clock import RealClock
from drivers.crazyflie import Crazyflie
from drivers.limo import Limo
from drivers.mavlink import MavlinkUav, MavlinkUgv, TelemetryPoses
from drivers.mocap import Mocap
from sim_backends.wire.endpoints import CrazyflieEndpoint, LimoEndpoint, MavlinkEndpoint

CONFIGS = Path(__file__).resolve().parents[2] / "mission_configs"


@pytest.fixture(scope="module")
def lab() -> Mission:
    return load(CONFIGS / "lab.yaml")


@pytest.fixture(scope="module")
def field() -> Mission:
    return load(CONFIGS / "field.yaml")


def written(folder: Path, source: str, fleet: str = "", **overrides: Any) -> Path:
    """A shipped mission in a folder of its own; ``fleet`` follows its fleet file."""
    path = save_copy(load(CONFIGS / source, overrides), folder)
    if fleet:
        file = folder / "fleet.yaml"
        head, _, vehicles = file.read_text().partition("\nvehicles:")
        file.write_text(head + fleet if "vehicles:" in fleet else head + fleet + "\nvehicles:" + vehicles)
    return path


# --- drivers


def test_the_labs_drivers(lab: Mission) -> None:
    clock = RealClock()
    vehicles = build_vehicles(lab, clock)
    assert {name: type(v) for name, v in vehicles.items()} == {
        "cf1": Crazyflie, "cf2": Crazyflie, "limo1": Limo, "limo2": Limo,
    }  # fmt: skip
    assert isinstance(build_poses(lab, vehicles, clock), Mocap)
    limits = uav_limits(lab, "cf1")
    assert (limits.max_speed_mps, limits.climb_mps, limits.altitude_m) == (0.6, 0.4, 2.0)
    pads = pads_of(lab)["limo1"]
    assert (pads.body, pads.height_m, pads.tolerance_m) == ("limo1", 0.26, pytest.approx(0.03))


def test_the_fields_drivers(field: Mission) -> None:
    clock = RealClock()
    vehicles = build_vehicles(field, clock)
    assert [type(v) for v in vehicles.values()] == [MavlinkUav, MavlinkUav, MavlinkUgv, MavlinkUgv]
    assert isinstance(build_poses(field, vehicles, clock), TelemetryPoses)


def test_a_fleet_is_real_until_it_is_told_other_places(lab: Mission) -> None:
    fleet = fleet_of(lab, RealClock(), "real")
    assert (fleet.name, fleet.virtual, fleet.truth) == ("real", False, None)
    assert fleet.connect_s == 30.0
    assert fleet.bodies == {"cf1": "cf1", "cf2": "cf2", "limo1": "limo1", "limo2": "limo2"}
    radio = [c for c in fleet.more_checks() if c.name == "radio budget"]
    assert [(c.verdict, c.value) for c in radio] == [("pass", 2)]
    places = {v.id: Place(f"udp://127.0.0.1:{n}", domain=3) for n, v in enumerate(lab.fleet)}
    for v in lab.fleet:
        if v.driver == "limo":
            places[v.id] = Place(f"/{v.id}", domain=3)
    elsewhere = fleet_of(lab, RealClock(), "wire", places)
    assert [c for c in elsewhere.more_checks() if c.name == "radio budget"] == []


def test_options_of_drivers_stand_in_the_fleet(tmp_path: Path) -> None:
    fleet = (
        "\nvehicles:\n"
        "  cf1: {type: crazyflie, endpoint: 'usb://0', crazyflie: {pose_rate_hz: 50.0, send_attitude: false}}\n"
        "  limo1: {type: limo, endpoint: /limo1, limo: {mode: mecanum, domain: 7, status: false}}\n"
    )
    mission = load(written(tmp_path, "lab.yaml", fleet))
    cf, limo = (v.options for v in mission.fleet)
    assert (getattr(cf, "pose_rate_hz", None), getattr(cf, "send_attitude", None)) == (50.0, False)
    assert (getattr(limo, "mode", None), getattr(limo, "domain", None)) == ("mecanum", 7)
    assert len(build_vehicles(mission, RealClock())) == 2


def test_limos_without_a_namespace_have_a_domain_each(tmp_path: Path) -> None:
    fleet = (
        "\nvehicles:\n  cf1: {type: crazyflie}\n"
        "  limo1: {type: limo, endpoint: /, limo: {domain: 1}}\n  limo2: {type: limo, endpoint: /, limo: {domain: 2}}\n"
    )
    assert [v.endpoint for v in load(written(tmp_path / "two", "lab.yaml", fleet)).fleet[1:]] == ["/", "/"]
    with pytest.raises(InputError, match="endpoint '/' is also that of 'limo1'"):
        load(written(tmp_path / "one", "lab.yaml", fleet.replace("domain: 2", "domain: 1")))


@pytest.mark.parametrize(
    ("fleet", "words"),
    [
        ("cf1: {type: crazyflie, driver: mavlink, endpoint: 'tcpin:h:1', sysid: 1}", "is none of a mavlink"),
        ("cf1: {type: crazyflie, crazyflie: {pose_rate: 50.0}}", r"fleet.yaml:\d+: .*pose_rate.*did you mean"),
        ("cf1: {type: crazyflie, crazyflie: {pose_rate_hz: -1.0}}", "pose_rate_hz is -1.0; give a number above 0"),
        ("cf1: {type: crazyflie, mavlink: {baud: 57600}}", "mavlink holds options of driver mavlink, but driver is"),
        ("cf1: {type: crazyflie, driver: mavlink, endpoint: 'tcp:h:1'}", "sysid is missing"),
        ("cf1: {type: crazyflie, driver: mavlink, mavlink: {setpoint_hz: 1.0}}", "PX4 wants 2 at least"),
    ],
)
def test_wrong_options_are_named(fleet: str, words: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=words) as error:
        load(written(tmp_path, "lab.yaml", f"\nvehicles:\n  {fleet}\n"))
    assert error.value.exit_code == 2


def test_a_signing_key_lies_beside_the_fleet_file_and_is_not_copied(tmp_path: Path) -> None:
    fleet = (
        "\nvehicles:\n"
        "  q: {type: quad, endpoint: 'udpin:127.0.0.1:14551', sysid: 1, mavlink: {signing_key_file: secret.key}}\n"
    )
    mission = load(written(tmp_path, "field.yaml", fleet))
    with pytest.raises(Exception, match=str(tmp_path / "secret.key")):
        build_vehicles(mission, RealClock())["q"].connect(0.0)
    assert not list((save_copy(mission, tmp_path / "copy")).parent.glob("*.key"))


# --- what is missing


@pytest.mark.parametrize(
    ("fleet", "backend", "sim", "key", "words"),
    [
        ("cf1: {type: crazyflie, driver: null}", "real", "kinematic", "vehicles.cf1.driver", "has no driver"),
        ("cf1: {type: crazyflie, driver: null}", "sim", "wire", "vehicles.cf1.driver", "has no driver"),
        ("cf1: {type: crazyflie}", "real", "kinematic", "vehicles.cf1.endpoint", "has no endpoint"),
        ("cf1: {type: crazyflie, driver: limo, endpoint: /x}", "real", "wire", "vehicles.cf1.driver", "is no UAV"),
        ("cf1: {type: crazyflie}\n  g: {type: limo, driver: crazyflie}", "sim", "wire", "vehicles.g.driver", "no UGV"),
    ],
)
def test_what_a_fleet_misses(fleet: str, backend: str, sim: str, key: str, words: str, tmp_path: Path) -> None:
    mission = load(written(tmp_path, "lab.yaml", f"\nvehicles:\n  {fleet}\n"))
    with pytest.raises(InputError, match=words) as error:
        require_ready(mission, backend, sim)
    assert (error.value.file, error.value.key) == (tmp_path / "fleet.yaml", key)


def test_drivers_are_wanted_by_those_alone_who_use_them(tmp_path: Path) -> None:
    mission = load(written(tmp_path, "lab.yaml", "\nvehicles:\n  cf1: {type: crazyflie, driver: null}\n"))
    require_ready(mission, "sim", "kinematic")
    fleet = connect(mission)
    assert fleet.virtual
    fleet.close()


def test_somebody_must_tell_where_the_vehicles_are() -> None:
    mission = load(CONFIGS / "lab.yaml", {"localisation": None})
    require_ready(mission, "sim", "kinematic")
    with pytest.raises(InputError, match="say who tells where the vehicles are") as error:
        require_ready(mission, "real", "kinematic")
    assert error.value.key == "localisation"


@pytest.mark.parametrize(
    ("localisation", "words"),
    [
        ({"source": "mocap"}, "section mocap is missing"),
        ({"source": "vehicles", "mocap": {"type": "optitrack", "hostname": "h"}}, "leave mocap out"),
        ({"source": "mocap", "mocap": {"type": "optitrak", "hostname": "h"}}, "did you mean optitrack"),
        ({"source": "mocap", "mocap": {"type": "vicon"}}, "hostname is None"),
        ({"source": "mocap", "mocap": {"type": "vicon", "hostname": "h", "hots": "x"}}, "unknown key 'hots'"),
        ({"source": "vehicles"}, "the map is not in longitude and latitude"),
        ({"source": "gps"}, "'gps' is none of the choices"),
    ],
)
def test_wrong_localisation(localisation: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        load(CONFIGS / "lab.yaml", {"localisation": localisation})


def test_gps_knows_no_other_scale_and_no_limos() -> None:
    with pytest.raises(InputError, match=r"arena\.scale is 0\.5"):
        load(CONFIGS / "field.yaml", {"arena.scale": 0.5, "arena.layers.lowest_m": 20.0})


# --- the globe


def test_the_arena_lies_on_the_globe_as_the_map_does(field: Mission) -> None:
    assert field.geo is not None
    lon, lat = 10.9959, 48.0008  # the depot, as field.yaml gives it
    x, y = field.geo.to_arena(lat, lon)
    assert math.dist((x, y), field.problem.depot) < 15.0, "moved onto the track, no further"


def test_a_turned_arena() -> None:
    mission = load(CONFIGS / "field.yaml", {"arena.rotation_deg": 90.0, "arena.origin_m": [5.0, 6.0]})
    assert mission.geo is not None
    lat, lon = mission.geo.to_globe(mission.settings.frame.to_arena((100.0, 0.0)))
    straight = geo_frame(load(CONFIGS / "field.yaml").settings.frame, (mission.geo.lat_deg, mission.geo.lon_deg))
    assert straight.to_arena(lat, lon) == pytest.approx((100.0, 0.0), abs=1e-3)


def test_a_copy_is_the_same_mission_drivers_included(lab: Mission, field: Mission, tmp_path: Path) -> None:
    for number, mission in enumerate((lab, field)):
        again = load(save_copy(mission, tmp_path / str(number)))
        assert again.digest == mission.digest
        assert again.localisation == mission.localisation


# --- endpoints of a simulation


def test_endpoints_of_the_lab(tmp_path: Path) -> None:
    fleet = (
        "\nvehicles:\n  cf1: {type: crazyflie}\n  limo1: {type: limo, limo: {mode: ackermann}}\n  limo2: {type: limo}\n"
    )
    assert endpoints_of(load(written(tmp_path, "lab.yaml", fleet))) == (
        CrazyflieEndpoint("cf1"),
        LimoEndpoint("limo1", mode="ackermann"),
        LimoEndpoint("limo2", mode="differential"),
    )


def test_endpoints_of_the_field(field: Mission) -> None:
    quad1, _, rover1, _ = endpoints_of(field)
    assert isinstance(quad1, MavlinkEndpoint)
    assert isinstance(rover1, MavlinkEndpoint)
    assert (quad1.type, quad1.autopilot, quad1.sysid) == ("copter", "px4", 1)
    assert (rover1.type, rover1.autopilot, rover1.sysid) == ("rover", "ardupilot", 11)
    assert quad1.origin == pytest.approx((48.0, 11.0, 0.0), abs=1e-5)
