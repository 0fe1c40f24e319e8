"""`--packages` and `--pieces`: what commands tell the readers of robots' and arenas' files."""

import os
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from usarmjx.cli.app import app
from usarmjx.cli.common import PiecesOption, with_robot
from usarmjx.cli.listing import commands_of
from usarmjx.models.files.resources import mesh_pieces

CASES = Path(__file__).parents[1] / "models" / "files" / "cases"
FILE_READERS = {
    *("serve", "train", "sweep run", "play", "eval", "teams", "list", "portraits", "calibrate", "radio-map"),
    *("robot check", "robot export", "arena check", "arena draw", "arena export", "arena generate"),
    *("arena lane", "arena obstacles"),
}
"""Commands that take the file of a robot or of an arena."""
SDF = """<sdf version="1.9"><world name="w"><include><uri>model://hut</uri><pose>2 0 0 0 0 0</pose></include>
  </world></sdf>"""
HUT = """<sdf version="1.9"><model name="hut"><static>true</static><link name="l"><collision name="c">
  <geometry><box><size>1 1 1</size></box></geometry></collision></link></model></sdf>"""


def run(*words):
    return CliRunner().invoke(app, [*map(str, words)])


@pytest.fixture
def lost(tmp_path):
    """A robot in a folder of its own, away from the package that its mesh is in."""
    path = tmp_path / "robot" / "lost.urdf"
    path.parent.mkdir()
    path.write_text((CASES / "pack_description" / "urdf" / "mesh_of_a_package.urdf").read_text())
    return path


def test_every_command_that_reads_files_has_packages():
    told = {name for name, command in commands_of(app) if any("--packages" in p.opts for p in command.params)}
    assert told == FILE_READERS


def test_packages_are_searched_for_robots_until_the_command_ends(lost):
    assert "--packages DIR names folders to search" in run("robot", "check", lost).stderr
    found = run("robot", "check", lost, "--packages", CASES)
    assert found.exit_code in (0, 1)
    assert "mass" in found.stdout
    assert "USARMJX_PACKAGES" not in os.environ


def test_packages_are_searched_for_arenas(tmp_path):
    world, hut = tmp_path / "world" / "w.sdf", tmp_path / "shed" / "hut"
    world.parent.mkdir()
    hut.mkdir(parents=True)
    world.write_text(SDF)
    (hut / "model.sdf").write_text(HUT)
    (hut / "model.config").write_text("<model><sdf>model.sdf</sdf></model>")
    out = tmp_path / "out.xml"
    assert run("arena", "export", world, "--out", out, "--packages", CASES).exit_code == 2
    assert run("arena", "export", world, "--out", out, "--packages", tmp_path / "shed").exit_code == 0
    assert 'size="0.5 0.5 0.5"' in out.read_text()


def test_folders_that_are_missing_are_refused(lost):
    found = run("robot", "check", lost, "--packages", lost.parent / "nowhere")
    assert found.exit_code == 2
    assert "--packages" in found.stderr


def test_pieces_reach_the_readers_until_the_command_ends():
    seen = []
    probe = typer.Typer()

    @probe.command()
    def look(pieces: PiecesOption = None):
        seen.append((pieces, mesh_pieces()))

    assert CliRunner().invoke(probe, ["--pieces", "6"]).exit_code == 0
    assert (seen, mesh_pieces()) == ([(6, 6)], 1)


def test_robot_of_a_task_is_its_field():
    assert with_robot(["radius=1"], "cart.urdf") == ["radius=1", "robot=cart.urdf"]
    assert with_robot(None, None) == []


def test_a_robot_is_named_as_its_file_in_a_folder_of_robots(lost):
    found = run("portraits", "--robot", "mesh_wheels", "--packages", CASES, "--out", lost.parent / "tub.png")
    assert found.exit_code == 0, found.stderr
    assert (lost.parent / "tub.png").stat().st_size > 1000
    found = run("portraits", "--robot", "mesh_wheel", "--packages", CASES, "--out", lost.parent / "tub.png")
    assert found.exit_code == 2
    assert "mesh_wheel" in found.stderr
