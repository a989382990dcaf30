"""Arena and MAVLink's frames: each way and back."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.geodesy import GeoFrame
from drivers.mavlink_frames import MavlinkFrame, wrap

METRES = st.floats(-3000.0, 3000.0)
ANGLES = st.floats(-math.pi, math.pi)


@pytest.mark.parametrize(
    ("arena", "ned"),
    [((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)), ((0.0, 1.0, 0.0), (1.0, 0.0, 0.0)), ((0.0, 0.0, 2.0), (0.0, 0.0, -2.0))],
)
def test_indoors_north_is_y_east_is_x(arena: tuple[float, ...], ned: tuple[float, ...]) -> None:
    assert MavlinkFrame().to_ned((arena[0], arena[1], arena[2])) == pytest.approx(ned)


@pytest.mark.parametrize(("yaw", "heading"), [(0.0, 90.0), (90.0, 0.0), (180.0, -90.0), (-90.0, 180.0)])
def test_indoors_a_heading_is_clockwise_from_y(yaw: float, heading: float) -> None:
    got = MavlinkFrame().to_heading(math.radians(yaw))
    assert wrap(got - math.radians(heading)) == pytest.approx(0.0, abs=1e-9)


def test_a_turned_arena_turns_vectors_and_headings_alike() -> None:
    frame = MavlinkFrame(GeoFrame(48.0, 11.0, math.radians(30.0)))
    # the arena's x axis lies 30 degrees clockwise of east: the arena was turned counter-clockwise from the plane
    north, east, _ = frame.to_ned((1.0, 0.0, 0.0))
    assert math.degrees(math.atan2(east, north)) == pytest.approx(120.0)
    assert math.degrees(frame.to_heading(0.0)) == pytest.approx(120.0)


@settings(deadline=None)
@given(METRES, METRES, METRES, ANGLES)
def test_vectors_come_back(x: float, y: float, z: float, turn: float) -> None:
    frame = MavlinkFrame(GeoFrame(48.0, 11.0, turn))
    assert frame.from_ned(frame.to_ned((x, y, z))) == pytest.approx((x, y, z), abs=1e-6)


@settings(deadline=None)
@given(ANGLES, ANGLES)
def test_headings_come_back(yaw: float, turn: float) -> None:
    frame = MavlinkFrame(GeoFrame(48.0, 11.0, turn))
    assert wrap(frame.from_heading(frame.to_heading(yaw)) - yaw) == pytest.approx(0.0, abs=1e-9)


@settings(deadline=None)
@given(METRES, METRES, st.floats(-5.0, 120.0))
def test_positions_on_the_globe_come_back_within_their_resolution(x: float, y: float, z: float) -> None:
    frame = MavlinkFrame(GeoFrame(48.0, 11.0, 0.4, (5.0, -3.0)), floor_amsl_m=500.0)
    lat, lon, amsl = frame.to_global((x, y, z))
    assert frame.from_global(lat, lon, round(amsl * 1000)) == pytest.approx((x, y, z), abs=0.02)


def test_heights_are_above_the_arenas_floor() -> None:
    frame = MavlinkFrame(GeoFrame(48.0, 11.0), floor_amsl_m=488.0)
    assert frame.to_global((0.0, 0.0, 12.0))[2] == pytest.approx(500.0)
    assert frame.from_global(480000000, 110000000, 500_000)[2] == pytest.approx(12.0)


def test_displacements_agree_with_vectors() -> None:
    frame = MavlinkFrame(GeoFrame(48.0, 11.0, 0.7), floor_amsl_m=0.0)
    lat0, lon0, _ = frame.to_global((0.0, 0.0, 0.0))
    lat1, lon1, _ = frame.to_global((100.0, 0.0, 0.0))
    north, east, _ = frame.to_ned((100.0, 0.0, 0.0))
    assert (lat1 - lat0) * 1e-7 * 111_200 == pytest.approx(north, abs=0.2)
    assert (lon1 - lon0) * 1e-7 * 111_320 * math.cos(math.radians(48.0)) == pytest.approx(east, abs=0.3)
