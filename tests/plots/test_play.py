"""Pictures of a policy at work."""

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from tests.train.handmade import policy_file
from usarmjx.base.errors import UsageError
from usarmjx.cli.app import app
from usarmjx.models.compile.physics import Physics
from usarmjx.models.robots import ROBOTS
from usarmjx.plots.play import GIF_SPEEDUP, _caption, record_episode, save_recording
from usarmjx.server.pictures.image_server import ImageServer
from usarmjx.server.rosbridge.net import RosbridgeServer
from usarmjx.server.viewing.controls import ServedControls
from usarmjx.server.wireless.net import WirelessService
from usarmjx.server.worlds.policy_world import PolicyWorld
from usarmjx.train.make import make
from usarmjx.train.policies import policies_in, sources
from usarmjx.train.policies.sources import load_policy

LIGHT = {"ranges": (), "pose": "GroundTruth", "physics": Physics(timestep=0.01, substeps=5), "repeat": 4}
SEED = 2
FREE_PORTS = [word for port in ("wss", "wss2", "position", "image") for word in (f"--{port}-port", "0")]


@pytest.fixture(scope="module")
def driven(tmp_path_factory):
    """An environment and a policy that heads for its goals."""
    file = policy_file(tmp_path_factory.mktemp("policy") / "goal.npz")
    env = make("drive-to-goal", engine="c", episode_steps=150, **LIGHT)
    return env, load_policy(str(file)).policy(env)


@pytest.fixture(scope="module")
def shown(driven):
    return record_episode(*driven, seed=SEED)


def test_a_film_shows_where_the_robot_truly_was(driven, shown):
    """The critic is told the way to the goal; at full speed a step of 0.2 s is 0.14 m."""
    env, _ = driven
    way = np.asarray(env.reset(SEED).privileged[0, :2])
    np.testing.assert_allclose(shown.goal - shown.poses[0, 0, :2], way, atol=1e-5)
    np.testing.assert_allclose(np.diff(shown.times), env.period, rtol=1e-6)
    limit = ROBOTS.get("P2AT").drive.full_scale["Left"] * ROBOTS.get("P2AT").wheel_radius * env.period
    steps = np.linalg.norm(np.diff(shown.poses[:, 0, :2], axis=0), axis=-1)
    assert steps.max() < 1.05 * limit
    assert (shown.end, shown.scores[-1], shown.scores[-2]) == ("done", 1.0, 0.0)
    left = np.linalg.norm(shown.goal - shown.poses[-1, 0, :2])
    assert env.task.radius < left < env.task.radius + limit, "the step before it was there"


def test_a_film_ends_when_asked(driven):
    short = record_episode(*driven, seconds=1.0, seed=SEED)
    assert (len(short.times), short.times[-1], short.end) == (6, pytest.approx(1.0), "")
    with pytest.raises(UsageError, match="more than 0"):
        record_episode(*driven, seconds=0.0)


def test_captions_tell_time_and_score(shown):
    assert _caption(shown, 0) == "0.0 s   score 0.00"
    assert _caption(shown, len(shown.times) - 1) == f"{shown.times[-1]:.1f} s   score 1.00 (done)"


def test_a_strip_has_the_goal_in_every_moment(shown, tmp_path):
    save_recording(shown, tmp_path / "new" / "strip.png")
    picture = np.asarray(Image.open(tmp_path / "new" / "strip.png").convert("RGB")).astype(int)
    red = np.abs(picture - (0xC4, 0x12, 0x2F)).sum(-1) < 30
    rows, columns = np.array_split(np.arange(len(red)), 2), np.array_split(np.arange(red.shape[1]), 3)
    assert all(red[np.ix_(row, column)].sum() > 20 for row in rows for column in columns)


def test_an_animation_moves_and_lasts_as_long_as_the_episode(shown, tmp_path):
    save_recording(shown, tmp_path / "film.gif")
    with Image.open(tmp_path / "film.gif") as picture:
        assert picture.n_frames == len(shown.times)
        first, lasted = np.asarray(picture.convert("RGB")).astype(int), 0
        for frame in range(picture.n_frames):
            picture.seek(frame)
            lasted += picture.info["duration"]
        assert np.abs(np.asarray(picture.convert("RGB")).astype(int) - first).sum(-1).max() > 200
    # The last moment, which stays for 2 s, is that of the end.
    assert lasted == pytest.approx(1000 * shown.times[-1] / GIF_SPEEDUP + 2000, rel=0.02)


def test_other_endings_are_refused(shown, tmp_path):
    with pytest.raises(UsageError, match=r"pictures end in \.png, \.gif"):
        save_recording(shown, tmp_path / "film.mp4")
    done = CliRunner().invoke(app, ["play", "--baseline", "wander", "--out", "film.mp4"])
    assert done.exit_code == 2


def test_play_serves_the_world_that_a_policy_drives(tmp_path, monkeypatch):
    """What clients meet in it is tested with `DrivenWorld`."""
    served = []
    monkeypatch.setattr("usarmjx.server.runtime.loop.serve", lambda *given: served.append(given))
    file = policy_file(tmp_path / "goal.npz", {"ranges": ""})
    how = ["--port", "3001", "--realtime-factor", "2", "--set", "pose=GroundTruth"]
    how += ["--rosbridge-port", "0", *FREE_PORTS]
    done = CliRunner().invoke(app, ["play", str(file), "--serve", *how])
    assert done.exit_code == 0, done.output
    assert done.output == "robots to take over by INIT: P2AT0\n"
    (((server,), clock, _),) = served
    radio, pictures, ros, controls = server.services
    assert isinstance(radio, WirelessService)
    assert isinstance(pictures, ImageServer)
    assert isinstance(ros, RosbridgeServer)
    assert ros.server is server, "robots that appear there report to it"
    assert isinstance(controls, ServedControls)
    assert isinstance(server.world, PolicyWorld)
    assert (server.settings.host, server.settings.port, clock.factor) == ("127.0.0.1", 3001, 2.0)


@pytest.mark.thorough
def test_play_serves_several_worlds_of_one_batch(tmp_path, monkeypatch):
    served = []
    monkeypatch.setattr("usarmjx.server.runtime.loop.serve", lambda *given: served.append(given))
    file = policy_file(tmp_path / "goal.npz", {"ranges": ""})
    how = ["--worlds", "2", "--instances", "all", "--port", "3101", "--set", "pose=GroundTruth", *FREE_PORTS]
    done = CliRunner().invoke(app, ["play", str(file), "--serve", *how])
    assert done.exit_code == 0, done.output
    ((servers, _, _),) = served
    assert [server.settings.port for server in servers] == [3101, 3102]
    assert servers[0].world.policy_batch is servers[1].world.policy_batch
    done = CliRunner().invoke(app, ["play", str(file), "--serve", *how[:2], "--instances", "2"])
    assert done.exit_code == 2
    assert "instance 2 is not among worlds 0 to 1" in done.output


def test_play_runs_a_packaged_policy_by_the_name_of_its_task(tmp_path, monkeypatch):
    policy_file(tmp_path / "drive-to-goal.npz", {"ranges": "", "pose": "GroundTruth"})
    monkeypatch.setattr(sources, "POLICIES", policies_in(tmp_path))
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(app, ["play", "drive-to-goal", "--out", "strip.png", "--seconds", "1"])
    assert done.exit_code == 0, done.output
    assert "drive-to-goal: 1.0 s, score 0.00: strip.png" in done.output
    assert (tmp_path / "strip.png").read_bytes().startswith(b"\x89PNG")
