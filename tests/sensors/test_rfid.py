"""RFID sensor against the manual's closed forms (10.9.3), C MuJoCo's rays and a captured line."""

import math
from dataclasses import replace

import jax
import numpy as np
import pytest

from tests.sensors.blocks import c_rays, random_blocks
from tests.sensors.people import Room, Watch
from usarmjx.base.errors import SpecError
from usarmjx.models.compile.tags import tag_ids, tag_table
from usarmjx.models.types.arena import Tag
from usarmjx.models.types.robot import Mount, options, resolve_settings
from usarmjx.sensors.base import Sensor
from usarmjx.sensors.rfid import (
    MAX_TAGS,
    OBSTACLE_MARGIN,
    RAY_END_HEIGHT,
    RfidSettings,
    distance_of_strength,
    signal_strength,
)
from usarmjx.server.gamebots.sensors import configuration, sensor_report
from usarmjx.server.protocol.grammar import format_message

HEIGHT = 0.26
FREE, THROUGH = 2.9854, 2.4406  # m: where 36 - 20 (5.25 + 2 log d) - (0 or 3.5) is -88
MOUNT, TURN = (0.1, 0.2, -0.1), (0.2, -0.3, 0.7)  # the wire's axes


def reader(name, mode="Attenuation", **keys):
    return Mount(kind="RFID", name=name, options=options(SensingMode=mode, **keys))


@pytest.fixture(scope="module")
def watch():
    mounts = (
        reader("Attenuation"),
        reader("Radius", "radius"),
        reader("Obstacle", "Obstacle"),
        reader("Strong", dBmTXPower=41.0, dBObstacleAttenuation=1e3),
        *(reader(f"{mode}Lines", mode, bTraceRFIDs=True) for mode in ("Attenuation", "Radius", "Obstacle")),
        Mount(kind="RFID", name="Tilted", at=MOUNT, direction=TURN, options=options(SensingMode="Radius")),
    )
    return Watch(mounts, "TagBench")


def at(distance, **keys):
    """A tag on the ground so far from a sensor at HEIGHT above the origin."""
    return Tag(at=(math.sqrt(distance**2 - HEIGHT**2), 0.0, 0.0), **keys)


def ids(value):
    return [int(row[1]) for row in value if row[0]]


WALL = ((1.0, 0.0, 0.5), (0.05, 1.0, 0.5), 0.0)

# --- range ------------------------------------------------------------------------------------


def test_the_strength_of_the_signal_is_the_manuals():
    """Manual 10.9.3.3: Ps = dBmTXPower - 2 [10 (5.25 + 2 log10 d)]; figures worked out by hand."""
    settings = RfidSettings()
    for distance, strength in {0.1: 36 - 65.0, 1.0: 36 - 105.0, 10.0: 36 - 145.0}.items():
        assert signal_strength(settings, np.float64(distance), False, np) == pytest.approx(strength, abs=1e-9)
    assert signal_strength(settings, np.float64(1.0), True, np) == pytest.approx(36 - 105 - 3.5)
    assert np.isfinite(signal_strength(settings, np.float64(0.0), False, np))
    assert signal_strength(settings, np.float64(FREE), False, np) == pytest.approx(-88, abs=1e-3)
    assert signal_strength(settings, np.float64(THROUGH), True, np) == pytest.approx(-88, abs=1e-3)


def test_rays_go_no_further_than_a_tag_can_be_read():
    settings = RfidSettings()
    far = distance_of_strength(settings)
    assert far == pytest.approx(FREE, rel=1e-3)
    assert signal_strength(settings, np.float64(far), False, np) <= settings.rx_sensitivity_dbm
    assert np.isfinite(distance_of_strength(replace(settings, tx_power_dbm=1e6)))


