"""Recordings computed again: to the last bit, on every engine, or the first difference is told."""

from dataclasses import fields, replace

import jax.numpy as jnp
import numpy as np
import pytest
from typer.testing import CliRunner

import usarmjx
from tests.recording.missions import HEIGHT, ROOM, SCOUT, mission_world
from usarmjx.base.errors import UsageError
from usarmjx.cli.app import app
from usarmjx.cli.recordings import recorded_episode
from usarmjx.models.compile.physics import Physics
from usarmjx.models.drives.ground import SkidSteer
from usarmjx.models.robots import ROBOTS
from usarmjx.recording.episodes import TrainingRecorder, episode_file
from usarmjx.recording.reader import Recording
from usarmjx.recording.replay import ReplayResult, check_recording
from usarmjx.server.worlds.batch_world import BatchWorld, SharedBatch
from usarmjx.server.worlds.recorded import record_worlds
from usarmjx.sim.batch import Batch
from usarmjx.sim.control import CommandUpdate
from usarmjx.sim.scene import RosterEntry, build_scene
from usarmjx.sim.single_world import SingleWorld

BARE = replace(ROOM, name="bare", has_floor=False, shapes=(), loose=(), victims=())
HOVER = replace(ROBOTS.get("AirRobot"), name="Hover", sensors=(), cameras=(), parts=())
"""Flies, and touches nothing: a scene that is compiled soon."""


def test_a_mission_is_computed_again_to_the_bit(mission):
    path, places = mission
    assert check_recording(Recording(path), 0) == ReplayResult(len(places))


def test_commands_that_come_otherwise_are_noticed(mission, monkeypatch):
    tell = SingleWorld.edit

    def edit(self, slot, **fields):
        command = fields["command"]
        tell(self, slot, command=command.replace(target=np.nextafter(command.target, np.float32(9))))

    monkeypatch.setattr(SingleWorld, "edit", edit)
    result = check_recording(Recording(mission[0]), 0)
    assert result.difference.startswith("at ")
    assert "First, " in result.difference
    assert "recorded" in result.difference
    assert "computed" in result.difference


def test_a_world_that_is_another_one_is_noticed_with_its_joint(mission, monkeypatch):
    step = SingleWorld.step

    def stumble(self):
        put_back = step(self)
        if int(self.world.step) == 25:
            data = self.engine.data
            address = self.engine.model.joint(_wheel(self)).qposadr[0]
            data.qpos[address] = np.nextafter(data.qpos[address], 99)
        return put_back

    monkeypatch.setattr(SingleWorld, "step", stumble)
    result = check_recording(Recording(mission[0]), 0)
    assert result.steps == 24
    assert result.difference.startswith("at 0.50 s (step 25): Second, joint ")


def _wheel(world):
    names = [world.engine.model.joint(i).name for i in range(world.engine.model.njnt)]
    return next(name for name in names if name.startswith("r1/") and name != "r1/root")


def test_what_the_command_line_says(mission, monkeypatch):
    run = CliRunner().invoke(app, ["replay", "--check", str(mission[0])])
    assert run.exit_code == 0
    assert f"{len(mission[1])} steps, bit for bit" in run.output
    monkeypatch.setattr(SingleWorld, "edit", lambda self, slot, **fields: None)
    run = CliRunner().invoke(app, ["replay", "--check", str(mission[0])])
    assert run.exit_code == 1
    assert " s (step " in run.output


def test_a_world_that_is_reset_or_redescribed_is_computed_again(tmp_path):
    world, file = mission_world(tmp_path / "reset.mcap")
    robot = world.spawn_at(SCOUT, "One", [((0.0, 0.0, HEIGHT), (0.0, 0.0, 0.0))])
    for step in range(30):
        if step == 3:
            world.update_command(robot, CommandUpdate(drive={"Left": 3.0, "Right": 4.0}))
        if step == 12:
            world.reset()
        if step == 20:
            world.update_robot_spec(robot, replace(SCOUT, battery_life=1.0))
        world.step()
    file.close()
    recording = Recording(file.path)
    assert check_recording(recording, 0) == ReplayResult(30)
    assert [m.value["kind"] for m in recording.messages(["events"])] == ["join", "reset"]


