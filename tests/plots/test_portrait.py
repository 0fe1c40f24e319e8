"""Pictures of robots show what C MuJoCo's rays meet."""

import mujoco
import numpy as np
import pytest

from usarmjx.base.errors import UnknownNameError
from usarmjx.models.robots import ROBOTS
from usarmjx.plots.gallery import portrait, portraits
from usarmjx.plots.render import render_geoms_of, render_picture
from usarmjx.sensors.cameras.shading import CHECKER_RGB, SKY_RGB

BALL = """<mujoco><worldbody>
  <geom name="floor" type="plane" size="0 0 1"/>
  <geom name="ball" type="sphere" size="0.5" pos="0 0 0.5" rgba="1 0 0 1"/>
  <geom name="brick" type="box" size="0.3 0.2 0.4" pos="0.2 1.4 0.4" rgba="0 0 1 1"/>
</worldbody></mujoco>"""
EYE, TARGET, WIDTH, HEIGHT = np.array([4.0, -1.0, 1.5]), np.array([0.0, 0.3, 0.5]), 60, 40


@pytest.fixture(scope="module")
def scene():
    model = mujoco.MjModel.from_xml_string(BALL)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return model, data, render_picture(render_geoms_of(model, data), EYE, TARGET, WIDTH, HEIGHT)


def pixel_rays():
    """The picture's rays from its definition: a pinhole, 32 degrees high."""
    forward = (TARGET - EYE) / np.linalg.norm(TARGET - EYE)
    right = np.cross(forward, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    step = 2 * np.tan(np.radians(16)) / HEIGHT
    for row in range(HEIGHT):
        for column in range(WIDTH):
            x, y = column - (WIDTH - 1) / 2, (HEIGHT - 1) / 2 - row
            yield row, column, forward + step * (x * right + y * up)


@pytest.mark.oracle
def test_every_pixel_has_the_colour_of_what_mj_ray_meets(scene):
    """Hues: shading scales the three channels alike, except where it clips at full brightness."""
    model, data, picture = scene
    group, geom = None, np.zeros(1, np.int32)
    seen = set()
    for row, column, ray in pixel_rays():
        mujoco.mj_ray(model, data, EYE, ray / np.linalg.norm(ray), group, 1, -1, geom, None)
        colour = picture[row, column]
        name = model.geom(int(geom[0])).name if geom[0] >= 0 else "sky"
        seen.add(name)
        if name == "sky":
            assert colour == pytest.approx(SKY_RGB)
        elif name == "floor":
            assert colour[0] == pytest.approx(colour[1]), "the tiles are grey"
            assert colour[2] / colour[0] == pytest.approx(CHECKER_RGB[0, 2] / CHECKER_RGB[0, 0], abs=0.04)
        else:
            own = 0 if name == "ball" else 2
            assert colour[own] > 0.3
            assert np.delete(colour, own) == pytest.approx([0, 0])
    assert seen == {"sky", "floor", "ball", "brick"}


def test_the_side_towards_the_sun_is_brighter_and_there_is_a_shadow(scene):
    _, _, picture = scene
    red = picture[..., 0] * (picture[..., 1] < 0.01)
    assert red.max() > 1.3 * red[red > 0].min()
    floor = picture[np.abs(picture[..., 0] - picture[..., 1]) < 1e-6][:, 0]
    assert floor.min() < 0.5 * floor.max(), "in the shadow there is only ambient light"


def test_all_of_a_robot_is_in_its_portrait_and_fills_it():
    """The mirror of an OmniP2AT, on its tube, is the only bluish white above its coloured parts."""
    picture = portrait(ROBOTS.get("OmniP2AT"), 192, 144)
    colored = np.ptp(picture, axis=-1) > 0.15  # its orange sides and its blue scanner
    top = np.nonzero(colored)[0].min()
    mirror = (picture[..., 2] - picture[..., 0] > 0.03) & (picture[..., 1] > 0.5)
    mirror &= np.arange(144)[:, None] < top
    for part in (colored, mirror):
        rows, columns = np.nonzero(part)
        assert len(rows) >= 16
        assert 4 < rows.min() <= rows.max() < 139
        assert 4 < columns.min() <= columns.max() < 187
    assert top - np.nonzero(mirror)[0].max() > 20, "it is far above"
    assert np.nonzero(colored)[0].max() - np.nonzero(mirror)[0].min() > 72, "half of the height at least"


def test_portraits_of_all_asked_for_in_one_file(tmp_path):
    file = tmp_path / "new" / "two.png"
    portraits(["p2at", "P2DX"], file, columns=2)
    assert file.read_bytes()[:4] == b"\x89PNG"
    with pytest.raises(UnknownNameError, match="Batmobile"):
        portraits(["Batmobile"], file)
