"""A sensor that only a file outside of the package knows: one function, one registration, and all works."""

import math
import re
import sys
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.arenas import FLAT
from tests.listening import compilations
from tests.scripts import load
from tests.server.peers import Peer, serving
from usarmjx.base.backend import xp
from usarmjx.base.errors import SpecError
from usarmjx.cli.catalogue import sensors_table
from usarmjx.models.compile.physics import Physics
from usarmjx.models.robots import ROBOTS
from usarmjx.models.robots.pioneer import P2AT
from usarmjx.models.types.robot import Mount, options
from usarmjx.sensors.base import FORMS, SENSORS, NoisySensorSettings, Quantity, Sensor, SensorSettings, noisy
from usarmjx.sensors.ranging import RangeScanner, ScannerSettings
from usarmjx.sensors.suite import suite_of
from usarmjx.server.gamebots import sensors as telling
from usarmjx.server.gamebots.sensors import CONFIGURATION, REPORTS, configuration, sensor_report
from usarmjx.server.protocol.grammar import format_message as line_of
from usarmjx.server.worlds.dynamic_world import DynamicWorld
from usarmjx.sim.batch import Batch
from usarmjx.sim.configure import configure
from usarmjx.sim.scene import build_scene

UP = (0.0, math.pi / 2, 0.0)
CURVE = ((0.0, 0.0), (5000.0, 1.0), (10000.0, 4.0))


@pytest.fixture(scope="module")
def example():
    """The example's module; what it registers leaves with it."""
    kept = [(registry, dict(registry._entries)) for registry in (ROBOTS, SENSORS)]
    yield load("own_sensor")
    del sys.modules["own_sensor"]
    for registry, entries in kept:
        registry._entries = entries


def meter(name, direction=UP, **settings):
    own = options(**{"Noise": 0.0, "ScanInterval": 0.0} | settings)
    return Mount(kind="LightMeter", name=name, at=(0.0, 0.0, -0.1), direction=direction, options=own)


@pytest.fixture(scope="module")
def bench(example, make_bench):
    sensors = (
        meter("Exact"),
        meter("Forward", direction=(0.0, 0.0, 0.0)),
        meter("Dim", Daylight=500.0),
        meter("Noisy", Noise=0.1),
        meter("Curved", OutputCurve=CURVE),
    )
    return make_bench(replace(P2AT, name="Lit", sensors=sensors))


def test_an_open_sky_is_all_the_light_there_is(bench):
    lux, *way = bench.once("LightMeter", "Exact")
    assert lux == pytest.approx(10_000.0)
    assert way == pytest.approx((0.0, 0.0, 1.0), abs=0.02)  # the rays' mean is as even as 128 points are
    assert bench.once("LightMeter", "Dim")[0] == pytest.approx(500.0)
    assert bench.once("LightMeter", "Curved")[0] == pytest.approx(4.0)


def test_half_of_the_sky_is_above_the_horizon(bench):
    """A plate that looks ahead sees the ground with its lower half."""
    lux, x, y, z = bench.once("LightMeter", "Forward")
    assert lux == pytest.approx(5000.0, abs=200.0)  # 128 points: 2 or 3 of them at the horizon
    # Centroid of half a disc: 4 / 3 pi up, and two thirds ahead, the mean height of the dome.
    assert z / x == pytest.approx(4 / (3 * math.pi) / (2 / 3), abs=0.03)
    assert y == pytest.approx(0.0, abs=0.03)


@pytest.mark.oracle
@pytest.mark.parametrize("height", [0.7, 1.5, 4.0])
def test_a_long_wall_takes_its_view_factor(bench, make_arena, height):
    """A level plate at the foot of a long wall sees (1 + cos b) / 2 of the sky, b the wall's elevation."""
    far, plate = 1.0, 0.36
    wall = ((0.0, far + 0.05, height / 2), (200.0, 0.05, height / 2), 0.0)
    lux, _, left, _ = bench.once("LightMeter", "Exact", geoms=make_arena((wall,)))
    elevation = math.atan2(height - plate, far)
    assert lux / 10_000 == pytest.approx((1 + math.cos(elevation)) / 2, abs=0.02)  # of 128 rays
    assert left < -0.02, "the light comes from the other side"


