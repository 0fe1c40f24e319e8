"""Sound, human motion and CO2 sensors against closed forms and the manual's lines (10.11, 10.12, 9.3)."""

import math

import jax
import numpy as np
import pytest

from tests.sensors.people import Room, Watch
from usarmjx.models.compile.victims import box_names, rest_height, segment_poses
from usarmjx.models.types.arena import HelpSound, SegmentMotion, Victim
from usarmjx.models.types.robot import Mount, options, resolve_settings
from usarmjx.sensors.base import NoisySensorSettings
from usarmjx.sensors.victim import HumanMotionSettings, SoundSettings, human_motion_probability
from usarmjx.server.gamebots.sensors import configuration, sensor_report
from usarmjx.server.protocol.grammar import format_message

CURVE = ((0.0, 0.0), (10.0, 1.0))
BACK = (0.0, 0.0, math.pi)
HEIGHT = 1.0


@pytest.fixture(scope="module")
def watch():
    mounts = (
        Mount(kind="Sound", name="Sound", options=options(Noise=0.0)),
        Mount(kind="Sound", name="Noisy", options=options(Noise=0.3)),
        Mount(kind="Sound", name="Curved", options=options(Noise=0.0, OutputCurve=CURVE)),
        Mount(kind="HumanMotion", name="Motion", options=options(Noise=0.0)),
        Mount(kind="HumanMotion", name="Trembling", options=options(Noise=0.5)),
        Mount(kind="HumanMotion", name="Narrow", options=options(Noise=0.0, FOV=10.0, MaxRange=4.0)),
        Mount(
            kind="HumanMotion", name="Bent", options=options(Noise=0.0, OutputCurve=((0.0, 0.0), (1.0, 0.5)))
        ),
        Mount(kind="CO2Sensor", name="CO2"),
        Mount(kind="CO2Sensor", name="Rough", options=options(Noise=0.2)),
    )
    return Watch(mounts, "EarBench")


def crying(name, x, y, loudness, **keys):
    return Victim(
        name=name, at=(x, y, 0.12), help_sound=HelpSound(loudness=loudness, duration=2.0, pause=1.0), **keys
    )


def head(victim, time=0.0):
    room = Room(victims=(victim,))
    return segment_poses(room.people, time)[0][2]


# --- sound --------------------------------------------------------------------------------------


@pytest.mark.parametrize(("x", "y"), [(2.0, 0.0), (-3.0, 4.0), (0.5, 10.0)])
def test_loudness_falls_with_the_square_of_the_distance(watch, x, y):
    victim = crying("v", x, y, 5.0)
    away = np.linalg.norm(head(victim) - (0, 0, HEIGHT))
    value = watch.once(Room(victims=(victim,)), at=(0, 0, HEIGHT))
    np.testing.assert_allclose(value["Sound"], [5.0 / away**2, 2.0], rtol=1e-5)
    np.testing.assert_allclose(value["Curved"], [0.5 / away**2, 2.0], rtol=1e-5)


def test_the_loudest_here_is_heard_wherever_it_is_and_whatever_is_between(watch):
    near, far = crying("near", 3.0, 0.0, 1.0), crying("far", -8.0, 0.0, 20.0)
    wall = ((1.5, 0.0, 1.0), (0.1, 3.0, 1.0), 0.0)
    for order in ((near, far), (far, near)):
        room = Room(victims=order, walls=(wall,))
        expected = max(v.help_sound.loudness / np.sum((head(v) - (0, 0, HEIGHT)) ** 2) for v in order)
        assert watch.once(room, at=(0, 0, HEIGHT))["Sound"][0] == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize(("time", "heard"), [(0.5, True), (1.9, True), (2.5, False), (3.5, True)])
def test_between_cries_there_is_silence(watch, time, heard):
    value = watch.once(Room(victims=(crying("v", 2.0, 0.0, 5.0),)), time=time)["Sound"]
    assert (value[0] > 0, value[1]) == (heard, 2.0 if heard else 0.0)


def test_noise_is_relative_and_within_its_amplitude(watch):
    inputs = watch.inputs(Room(victims=(crying("v", 2.0, 0.0, 5.0),)))
    memory = watch.start(inputs)
    draws = [watch.read(inputs, memory, seed)[1] for seed in range(200)]
    error = np.array([draw["Noisy"][0] for draw in draws]) / draws[0]["Sound"][0] - 1
    assert 0.28 < np.abs(error).max() <= 0.3 + 1e-6
    assert abs(error.mean()) < 0.05  # 0.17 / sqrt(200), four times


def test_in_an_empty_world_it_is_silent_still_and_fresh(watch):
    for inputs in (watch.inputs(Room()), watch.inputs(Room()).replace(surroundings=None)):
        memory = watch.suite.init_memory(inputs, jax.random.key(0))
        _, readings = watch.suite.read(inputs, memory, jax.random.key(0))
        assert not any(np.asarray(reading.value).any() for reading in readings)


# --- human motion -------------------------------------------------------------------------------


