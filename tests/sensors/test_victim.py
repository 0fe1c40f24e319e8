"""Victim sensor against C MuJoCo's rays, the original's VictSensor.uc and captured lines (manual 10.10)."""

import math

import jax
import numpy as np
import pytest

from tests.sensors.people import Room, Watch
from usarmjx.base.errors import SpecError
from usarmjx.base.transforms import mat_from_angles
from usarmjx.models.compile.kinematic_tree import kinematic_tree_of
from usarmjx.models.compile.victims import PART_NAMES, box_names, rest_height
from usarmjx.models.robots.pioneer import P2AT
from usarmjx.models.types.arena import FalseAlarm, SegmentMotion, Victim
from usarmjx.models.types.robot import Mount, options, resolve_settings
from usarmjx.sensors.victim import VictSensor, VictSensorSettings, shifted_grids
from usarmjx.server.gamebots.sensors import configuration, sensor_report
from usarmjx.server.protocol.grammar import format_message

DRAWS = 400
MOUNT, TURN = (0.2, 0.1, -0.3), (0.1, -0.2, 0.15)  # the wire's axes
WIDE = dict(HorizontalFOV=1.5, VerticalFOV=1.2, HorizontalStep=0.05, VerticalStep=0.05)


@pytest.fixture(scope="module")
def watch():
    mounts = (
        Mount(kind="VictSensor", name="Exact", at=(0, 0, 0), options=options(Sigma=0.0)),
        Mount(
            kind="VictSensor",
            name="Tilted",
            at=MOUNT,
            direction=TURN,
            options=options(Sigma=0.0, **WIDE),
        ),
        Mount(kind="VictSensor", name="Noisy", at=(0, 0, 0), options=options(Sigma=0.05, Mean=0.02)),
        Mount(kind="VictSensor", name="Drawing", at=(0, 0, 0), options=options(bShowResults=True)),
    )
    return Watch(mounts, "VictimBench")


def random_room(seed):
    """Two victims and a false alarm a few metres ahead, and posts in front of them."""
    rng = np.random.default_rng(seed)
    postures = ["standing", "lying", "sitting", "crouched"]
    victims = []
    for i in range(2):
        posture = postures[rng.integers(4)]
        wave = SegmentMotion(name="LeftArm", initial=(-2, 0, 0.3), final=(-1, 0, 1), rates=(2, 0, 2))
        place = (rng.uniform(2, 5.5), rng.uniform(-1.5, 1.5), rest_height(posture))
        turned = (0.0, 0.0, rng.uniform(-3, 3))
        victims.append(Victim(name=f"v{i}", at=place, rotation=turned, posture=posture, segments=(wave,) * i))
    alarm = FalseAlarm(part="Head", at=(rng.uniform(2, 4), rng.uniform(-1, 1), 0.2))
    walls = tuple(
        ((rng.uniform(1, 3), rng.uniform(-2, 2), 0.5), (0.05, rng.uniform(0.1, 0.4), 0.5), rng.uniform(-1, 1))
        for _ in range(3)
    )
    return Room(victims=tuple(victims), alarms=(alarm,), walls=walls)