@pytest.mark.parametrize(
    ("name", "free", "through"),
    [
        ("Attenuation", FREE, THROUGH),
        ("Radius", 3.0, 3.0),
        ("Obstacle", 3.0, 0.0),
        ("Strong", 10 ** ((129 / 20 - 5.25) / 2), 0.0),
    ],
)
@pytest.mark.parametrize("single", [False, True])
def test_each_mode_has_its_range(watch, name, free, through, single):
    """Obstacles end Obstacle, cost Attenuation 3.5 dB; single shots reach farther in the other two."""
    if single and name in ("Radius", "Obstacle"):
        free, through = 2 * free, 2 * through
    for walls, reach in (((), free), ((WALL,), through)):
        for distance in (1.2, reach - 0.01, reach + 0.01):
            if distance < 1.2:
                continue
            tag = at(distance, id=1001, single_shot=single)
            value = watch.once(Room(tags=(tag,), walls=walls), at=(0, 0, HEIGHT))[name]
            assert ids(value) == ([1001] if distance < reach else []), (walls, distance)


@pytest.mark.oracle
@pytest.mark.parametrize("seed", range(6))
def test_what_hides_a_tag_is_what_c_mujocos_rays_meet(watch, seed):
    rng = np.random.default_rng(seed)
    blocks = [(c, tuple(0.4 * np.array(half)), yaw) for c, half, yaw in random_blocks(seed)]
    blocks = [((0.4 * c[0], 0.4 * c[1], 0.2), half, yaw) for c, half, yaw in blocks]
    bearing, far = rng.uniform(-math.pi, math.pi, 6), rng.uniform(0.5, 2.9, 6)
    tags = tuple(
        Tag(at=(r * math.cos(b), r * math.sin(b), 0.0), id=2000 + i)
        for i, (b, r) in enumerate(zip(bearing, far, strict=True))
    )
    origin, shown = np.array([0.0, 0.0, HEIGHT]), []
    for tag in tags:
        way = np.add(tag.at, (0, 0, RAY_END_HEIGHT)) - origin
        distance = np.linalg.norm(np.array(tag.at) - origin)
        met = c_rays(blocks, origin, [way / np.linalg.norm(way)])[0]
        if met >= distance - OBSTACLE_MARGIN and distance <= 3.0:
            shown.append(tag.id)
    value = watch.once(Room(tags=tags, walls=tuple(blocks)), at=tuple(origin))["Obstacle"]
    assert sorted(ids(value)) == shown
    assert len(shown) < 6 or seed > 0


def test_dropped_tags_are_read_too_by_their_numbers_and_nearest_first(watch):
    room = Room(tags=(at(2.0, id=4711),), dropped=((0.5, 0.0, 0.0), (0.0, 2.5, 0.0), (9.0, 0.0, 0.0)))
    assert ids(watch.once(room, at=(0, 0, HEIGHT))["Attenuation"]) == [0, 4711, 1]


def test_a_heap_of_tags_shows_the_nearest(watch):
    heap = tuple((0.05 * i, 0.0, 0.0) for i in range(20))
    value = watch.once(Room(dropped=heap), at=(0, 0, HEIGHT))
    assert ids(value["Radius"]) == ids(value["Attenuation"]) == list(range(MAX_TAGS))


def test_places_are_seen_from_the_sensor_and_in_its_axes(watch):
    """By hand: the wire's rotations, turned back one after the other."""
    value = watch.once(
        Room(tags=(Tag(at=(1.0, -0.5, 0.1), id=1001),), floor=0.2), at=(0.3, 0.1, 0.5), angles=(0, 0, 0.4)
    )["Tilted"]

    def turned(x, y, angle):
        return x * math.cos(angle) - y * math.sin(angle), x * math.sin(angle) + y * math.cos(angle)

    x, y = turned(1.0 - 0.3, -0.5 - 0.1, -0.4)
    x, y, z = x, -y, -(0.1 + 0.2 - 0.5)  # the wire's
    x, y, z = x - MOUNT[0], y - MOUNT[1], z - MOUNT[2]
    x, y = turned(x, y, -TURN[2])
    z, x = turned(z, x, -TURN[1])
    y, z = turned(y, z, -TURN[0])
    np.testing.assert_allclose(value[0, 2:], [x, -y, -z], atol=1e-6)


def test_a_single_shot_answers_once(watch):
    tags = (at(1.0, id=1001, single_shot=True), at(1.5, id=1002))
    inputs = watch.inputs(Room(tags=tags), at=(0, 0, HEIGHT))
    memory = watch.start(inputs)
    memory, first = watch.read(inputs, memory)
    memory, second = watch.read(inputs, memory)
    away = watch.inputs(Room(tags=tags), at=(50, 0, HEIGHT))
    memory, none = watch.read(away, memory)
    memory, back = watch.read(inputs, memory)
    for name in ("Attenuation", "Radius"):
        assert [ids(v[name]) for v in (first, second, none, back)] == [[1001, 1002], [1002], [], [1002]]


