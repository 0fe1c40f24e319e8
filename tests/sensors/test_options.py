"""Options of many sensors: forms of noise, distortion after it, weights and housings; and measured wheels."""

import math
from dataclasses import replace

import jax
import mujoco
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from usarmjx.base.errors import SpecError
from usarmjx.base.settings.declaration import SMALLEST
from usarmjx.base.transforms import mat_from_angles
from usarmjx.models.compile.compose import add_robot, new_spec
from usarmjx.models.compile.kinematic_tree import kinematic_tree_of
from usarmjx.models.compile.parts import HOUSING_SIZE
from usarmjx.models.compile.physics import Physics
from usarmjx.models.robots.pioneer import ENCODER_AXIS, P2AT
from usarmjx.models.types.arena import ArenaSpec
from usarmjx.models.types.robot import Mount, options, resolve_settings
from usarmjx.sensors.base import SENSORS, NoisySensorSettings, noisy
from usarmjx.sensors.cameras.mounts import carried_weight
from usarmjx.sensors.ranging import RangeSettings, range_readings
from usarmjx.server.gamebots.sensors import geometry

AT = (0.3, 0.0, -0.3)  # in front of the robot, above its wheels
FAR = 1.9  # m to the wall
STEP_CURVE = ((0.0, 0.0), (2.0, 0.0), (10.0, 8.0))  # nothing up to 2 m, then what is beyond 2 m
DRAWS = 40
SCAN = {"Resolution": 0.02, "ScanFov": 3.0, "MaxRange": 20.0, "ScanInterval": 0.02}


def mount(kind, name, **keys):
    parent, direction = ("LeftFWheel", ENCODER_AXIS) if kind == "Encoder" else ("HARD", (0.0, 0.0, 0.0))
    return Mount(kind=kind, name=name, parent=parent, at=AT, direction=direction, options=options(**keys))


MOUNTS = (
    mount("Sonar", "Both", Noise=0.2, OutputCurve=STEP_CURVE, BeamAngle=0.0),
    mount("IR", "Both", Noise=0.2, OutputCurve=STEP_CURVE),
    mount("RangeScanner", "Both", Noise=0.2, OutputCurve=STEP_CURVE, **SCAN),
    mount("IRScanner", "Both", Noise=0.2, OutputCurve=STEP_CURVE, **SCAN),
    mount("RangeScanner", "Clean", **SCAN),
    mount("RangeScanner", "Gauss", Mean=0.05, Sigma=0.02, **SCAN),
    mount("IRScanner", "Clean", **SCAN),
    mount("IRScanner", "Uniform", Noise=0.1, **SCAN),
    mount("IRScanner", "Tilted", bYaw=False, bPitch=True, **SCAN),
    mount("IRScanner", "Slow", **SCAN | {"ScanInterval": 0.5}),
    mount("Odometry", "True", ScanInterval=0.0),
    mount("Odometry", "Big", ScanInterval=0.0, DiameterError=0.1),
    mount("Odometry", "Wide", ScanInterval=0.0, SeparationError=0.25),
    mount("Odometry", "Gauss", ScanInterval=0.0, Sigma=0.1, EncoderResolution=0.001),
    mount("Encoder", "Gauss", Resolution=0.001, Noise=0.0, Sigma=0.05),
)


@pytest.fixture(scope="module")
def bench(make_bench):
    return make_bench(replace(P2AT, name="OptionsBench", sensors=MOUNTS))


@pytest.fixture(scope="module")
def before_a_wall(bench, make_arena):
    """What the sensors read 1.9 m from a wall, by seed: functions of type and name."""
    geoms = make_arena(boxes=[((AT[0] + FAR + 0.5, 0.0, 0.5), (0.5, 30.0, 5.0), 0.0)])
    inputs = bench.inputs(geoms=geoms)
    memory = bench.start(inputs)
    seen = [bench.read(inputs, memory, seed)[1] for seed in range(DRAWS)]
    return lambda kind, name: np.array([bench.value(readings, kind, name) for readings in seen])