def waving(name, x, y, rate=2.0, swing=1.0, **keys):
    wave = SegmentMotion(name="LeftArm", initial=(-2.5, 0, 0), final=(-2.5 + swing, 0, 0), rates=(rate, 0, 0))
    place = (x, y, rest_height("standing"))
    return Victim(name=name, at=place, rotation=(0, 0, math.pi), posture="standing", segments=(wave,), **keys)


def expected(victim, time, swing=1.0, rate=2.0):
    """By hand: the fingertips are 0.332 + 0.108 of the height from the shoulder, and swing about it."""
    names = [name.split("/")[1] for name in box_names([victim])]
    pos = segment_poses(Room(victims=(victim,)).people, time)[0]
    near = min(np.linalg.norm(pos[names.index(bone)] - (0, 0, HEIGHT)) for bone in ("LeftArm", "LeftHand"))
    reach = math.hypot(0.332 + 0.108, 0.024) * 1.75
    speed, far = rate * reach, 2 * reach * math.sin(swing / 2)
    return 1 / (1 + (near / 5) ** 2) * speed / (speed + 0.2) * far / (far + 0.1)


def test_the_formula_is_halved_by_distance_speed_and_amplitude():
    assert human_motion_probability(0.0, 1e9, 1e9, np) == pytest.approx(1.0)
    assert human_motion_probability(5.0, 1e9, 1e9, np) == pytest.approx(0.5)
    assert human_motion_probability(0.0, 0.2, 1e9, np) == pytest.approx(0.5)
    assert human_motion_probability(0.0, 1e9, 0.1, np) == pytest.approx(0.5)
    assert human_motion_probability(0.0, 0.0, 0.0, np) == 0.0
    grid = np.linspace(0.01, 10, 30)
    assert np.all(np.diff(human_motion_probability(grid, 1.0, 1.0, np)) < 0)
    assert np.all(np.diff(human_motion_probability(1.0, grid, 1.0, np)) > 0)
    assert np.all(np.diff(human_motion_probability(1.0, 1.0, grid, np)) > 0)


@pytest.mark.parametrize(("x", "y", "time"), [(2.0, 0.0, 0.2), (3.0, -0.5, 1.1), (6.0, 1.0, 0.2)])
def test_a_waving_victim_moves_as_the_formula_says(watch, x, y, time):
    victim = waving("v", x, y)
    value = watch.once(Room(victims=(victim,)), at=(0, 0, HEIGHT), time=time)["Motion"]
    assert value == pytest.approx(expected(victim, time), rel=1e-3)  # speed by differences over 0.02 s


def test_the_closest_moving_one_counts(watch):
    still = Victim(name="still", at=(1.5, 0.3, rest_height("standing")), posture="standing")
    slow, fast = waving("slow", 2.5, -0.3, rate=0.3), waving("fast", 4.0, 0.5)
    for order in ((still, slow, fast), (fast, slow, still)):
        value = watch.once(Room(victims=order), at=(0, 0, HEIGHT), time=0.2)["Motion"]
        assert value == pytest.approx(expected(slow, 0.2, rate=0.3), rel=1e-3)


def test_whoever_is_still_is_no_motion(watch):
    still = Victim(name="still", at=(2.0, 0.0, 0.12))
    assert watch.once(Room(victims=(still,)), at=(0, 0, HEIGHT))["Motion"] == 0


def test_motion_outside_of_the_cone_beyond_the_range_or_behind_a_wall_is_not_seen(watch):
    """FOV is 60 degrees by default: half of it to each side."""
    assert watch.once(Room(victims=(waving("v", 3.0, 0.0),)), at=(0, 0, HEIGHT), angles=BACK)["Motion"] == 0
    tall = 1.4  # m: about where the hand is
    for bearing, seen in ((25, True), (35, False)):
        turn = (0.0, 0.0, math.radians(bearing))
        value = watch.once(Room(victims=(waving("v", 4.0, 0.0),)), at=(0, 0, tall), angles=turn)
        assert (value["Motion"] > 0) == seen
        assert value["Narrow"] == 0  # 10 degrees
    victim = waving("v", 0.0, 0.0)
    names = [name.split("/")[1] for name in box_names([victim])]
    hand = segment_poses(Room(victims=(victim,)).people, 0.0)[0][names.index("LeftHand")]
    for away, seen in ((3.9, True), (4.1, False)):  # of 4 m; the arm is farther away and out of the cone
        at = (hand[0] - away, hand[1], hand[2])
        assert (watch.once(Room(victims=(victim,)), at=at)["Narrow"] > 0) == seen
    wall = ((1.5, 0.0, 1.5), (0.1, 3.0, 1.5), 0.0)
    room = Room(victims=(waving("v", 3.0, 0.0),), walls=(wall,))
    assert watch.once(room, at=(0, 0, HEIGHT))["Motion"] == 0
    low = Room(victims=(waving("v", 3.0, 0.0),), walls=(((1.5, 0.0, 0.4), (0.1, 3.0, 0.4), 0.0),))
    assert watch.once(low, at=(0, 0, HEIGHT))["Motion"] > 0