class StrangeDrive(SkidSteer):
    """Not among usarmjx's own drives."""


def test_a_robot_of_foreign_code_is_recorded_and_named_as_what_cannot_be_repeated(tmp_path):
    world, file = mission_world(tmp_path / "foreign.mcap")
    given = {field.name: getattr(SCOUT.drive, field.name) for field in fields(SCOUT.drive) if field.init}
    drive = StrangeDrive(**given)
    strange = replace(SCOUT, name="Strange", drive=drive)
    for _ in range(3):
        world.step()
    world.spawn_at(strange, "One", [((0.0, 0.0, HEIGHT), (0.0, 0.0, 0.0))])
    for _ in range(12):
        world.step()
    file.close()
    recording = Recording(file.path)
    result = check_recording(recording, 0)
    assert result.steps == 3
    assert "StrangeDrive" in result.note
    assert recording.last("frames", 0, 9.0).value.robots.keys() == {0}


@pytest.mark.parametrize("engine", ["c", pytest.param("jax", marks=pytest.mark.thorough)])
def test_worlds_of_a_batch_are_computed_again_to_the_bit(tmp_path, engine):
    scene = build_scene(BARE, [RosterEntry(robot=HOVER, parked=True)])
    shared = SharedBatch(Batch(scene, 2, engine=engine, seed=1))
    worlds = [BatchWorld(shared, number) for number in range(2)]
    file = record_worlds(worlds, tmp_path / "batch.mcap")
    for step in range(12):
        if step == 2:
            robot = worlds[1].spawn_at(HOVER, "One", [((0.0, 0.0, 1.0), (0.0, 0.0, 0.5))])
        if step == 4:
            worlds[1].update_command(robot, CommandUpdate(drive={"LinearVelocity": 1.0}))
        if step == 9:
            worlds[1].remove(robot)
        for world in worlds:
            world.step()
    file.close()
    recording = Recording(file.path)
    assert check_recording(recording, 1) == ReplayResult(12)
    states = [message.value for message in recording.messages(["states"], 1)]
    ways = np.array([state.qpos[:3] for state in states])
    assert np.linalg.norm(ways[7] - ways[2]) > 1e-4  # it flew


@pytest.fixture(scope="module")
def env():
    light = {"ranges": (), "pose": "GroundTruth", "physics": Physics(timestep=0.01, substeps=5), "repeat": 2}
    return usarmjx.make("drive-to-goal", worlds=2, engine="c", radius=1e-6, **light)


def act(env, state, step):
    (group,) = env.groups
    return env.step(state, (jnp.full((2, len(group.agents), group.action_size), 0.1 * step),))


def test_an_episode_of_a_policy_is_computed_again_to_the_bit(tmp_path, env):
    with recorded_episode(env, tmp_path / "episode.mcap", 4) as watch:
        state = env.reset(4)
        watch(state)
        for step in range(5):
            state = act(env, state, step)
            watch(state)
    recording = Recording(tmp_path / "episode.mcap")
    assert check_recording(recording, 0) == ReplayResult(5 * env.task.repeat)
    scores = [message.value.score for message in recording.messages(["frames"])]
    assert scores[0] == 0.0


def test_of_a_training_every_other_iteration_is_kept_and_cannot_be_repeated(tmp_path, env):
    state, places = env.reset(1), []
    with episode_file(env, tmp_path / "training.mcap") as file:
        recorder = TrainingRecorder(env, file, every=2, calls=3)
        for step in range(12):
            recorder.look(state)
            places.append(np.asarray(env.batch.physics(state.batch).qpos)[1])
            state = act(env, state, step)
    recording = Recording(tmp_path / "training.mcap")
    assert recording.worlds == (0, 1)
    kept = [places[step] for step in (1, 2, 3, 7, 8, 9)]  # the very first look tells where it begins
    states = [message.value.qpos for message in recording.messages(["states"], 1)]
    np.testing.assert_array_equal(states, kept)
    with pytest.raises(UsageError, match="cannot be computed again: training"):
        check_recording(recording, 0)


def test_nothing_is_recorded_that_nobody_asks_for(env):
    with recorded_episode(env, None, 4) as watch:
        assert watch is None
