"""`usarmjx robot check`: figures of a robot's file, what is left out, and whether it stands."""

import json
from pathlib import Path

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
