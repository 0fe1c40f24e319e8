"""The plots of sensors: their numbers have oracles, and the pictures show them where they belong."""

import math

import mujoco
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.image import imread
from typer.testing import CliRunner

import dev
from tests.test_docs import blocks
from tools import sensor_figures
from tools.sensor_figures import app
from usarmjx.models.robots import ROBOTS
from usarmjx.models.types.arena import ArenaSpec
from usarmjx.models.types.shapes import Shape
from usarmjx.sensors.cameras.paint import ARENA_LABEL, ROBOT_LABEL, VICTIM_LABEL
from usarmjx.sensors.ranging import RangeSettings, SonarSettings
from usarmjx.sensors.rfid import RfidSettings, signal_strength

RAY_ATOL = 1e-3
"""Single precision at a few metres, and poses of a robot that stands 1 mm above the floor [m]."""
WALL = Shape(kind="box", size=(0.1, 3.0, 0.6), at=(2.1, 0.0, 0.6), surface="wall")
POST = Shape(kind="box", size=(0.2, 0.2, 0.6), at=(-1.0, 1.5, 0.6), surface="wall")
ROOM = ArenaSpec(name="room", starts=(), shapes=(WALL, POST), extent=((-3, 3), (-3, 3)))
AT, YAW = (0.5, -0.4), 0.3


@pytest.fixture(scope="module")
def seen():
    return sensor_figures.range_study(ROOM, AT, YAW)


@pytest.mark.oracle
def test_laser_beams_end_where_c_mujoco_says(seen):
    spec = mujoco.MjSpec()
    for shape in ROOM.shapes:
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, pos=shape.at, size=shape.size)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    assert seen.pose == pytest.approx((*AT, YAW), abs=1e-5)
    # The P2AT's scanner: 0.1439 m ahead (captured), 181 beams of a degree, from right to left.
    origin = np.array([AT[0] + 0.1439 * math.cos(YAW), AT[1] + 0.1439 * math.sin(YAW), 0.35])
    np.testing.assert_allclose(seen.origin, origin[:2], atol=RAY_ATOL)
    assert len(seen.ends) == 181
    met = 0
    for i, end in enumerate(seen.ends):
        angle = YAW + math.radians(i - 90)
        along, geom = np.array([math.cos(angle), math.sin(angle), 0.0]), np.zeros(1, np.int32)
        far = mujoco.mj_ray(model, data, origin, along, None, 1, -1, geom)
        assert seen.hit[i] == (far >= 0)
        if far >= 0:
            np.testing.assert_allclose(end, origin[:2] + far * along[:2], atol=5e-3)  # the beams' own angles
            met += 1
    assert 60 < met < 181


def test_sonars_are_where_the_manual_has_them_and_hear_the_wall(seen):
    """F4 and F5 look 10 degrees to the left and right, 0.24 m ahead and 0.025 m aside (12.1.1)."""
    assert seen.sonars.shape == (16, 3)
    cos, sin = math.cos(YAW), math.sin(YAW)
    for sonar, (y, turn) in {3: (0.025, 10), 4: (-0.025, -10)}.items():
        x = AT[0] + 0.24 * cos - y * sin
        assert seen.sonars[sonar] == pytest.approx(
            (x, AT[1] + 0.24 * sin + y * cos, YAW + math.radians(turn)), abs=RAY_ATOL
        )
        # The nearest line of the cone is the one that meets the wall most squarely; Noise is 5 %.
        low = min(abs(YAW + math.radians(turn) + a) for a in (-0.1746, 0.0, 0.1746))
        assert seen.echoes[sonar] == pytest.approx((2.0 - x) / math.cos(low), rel=0.06)
        assert not seen.no_echo[sonar]
    assert (seen.echoes[seen.no_echo] == 5.0).all()
    assert seen.no_echo.sum() >= 4, "nothing is behind the robot but a post"


def drawn(fill, seen):
    """A picture of 8 x 8 m about the origin, from the top, and what turns places into its pixels."""
    figure = Figure(figsize=(8, 8), dpi=50)
    canvas = FigureCanvasAgg(figure)
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set(xlim=(-4, 4), ylim=(-4, 4))
    fill(axes, seen)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[::-1, :, :3] / 255, axes.transData


def test_hits_and_robot_are_drawn_where_they_are(seen):
    image, pixels = drawn(sensor_figures.draw_laser, seen)
    column, row = pixels.transform(AT)
    assert image[round(row), round(column)] == pytest.approx(to_rgb(sensor_figures.BLUE), abs=0.02)
    pink = np.abs(image - to_rgb(sensor_figures.PINK)).max(-1) < 0.1
    for end in seen.ends[seen.hit][::10]:
        column, row = pixels.transform(end)
        here = pink[round(row) - 2 : round(row) + 3, round(column) - 2 : round(column) + 3]
        assert here.any(), end


def test_cones_reach_as_far_as_the_echo(seen):
    image, pixels = drawn(sensor_figures.draw_sonars, seen)
    x, y, yaw = seen.sonars[3]
    for share, filled in ((0.8, True), (1.3, False)):
        far = share * seen.echoes[3]
        column, row = pixels.transform((x + far * math.cos(yaw), y + far * math.sin(yaw)))
        red, _, blue = image[round(row), round(column)]
        assert (red - blue > 0.2) == filled