@pytest.mark.oracle
@pytest.mark.parametrize("seed", range(8))
def test_it_sees_what_c_mujocos_rays_meet_and_where(watch, seed):
    rng = np.random.default_rng(100 + seed)
    room, time = random_room(seed), 0.7 * seed
    at, angles = (rng.uniform(-0.5, 0.5), rng.uniform(-0.5, 0.5), 0.4), (0.0, 0.05, rng.uniform(-0.2, 0.2))
    value = watch.once(room, at=at, angles=angles, time=time)["Tilted"]
    # Where the sensor is, worked out by hand: the wire's y and z point the other way.
    body = mat_from_angles(*angles)
    origin = np.array(at) + body @ (MOUNT[0], -MOUNT[1], -MOUNT[2])
    frame = body @ mat_from_angles(TURN[0], -TURN[1], -TURN[2])
    lines = np.concatenate(
        shifted_grids(
            VictSensorSettings(horizontal_fov=1.5, vertical_fov=1.2, horizontal_step=0.05, vertical_step=0.05)
        )
    )
    far, which = room.met(origin, lines.astype(float) @ frame.T, time)
    counts = np.bincount(which[(which >= 0) & (far <= 6.0)], minlength=room.people.num_boxes)
    people = np.arange(room.people.num_boxes) < room.people.num_boxes - 1  # the last one is the false alarm
    assert (counts[people] > 0).sum() >= 3
    seen = value[: room.people.num_boxes, 0].astype(bool)
    np.testing.assert_array_equal(seen[people], counts[people] > 0)
    around = room.around(time)
    for box in np.flatnonzero(seen):
        expected = frame.T @ (around.box_pos[box] - origin)
        np.testing.assert_allclose(value[box, 2:], expected, atol=1e-5)  # float32 over 6 m
        assert value[box, 1] == around.box_part[box]
    assert not value[~np.isin(np.arange(len(value)), np.flatnonzero(seen))][:, [0, 2, 3, 4]].any()


@pytest.mark.oracle
@pytest.mark.parametrize("seed", range(3))
def test_with_show_results_it_draws_where_c_mujocos_rays_end_and_what_they_meet(watch, seed):
    """Manual 10.10.2; victims, false alarms, anything else and misses have a colour each."""
    room, origin = random_room(seed), np.array([0.0, 0.0, 0.5])
    overlay = watch.overlay("Drawing", room, at=tuple(origin))
    lines = np.concatenate(shifted_grids(VictSensorSettings())).astype(float)
    far, which = room.met(origin, lines)
    np.testing.assert_array_equal(overlay.start, overlay.end)
    assert overlay.shown.all()
    people, alarms = room.people.num_boxes - 1, which == room.people.num_boxes - 1
    missed = far > 6.0
    colors = np.where(which[:, None] >= 0, (0, 1, 0), (1, 0, 0))
    colors[alarms] = (1, 1, 0)
    colors[missed] = (1, 1, 1)
    same = np.isclose(overlay.end, origin + np.minimum(far, 6.0)[:, None] * lines, atol=1e-3).all(1)
    assert same.mean() > 0.99, "but for rays that graze an edge"
    assert (overlay.rgb == colors)[same].all(1).mean() > 0.99, "and those that end where two boxes meet"
    assert len(np.unique(colors, axis=0)) >= 3
    assert people > 0


STANDING = Victim(
    name="v", at=(3.0, 0.0, rest_height("standing")), rotation=(0, 0, math.pi), posture="standing"
)
CHEST = STANDING.at[2] + 0.17 * 1.75


def parts_of(value):
    names = [name.split("/")[1] for name in box_names([STANDING])]
    return {name for name, row in zip(names, value, strict=False) if row[0]}


def test_a_body_ahead_shows_its_limbs_left_and_right(watch):
    """At 3 m, 40 degrees are 2.2 m: from the belt up and down all of it but the feet."""
    value = watch.once(Room(victims=(STANDING,)), at=(0.0, 0.0, 1.0))["Exact"]
    seen = parts_of(value)
    assert {"Chest", "Pelvis", "Head", "LeftArm", "RightArm", "LeftLeg", "RightLeg"} <= seen
    row = value[[name.split("/")[1] for name in box_names([STANDING])].index("LeftArm")]
    assert PART_NAMES[int(row[1])] == "Arm"
    assert row[2] == pytest.approx(3.0, abs=1e-5)
    assert row[3] < -0.1  # it faces us: its left is our right, and y is left


@pytest.mark.parametrize(("x", "seen"), [(3.0, True), (5.8, True), (6.2, False)])
def test_nothing_is_seen_farther_than_distance(watch, x, seen):
    victim = Victim(**{**vars(STANDING), "at": (x, 0.0, STANDING.at[2])})
    value = watch.once(Room(victims=(victim,)), at=(0.0, 0.0, 1.0))["Exact"]
    assert bool(parts_of(value)) == seen


