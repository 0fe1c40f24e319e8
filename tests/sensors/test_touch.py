"""Touch sensors against closed forms, and pressed by a robot that drives into a wall (manual 10.8)."""

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.rig import Rig
from usarmjx.base.transforms import angles_from_mat
from usarmjx.models.robots.pioneer import P2AT
from usarmjx.models.types.robot import Mount, options, resolve_settings
from usarmjx.models.types.shapes import Shape
from usarmjx.sensors.touch import TouchSettings, button_ray_origins
from usarmjx.server.gamebots.sensors import configuration, sensor_report
from usarmjx.server.protocol.grammar import format_message

HULL_X = 0.276  # m: front face of the P2AT's hull, 0.11 m below its origin
LOW = 0.11
HEIGHT = 0.26  # m: origin of a P2AT on the floor


@pytest.fixture(scope="module")
def bench(make_bench):
    def touch(name: str, at: tuple, yaw: float = 0.0, **keys: object) -> Mount:
        return Mount(kind="Touch", name=name, at=at, direction=(0.0, 0.0, yaw), options=options(**keys))

    mounts = (
        touch("Front", (HULL_X, 0.0, LOW)),
        touch("Left", (0.0, -0.3, 0.0), -math.pi / 2),  # the wire's y is to the right, its yaw clockwise
        touch("Wide", (HULL_X, 0.0, LOW), Diameter=0.04),
    )
    return make_bench(replace(P2AT, name="TouchBench", sensors=mounts))


def ahead(gap: float) -> tuple:
    """A wall whose face is that far ahead of the front button."""
    return ((HULL_X + gap + 0.1, 0.0, 0.5), (0.1, 2.0, 0.5), 0.0)


@pytest.mark.parametrize(
    ("gap_mm", "touched"),
    [(-5.0, True), (-1.0, True), (0.0, True), (4.6, True), (4.8, False), (100.0, False)],
)
def test_a_wall_nearer_than_4_7_mm_touches(bench, make_arena, gap_mm, touched):
    """Manual 10.8.1. A little inside the wall counts too: bodies in contact sink into each other."""
    geoms = make_arena(boxes=[ahead(gap_mm / 1000)])
    assert bench.once("Touch", "Front", geoms=geoms) == float(touched)
    assert bench.once("Touch", "Left", geoms=geoms) == 0.0


def test_in_the_open_nothing_touches(bench):
    assert [bench.once("Touch", name) for name in ("Front", "Left", "Wide")] == [0.0, 0.0, 0.0]


@pytest.mark.parametrize(("gap_mm", "touched"), [(4.6, 1.0), (4.8, 0.0)])
def test_a_button_on_the_side_feels_what_is_beside(bench, make_arena, gap_mm, touched):
    geoms = make_arena(boxes=[((0.0, 0.3 + gap_mm / 1000 + 0.1, 0.5), (1.0, 0.1, 0.5), 0.0)])
    assert bench.once("Touch", "Left", geoms=geoms) == touched
    assert bench.once("Touch", "Front", geoms=geoms) == 0.0


@pytest.mark.parametrize(("y", "z"), [(1, 0), (-1, 0), (0, 1), (0, -1)])
@pytest.mark.parametrize(("name", "radius"), [("Front", 0.005), ("Wide", 0.02)])
def test_the_button_is_as_wide_as_its_diameter(bench, make_arena, name, radius, y, z):
    """A small block 2 mm ahead, just on the rim and just beside it, on every side."""
    for beside, touched in ((radius - 5e-4, 1.0), (radius + 5e-4, 0.0)):
        offset, half = beside + 0.03, 0.03
        centre = (HULL_X + 0.002 + half, offset * y, HEIGHT - LOW + offset * z)
        geoms = make_arena(boxes=[(centre, (half, half, half), 0.0)])
        assert bench.once("Touch", name, geoms=geoms) == touched


def test_lines_are_spread_evenly_over_the_button():
    spots = button_ray_origins(0.01)
    assert len(np.unique(spots.round(6), axis=0)) == len(spots) > 5
    np.testing.assert_allclose(spots[:, 1:].sum(0), 0, atol=1e-8)
    assert np.linalg.norm(spots[:, 1:], axis=1).max() == pytest.approx(0.005, rel=1e-6)