@pytest.mark.oracle
def test_ranges_of_tags_are_where_the_power_falls_to_the_sensibility():
    """2.99 m free and 2.44 m behind an obstacle: the manual's constants in its formula (10.9.3.3)."""
    for blocked, expected in ((False, 2.99), (True, 2.44)):
        reach = sensor_figures.rfid_range(RfidSettings(), blocked=blocked)
        assert reach == pytest.approx(expected, abs=0.005)
        assert signal_strength(RfidSettings(), reach, blocked, np) == pytest.approx(-88.0, abs=1e-9)


@pytest.mark.oracle
def test_an_exact_ins_is_on_the_winding_way():
    times, way = sensor_figures.winding_path(0.2)
    paths = sensor_figures.ins_paths(2, Sigma=0.0)
    assert paths.shape == (2, len(times), 2)
    np.testing.assert_array_equal(paths[0], paths[1])
    # A step along the new heading instead of the chord's is off by half the turn of a step: 3 cm over a bend.
    assert np.linalg.norm(paths[0] - way[:, :2], axis=-1).max() < 0.06
    # The heading is the way's: its chords point the same way, but for half a step's turn.
    chord = np.diff(way[:, :2], axis=0)
    turned = np.arctan2(chord[:, 1], chord[:, 0]) - way[:-1, 2]
    assert np.abs(turned).max() < 0.05


@pytest.mark.thorough
def test_noise_and_drift_of_an_ins_grow():
    _, way = sensor_figures.winding_path(0.2)
    exact = sensor_figures.ins_paths(1, Sigma=0.0)
    noisy = sensor_figures.ins_paths(16, Sigma=0.1) - exact
    drifting = sensor_figures.ins_paths(16, Sigma=0.0, Drifting=True) - exact
    for error in (noisy, drifting):
        far = np.median(np.linalg.norm(error, axis=-1), axis=0)
        assert 0 < 3 * far[len(way) // 10] < far[-1]
    # After a second at most 1/Precision per axis, and what half as much of a turn makes of the way of 0.5 m.
    assert 0 < np.abs(drifting[:, 5]).max() < 1e-3 + 0.5 * 1e-3 * 0.5 + 1e-5


@pytest.mark.parametrize(("satellites", "largest"), [(12, 0.75), (8, 1.625), (4, 2.5)])
def test_gps_errors_stay_within_the_largest(satellites: int, largest: float):
    """Linear between 12 and 4 satellites; three standard deviations."""
    errors = sensor_figures.gps_errors(satellites, 400)
    assert np.abs(errors).max() <= largest + 1e-5
    # Cut off at three standard deviations a normal number has 0.987 of its own; four errors for 800 numbers.
    assert errors.std() == pytest.approx(0.987 * largest / 3, rel=4 / math.sqrt(2 * 800))


def test_ranges_are_told_as_the_settings_say():
    true = np.array([0.05, 1.0, 2.0, 4.999, 5.0, 6.0], np.float32)
    curve = ((0.0, 0.0), (1.0, 1.6), (3.0, 2.4), (5.0, 5.0))
    assert curve == sensor_figures.EXAMPLE_OUTPUT_CURVE
    exact = sensor_figures.reported_ranges(true, RangeSettings(output_curve=curve))
    assert exact == pytest.approx([0.16, 1.6, 2.0, 4.9987, 5.0, 5.0], abs=1e-4)
    noisy = sensor_figures.reported_ranges(np.full(400, 2.0, np.float32), SonarSettings())
    assert np.abs(noisy - 2.0).max() <= 0.1 + 1e-6
    assert noisy.std() == pytest.approx(0.1 / math.sqrt(3), rel=0.15)  # four errors for 400 uniform numbers


def test_labels_of_pictures_have_their_colours_and_robots_are_one():
    names = [name for name, _ in sensor_figures.LABELS.values()]
    labels = np.array([ARENA_LABEL, VICTIM_LABEL, ROBOT_LABEL, ROBOT_LABEL + 3, -1, 0])
    found = [names[place] for place in sensor_figures.label_indices(labels)]
    assert found == ["arena", "victim", "the robot", "the robot", "outside", "sky"]


def test_the_first_camera_of_the_stereo_pair_is_the_left_one():
    """The wire's y is to the right."""
    left, right = ROBOTS.get("StereoP2AT").cameras
    assert left.at[1] < right.at[1]


def test_the_command_writes_what_is_asked_for(tmp_path):
    result = CliRunner().invoke(app, ["rfid", "noise", "--out", str(tmp_path / "new")])
    assert result.exit_code == 0, result.output
    files = [tmp_path / "new" / f"sensor-{name}.png" for name in ("rfid", "noise")]
    assert result.stdout == "".join(f"wrote {path}\n" for path in files)
    image = imread(files[0])[..., :3]
    for colour in (sensor_figures.BLUE, sensor_figures.ORANGE):
        assert (np.abs(image - to_rgb(colour)).max(-1) < 0.02).sum() > 500
    result = CliRunner().invoke(app, ["smell", "--out", str(tmp_path)])
    assert result.exit_code == 2
    assert "unknown plot 'smell'; known: camera, gps, ins, laser" in result.output


def test_all_plots_are_in_the_docs_and_small():
    page = (dev.ROOT / "docs" / "sensors.md").read_text(encoding="utf-8")
    for name in sensor_figures.PLOTS.names():
        assert f"](sensor-{name}.png)" in page
        assert (dev.ROOT / "docs" / f"sensor-{name}.png").stat().st_size < 150_000
    assert any("python tools/sensor_figures.py --out docs" in block for block in blocks(page, "console"))