def test_walls_hide_what_is_behind_them(watch):
    low = Room(victims=(STANDING,), walls=(((2.0, 0.0, 0.5), (0.05, 3.0, 0.5), 0.0),))
    seen = parts_of(watch.once(low, at=(0.0, 0.0, 1.0))["Exact"])
    assert "Head" in seen  # above a wall of 1 m
    assert "LeftLeg" not in seen
    high = Room(victims=(STANDING,), walls=(((2.0, 0.0, 1.5), (0.05, 3.0, 1.5), 0.0),))
    assert not parts_of(watch.once(high, at=(0.0, 0.0, 1.0))["Exact"])


@pytest.mark.parametrize("angles", [(0, 0, 1.0), (0, 0, math.pi), (0, -1.2, 0)])
def test_what_is_outside_of_the_field_of_view_is_not_seen(watch, angles):
    assert not parts_of(watch.once(Room(victims=(STANDING,)), at=(0.0, 0.0, 1.0), angles=angles)["Exact"])


def test_the_four_grids_interleave():
    """VictSensor.uc: 11 x 11 rays, then shifted by half a step to the right, down, and both."""
    first, right, both, down = shifted_grids(VictSensorSettings())
    assert [len(grid) for grid in (first, right, both, down)] == [121, 110, 100, 110]
    left, up = (np.arcsin(first[:, 1] / np.hypot(*first[:, :2].T)), np.arcsin(first[:, 2]))
    half = 0.6981317 / 2
    for angles in (left, up):
        assert angles.max() == pytest.approx(half, abs=1e-6)
        assert angles.min() == pytest.approx(-half, abs=2e-6)
    turn = np.arctan2(right[:, 1], right[:, 0])
    assert turn.max() == pytest.approx(half - 0.0698131 / 2, abs=1e-6)
    assert np.arcsin(right[:, 2]).max() == pytest.approx(half, abs=1e-6)
    assert np.arcsin(both[:, 2]).max() == pytest.approx(half - 0.0698131 / 2, abs=1e-6)
    everything = np.concatenate([first, right, both, down])
    assert len(np.unique(everything.round(5), axis=0)) == 441
    np.testing.assert_allclose(np.linalg.norm(everything, axis=1), 1, rtol=1e-6)


def test_errors_grow_with_the_distance(watch):
    """Each coordinate is off by distance * N(Mean, Sigma)."""
    inputs = watch.inputs(Room(victims=(STANDING,)), at=(0.0, 0.0, CHEST))
    memory = watch.start(inputs)
    draws = [watch.read(inputs, memory, seed)[1] for seed in range(DRAWS)]
    chest = 1
    true = draws[0]["Exact"][chest, 2:]
    distance = float(np.linalg.norm(true))
    errors = np.array([draw["Noisy"][chest, 2:] for draw in draws]) - true
    # 1200 draws: 2 % of the deviation, 3 % of it for the mean; four times that
    assert errors.std() == pytest.approx(0.05 * distance, rel=0.08)
    assert errors.mean() == pytest.approx(0.02 * distance, abs=0.12 * 0.05 * distance)
    assert np.abs(np.corrcoef(errors.T) - np.eye(3)).max() < 0.2  # each axis has an error of its own
    assert all(np.array_equal(draw["Exact"][chest, 2:], true) for draw in draws)


@pytest.mark.every_run("3.0")
@pytest.mark.parametrize("distance", [5.0, 3.0, 1.5])
def test_false_alarms_come_and_go(watch, distance):
    """VictSensor.uc: each of four grids that meets one drops it if |N| < Distance / 3 / distance."""
    alarm = FalseAlarm(part="Chest", at=(distance, 0.0, 1.0), scale=2.0)  # as large as to be met by all four
    inputs = watch.inputs(Room(alarms=(alarm,)), at=(0.0, 0.0, 1.0))
    memory = watch.start(inputs)
    seen = np.array([watch.read(inputs, memory, seed)[1]["Exact"][0] for seed in range(DRAWS)])
    dropped = math.erf(6.0 / 3 / distance / math.sqrt(2))
    expected = 1 - dropped**4
    slack = 4 * math.sqrt(expected * (1 - expected) / DRAWS) + 1e-3
    assert seen[:, 0].mean() == pytest.approx(expected, abs=slack)
    told = seen[seen[:, 0] > 0][0]
    assert PART_NAMES[int(told[1])] == "Chest"