def test_under_a_roof_it_is_dark_and_comes_from_nowhere(bench, make_arena):
    roof = ((0.0, 0.0, 2.0), (400.0, 400.0, 0.1), 0.0)
    assert bench.once("LightMeter", "Exact", geoms=make_arena((roof,))).tolist() == [0.0] * 4


def test_noise_is_relative_and_uniform(bench):
    told = np.array([bench.once("LightMeter", "Noisy", seed=seed)[0] for seed in range(200)]) / 10_000 - 1
    assert abs(told).max() <= 0.1
    # Standard deviation of a uniform number: its half width by the root of 3; four of its errors for 200.
    assert told.std() == pytest.approx(0.1 / math.sqrt(3), abs=4 * 0.1 / math.sqrt(3 * 400))


@pytest.fixture(scope="module")
def lean(example):
    """The example's robot without what else it carries, which takes long to compile."""
    spec = ROBOTS.get("LightP2AT")
    suite = suite_of(spec)
    assert suite.index("LightMeter") == len(suite.sensors) - 1 == len(suite_of(P2AT).sensors)
    light = tuple(mount for mount in spec.sensors if mount.kind == "LightMeter")
    return ROBOTS.replace("LightP2AT", replace(spec, sensors=light))


def test_the_example_reads_it_in_a_batch(example, lean, capsys):
    example.main()
    lines = capsys.readouterr().out.splitlines()
    read = [re.match(rf"{place} +(\d+) lx", line) for place, line in zip(example.PLACES, lines, strict=True)]
    bright, wall, edge, dark = (float(found[1]) for found in read)
    assert bright == pytest.approx(10_000, rel=0.021)  # its own Noise
    assert 0.4 < wall / bright < 0.8
    assert 0.4 < edge / bright < 0.7, "half of the sky"
    assert dark / bright < 0.15


def test_a_client_hears_it_and_asks_about_it(example, lean):
    world = DynamicWorld(example.YARD, Physics(), 1, max_robots=1)
    world.prepare(lean)
    with serving(world, realtime_factor=0.0) as (port, _):
        peer = Peer(port, "INIT {ClassName USARBot.LightP2AT} {Name R1} {Start S-12.0}")
        number = r"(-?\d+\.\d{4})"
        line = peer.until(b"SEN").decode()
        said = re.fullmatch(
            rf"SEN {{Time {number}}} {{Type LightMeter}} {{Name Light}} {{Lux {number}}}"
            rf" {{Direction {number},{number},{number}}}",
            line,
        )
        assert said is not None, line
        assert float(said[2]) == pytest.approx(10_000, rel=0.021)
        assert float(said[5]) == pytest.approx(-1.0, abs=0.01), "up is negative on the wire"
        peer.say("GETCONF {Type LightMeter}")
        conf = peer.until(b"CONF").decode()
        assert conf == "CONF {Type LightMeter} {Name Light} {Daylight 10000.0000}"
        peer.say("GETGEO {Type LightMeter}")
        assert "{Name Light Location -0.2000,-0.1500,-0.0500 " in peer.until(b"GEO").decode()
        peer.say("SET {Type LightMeter} {Name Light} {Opcode RESET}")
        assert peer.until(b"RES").endswith(b"{Type LightMeter} {Name Light} {Status Failed}")
        peer.close()