def test_pushing_a_wall_presses_the_button_and_backing_off_releases_it(bench, make_arena):
    """The hull's face meets the wall in C MuJoCo; the button sits on it."""
    face = HULL_X + 0.1
    rig = Rig("P2AT", Shape(kind="box", size=(0.1, 2.0, 0.5), at=(face + 0.1, 0.0, 0.5), surface="wall"))
    geoms = make_arena(boxes=[((face + 0.1, 0.0, 0.5), (0.1, 2.0, 0.5), 0.0)])

    def feels() -> float:
        pos, angles = rig.data.body("r0/chassis").xpos, angles_from_mat(rig.mat("chassis"))
        return float(bench.once("Touch", "Front", at=tuple(pos), angles=tuple(angles), geoms=geoms))

    felt = [feels()]
    for speed in (2.0, -2.0):
        rig.tell(Left=speed, Right=speed)
        rig.run(1.0)
        felt.append(feels())
    assert felt == [0.0, 1.0, 0.0]


def test_defaults_are_the_manuals():
    """Manual 10.8.2."""
    settings = resolve_settings(TouchSettings, (), "Touch T")
    assert (settings.diameter, settings.weight, settings.with_time_stamp) == (0.01, 0.4, False)
    assert resolve_settings(TouchSettings, options(Diameter=0.02), "Touch T").diameter == 0.02


def test_all_of_a_robot_come_in_one_line(bench):
    (group,) = bench.suite.sensors
    assert format_message(sensor_report(group, np.array([1, 0, 0], np.float32), 1.0)) == (
        "SEN {Type Touch} {Name Front Touch True} {Name Left Touch False} {Name Wide Touch False}"
    )


def test_getconf_tells_the_diameter(bench):
    (message,) = configuration(
        bench.robot, bench.suite.sensors, (1.0,) * len(bench.robot.cameras), "Touch", "Wide"
    )
    assert format_message(message) == "CONF {Type Touch} {Name Wide} {Diameter 0.0400}"


PROUD = (0.280, 0.290, 0.300, 0.330)
"""How far ahead of the origin buttons stand out [m]; the hull meets walls at `HULL_X`."""


@pytest.fixture(scope="module")
def proud(make_bench):
    ahead = [Mount(kind="Touch", name=f"T{1000 * x:.0f}", at=(x, 0.0, z)) for x in PROUD for z in (LOW,)]
    above = [Mount(kind="Touch", name=f"A{1000 * x:.0f}", at=(x, 0.0, -0.4)) for x in PROUD]
    behind = [Mount(kind="Touch", name="Back", at=(-0.31, 0.0, LOW), direction=(0.0, 0.0, math.pi))]
    return make_bench(replace(P2AT, name="ProudBench", sensors=(*ahead, *above, *behind)))


@pytest.mark.parametrize("sunk_mm", [-2.0, 0.0, 2.0])
def test_buttons_that_stand_out_are_pressed_while_the_hull_is_pushed(proud, make_arena, sunk_mm):
    """Manual 10.8.1: nearer than 4.7 mm is touching, however far a button stands out, above the hull too."""
    geoms = make_arena(boxes=[ahead(-sunk_mm / 1000)])
    for x in PROUD:
        for row in "TA":
            assert proud.once("Touch", f"{row}{1000 * x:.0f}", geoms=geoms) == 1.0
    assert proud.once("Touch", "Back", geoms=geoms) == 0.0


def test_buttons_that_stand_out_keep_their_trigger_distance(proud, make_arena):
    for x in PROUD:
        for gap, touched in ((0.0046, 1.0), (0.0048, 0.0)):
            geoms = make_arena(boxes=[ahead(x + gap - HULL_X)])
            assert proud.once("Touch", f"T{1000 * x:.0f}", geoms=geoms) == touched
    geoms = make_arena(boxes=[((-HULL_X - 0.1, 0.0, 0.5), (0.1, 2.0, 0.5), 0.0)])
    assert proud.once("Touch", "Back", geoms=geoms) == 1.0
