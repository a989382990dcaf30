from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from deploy.backends import connect, faults_of, require, world_of
from deploy.errors import InputError
from deploy.map_drawing import drawing_of
from deploy.maps import Area, MapGeometry, MapImage
from deploy.mission import Mission, load
from deploy.mission_model import RandomFaults
from drivers.vehicle import Arm
from sim_backends.world import UAV_POWER_W

DEMO = Path(__file__).parents[2] / "mission_configs" / "demo.yaml"


@pytest.fixture(scope="module")
def demo() -> Mission:
    return load(DEMO)


def test_fleet_of_the_demo(demo: Mission) -> None:
    fleet = connect(demo)
    assert list(fleet.vehicles) == ["uav0", "uav1", "ugv0", "ugv1"]
    assert fleet.virtual
    assert fleet.name == "kinematic"
    assert fleet.planner_delay_s() == 0.0
    assert fleet.connect(5.0) == {}
    while fleet.clock.now() < 1.0:
        fleet.clock.wait_until(1.0)
    assert {pose.body for pose in fleet.poses.read()} == {u.body for u in demo.settings.uavs} | {
        g.body for g in demo.settings.ugvs
    }
    for vehicle in fleet.vehicles.values():
        vehicle.send(Arm(vehicle.id))
        assert vehicle.state().link
    assert fleet.truth is not None
    assert fleet.truth().violations == ()
    fleet.close()


def test_the_world_is_the_missions(demo: Mission) -> None:
    world = world_of(demo, seed=7)
    assert world.seed == 7
    assert world.fence_m == demo.settings.geofence.polygon_m
    assert [u.id for u in world.uavs] == [u.id for u in demo.problem.uavs]
    for uav, planned in zip(world.uavs, demo.problem.uavs, strict=True):
        assert uav.power_w == UAV_POWER_W
        assert uav.energy_j == pytest.approx(uav.capacity_j)  # full at take-off, the planner sees what is left above
        assert uav.capacity_j == planned.capacity_j
    starts = [v.start_m for v in (*world.uavs, *world.ugvs)]
    assert len(set(starts)) == len(starts)


def test_other_powers_than_the_papers(demo: Mission) -> None:
    uavs = tuple(replace(u, cruise_w=100.0, hover_w=120.0) for u in demo.problem.uavs)
    ugvs = tuple(replace(g, drive_w=50.0) for g in demo.problem.ugvs)
    mission = replace(demo, problem=replace(demo.problem, uavs=uavs, ugvs=ugvs))
    world = world_of(mission, seed=0)
    power = world.uavs[0].power_w
    assert power[0] == 120.0
    assert sum(c * 10.0**n for n, c in enumerate(power)) == pytest.approx(100.0)
    assert world.ugvs[0].power_w == (50.0,)


def test_drawn_faults(demo: Mission) -> None:
    assert faults_of(demo, 1000.0) == demo.faults
    mission = replace(demo, random_faults=RandomFaults(count=3, seed=2))
    faults = faults_of(mission, 1000.0)
    assert len(faults) == len(demo.faults) + 3
    assert faults == faults_of(mission, 1000.0)
    assert all(f.at_s <= 1000.0 for f in faults)


@pytest.mark.parametrize(("backend", "sim", "key"), [("x", "wire", "--backend"), ("sim", "y", "--sim")])
def test_what_is_not_there(backend: str, sim: str, key: str) -> None:
    with pytest.raises(InputError, match="does not exist") as error:
        require(backend, sim)
    assert "--backend sim --sim wire" in str(error.value)
    assert (error.value.key, error.value.exit_code) == (key, 2)


def test_drawing_of_a_road_map() -> None:
    square = np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 0.0)])
    line = np.array([(0.0, 0.0), (50.0, 0.0)])
    geometry = MapGeometry(
        bounds=(0.0, 1.0, 100.0, 200.0),
        roads=(line,),
        lines=(("stream", line), ("power", line)),
        areas=(Area("wood", square), Area("water", square), Area("block", square)),
    )
    drawing = drawing_of(geometry)
    assert drawing.extent == (0.0, 100.0, 1.0, 200.0)
    assert {kind: len(rings) for kind, rings in drawing.polygons.items()} == {"forest": 1, "water": 2, "building": 1}
    assert drawing.image is None


def test_drawing_of_an_occupancy_map() -> None:
    pixels = np.array([[0, 50, 100], [150, 200, 250]], dtype=np.uint8)
    straight = drawing_of(MapGeometry((0.0, 0.0, 3.0, 2.0), image=MapImage(pixels, 0.5, (1.0, 2.0, 0.0))))
    assert straight.image_extent == pytest.approx((1.0, 2.5, 2.0, 3.0))
    assert np.array_equal(straight.image, pixels)
    # turned a quarter counter-clockwise about its lower left corner: what was its left edge is the bottom
    turned = drawing_of(MapGeometry((0.0, 0.0, 3.0, 2.0), image=MapImage(pixels, 0.5, (1.0, 2.0, np.pi / 2))))
    assert turned.image_extent == pytest.approx((0.0, 1.0, 2.0, 3.5))
    assert turned.image is not None
    assert turned.image.tolist() == [[100, 250], [50, 200], [0, 150]]