def test_only_tags_in_range_can_be_read_and_written(watch):
    room = Room(tags=(at(1.0, id=1001), at(4.0, id=1002)))
    inputs = watch.inputs(room, at=(0, 0, HEIGHT))
    memory = watch.start(inputs)
    place = watch.suite.find("RFID", "Attenuation")
    assert watch.suite.handle_set(place, "Read", (1001.0,), inputs, memory) is None  # nothing was read yet
    memory, _ = watch.read(inputs, memory)
    for opcode in ("Read", "Write", "READ", "write"):
        assert watch.suite.handle_set(place, opcode, (1001.0,), inputs, memory) is not None
        assert watch.suite.handle_set(place, opcode, (1002.0,), inputs, memory) is None
        assert watch.suite.handle_set(place, opcode, (-1.0,), inputs, memory) is None
        assert watch.suite.handle_set(place, opcode, (), inputs, memory) is None
    assert watch.suite.handle_set(place, "Burn", (1001.0,), inputs, memory) is None


def test_without_tags_nothing_is_read(watch):
    assert not watch.once(Room())["Attenuation"].any()
    inputs = watch.inputs(Room()).replace(surroundings=None)
    memory = watch.suite.init_memory(inputs, jax.random.key(0))
    _, readings = watch.suite.read(inputs, memory, jax.random.key(0))
    assert not np.asarray(readings[0].value).any()


# --- traced lines -------------------------------------------------------------------------------

GREEN, RED, BLACK = (0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 0.0)
TO_BE_TRACED = Room(
    tags=(
        Tag(at=(1.2, 0.0, 0.0), id=2000),  # behind the wall
        Tag(at=(0.0, 1.0, 0.0), id=2001),
        Tag(at=(-2.7, 0.0, 0.0), id=2002),
        Tag(at=(0.0, -3.5, 0.0), id=2003, single_shot=True),
        Tag(at=(0.0, 3.6, 0.0), id=2004),
    ),
    walls=(((1.0, 0.0, 0.5), (0.05, 0.5, 0.5), 0.0),),
)


def lines(watch, mode):
    """Colours of the lines to the tags, by the tags' IDs; they start at the sensor."""
    overlay = watch.overlay(f"{mode}Lines", TO_BE_TRACED, at=(0, 0, HEIGHT))
    found = {}
    for start, end, rgb in zip(
        *(rows[overlay.shown] for rows in (overlay.start, overlay.end, overlay.rgb)), strict=True
    ):
        np.testing.assert_allclose(start, (0, 0, HEIGHT), atol=1e-6)
        (tag,) = [tag for tag in TO_BE_TRACED.tags if np.allclose(tag.at, end, atol=1e-6)]
        found[tag.id] = tuple(rgb.tolist())
    return found


def test_all_lines_are_green_in_the_mode_radius(watch):
    """Manual 10.9.3.1."""
    assert lines(watch, "Radius") == dict.fromkeys((2000, 2001, 2002, 2003), GREEN)


def test_lines_to_hidden_tags_are_red_in_the_mode_obstacle(watch):
    """Manual 10.9.3.2: green for reachable tags, red for hidden ones."""
    assert lines(watch, "Obstacle") == {2000: RED} | dict.fromkeys((2001, 2002, 2003), GREEN)


def test_lines_are_the_redder_the_weaker_the_signal_and_black_out_of_reach(watch):
    """Manual 10.9.3.3; green is what a tag at 1 m gives: 36 - 105 = -69 dBm, red the weakest that is read."""
    found = lines(watch, "Attenuation")
    assert found[2003] == found[2004] == BLACK
    for tag, through in ((2000, 3.5), (2001, 0.0), (2002, 0.0)):
        far = math.hypot(*TO_BE_TRACED.tags[tag - 2000].at, HEIGHT)
        good = (36 - 20 * (5.25 + 2 * math.log10(far)) - through + 88) / (88 - 69)
        assert found[tag] == pytest.approx((1 - good, good, 0.0), abs=1e-5)  # float32


