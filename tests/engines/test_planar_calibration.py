"""Engine `planar`: what was measured of robots on engine `c`."""

import json
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from typer.testing import CliRunner

import dev
import usarmjx
from tests.engines.eager import AT_ONCE, BLIND, EAGER
from usarmjx.base.settings.json_file import kept_text
from usarmjx.cli.app import app
from usarmjx.engines.planar import responses
from usarmjx.engines.planar.responses import (
    description_key,
    override_response,
    packaged_responses,
    response_entry,
    rolls,
)
from usarmjx.models.robots import ROBOTS
from usarmjx.server import make_worlds
from usarmjx.sim.calibration import calibrate, ensure_calibrated, measure_all, random_commands, record_drive
from usarmjx.train import open_floor

GEOM = mujoco.mjtGeom


ROLLING = [name for name, robot in ROBOTS if rolls(robot.drive)]


@pytest.mark.parametrize("name", ROLLING)
def test_responses_were_measured_of_robots_as_they_are(name):
    """After a change of a robot: `usarmjx calibrate`."""
    entry = packaged_responses()[name]
    assert entry["key"] == description_key(ROBOTS.get(name))
    assert set(entry["errors"]) == {"1 s", "5 s", "20 s"}


@pytest.mark.thorough
def test_a_measurement_comes_again_to_what_is_published():
    robot = ROBOTS.get("Talon")
    orders = random_commands(robot, 6, 150, seed=7)
    real, planar = (record_drive(robot, orders, engine) for engine in ("c", "planar"))
    apart = np.median(np.linalg.norm((planar.pose - real.pose)[-1, :, :2], axis=-1))
    assert apart <= 2.0 * packaged_responses()["Talon"]["errors"]["5 s"]["distance"], (
        "after 3 s, other orders"
    )
    assert apart < 0.1 * np.median(np.linalg.norm(np.diff(real.pose[..., :2], axis=0), axis=-1).sum(0))


@pytest.mark.every_run("Talon")
@pytest.mark.parametrize("name", ["Talon", "P2AT", "P2DX", "Sedan", "OmniP2AT"])
def test_planar_is_as_far_from_c_as_is_published(name):
    """A class of each kind of drive (tracks, sides, Ackermann, wheels that all steer), by the same orders.

    The motors of a P2DX have more torque at standstill.
    """
    robot, published = ROBOTS.get(name), packaged_responses()[name]["errors"]
    orders = random_commands(robot, 16, 1000, seed=1)[:250]
    real, planar = (record_drive(robot, orders, engine) for engine in ("c", "planar"))
    apart = np.median(np.linalg.norm((planar.pose - real.pose)[..., :2], axis=-1), axis=1)
    way = np.linalg.norm(np.diff(real.pose[..., :2], axis=0), axis=-1)
    for horizon, step in (("1 s", 50), ("5 s", 250)):
        assert apart[step - 1] == pytest.approx(published[horizon]["distance"], rel=0.1, abs=1e-3)
        assert np.median(way[: step - 1].sum(0)) == pytest.approx(published[horizon]["way"], rel=0.01)


def test_a_robot_of_one_s_own_is_measured_once_and_kept(tmp_path, monkeypatch, caplog):
    own = replace(BLIND, name="Own", mass=30.0, drive=replace(BLIND.drive, max_spin=3.0))
    made = []

    def quick(robot):
        made.append(robot.name)
        return calibrate(robot, robots=4, seconds=2.0)

    monkeypatch.setattr("usarmjx.sim.calibration.calibrate", quick)
    ensure_calibrated([own, own, EAGER], tmp_path)
    assert made == ["Own"]
    assert "measuring how a Own answers its motors" in caplog.text
    (file,) = (tmp_path / "planar").glob("*.json")
    assert json.loads(file.read_text())["key"] == description_key(own)
    response = responses._overrides.pop(own)
    ensure_calibrated([own], tmp_path)
    assert made == ["Own"]
    assert responses._overrides.pop(own) == response
    assert 0.5 < response.gain < 1.5


@pytest.fixture
def own(tmp_path, monkeypatch):
    """A robot of which nothing was measured; measuring it takes no time."""

    def quick(robot):
        override_response(robot, AT_ONCE)
        return response_entry(robot, AT_ONCE)

    robot = replace(ROBOTS.get("P2AT"), name="Mine", mass=31.0)
    monkeypatch.setenv("USARMJX_CACHE", str(tmp_path))
    monkeypatch.setattr("usarmjx.sim.calibration.calibrate", quick)
    yield robot
    responses._overrides.pop(robot, None)


