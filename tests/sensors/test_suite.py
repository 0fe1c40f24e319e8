"""When sensors measure, what they hold in between, and whose noise is whose."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from usarmjx.base.clock import clock_at
from usarmjx.base.errors import UnknownNameError
from usarmjx.models.robots.pioneer import P2AT
from usarmjx.models.types.robot import Mount, options
from usarmjx.sensors.suite import suite_of

PERIOD = 0.02  # s
# What runs twice is not worth XLA's optimiser.
quick_jit = partial(jax.jit, compiler_options={"xla_backend_optimization_level": 0})


def drive_along(bench, seconds: float):
    """Read at every control step of a drive at 0.5 m/s; yields (time, x, readings)."""
    memory = None
    for i in range(round(seconds / PERIOD) + 1):
        time = np.float32(np.float32(i) * np.float32(PERIOD))  # as a world's clock counts
        inputs = bench.inputs(time, at=(0.5 * float(time), 0.0, 0.26))
        memory = bench.start(inputs) if memory is None else memory
        memory, readings = bench.read(inputs, memory, seed=i)
        yield float(time), 0.5 * float(time), readings


def test_sensors_measure_at_their_interval_and_hold_the_value_in_between(bench):
    place = {name: bench.suite.find(*name) for name in (("Odometry", "Timed"), ("GroundTruth", "Chassis"))}
    scans, poses, held = [], [], 0.0
    for time, x, readings in drive_along(bench, 1.0):
        if readings[place["Odometry", "Timed"]].fresh:
            scans.append(time)
        truth = readings[place["GroundTruth", "Chassis"]]
        if truth.fresh:
            poses.append(time)
            held = x
        assert truth.value[0] == pytest.approx(held, abs=1e-6)
        assert readings[bench.suite.find("GroundTruth", "Head")].fresh  # ScanInterval 0
    np.testing.assert_allclose(scans, [0, 0.2, 0.4, 0.6, 0.8, 1.0], atol=1e-6)
    # 0.05 s do not fit steps of 0.02 s; the rate holds on average, within a step.
    assert len(poses) == 21
    np.testing.assert_allclose(poses, 0.05 * np.arange(21), atol=PERIOD)


def test_a_late_scan_is_not_made_up_for(bench):
    inputs = bench.inputs()
    memory = bench.start(inputs)
    place = bench.suite.find("Odometry", "Timed")
    fresh = []
    for time in (0.0, 5.0, 5.1, 5.2, 5.3, 5.4):  # nobody read for five seconds
        memory, readings = bench.read(inputs.replace(clock=clock_at(time, 1e-3)), memory)
        fresh.append(bool(readings[place].fresh))
    assert fresh == [True, True, False, True, False, True]


def test_an_episode_that_starts_late_measures_at_once(bench):
    inputs = bench.inputs(7.0)
    _, readings = bench.read(inputs, bench.start(inputs))
    manual = bench.suite.find("RangeScanner", "Manual")
    assert [bool(r.fresh) for r in readings] == [i != manual for i in range(len(readings))]


def test_a_manual_scanner_scans_once_for_each_command(bench, make_arena):
    place = bench.suite.find("RangeScanner", "manual")
    clean = bench.suite.find("RangeScanner", "Clean")
    near = make_arena(boxes=[((3.0, 0, 1), (0.5, 5, 1), 0.0)])
    inputs = bench.inputs(geoms=near)
    memory = bench.start(inputs)
    memory, readings = bench.read(inputs, memory)
    assert not readings[place].fresh
    assert bench.suite.handle_set(place, "RESET", (), inputs, memory) is None
    memory = bench.suite.handle_set(place, "scan", (), inputs, memory)
    memory, readings = bench.read(inputs, memory)
    assert readings[place].fresh
    scan = np.asarray(readings[place].value)
    np.testing.assert_array_equal(scan, readings[clean].value)
    assert (scan < 20).sum() > 50
    # Afterwards it holds that scan, whatever stands there.
    away = bench.inputs(1.0)
    memory, readings = bench.read(away, memory)
    assert not readings[place].fresh
    np.testing.assert_array_equal(readings[place].value, scan)
    memory = bench.suite.handle_set(place, "SCAN", (), away, memory)
    memory, readings = bench.read(away, memory)
    assert readings[place].fresh
    assert set(np.asarray(readings[place].value).tolist()) == {20.0}


def test_scan_in_automatic_mode_scans_out_of_turn(bench):
    """The command is valid in both modes (manual, Table 3)."""
    place = bench.suite.find("RangeScanner", "Clean")
    inputs = bench.inputs()
    memory, _ = bench.read(inputs, bench.start(inputs))
    inputs = inputs.replace(clock=clock_at(0.1, 1e-3))
    memory, readings = bench.read(inputs, memory)
    assert not readings[place].fresh
    memory = bench.suite.handle_set(place, "SCAN", (), inputs, memory)
    _, readings = bench.read(inputs, memory)
    assert readings[place].fresh


def kinds_of(tree):
    """Shape, type and weakness of every leaf: what decides whether a compiled function can be used again."""
    return jax.tree.map(lambda x: (jnp.shape(x), x.dtype, x.aval.weak_type), tree)


def test_nothing_that_happens_to_a_suite_needs_another_compilation(bench):
    inputs = bench.inputs()
    memory = bench.start(inputs)
    before = bench._read._cache_size()
    for i in range(3):
        memory, _ = bench.read(bench.inputs(0.1 * i, at=(i, 0, 0.26), wheels=[i] * 4), memory, seed=i)
    assert bench._read._cache_size() <= before + 1
    for kind, name, opcode, params in (
        ("RangeScanner", "Manual", "SCAN", ()),
        ("Odometry", "Odometry", "RESET", ()),
        ("Encoder", "Left", "RESET", ()),
        ("INS", "Loud", "POSE", (0.0,) * 6),
    ):
        told = bench.suite.handle_set(bench.suite.find(kind, name), opcode, params, inputs, memory)
        assert kinds_of(told) == kinds_of(memory), kind


# --- noise ------------------------------------------------------------------------------------

NOISY = (
    Mount(kind="Sonar", name="A", options=options(Noise=0.5, MaxIncidence=1.58)),
    Mount(
        kind="RangeScanner",
        name="B",
        direction=(0.0, -0.5, 0.0),
        options=options(Noise=0.5, Resolution=0.5, MaxRange=20.0, ScanInterval=0.02),
    ),
    Mount(kind="INS", name="C", options=options(ScanInterval=0.0)),
    Mount(kind="Encoder", name="D", parent="LeftFWheel", direction=(0, 0, -1.5708)),
)
MORE = (
    replace(NOISY[0], name="Z"),  # joins the group of A
    replace(NOISY[1], name="Y"),
    Mount(kind="Encoder", name="X", parent="LeftFWheel"),
    Mount(kind="INS", name="W"),
    Mount(kind="GroundTruth", name="V"),
)


@pytest.fixture(scope="module")
def noise(bench):
    """Readings of the robot with few sensors and with more, twice each with different keys."""
    geoms, here = bench.open, bench.inputs()
    there = bench.inputs(0.2, at=(0.5, 0.1, 0.26), angles=(0, 0, 0.3), wheels=[500.0] * 4)

    def draw(sensors):
        suite = suite_of(replace(P2AT, name=f"With{len(sensors)}", sensors=sensors))

        @quick_jit
        def read(seed):
            key = jax.random.key(seed)
            inputs = there.replace(hits=suite.cast_rays(geoms, there.bodies, jnp.int32(0)))
            return suite.read(inputs, suite.init_memory(here, jax.random.key(0)), key)[1]

        def named(seed):
            readings, values = read(seed), {}
            for mount in sensors:
                place = suite.find(mount.kind, mount.name)
                names = [m.name for m in suite.sensors[place].mounts]
                value = np.asarray(readings[place].value)
                grouped = suite.sensors[place].grouped
                values[mount.name] = value[names.index(mount.name)] if grouped else value
            return values

        return named(5), named(6)

    return draw(NOISY), draw(NOISY + MORE)


def test_a_sensor_added_at_the_end_leaves_the_noise_of_the_others_alone(noise):
    (alone, other_key), (joined, _) = noise
    for name in "ABCD":
        np.testing.assert_allclose(joined[name], alone[name], rtol=1e-6)
        assert np.any(alone[name] != other_key[name])  # there is noise


def test_two_alike_sensors_have_noise_of_their_own(noise):
    _, (joined, _) = noise
    assert joined["A"] != joined["Z"]
    hit = joined["B"] < 20
    assert hit.any()
    assert (joined["B"] != joined["Y"])[hit].all()


# --- looking up -------------------------------------------------------------------------------


def test_grouped_sensors_share_a_place_and_others_do_not():
    suite = suite_of(P2AT)
    kinds = ["Sonar", "RangeScanner", "Odometry", "INS", "GroundTruth", "RFID"]
    assert [s.kind for s in suite.sensors] == kinds
    assert [len(s.mounts) for s in suite.sensors] == [16, 1, 1, 1, 1, 1]
    assert suite.find("sonar", "f1") == suite.find("SONAR", "R8") == 0
    assert suite.find("Sonar", "Scanner1") is None
    assert suite.index("ins") == 3
    with pytest.raises(UnknownNameError, match="P2AT has no sensor 'Touch'; it has: Sonar, RangeScanner"):
        suite.index("Touch")


def test_unknown_sensor_types_and_settings_are_refused_when_the_suite_is_made():
    def with_mount(mount: Mount):
        return suite_of(replace(P2AT, name="Odd", sensors=(mount,)))

    with pytest.raises(
        UnknownNameError, match=r"unknown sensor 'Nose'; known: AHRS, AltitudeSensor, Battery, CO2Sensor, Enc"
    ):
        with_mount(Mount(kind="Nose", name="N"))
    with pytest.raises(UnknownNameError, match="INS I: InsSettings has no setting 'MaxRange'"):
        with_mount(Mount(kind="INS", name="I", options=options(MaxRange=3.0)))
