"""The map of received power: its numbers are the manual's, and the picture shows them where they belong."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread
from typer.testing import CliRunner

from tests.comms.solids import box, slab_count, solids
from tests.comms.test_attenuation import DBM_ATOL, manual_power
from usarmjx.base.errors import UsageError
from usarmjx.cli.app import app
from usarmjx.comms.attenuation import RadioSettings, link_range
from usarmjx.models.types.arena import ArenaSpec, StartPose
from usarmjx.models.types.shapes import Shape
from usarmjx.plots import picture
from usarmjx.plots.radio_map import ANTENNA_HEIGHT, CUTOFF_LINE, parse_position, power_map, radio_picture

ROOM = ArenaSpec(
    name="Room",
    floor=-2.0,
    shapes=(Shape(kind="box", size=(0.1, 2.0, 0.5), at=(3.0, 0.0, 0.5), surface="wall"),),
    starts=(StartPose(tag="A", at=(0.0, 0.0, 0.2)),),
    extent=((-2.0, 4.0), (-2.0, 2.0)),
)
SENDER = (0.03, 0.02)


@pytest.mark.oracle
@pytest.mark.parametrize("heights", [(None, None), (0.4, None), (1.6, 0.3)])
def test_every_place_has_the_manuals_power(heights: tuple):
    sender, receiver = heights
    source = SENDER if sender is None else (*SENDER, sender)
    drawn = power_map(ROOM, source, height=receiver, step=0.25)
    assert drawn.power.shape == drawn.walls.shape == (len(drawn.y), len(drawn.x))
    wall = solids(box((3.0, 0.0, 0.5), (0.1, 2.0, 0.5)))
    up = ANTENNA_HEIGHT if sender is None else sender
    places = np.array([(x, y, up if receiver is None else receiver) for y in drawn.y for x in drawn.x])
    starts = np.tile((*SENDER, up), (len(places), 1))
    walls = slab_count(wall, starts, places)
    np.testing.assert_array_equal(drawn.walls.ravel(), walls)
    assert 0 < walls.mean() < 0.5
    apart = np.linalg.norm(places - starts, axis=-1)
    expected = [manual_power(d, w) for d, w in zip(apart, walls, strict=True)]
    np.testing.assert_allclose(drawn.power.ravel(), expected, atol=DBM_ATOL)


def test_the_picture_shows_the_cutoff_where_it_is(tmp_path: Path):
    """In the open a circle: half as wide as the wall of 4 m is long."""
    constants = RadioSettings(cutoff=-46.39)
    radius = link_range(constants, 0)
    assert radius == pytest.approx(1.0, abs=0.01)
    path = tmp_path / "map.png"
    radio_picture(ROOM, path, (0.0, 0.0), constants)
    assert path.read_bytes().startswith(b"\x89PNG\r\n\x1a\n")
    image = imread(path)[..., :3]

    def pixels(colour: str) -> np.ndarray:
        rgb = [int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)]
        return np.argwhere(np.abs(image - rgb).max(-1) < 0.02)

    wall = pixels(picture.WALL)
    columns = np.bincount(wall[:, 1])
    wall = wall[columns[wall[:, 1]] > 200]  # letters have dark pixels too
    scale = np.median(columns[columns > 200]) / 4.0
    circle = pixels(CUTOFF_LINE)
    assert len(circle) > 200
    # As exact as the line is wide and the grid fine.
    assert np.ptp(circle[:, 0]) / scale == pytest.approx(2 * radius, abs=0.06)
    middle = (circle[:, 1].min() + circle[:, 1].max()) / 2
    assert (wall[:, 1].mean() - middle) / scale == pytest.approx(3.0, abs=0.06)


def test_an_arena_without_a_cutoff_in_it_is_drawn(tmp_path: Path):
    radio_picture(replace(ROOM, shapes=()), tmp_path / "map.png", (0.0, 0.0))
    assert (tmp_path / "map.png").stat().st_size > 5000


def test_places_are_read_or_refused():
    assert parse_position("1,-2") == (1.0, -2.0)
    assert parse_position("-1.5, 2 ,0.3") == (-1.5, 2.0, 0.3)
    for wrong in ("", "1", "1,2,3,4", "1,b", "1,nan", "inf,0"):
        with pytest.raises(UsageError, match=r"x,y or x,y,z"):
            parse_position(wrong)


@pytest.mark.parametrize("step", [0.0, -1.0, 0.001, float("nan")])
def test_steps_that_are_too_fine_are_refused(step: float):
    with pytest.raises(UsageError, match=r"0\.02 m and more"):
        power_map(ROOM, SENDER, step=step)


def test_the_command_draws_with_the_constants_of_an_ini(tmp_path: Path):
    out, ini = tmp_path / "map.png", tmp_path / "USARComServer.ini"
    ini.write_text("[USARBotAPI.ComConnection]\neCutoff=-70\n")
    words = [
        "radio-map",
        "yellow",
        "--out",
        str(out),
        "--from",
        "-1.8,-1.2,1.6",
        "--height",
        "0.5",
        "--radio-ini",
        str(ini),
    ]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 0, result.output
    assert result.output == f"wrote {out}\n"
    with_line = imread(out)
    rgb = [int(CUTOFF_LINE[i : i + 2], 16) / 255 for i in (1, 3, 5)]
    assert (np.abs(with_line[..., :3] - rgb).max(-1) < 0.02).sum() > 500
    result = CliRunner().invoke(app, ["radio-map", "yellow", "--out", str(out), "--from", "here"])
    assert result.exit_code == 2
    assert "'here' is not of the form x,y or x,y,z" in result.output