def test_nothing_is_compiled_for_it_in_a_served_world(example, lean):
    """As in a batch, at the same step and place; see docs/own-sensor.md."""
    x, y, z = example.YARD.starts[0].at
    with compilations() as events, jax.transfer_guard("disallow_explicit"):
        world = DynamicWorld(example.YARD, seed=1)
        robot = world.spawn(lean, "R1", (x, y, z + 0.1), (0.0, 0.0, 0.0))
        world.observe([robot])
    assert events == []
    (told,) = robot.pending.values()
    batch = Batch(build_scene(example.YARD, [lean]), 1, engine="c", seed=1)
    _, ((read,),) = batch.observe(batch.reset())
    np.testing.assert_allclose(told, read.value[0, 0], rtol=1e-5, atol=1e-4)  # single precision, of 1e4 lx


def test_one_that_says_jax_numpy_is_served_too(monkeypatch):
    """It compiles, but reads."""
    monkeypatch.setattr(SENSORS, "_entries", dict(SENSORS._entries))

    class Tilt(Sensor):
        kind = "Tilt"
        settings_class = NoisySensorSettings

        def read(self, inputs, memory, key):
            _, mat = self.mount_poses(inputs.bodies)
            told = jnp.arccos(jnp.clip(mat[0, 2, 2:], -1.0, 1.0))
            return memory, noisy(key, told, self.settings) + 0 * jax.random.uniform(key)

    SENSORS.add(Tilt.kind, Tilt)
    world = DynamicWorld(FLAT, seed=1)
    robot = world.spawn(
        replace(P2AT, name="Level", sensors=(Mount(kind="Tilt", name="T"),)), "R1", (0, 0, 1.0), (0.3, 0, 0)
    )
    world.observe([robot])
    assert robot.pending[0] == pytest.approx([0.3], abs=1e-6)


def test_an_ini_file_mounts_it_and_sets_its_keys(example, tmp_path, monkeypatch):
    monkeypatch.setattr(ROBOTS, "_entries", dict(ROBOTS._entries))
    ini = tmp_path / "light.ini"
    ini.write_text(
        "[USARBot.LightMeter]\nDaylight=800\nDusk=1\n[USARBot.P2AT]\n"
        "AddSensors=(ItemClass=class'USARBot.LightMeter',ItemName=\"L\")\n"
    )
    (warning,) = configure([ini]).warnings
    assert "light.ini:3: unknown key" in warning
    assert "daylight" in warning
    assert suite_of(ROBOTS.get("P2AT")).sensors[-1].settings[0].daylight == 800.0
    ini.write_text("[USARBot.LightMeter]\nDaylight=-1\n")
    with pytest.raises(SpecError, match=r"light\.ini:2: .*Daylight is -1.*above 0"):
        configure([ini])


def test_lists_show_it(example):
    table = sensors_table()
    assert re.search(r"^\| LightMeter \| A plate .* \| 128 \| LightP2AT.* \| own \|$", table, re.MULTILINE)
    assert "Daylight=1e+04" in table


# The wire form of sensors that have none of their own.


def of_type(kind, quantities=(), grouped=False, settings=SensorSettings, names=("A",)):
    """A sensor of a new type that reads nothing."""
    bases = {"kind": kind, "quantities": quantities, "grouped": grouped, "read": None}
    made = type(kind, (Sensor,), bases)
    made.__abstractmethods__ = frozenset()
    mounts = tuple(Mount(kind=kind, name=name) for name in names)
    return made(plan=None, mounts=mounts, settings=(settings(),) * len(names))


def said(sensor, value):
    return line_of(sensor_report(sensor, np.array(value, np.float32), 62.01))


@pytest.mark.parametrize(
    ("form", "value", "text"),
    [
        ("number", [0.25], "0.2500"),
        ("count", [41.0], "41"),
        ("flag", [1.0], "True"),
        ("flag", [0.0], "False"),
        ("yaw", [0.5], "-0.5000"),
        ("vector", [1.0, 2.0, 3.0], "1.0000,-2.0000,-3.0000"),
        ("angles", [0.1, 0.2, 0.3], "0.1000,-0.2000,-0.3000"),
    ],
)
def test_every_form_is_turned_into_the_wires_axes(form, value, text):
    """Manual 6.1: y to the right, z down, so that pitch and yaw change sign and roll does not."""
    assert (
        said(of_type("New", (Quantity("Key", form),)), value) == f"SEN {{Type New}} {{Name A}} {{Key {text}}}"
    )
    assert set(FORMS) == set(telling._FORMATS)


