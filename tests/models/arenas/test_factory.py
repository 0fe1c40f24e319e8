"""DM-Factory: doors, the window, the glass and the roof, clear starts, and ways between all of them."""

import math

import mujoco
import numpy as np
import pytest

from tests.rig import Rig
from tests.starts import deepest
from tests.tours import ArenaRoute
from usarmjx.models.arenas.factory import BAY, DOCK, FACTORY, FLOOR, HEIGHT, WINDOW
from usarmjx.models.compile.reachability import footprint_of, reach_map, victims_reached
from usarmjx.models.robots import ROBOTS
from usarmjx.models.types.shapes import FENDER, GLASS, MIRROR
from usarmjx.sim.scene import build_scene

DEEP = 0.002  # m
BRUSH = 0.003  # m: how deep a robot of 14 kg gets into what it pushes
DOORS = {"Hall": (7.5, 8.0), "Office": (3.0, 10.0), "Control": (13.5, 10.0)}
"""Where a P2AT starts that then goes through the door, northward."""


def test_budget_of_solids_and_loose_objects():
    assert len(FACTORY.shapes) <= 150
    assert len(FACTORY.loose) <= 12
    assert {shape.kind for shape in FACTORY.shapes} == {"box"}, "cylinders touch boxes on every engine"
    assert {GLASS, MIRROR, FENDER} <= {shape.material for shape in FACTORY.shapes}


@pytest.mark.parametrize("name", FACTORY.robots)
def test_starts_are_clear(name):
    assert max(deepest(FACTORY, name).values()) <= DEEP


def ray(model, data, start, along):
    """Distance to what a ray meets that starts at a place in the arena's axes; -1: nothing."""
    place = np.add(start, (0.0, 0.0, FLOOR))
    return mujoco.mj_ray(model, data, place, np.array(along, float), None, 1, -1, np.zeros(1, np.int32))


@pytest.fixture(scope="module")
def built():
    model = build_scene(FACTORY, ["ComStation"]).model
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def test_the_roof_covers_every_room(built):
    """Straight up, from above the furniture: no sky, so no satellites."""
    for x in np.arange(0.25, 24.0, 0.5):
        for y in np.arange(0.25, 16.0, 0.5):
            up = ray(*built, (x, y, 2.3), (0, 0, 1))
            assert 0 <= up <= HEIGHT - 2.3 + 1e-6, (x, y)


def test_the_window_is_1_4_m_wide_and_high(built):
    """Rays through its plane, a millimetre inside and outside of each edge."""
    y0, y1, z0, z1 = WINDOW
    assert (y1 - y0, z1 - z0) == pytest.approx((1.4, 1.4))

    def passes(y, z):
        return not 0 <= ray(*built, (BAY - 0.5, y, z), (1, 0, 0)) < 0.6

    y, z = (y0 + y1) / 2, (z0 + z1) / 2
    for inside, sign in ((0.001, True), (-0.001, False)):
        assert passes(y0 + inside, z) == passes(y1 - inside, z) == sign
        assert passes(y, z0 + inside) == passes(y, z1 - inside) == sign


def test_an_airrobot_flies_through_the_window_by_its_drive_commands():
    """Up to the window's middle, ahead through it, stop; nothing is touched. 0.2 m are free on each side."""
    rig = Rig("AirRobot", arena=FACTORY, places=((13.6, (WINDOW[0] + WINDOW[1]) / 2, 0.0),))
    flight = ArenaRoute(rig)

    def fly(seconds, **values):
        rig.tell(**values)
        for _ in range(round(seconds * 50)):
            flight.step()

    fly(2.9, AltitudeVelocity=0.5)
    fly(1.5, AltitudeVelocity=0.0)
    fly(6.0, LinearVelocity=0.8)
    fly(2.0, LinearVelocity=0.0)
    assert flight.touched == 0.0
    x, y, z, up = flight.path[-1]
    assert x > BAY + 1.0
    assert y == pytest.approx((WINDOW[0] + WINDOW[1]) / 2, abs=0.05)
    assert WINDOW[2] < z - FLOOR < WINDOW[3]
    assert up > 0.99


def test_the_same_flight_a_metre_to_the_side_meets_the_wall():
    rig = Rig("AirRobot", arena=FACTORY, places=((13.6, WINDOW[0] - 0.3, 0.0),))
    flight = ArenaRoute(rig)
    for seconds, values in ((2.9, {"AltitudeVelocity": 0.5}), (5.0, {"LinearVelocity": 0.8})):
        rig.tell(**({"AltitudeVelocity": 0.0} | values))
        for _ in range(round(seconds * 50)):
            flight.step()
    assert flight.touched > 0.0
    assert flight.path[-1, 0] < BAY


@pytest.mark.every_run("in-Hall", "out-Office")
@pytest.mark.parametrize("name", DOORS)
@pytest.mark.parametrize("way", [1, -1], ids=["in", "out"])
def test_a_p2at_pushes_a_door_open_and_goes_through(name, way):
    x, y = DOORS[name]
    y = y if way > 0 else y + 2.0
    rig = Rig("P2AT", arena=FACTORY, places=((x, y, way * math.pi / 2),))
    door = rig.data.joint(f"door/{name}")
    tour = ArenaRoute(rig)
    assert door.qpos[0] == 0.0
    assert tour.to([(x, y + way * 2.0)], limit=10.0)
    assert way * door.qpos[0] > math.radians(60), "away from the robot: counter-clockwise going north"
    assert 0.0 < tour.touched < 2.0, "the door, on its way"
    assert tour.deepest < BRUSH
    assert tour.path[:, 3].min() > 0.99


def test_doors_stay_shut_by_themselves():
    rig = Rig("P2AT", arena=FACTORY, places=((*DOORS["Hall"], 0.0),))
    rig.run(2.0)
    assert max(abs(rig.data.joint(f"door/{name}").qpos[0]) for name in DOORS) < 1e-6


def test_a_p2at_drives_up_the_ramp_onto_the_dock():
    rig = Rig("P2AT", arena=FACTORY, places=((DOCK[0] - 3.0, 1.2, 0.0),))
    tour = ArenaRoute(rig)
    assert tour.to([(DOCK[0] + 1.0, 1.2)], limit=20.0)
    height = tour.path[-1, 2] - FLOOR
    assert height == pytest.approx(DOCK[2] + ROBOTS.get("P2AT").origin_height, abs=0.01)
    assert tour.path[:, 3].min() > math.cos(math.radians(16)), "the ramp has 14 degrees"


def test_p2ats_reach_every_start_and_every_victim():
    """Doors do not count, they open; a victim is reached when a robot gets within a metre of a part."""
    size = footprint_of(ROBOTS.get("P2AT"))
    reach = reach_map(FACTORY, size.radius, size.step)
    for start in FACTORY.starts:
        assert reach.reachable(*start.at[:2]), start.tag
    assert victims_reached(FACTORY, reach) == [True] * len(FACTORY.victims)


def test_loose_things_stay_where_they_are_put():
    rig = Rig("P2AT", arena=FACTORY, places=((*DOORS["Hall"], 0.0),))
    before = {loose.name: rig.data.joint(f"loose/{loose.name}").qpos.copy() for loose in FACTORY.loose}
    rig.run(3.0)
    for name, pose in before.items():
        now = rig.data.joint(f"loose/{name}").qpos
        assert np.linalg.norm(now[:3] - pose[:3]) < 0.005, name