def test_real_victims_are_never_dropped(watch):
    inputs = watch.inputs(Room(victims=(STANDING,)), at=(0.0, 0.0, 1.0))
    memory = watch.start(inputs)
    assert len({frozenset(parts_of(watch.read(inputs, memory, seed)[1]["Exact"])) for seed in range(50)}) == 1


def test_in_an_empty_world_nothing_is_seen(watch):
    inputs = watch.inputs(Room()).replace(surroundings=None)
    memory = watch.suite.init_memory(inputs, jax.random.key(0))
    _, readings = watch.suite.read(inputs, memory, jax.random.key(0))
    assert readings[0].value.shape == (0, 5)


# --- settings and lines -----------------------------------------------------------------------


def test_defaults_are_the_manuals():
    """Manual 10.10.2; a report after four ticks of 0.2 s (VictSensor.uc)."""
    settings = resolve_settings(VictSensorSettings, (), "VictSensor V")
    assert settings == VictSensorSettings(
        hidden_sensor=True,
        distance=6.0,
        horizontal_fov=0.6981317,
        horizontal_step=0.0698131,
        vertical_fov=0.6981317,
        vertical_step=0.0698131,
        with_time_stamp=True,
        show_results=False,
        mean=0.0,
        sigma=0.01,
        scan_interval=0.8,
    )
    keys = options(HorizontalFOV=1.0, VerticalStep=0.1, bShowResults=True, Mean=0.1)
    assert resolve_settings(VictSensorSettings, keys, "VictSensor V").horizontal_fov == 1.0


def test_it_reports_every_fourth_tick(watch):
    room, fresh = Room(victims=(STANDING,)), []
    memory = watch.start(watch.inputs(room))
    for tick in range(9):
        inputs = watch.inputs(room, at=(0.0, 0.0, 1.0), time=0.2 * tick)
        memory, readings = watch._read(inputs, memory, jax.random.key(tick))
        fresh.append(bool(readings[0].fresh))
    assert fresh == [True, False, False, False, True, False, False, False, True]


def test_a_step_of_zero_is_refused():
    mount = Mount(kind="VictSensor", name="V", options=options(VerticalStep=0.0))
    with pytest.raises(SpecError, match=r"VictSensor V: VerticalStep is 0\.0, expected a number"):
        Watch((mount,), "Stepless")


def sensor():
    mount = Mount(kind="VictSensor", name="VictimSensor")
    return VictSensor(plan=kinematic_tree_of(P2AT), mounts=(mount,), settings=(VictSensorSettings(),))


def test_lines_are_those_of_the_manual_and_of_captures():
    leg, head = PART_NAMES.index("Leg"), PART_NAMES.index("Head")
    value = np.array(
        [[1, leg, 2.05, -0.33, -0.46], [0, head, 0, 0, 0], [1, leg, 2.51, -0.44, -0.39]], np.float32
    )
    assert format_message(sensor_report(sensor(), value, 5609.4467)) == (
        "SEN {Time 5609.4467} {Type VictSensor} {Name VictimSensor} {PartName Leg} {Location 2.05,0.33,0.46}"
        " {PartName Leg} {Location 2.51,0.44,0.39}"
    )
    for nothing in (0 * value, np.zeros((0, 5), np.float32)):
        assert format_message(sensor_report(sensor(), nothing, 5609.4467)) == (
            "SEN {Time 5609.4467} {Type VictSensor} {Status NoVictims}"
        )


def test_getconf_tells_range_and_fields_of_view(watch):
    (message,) = configuration(
        watch.robot, watch.suite.sensors, (1.0,) * len(watch.robot.cameras), "VictSensor", "Exact"
    )
    assert format_message(message) == (
        "CONF {Type VictSensor} {Name Exact} {MaxRange 6.0000} {HorizontalFOV 0.6981} {VerticalFOV 0.6981}"
    )