def test_quantities_follow_each_other_and_without_them_all_numbers_are_one():
    both = (Quantity("At", "vector"), Quantity("Heat"))
    assert said(of_type("New", both), [1, 2, 3, 36.5]) == (
        "SEN {Type New} {Name A} {At 1.0000,-2.0000,-3.0000} {Heat 36.5000}"
    )
    assert (
        said(of_type("New"), [[1, 2], [3, 4]])
        == "SEN {Type New} {Name A} {Value 1.0000,2.0000,3.0000,4.0000}"
    )


def test_a_group_has_a_segment_for_each_and_the_time_if_wanted():
    @dataclass(frozen=True)
    class Timed(NoisySensorSettings):
        with_time_stamp: bool = True

    group = of_type("New", (Quantity("Heat"), Quantity("On", "flag")), True, Timed, ("A", "B"))
    assert said(group, [[1, 0], [2, 1]]) == (
        "SEN {Time 62.0100} {Type New} {Name A Heat 1.0000 On False} {Name B Heat 2.0000 On True}"
    )


def test_configuration_has_the_settings_of_its_own():
    @dataclass(frozen=True)
    class Own(NoisySensorSettings):
        top_speed: float = 1.5
        quick: bool = True
        mode: str = "Radius"
        steps: int = 3
        points: tuple = ()

    answer = configuration(P2AT, [of_type("New", settings=Own)], [0.9], "new", "")
    assert [line_of(line) for line in answer] == [
        "CONF {Type new} {Name A} {TopSpeed 1.5000} {Quick True} {Mode Radius} {Steps 3}"
    ]


def test_a_derived_sensor_speaks_as_its_ancestor_under_its_own_type():
    class Laser(RangeScanner):
        kind = "Laser"

    class Talker(RangeScanner):
        kind = "Talker"
        quantities = (Quantity("Nearest"),)

    short = ScannerSettings(resolution=1.5707, scan_fov=3.1415)
    laser, talker, plain = (
        made(plan=None, mounts=(Mount(kind=made.kind, name="S"),), settings=(short,))
        for made in (Laser, Talker, RangeScanner)
    )
    assert said(laser, [1, 2, 3]) == said(plain, [1, 2, 3]).replace("RangeScanner", "Laser")
    assert said(talker, [1]) == "SEN {Time 62.0100} {Type Talker} {Name S} {Nearest 1.0000}"
    conf, own = (
        line_of(configuration(P2AT, [sensor], [0.9], sensor.kind, "")[0]) for sensor in (laser, plain)
    )
    assert conf == own.replace("RangeScanner", "Laser")


def test_the_manuals_sensors_speak_as_captured():
    for kind in SENSORS.names():
        assert (kind in REPORTS) == (kind in CONFIGURATION)


def test_wrong_quantities_are_refused():
    with pytest.raises(SpecError, match=r"Heat is a 'temperature', expected one of number, count"):
        Quantity("Heat", "temperature")
    with pytest.raises(SpecError, match="'Two words', expected one word"):
        Quantity("Two words")


def test_a_value_of_another_shape_is_refused_when_the_world_starts(make_bench, monkeypatch):
    monkeypatch.setattr(SENSORS, "_entries", dict(SENSORS._entries))

    class Wrong(Sensor):
        kind = "Wrong"
        quantities = (Quantity("At", "vector"),)

        def read(self, inputs, memory, key):
            return memory, xp.zeros(2)

    SENSORS.add(Wrong.kind, Wrong)
    bench = make_bench(replace(P2AT, name="Bad", sensors=(Mount(kind="Wrong", name="W"),)))
    with pytest.raises(SpecError, match=r"Wrong: a value of shape \(2,\) was read, expected 3 numbers"):
        bench.start(bench.inputs())