def test_a_batch_refuses_a_robot_that_was_not_measured_at_once(own, tmp_path, caplog):
    scene = usarmjx.build_scene(open_floor(), [own, "P2AT"])
    with pytest.raises(usarmjx.UnsupportedFeatureError) as refused:
        usarmjx.Batch(scene, engine="planar")
    assert "no motor response of Mine was measured" in str(refused.value)
    assert "usarmjx.sim.ensure_calibrated(scene)" in str(refused.value)
    assert "\n" not in str(refused.value)
    assert not caplog.text
    assert not [*tmp_path.iterdir()]
    usarmjx.sim.ensure_calibrated(scene)
    assert usarmjx.Batch(scene, engine="planar").engine
    responses._overrides.pop(own)  # as in another process, which finds the file
    assert usarmjx.Batch(scene, engine="planar").engine


def test_make_measures_a_robot_before_it_builds(own, caplog):
    env = usarmjx.make("drive-to-goal", engine="planar", robot=own, arena="floor")
    assert env.scene.robots[0][0].name == "Mine"
    assert "measuring how a Mine answers its motors" in caplog.text


def test_serving_measures_a_robot_before_it_builds(own, monkeypatch, caplog):
    monkeypatch.setattr(ROBOTS, "_entries", dict(ROBOTS._entries))
    ROBOTS.add(own.name, own)
    monkeypatch.setattr("usarmjx.server.worlds.make.SharedBatch", lambda batch: batch)  # as it compiles
    monkeypatch.setattr("usarmjx.server.worlds.make.BatchWorld", lambda batch, number: batch)
    (batch,) = make_worlds(
        arena="yellow", engine="planar", worlds=1, instances=[0], roster="Mine:1", max_robots=1, seed=0
    )
    assert batch.scene.robots[0][0] == own
    assert "measuring how a Mine answers its motors" in caplog.text


def test_the_page_has_the_table_of_what_ships():
    printed = CliRunner().invoke(app, ["calibrate", "--markdown"])
    assert printed.exit_code == 0
    assert printed.output.strip() in (dev.ROOT / "docs" / "fidelity.md").read_text(encoding="utf-8")
    assert f"| P2AT | {packaged_responses()['P2AT']['errors']['1 s']['distance']:.2f} m" in printed.output


def test_what_does_not_roll_is_refused():
    refused = CliRunner().invoke(app, ["calibrate", "AirRobot"])
    assert refused.exit_code == 2
    assert "AirRobot does not roll on wheels or tracks" in refused.output


@pytest.mark.parametrize("fault", ["cut", "empty", "digit", "nan", "key", "other", "field", "list"])
def test_a_kept_response_that_is_not_whole_is_measured_again_with_one_line(own, tmp_path, caplog, fault):
    text = kept_text(response_entry(own, responses.Response(gain=1.0165)))
    other = kept_text(response_entry(ROBOTS.get("Talon"), responses.Response(gain=1.0165)))
    entry = {"key": description_key(own), "response": {"gain": 1.0}}
    file = responses.response_file(own, tmp_path)
    file.parent.mkdir()
    file.write_text(
        {
            "cut": text[:60],
            "empty": "",
            "digit": text.replace("1.0165", "1.0166"),
            "nan": text.replace("1.0165", "NaN"),
            "key": text.replace(description_key(own), "0" * 16),
            "other": other,
            "field": kept_text(entry),
            "list": "[]",
        }[fault]
    )
    assert responses.find_response(own, tmp_path) is None
    assert not file.exists()
    (line,) = caplog.messages
    assert line.startswith(f"{file}:")
    assert line.endswith("; it is measured again")
    ensure_calibrated([own], tmp_path)
    assert file.exists()


def test_a_whole_kept_response_is_used(own, tmp_path):
    expected = responses.Response(gain=1.0165)
    file = responses.response_file(own, tmp_path)
    file.parent.mkdir()
    file.write_text(kept_text(response_entry(own, expected)))
    assert responses.find_response(own, tmp_path) == expected


@pytest.mark.parametrize("text", ["", "{", "[]", '{"P2AT": {}}', '{"P2AT": {"response": {"gain": NaN}}}'])
def test_a_damaged_file_of_figures_is_one_line(tmp_path, text):
    file = tmp_path / "figures.json"
    file.write_text(text)
    with pytest.raises(usarmjx.SpecError) as refused:
        next(measure_all([ROBOTS.get("P2AT")], file))
    assert str(refused.value).startswith(f"{file}:")
    assert "\n" not in str(refused.value)
