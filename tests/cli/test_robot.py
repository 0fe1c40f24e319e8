"""`usarmjx robot check`: figures of a robot's file, what is left out, and whether it stands."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from tests.models.files.test_robot_files import BASE, WHEEL, hinge
from usarmjx.cli.app import app

CASES = Path(__file__).parents[1] / "models" / "files" / "cases"


def check(*words):
    return CliRunner().invoke(app, ["robot", "check", *map(str, words)])


def test_motors_of_hinges_and_slides_have_their_units(tmp_path):
    limit = '<limit lower="-.1" upper=".1" effort="5" velocity="2"/>'
    lift = WHEEL.format("carriage") + hinge(
        "lift", "carriage", "0 0 .3", "0 0 1", kind="prismatic", more=limit
    )
    turret = WHEEL.format("turret") + hinge("pan", "turret", "0 0 .3", kind="revolute", more=limit)
    path = tmp_path / "stand.urdf"
    path.write_text(f'<robot name="Stand">{BASE}{lift}{turret}<gazebo><kp>1</kp></gazebo></robot>')
    found = json.loads(check(path, "--json").stdout)
    assert found["motors"] == ["lift 5 N, 2 m/s", "pan 5 N m, 2 rad/s"]
    assert found["left out or mended"] == [f"{path}:9: settings of Gazebo are left out: kp"]


def test_a_robot_that_stands_has_no_faults_and_one_that_tips_has_one(tmp_path):
    found = check(CASES / "mesh_wheels.urdf")
    assert (found.exit_code, "fault" in found.stdout) == (0, False)
    path = tmp_path / "tip.urdf"
    base = BASE.replace('size=".6 .4 .1"', 'size=".02 .02 .1"')
    base = base.replace("<inertial>", '<inertial><origin xyz=".3 0 .1"/>')
    path.write_text(f'<robot name="Tip">{base}</robot>')
    found = check(path)
    assert found.exit_code == 1
    assert "fault        it moves by" in found.stdout


def test_a_policy_drives_a_robot_from_a_file(tmp_path):
    words = ["play", "--baseline", "drive-to-goal", "--robot", str(CASES / "mesh_wheels.urdf")]
    result = CliRunner().invoke(app, [*words, "--seconds", "0.4", "--out", str(tmp_path / "play.png")])
    assert result.exit_code == 0, result.output
    assert "drive-to-goal: 0.4 s, score" in result.output
    assert (tmp_path / "play.png").stat().st_size > 1000


@pytest.mark.thorough
def test_a_sweep_plays_a_robot_from_a_file(tmp_path):
    """It reaches its goal in both episodes, as the task's own robot does."""
    file = tmp_path / "s.yaml"
    file.write_text("common: {task: drive-to-goal, episodes: 2, policy: baseline}\n")
    words = ["sweep", str(file), "--robot", str(CASES / "mesh_wheels.urdf"), "--out", str(tmp_path / "out")]
    result = CliRunner().invoke(app, [*words, "--engine", "c"])
    assert result.exit_code == 0, result.output
    assert "1 of 1 cells, 0 failed" in result.output
    assert "| 1 (0.342 to 1) Wilson |" in result.output