@pytest.mark.parametrize("kind", ["Sonar", "IR", "RangeScanner", "IRScanner"])
def test_noise_comes_first_and_the_distortion_after_it(before_a_wall, kind):
    """The other way round 1.9 m would always read 0, and noise of nothing is nothing."""
    value = before_a_wall(kind, "Both")
    ahead = value if value.ndim == 1 else value[:, value.shape[1] // 2]
    assert (ahead == 0).any()
    assert (ahead > 0).any()
    assert ahead.max() <= 1.2 * FAR * 1.001 - 2.0


def test_gaussian_noise_of_a_range_scanner_has_its_mean_and_sigma(before_a_wall):
    """40 scans of 151 beams: the mean is good to 0.02 / 78, the deviation to 1 %; four times that."""
    clean, loud = before_a_wall("RangeScanner", "Clean")[0], before_a_wall("RangeScanner", "Gauss")
    met = clean < 15.0
    error = (loud / clean - 1)[:, met]
    count = error.size
    assert count > 4000
    assert error.mean() == pytest.approx(0.05, abs=4 * 0.02 / math.sqrt(count))
    assert error.std() == pytest.approx(0.02, rel=4 / math.sqrt(2 * count))
    assert (loud[:, clean >= 20.0] == 20.0).all(), "no return is MaxRange exactly"


def test_uniform_noise_of_an_infrared_scanner_keeps_its_bounds(before_a_wall):
    clean, loud = before_a_wall("IRScanner", "Clean")[0], before_a_wall("IRScanner", "Uniform")
    met = clean < 15.0
    error = (loud / clean - 1)[:, met]
    assert np.abs(error).max() <= 0.1 * 1.0001
    # A uniform distribution: deviation 0.1 / sqrt(3), good to 1 % in 4000 draws; four times that.
    assert error.std() == pytest.approx(0.1 / math.sqrt(3), rel=0.04)
    assert abs(error.mean()) < 4 * 0.0577 / math.sqrt(error.size)
    assert (loud[:, clean >= 20.0] == 20.0).all()


def test_an_infrared_scanner_tilts(bench, before_a_wall):
    """From the floor up: FAR / cos upward to the wall, height / sin downward to the floor."""
    value = before_a_wall("IRScanner", "Tilted")[0]
    angle = -1.5 + 0.02 * np.arange(len(value))
    height = 0.26 - AT[2]
    with np.errstate(divide="ignore"):
        floor = np.where(angle < 0, height / np.sin(-angle), np.inf)
    expected = np.minimum(floor, FAR / np.cos(angle))
    low = expected < 4.0  # the wall ends 5.5 m up
    np.testing.assert_allclose(value[low], expected[low], atol=2e-4)
    assert low.sum() > 100


def test_an_infrared_scanner_scans_at_its_interval(bench):
    place = bench.suite.find("IRScanner", "Slow")
    memory, fresh = bench.start(bench.inputs()), []
    for tick in range(11):
        memory, readings = bench.read(bench.inputs(time=0.1 * tick), memory)
        fresh.append(bool(readings[place].fresh))
    assert np.flatnonzero(fresh).tolist() == [0, 5, 10]


def driven(bench, left, right, seed=0):
    inputs = bench.inputs()
    memory = bench.start(inputs)
    state = inputs.state.replace(joint_pos=inputs.state.joint_pos.at[:4].set(np.array([left, right] * 2)))
    _, readings = bench.read(inputs.replace(state=state), memory, seed)
    return lambda kind, name: bench.value(readings, kind, name)


def test_wheels_measured_too_large_make_ways_too_long(bench):
    """Manual 10.4.1: errors of the measured diameter and of the wheels' distance."""
    ahead = driven(bench, 10.005, 10.005)
    assert ahead("Odometry", "True")[0] == pytest.approx(10.0 * 0.13, abs=1e-4)
    assert ahead("Odometry", "Big")[0] == pytest.approx(1.1 * 10.0 * 0.13, abs=1e-4)
    assert ahead("Odometry", "Wide")[0] == pytest.approx(10.0 * 0.13, abs=1e-4)


def test_wheels_measured_too_far_apart_make_turns_too_small(bench):
    on_the_spot = driven(bench, -1.005, 1.005)
    turn = 2 * 1.0 * 0.13 / 0.4712
    assert on_the_spot("Odometry", "True")[2] == pytest.approx(turn, abs=1e-4)
    assert on_the_spot("Odometry", "Wide")[2] == pytest.approx(turn / 1.25, abs=1e-4)
    assert on_the_spot("Odometry", "Big")[2] == pytest.approx(turn * 1.1, abs=1e-4)


def test_odometry_and_encoders_take_sigma(bench):
    """Manual 10.6.2: any sensor. The way is the mean of two wheels': their deviation over the root of two."""
    values = [driven(bench, 10.0005, 10.0005, seed) for seed in range(150)]
    ways = np.array([value("Odometry", "Gauss")[0] for value in values]) / (10.0 * 0.13) - 1
    # 150 draws: the deviation is good to 6 %, the mean to 0.08 of it; three times that.
    assert ways.std() == pytest.approx(0.1 / math.sqrt(2), rel=0.18)
    assert abs(ways.mean()) < 0.25 * 0.0707
    ticks = np.array([value("Encoder", "Gauss") for value in values])
    ratio = np.abs(ticks) / (10.0 / 0.001) - 1
    assert ratio.std() == pytest.approx(0.05, rel=0.18)
    assert abs(ratio.mean()) < 0.25 * 0.05


def test_without_sigma_the_noise_is_the_uniform_one_alone_and_each_row_its_own():
    data = np.ones((2, 500), np.float32)
    plain, gauss = NoisySensorSettings(noise=0.1), NoisySensorSettings(noise=0.1, mean=1.0, sigma=0.0)
    told = np.asarray(noisy(jax.random.key(3), data, (plain, gauss)))
    alone = np.asarray(noisy(jax.random.key(3), data[:1], (plain,)))
    np.testing.assert_allclose(told[0], alone[0], rtol=1e-6)
    assert np.abs(told[0] - 1).max() <= 0.1
    assert (told[1] > 1.8).all()
    assert np.any(told[1] / 2 != told[0])


@settings(deadline=None)
@given(
    distances=st.lists(st.floats(0.0, 100.0, width=32) | st.just(math.inf), min_size=16, max_size=16),
    low=st.floats(0.0, 3.0),
    span=st.floats(0.0, 50.0),
    noise=st.floats(0.0, 3.0),
    sigma=st.floats(0.0, 3.0),
    seed=st.integers(0, 1000),
)
@example(distances=[0.0] * 16, low=6.3e-45, span=1.0, noise=0.0, sigma=0.0, seed=0)
def test_ranges_stay_within_their_limits_whatever_the_noise(distances, low, span, noise, sigma, seed):
    keys = {"MinRange": low, "MaxRange": low + span, "Noise": noise, "Sigma": sigma}
    if any(0 < value < SMALLEST for value in keys.values()):
        with pytest.raises(SpecError, match=r"numbers that are not 0 have magnitudes from 1\.2e-38"):
            resolve_settings(RangeSettings, options(**keys), "Sonar S")
        return
    mine = RangeSettings(min_range=low, max_range=low + span, noise=noise, sigma=sigma)
    true = np.array([distances], np.float32)
    told = np.asarray(range_readings(true, (mine,), jax.random.key(seed)))
    least, most = np.float32(mine.min_range), np.float32(mine.max_range)
    assert ((told >= least) & (told <= most)).all()
    assert (told[true >= most] == most).all()


@pytest.mark.parametrize("kind", sorted(kind for kind, _ in SENSORS))
def test_the_weight_of_every_sensor_adds_to_the_payload_and_to_no_mass(kind):
    bare = replace(P2AT, name="Bare", sensors=(), cameras=())
    loaded = replace(bare, sensors=(mount(kind, "A", Weight=1.25), mount(kind, "B", Weight=0.5)))
    assert carried_weight(loaded) == pytest.approx(1.75)
    assert kinematic_tree_of(loaded).mass == kinematic_tree_of(bare).mass


# --- HiddenSensor -------------------------------------------------------------------------------


def compiled(robot):
    spec = new_spec(ArenaSpec(name="nowhere", starts=(), extent=((0, 0), (0, 0))), Physics())
    add_robot(spec, robot, "", (0.0, 0.0, 2.0))
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


DIRECTION = (0.2, 0.4, 1.1)


def shown(kind, **keys):
    turned = Mount(
        kind=kind, name="S", parent="CameraPanTilt_Link2", at=(1.0, 0.2, -0.1), direction=DIRECTION,
        options=options(**keys),
    )  # fmt: skip
    return replace(P2AT, name="Shown", sensors=(turned,))


@pytest.mark.parametrize(
    ("kind", "key"), [("RangeScanner", "HiddenSensor"), ("GPS", "bHiddenSensor"), ("INS", "HiddenSensor")]
)
def test_a_sensor_that_is_not_hidden_is_seen_where_it_sits_and_never_touched(kind, key):
    hidden, visible = shown(kind), shown(kind, **{key: False})
    assert len(kinematic_tree_of(visible).geom_type) == len(kinematic_tree_of(hidden).geom_type) + 1
    assert (
        kinematic_tree_of(shown(kind, **{key: True})).geom_type.tolist()
        == kinematic_tree_of(hidden).geom_type.tolist()
    )
    assert kinematic_tree_of(visible).mass == kinematic_tree_of(hidden).mass
    model, data = compiled(visible)
    body = model.body("CameraPanTilt_Link2").id
    mine = (model.geom_bodyid == body) & (model.geom_size[:, 0] == HOUSING_SIZE[0])
    (geom,) = np.flatnonzero(mine)
    assert (model.geom_contype[geom], model.geom_conaffinity[geom]) == (0, 0)
    # Its front is where the mount is: there a ray against the sensor's direction ends. z is down on the wire.
    flip = np.diag([1.0, -1.0, -1.0])
    ahead = flip @ mat_from_angles(*DIRECTION)[:, 0]
    place, turn = data.xpos[body], data.xmat[body].reshape(3, 3)
    mounted = place + turn @ (flip @ (1.0, 0.2, -0.1))
    start = mounted + turn @ ahead
    hit = np.zeros(1, np.int32)
    far = mujoco.mj_ray(model, data, start, -(turn @ ahead), None, 1, -1, hit)
    assert (far, hit[0]) == (pytest.approx(1.0, abs=1e-6), geom)


def test_what_it_looks_like_changes_no_message(bench):
    for kind in ("RangeScanner", "GPS"):
        told = [
            geometry(kinematic_tree_of(robot), kind, "S")
            for robot in (shown(kind), shown(kind, HiddenSensor=False))
        ]
        assert told[0] == told[1]