def test_nothing_is_drawn_unless_wanted(watch):
    drawn = {sensor.mounts[0].name for sensor in watch.suite.sensors if sensor.has_overlay}
    assert drawn == {"AttenuationLines", "RadiusLines", "ObstacleLines"}
    quiet = watch.suite.sensors[0]
    assert watch.start(watch.inputs(Room())).own[0].overlay is None
    with pytest.raises(NotImplementedError, match="RFID"):
        Sensor.overlay(quiet, ())


# --- settings, IDs, lines -----------------------------------------------------------------------


def test_defaults_are_the_manuals():
    """Manual 10.9.2; captured lines have no time."""
    settings = resolve_settings(RfidSettings, (), "RFID R")
    assert (settings.mode, settings.max_range, settings.max_single_shot_range) == ("Attenuation", 3.0, 6.0)
    assert (settings.tx_power_dbm, settings.rx_sensitivity_dbm) == (36.0, -88.0)
    assert (settings.obstacle_attenuation_db, settings.weight) == (3.5, 0.4)
    assert (settings.trace_rfids, settings.always_read_rfid_mem, settings.with_time_stamp) == (False,) * 3
    keys = options(dBmTXPower=30.0, bTraceRFIDs=True, bAlwaysReadRFIDmem=True, dBmRXSensibility=-80.0)
    changed = resolve_settings(RfidSettings, keys, "RFID R")
    assert (changed.tx_power_dbm, changed.trace_rfids, changed.always_read_rfid_mem) == (30.0, True, True)


def test_other_modes_are_refused():
    with pytest.raises(SpecError, match="'Magic', expected one of Radius, Obstacle, Attenuation"):
        Watch((reader("R", "Magic"),), "Moded")


def test_automatic_ids_are_the_next_free_ones_above_those_of_releasers():
    here = (0.0, 0.0, 0.0)
    tags = (Tag(at=here), Tag(at=here, id=1002), Tag(at=here), Tag(at=here, id=5000))
    assert tag_ids(tags) == (1001, 1002, 1003, 5000)
    table = tag_table(tags, 6)
    assert table.id.tolist() == [1001, 1002, 1003, 5000, -1, -1]
    assert table.pos.shape == (6, 3)
    with pytest.raises(SpecError, match="4 tags do not fit into room for 3"):
        tag_table(tags, 3)
    with pytest.raises(SpecError, match="tag 1000, expected -1 or one above 1000"):
        tag_ids((Tag(at=here, id=1000),))
    with pytest.raises(SpecError, match="tags of one ID among 2000, 2000"):
        tag_ids((Tag(at=here, id=2000), Tag(at=here, id=2000)))


def test_lines_are_as_captured(watch):
    """`SEN {Type RFID} {Name RFIDReader} {ID 118} {Location -0.09,-0.00,0.04} {Mem 0} {ID ...}`."""
    loud = Watch((reader("RFIDReader", bAlwaysReadRFIDmem=True),), "LoudTagBench")
    (quiet, *_), (talker,) = watch.suite.sensors, loud.suite.sensors
    value = np.zeros((MAX_TAGS, 5), np.float32)
    value[0], value[1] = (1, 118, -0.09, 0.001, -0.04), (1, 1001, 2.5, -1.25, 0.3)
    assert format_message(sensor_report(talker, value, 1.0, texts={1001: "victim A"})) == (
        "SEN {Type RFID} {Name RFIDReader} {ID 118} {Location -0.09,-0.00,0.04} {Mem 0}"
        " {ID 1001} {Location 2.50,1.25,-0.30} {Mem victim A}"
    )
    assert format_message(sensor_report(quiet, value, 1.0, texts={1001: "victim A"})) == (
        "SEN {Type RFID} {Name Attenuation} {ID 118} {Location -0.09,-0.00,0.04}"
        " {ID 1001} {Location 2.50,1.25,-0.30}"
    )
    assert sensor_report(quiet, 0 * value, 1.0) is None


def test_getconf_tells_the_range(watch):
    (message,) = configuration(
        watch.robot, watch.suite.sensors, (1.0,) * len(watch.robot.cameras), "RFID", "Radius"
    )
    assert format_message(message) == "CONF {Type RFID} {Name Radius} {MaxRange 3.0000}"
