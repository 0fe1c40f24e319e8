"""Recordings as tables, figures and films."""

import csv
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from tests.recording.missions import HEIGHT, SCOUT, mission_world
from usarmjx.cli.app import app
from usarmjx.models.types.arena import LooseObject
from usarmjx.models.types.shapes import Shape
from usarmjx.plots.recording import read_mission
from usarmjx.recording.reader import RecordedMessage, Recording
from usarmjx.recording.recorder import ChannelName
from usarmjx.recording.tables import rows_of


def run(*words):
    return CliRunner().invoke(app, [*map(str, words)])


def table(path):
    with path.open(encoding="utf-8", newline="") as file:
        return [*csv.DictReader(file)]


def test_tables_have_what_happened(mission, tmp_path):
    path, places = mission
    result = run("export", path, "--out", tmp_path / "out.csv")
    assert result.exit_code == 0, result.output
    poses = table(tmp_path / "out-poses.csv")
    for row in poses:
        here = places[round(float(row["time"]) / 0.02) - 1][row["robot"]]
        np.testing.assert_allclose([float(row[axis]) for axis in "xyz"], here, atol=1e-5)
    assert {row["robot"] for row in poses} == {"First", "Second"}
    commands = [row for row in table(tmp_path / "out-commands.csv") if row["what"] == "setpoint"]
    told = [float(row["value"]) for row in commands if row["slot"] == "0"]
    assert told[-2:] == [4.0, 5.0]
    beams = [row for row in table(tmp_path / "out-readings.csv") if row["name"] == "Scanner1"]
    assert max(int(row["index"]) for row in beams) == 31
    assert table(tmp_path / "out-lines.csv")[0]["text"] == "DRIVE {Left 1}"
    assert [row["kind"] for row in table(tmp_path / "out-events.csv")] == ["join", "join", "leave"]
    assert table(tmp_path / "out-joints.csv")[0]["robot"] == "First"
    assert not (tmp_path / "out-scores.csv").exists()


def test_a_row_is_a_line_however_it_came():
    came = [("A", False, "INIT {Class"), ("B", False, "PLAY\n\n"), ("A", True, "NFO {Level X}\r\nSTA {")]
    came += [("A", False, "Name P2AT}\r"), ("A", False, "\nDRIVE {Left 1}\r\nGETG")]
    messages = [
        RecordedMessage(
            0.1 * n, ChannelName(0, "lines"), {"robot": "", "peer": peer, "sent": sent, "text": text}
        )
        for n, (peer, sent, text) in enumerate(came)
    ]
    recording = SimpleNamespace(messages=lambda kinds: iter(messages))
    assert [(round(row[0], 6), *row[3:]) for row in rows_of(recording, "lines")] == [
        (0.1, "B", False, "PLAY"),
        (0.2, "A", True, "NFO {Level X}"),
        (0.3, "A", False, "INIT {ClassName P2AT}"),
        (0.4, "A", False, "DRIVE {Left 1}"),
        (0.2, "A", True, "STA {"),
        (0.4, "A", False, "GETG"),
    ]


def test_what_parquet_needs_is_said(mission, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    result = run("export", mission[0], "--out", tmp_path / "out.parquet")
    assert result.exit_code == 2
    assert "pip install pyarrow" in result.output
    assert not [*tmp_path.iterdir()]


def test_parquet_has_the_same_rows(mission, tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    assert run("export", mission[0], "--out", tmp_path / "out.parquet").exit_code == 0
    rows = parquet.read_table(tmp_path / "out-poses.parquet").to_pylist()
    assert run("export", mission[0], "--out", tmp_path / "out.csv").exit_code == 0
    assert [row["x"] for row in rows] == [float(row["x"]) for row in table(tmp_path / "out-poses.csv")]


def test_films_move(mission, tmp_path):
    result = run("export", mission[0], "--out", tmp_path / "out.gif", "--speed", "1")
    assert result.exit_code == 0, result.output
    with Image.open(tmp_path / "out.gif") as film:
        assert film.n_frames == 6
        first = np.array(film.convert("RGB")).astype(int)
        film.seek(5)
        assert (np.abs(np.array(film.convert("RGB")) - first).max(-1) > 60).sum() > 50


def test_what_an_mp4_needs_is_said(mission, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    monkeypatch.setenv("PATH", "")
    result = run("export", mission[0], "--out", tmp_path / "out.mp4")
    assert result.exit_code == 2
    assert "imageio-ffmpeg" in result.output
    assert not [*tmp_path.iterdir()]


def test_other_files_are_refused_by_name(mission, tmp_path):
    result = run("export", mission[0], "--out", tmp_path / "out.avi")
    assert result.exit_code == 2
    assert ".csv, .parquet, .gif, .mp4" in " ".join(result.output.split())


def test_a_mission_has_ways_scans_and_the_victim(mission):
    shown = read_mission(Recording(mission[0]), 0, (0.0, np.inf))
    assert [way.name for way in shown.ways] == ["First", "Second"]
    for way in shown.ways:
        for time, (x, y, _) in zip(way.times, way.poses, strict=True):
            here = mission[1][round(time / 0.02) - 1][way.name]
            np.testing.assert_allclose((x, y), here[:2], atol=1e-5)
    assert shown.found.keys() == {0}
    assert shown.found[0][1] == "First"
    walls = np.abs(shown.scans).max(-1)  # beams end on walls of the room, or on who stands in it
    assert (walls < 3.1).all()
    assert (np.abs(walls - 2.95) < 0.1).mean() > 0.4


def test_a_part_of_the_time_is_all_that_is_looked_at(mission):
    shown = read_mission(Recording(mission[0]), 0, (0.5, 0.7))
    assert {time for way in shown.ways for time in way.times} <= {0.6200000000000001, 0.62, 0.6}


def test_films_from_above_show_objects_that_come_and_go(tmp_path):
    world, file = mission_world(tmp_path / "objects.mcap")
    world.spawn_at(SCOUT, "First", [((-1.0, 0.0, HEIGHT), (0.0, 0.0, 0.0))])
    box = Shape(kind="box", size=(0.1, 0.1, 0.1), mass=0.2)
    for step in range(36):
        if step == 12:
            world.add_loose(LooseObject(name="crate", at=(1.0, -1.5, 0.1), shapes=(box,)), held=False)
        if step == 24:
            world.remove_loose(1)
        world.step()
    file.close()
    shown = read_mission(Recording(tmp_path / "objects.mcap"), 0, (0.0, np.inf))
    counts = [len(places) for _, places in shown.loose]
    assert (counts[0], max(counts), counts[-1]) == (1, 2, 1)
    result = run("export", tmp_path / "objects.mcap", "--out", tmp_path / "objects.gif")
    assert result.exit_code == 0, result.output


def test_figures_are_written_as_the_names_say(mission, tmp_path):
    result = run("plot", mission[0], "--png", tmp_path / "m.png", "--pdf", tmp_path / "m.pdf")
    assert result.exit_code == 0, result.output
    assert (tmp_path / "m.pdf").read_bytes()[:5] == b"%PDF-"
    with Image.open(tmp_path / "m.png") as figure:
        assert figure.width == round(7.16 * 150)  # a page of IEEE's journals, pixels per inch of the style
        assert len(np.unique(np.array(figure.convert("RGB")).reshape(-1, 3), axis=0)) > 500


def test_a_figure_needs_a_name_and_a_world(mission, tmp_path):
    assert "--png" in run("plot", mission[0]).output
    result = run("plot", mission[0], "--png", tmp_path / "m.png", "--world", "7")
    assert result.exit_code == 2
    assert "has no world 7; it has: 0" in result.output