def test_a_probability_stays_one_with_noise(watch):
    inputs = watch.inputs(Room(victims=(waving("v", 2.0, 0.0, rate=20.0, swing=2.0),)), at=(0, 0, 1.6))
    memory = watch.start(inputs)
    draws = np.array([watch.read(inputs, memory, seed)[1]["Trembling"] for seed in range(100)])
    assert draws.max() == 1.0
    assert draws.min() >= 0.0
    assert draws.std() > 0.1


def test_a_curve_distorts_the_probability(watch):
    value = watch.once(Room(victims=(waving("v", 2.0, 0.0),)), at=(0, 0, HEIGHT), time=0.2)
    assert value["Bent"] == pytest.approx(value["Motion"] / 2, rel=1e-5)
    assert value["Motion"] > 0.1


# --- CO2 ----------------------------------------------------------------------------------------


def test_breath_thins_out_with_the_square_of_the_distance(watch):
    """4 % at 0.1 m of the mouth, so 0.04 % at 1 m."""
    victim = Victim(name="v", at=(0.0, 0.0, 0.12))
    mouth = head(victim)
    for far, density in ((1.0, 0.04), (2.0, 0.01), (0.05, 4.0), (30.0, 4e-2 / 900)):
        at = (mouth[0] + far, mouth[1], mouth[2])
        assert watch.once(Room(victims=(victim,)), at=at)["CO2"] == pytest.approx(density, rel=1e-4)
    dead = Victim(name="v", at=(0.0, 0.0, 0.12), breathes=False)
    assert watch.once(Room(victims=(dead,)), at=tuple(mouth))["CO2"] == 0
    twin = Victim(**{**vars(victim), "name": "twin"})
    at = (mouth[0] + 1.0, mouth[1], mouth[2])
    assert watch.once(Room(victims=(victim, twin)), at=at)["CO2"] == pytest.approx(0.08, rel=1e-4)


def test_noise_of_a_density_is_relative_and_within_its_amplitude(watch):
    """A uniform one: 100 draws tell its deviation, 0.2 / sqrt(3), to 5 %; three times that."""
    victim = Victim(name="v", at=(0.0, 0.0, 0.12))
    mouth = head(victim)
    inputs = watch.inputs(Room(victims=(victim,)), at=(mouth[0] + 1.0, mouth[1], mouth[2]))
    memory = watch.start(inputs)
    draws = np.array([watch.read(inputs, memory, seed)[1]["Rough"] for seed in range(100)]) / 0.04 - 1
    assert np.abs(draws).max() <= 0.2001
    assert draws.std() == pytest.approx(0.2 / math.sqrt(3), rel=0.15)


# --- settings and lines -------------------------------------------------------------------------


def test_defaults_are_the_manuals():
    """Manual 10.11.2, 10.12.2."""
    sound, motion = resolve_settings(SoundSettings, (), "S"), resolve_settings(HumanMotionSettings, (), "M")
    assert (sound.noise, sound.weight, sound.output_curve) == (0.05, 0.4, ())
    assert (motion.max_range, motion.fov, motion.noise, motion.weight) == (1000.0, 60.0, 0.1, 0.4)
    assert resolve_settings(NoisySensorSettings, (), "C").weight == 0.4
    assert (sound.with_time_stamp, motion.with_time_stamp) == (False, False)


@pytest.mark.parametrize(
    ("fov", "radians"), [(60.0, math.pi / 3), (360.0, 2 * math.pi), (65535, 2 * math.pi)]
)
def test_a_field_of_view_is_in_degrees_or_in_unreals_units(fov, radians):
    assert HumanMotionSettings(fov=fov).fov_radians == pytest.approx(radians)


def test_lines_are_those_of_the_manual_and_of_captures(watch):
    """Manual 9.3; `SEN {Type CO2Sensor} {Name CO2} {Gas CO2} {Density 0.00}` was captured."""
    sensors = {sensor.mounts[0].name: sensor for sensor in watch.suite.sensors}

    def line(name, value):
        return format_message(sensor_report(sensors[name], np.array(value, np.float32), 5.0))

    assert line("Motion", 0.81) == "SEN {Type HumanMotion} {Name Motion} {Prob 0.81}"
    assert line("Sound", [17.22, 6.63]) == "SEN {Type Sound} {Name Sound} {Loudness 17.22} {Duration 6.63}"
    assert line("CO2", 0.0) == "SEN {Type CO2Sensor} {Name CO2} {Gas CO2} {Density 0.00}"


def test_getconf(watch):
    """Manual 9.3 and 10.11.2: what the sensor's section configures, but for looks and weight."""

    def conf(kind, name):
        (message,) = configuration(
            watch.robot, watch.suite.sensors, (1.0,) * len(watch.robot.cameras), kind, name
        )
        return format_message(message)

    assert conf("Sound", "Noisy") == "CONF {Type Sound} {Name Noisy} {Noise 0.3000}"
    assert conf("HumanMotion", "Motion") == (
        "CONF {Type HumanMotion} {Name Motion} {MaxRange 1000.0000} {FOV 1.0471}"
    )
    assert conf("CO2Sensor", "CO2") == "CONF {Type CO2Sensor} {Name CO2} {Noise 0.0000}"
